"""CraftEnv's tasks for LeRobot's EnvHub: put this file and requirements.txt into a repository of the Hub.

    from lerobot.envs.factory import make_env
    tasks = make_env("OWNER/REPOSITORY", n_envs=4, trust_remote_code=True)["craftsim"]

Policies of LeRobot act in continuous numbers. Here these are a score for each action of each car, and every car does
the legal action with the highest one. ``CRAFTSIM_BACKEND=grid`` plays by the rules alone, and fast.
"""

import os
from functools import partial

import gymnasium
import numpy as np
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv

import craftsim.envs
from craftsim.envs.text import goal_text


class ForLeRobot(gymnasium.Wrapper):
    """One task with the keys, infos and actions of LeRobot."""

    def __init__(self, env):
        """Wrap the environment of a task, as Gymnasium makes it."""
        super().__init__(env)
        core = env.unwrapped.core
        self.task = core.task.name
        self.task_description = f"{self.task}: {goal_text(core.task)}"
        self._max_episode_steps = core.task.max_steps + 2
        state = env.observation_space["observation"]
        self.observation_space = gymnasium.spaces.Dict(
            {"environment_state": gymnasium.spaces.Box(-np.inf, np.inf, state.shape, np.float32)}
        )
        choices = env.action_space.nvec
        self._scores = (len(choices), choices[0])
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (choices.sum(),), np.float32)

    def reset(self, *, seed=None, options=None):
        """Begin an episode."""
        observation, info = self.env.reset(seed=seed)
        self._mask = info["action_mask"]
        return self._seen(observation), {"is_success": False}

    def step(self, action):
        """Let each car do its legal action with the highest score; ``action`` (n_cars * actions,)."""
        scores = np.where(self._mask == 1, np.reshape(action, self._scores), -np.inf)
        observation, reward, terminated, truncated, info = self.env.step(scores.argmax(axis=1))
        self._mask = info["action_mask"]
        success = {"is_success": bool(info["success"])}
        return self._seen(observation), reward, terminated, truncated, success

    def _seen(self, observation):
        return {"environment_state": observation["observation"].astype(np.float32)}


def make_one(task):
    """Return one environment of a task."""
    backend = os.environ.get("CRAFTSIM_BACKEND", "physics")
    # LeRobot looks at the spaces itself.
    env = gymnasium.make(task, backend=backend, disable_env_checker=True)
    return ForLeRobot(env)


def make_env(n_envs=1, use_async_envs=False, cfg=None):
    """Return by suite and number the batches of environments of CraftEnv's six tasks, as EnvHub asks for them.

    ``cfg``, a configuration of LeRobot, may name one of them as its ``task``.
    """
    names = list(craftsim.envs.TASK_NAMES)
    if getattr(cfg, "task", None):
        names = [cfg.task]
    kind = AsyncVectorEnv if use_async_envs else SyncVectorEnv
    batches = {}
    for number, name in enumerate(names):
        make = partial(make_one, craftsim.envs.TASK_IDS[name])
        batches[number] = kind([make] * n_envs, autoreset_mode=AutoresetMode.SAME_STEP)
    return {"craftsim": batches}
