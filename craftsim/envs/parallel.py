"""The PettingZoo form: every car is an agent, and all act at the same time."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from pettingzoo import ParallelEnv

from craftsim.discrete.grid import Grid
from craftsim.discrete.tasks import Task
from craftsim.envs.actions import by_agent
from craftsim.envs.backend import Backend
from craftsim.envs.core import Core
from craftsim.envs.options import RENDER_FPS, RENDER_MODES, Options
from craftsim.envs.spaces import car_space, state_space

Observation = dict[str, NDArray[Any]]


class Observations(dict[str, Observation]):
    """What all agents observe, by agent; it knows of which task, so that a policy can refuse another one."""

    def __init__(self, seen: dict[str, Observation], task: Task) -> None:
        super().__init__(seen)
        self.task = task


class ParallelConstruction(ParallelEnv[str, Observation, int]):
    """A task for cars that share one reward; ``car_0``, ``car_1``, ... are the agents.

    An agent observes ``{"observation", "action_mask"}``, and images if asked to; docs/reference/environments.md
    describes them, and the
    infos.
    """

    metadata: ClassVar[dict[str, Any]] = {
        "render_modes": list(RENDER_MODES),
        "render_fps": RENDER_FPS,
        "is_parallelizable": True,
    }

    def __init__(self, task: Task | str, options: Options, backend: Backend | None = None) -> None:
        """Prepare a task; the first episode begins with :meth:`reset`. ``backend`` replaces the one of the options."""
        self.core = Core(task, options, backend)
        own = {"name": f"craftsim_{self.core.task.name}_v0", "render_fps": options.render_fps}
        self.metadata = type(self).metadata | own  # type: ignore[misc]
        self.render_mode = options.render_mode
        self.possible_agents = [f"car_{car}" for car in range(self.core.n_cars)]
        self.agents: list[str] = []
        self.state_space = state_space(self.core.task)
        self._own = options.observe
        self._images = options.images
        space, n = None if self._own is None else self._own.space, len(self.core.rules.actions)
        self._observation_spaces = {
            agent: car_space(self.core.task, space, self._images, n) for agent in self.possible_agents
        }
        self._action_spaces = {agent: spaces.Discrete(n) for agent in self.possible_agents}

    def observation_space(self, agent: str) -> spaces.Dict:
        """Return an agent's observation space: what it observes, and its action mask."""
        return self._observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Discrete:
        """Return an agent's action space: the 15 primitive actions, and registered ones."""
        return self._action_spaces[agent]

    @property
    def grid(self) -> Grid:
        """A copy of the world as it is seen."""
        return self.core.grid

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Observation], dict[str, dict[str, Any]]]:
        """Begin an episode; see :meth:`craftsim.envs.core.Core.reset` for the options."""
        infos = self.core.reset(seed, options)
        self.agents = self.possible_agents[:]
        return self._observe(), dict(zip(self.agents, infos, strict=True))

    def step(
        self, actions: dict[str, int]
    ) -> tuple[
        dict[str, Observation],
        dict[str, float],
        dict[str, bool],
        dict[str, bool],
        dict[str, dict[str, Any]],
    ]:
        """Let all cars act once.

        Raises InputError where no episode runs, and if an agent's action is missing or no number from 0 to 14.
        """
        self.core.require_episode()
        agents = self.agents
        result = self.core.step(by_agent(actions, agents))
        if result.terminated or result.truncated:
            self.agents = []
        return (
            self._observe(),
            dict.fromkeys(agents, result.reward),
            dict.fromkeys(agents, result.terminated),
            dict.fromkeys(agents, result.truncated),
            dict(zip(agents, result.infos, strict=True)),
        )

    def _observe(self) -> dict[str, Observation]:
        masks = self.core.masks.copy()
        seen = list(self.core.vectors())
        if self._own is not None:
            grid = self.core.grid
            seen = [self._own.of(grid, car) for car in range(self.core.n_cars)]
        of_cars = {
            agent: {"observation": seen[car], "action_mask": masks[car]}
            for car, agent in enumerate(self.possible_agents)
        }
        if self._images is not None:
            for car, observation in enumerate(of_cars.values()):
                observation |= self._images.of_car(self.core.images, car)
        return Observations(of_cars, self.core.task)

    def state(self) -> NDArray[np.int32]:
        """Return the global state: the rows of all entities, flattened, as ``state_space`` says."""
        return self.core.state()

    def render(self) -> NDArray[np.uint8] | list[NDArray[np.uint8]] | str | None:
        """Return a picture (``rgb_array``), all since the last call (``rgb_array_list``) or text (``ansi``).

        ``human`` shows every tick by itself.
        """
        return self.core.render()

    def close(self) -> None:
        """Release what rendering holds."""
        self.core.close()
