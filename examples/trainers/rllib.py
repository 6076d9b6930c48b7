"""PPO of RLlib with its module for masks, which wants other keys and floats."""

import gymnasium
import numpy as np
import ray
import torch
from pettingzoo.utils import BaseParallelWrapper
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.core.rl_module.multi_rl_module import MultiRLModuleSpec
from ray.rllib.core.rl_module.rl_module import RLModuleSpec
from ray.rllib.env.wrappers.pettingzoo_env import ParallelPettingZooEnv
from ray.rllib.examples.rl_modules.classes.action_masking_rlm import ActionMaskingTorchRLModule
from ray.tune.registry import register_env

from craftsim.envs import parallel_env


class Masked(BaseParallelWrapper):
    """Names and types as RLlib's masking example has them."""

    def observation_space(self, agent):
        space = self.env.observation_space(agent)
        box = space["observation"]
        mask = gymnasium.spaces.Box(0.0, 1.0, space["action_mask"].shape, np.float32)
        own = gymnasium.spaces.Box(
            float(box.low.min()), float(box.high.max()), box.shape, np.float32
        )
        return gymnasium.spaces.Dict({"action_mask": mask, "observations": own})

    def _named(self, seen):
        return {
            agent: {
                "action_mask": of["action_mask"].astype(np.float32),
                "observations": of["observation"].astype(np.float32),
            }
            for agent, of in seen.items()
        }

    def reset(self, seed=None, options=None):
        seen, infos = super().reset(seed, options)
        return self._named(seen), infos

    def step(self, actions):
        seen, *rest = super().step(actions)
        return self._named(seen), *rest


ray.init(address="local", include_dashboard=False)  # no cluster that happens to run
register_env("strip", lambda config: ParallelPettingZooEnv(Masked(parallel_env("strip", "grid"))))
module = RLModuleSpec(
    module_class=ActionMaskingTorchRLModule,
    model_config={"head_fcnet_hiddens": [64], "vf_share_layers": False},
)
config = (
    PPOConfig()
    .environment("strip")
    .env_runners(num_env_runners=0)
    .multi_agent(policies={"car"}, policy_mapping_fn=lambda agent, episode, **_: "car")
    .rl_module(rl_module_spec=MultiRLModuleSpec(rl_module_specs={"car": module}))
    .training(train_batch_size_per_learner=80, minibatch_size=40, num_epochs=1)
    .debugging(seed=0)
)
algorithm = config.build_algo()
result = algorithm.train()
assert result["env_runners"]["num_env_steps_sampled"] >= 80

env = Masked(parallel_env("strip", "grid"))  # what it learnt plays
seen, _ = env.reset(seed=1)
keys = ("action_mask", "observations")
batch = {"obs": {key: torch.tensor(np.stack([of[key] for of in seen.values()])) for key in keys}}
rated = algorithm.get_module("car").forward_inference(batch)["action_dist_inputs"]
actions = dict(zip(seen, rated.argmax(-1).tolist(), strict=True))
assert all(of["action_mask"][actions[agent]] for agent, of in seen.items())
env.step(actions)
algorithm.stop()
ray.shutdown()
