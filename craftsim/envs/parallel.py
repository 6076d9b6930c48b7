"""The PettingZoo form: every car is an agent, and all act at the same time."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from pettingzoo import ParallelEnv

from craftsim.envs.actions import by_agent
from craftsim.envs.backends import Backend
from craftsim.envs.observations import Observation
from craftsim.envs.options import Options
from craftsim.envs.single_world import SingleWorld
from craftsim.envs.spaces import car_space, state_space
from craftsim.tasks import Task

Infos = dict[str, dict[str, Any]]
ParallelStep = tuple[
    dict[str, Observation], dict[str, float], dict[str, bool], dict[str, bool], Infos
]
"""By agent: observations, rewards, whether they are terminated and truncated, infos."""


class Observations(dict[str, Observation]):
    """The observations of all agents, by agent, with their task, and whether an episode begins."""

    def __init__(self, observations: dict[str, Observation], task: Task, begins: bool) -> None:
        super().__init__(observations)
        self.task = task
        self.begins = begins


class CarWorld(SingleWorld):
    """What the PettingZoo forms share: ``car_0``, ``car_1``, ... are the agents.

    An agent observes ``{"observation", "action_mask"}``, and images if asked to; docs/reference/environments.md
    describes them, and the infos.
    """

    def __init__(self, task: Task | str, options: Options, backend: Backend | None = None) -> None:
        super().__init__(task, options, backend)
        task = self.core.task
        form = self.core.form
        self.metadata |= {"name": f"craftsim_{task.name}_v0", "is_parallelizable": True}
        self.possible_agents = [f"car_{car}" for car in range(self.core.n_cars)]
        self.agents: list[str] = []
        self.state_space = state_space(task)
        self._observation_spaces = {
            agent: car_space(task, options, form) for agent in self.possible_agents
        }
        self._action_spaces = {
            agent: spaces.Discrete(form.n_actions) for agent in self.possible_agents
        }

    def observation_space(self, agent: str) -> spaces.Dict:
        """Return an agent's observation space: what it observes, and its action mask."""
        return self._observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Discrete:
        """Return an agent's action space: the 15 primitive actions, and registered ones."""
        return self._action_spaces[agent]

    def observe_all(self) -> dict[str, Observation]:
        """Return the observations of all agents."""
        core = self.core
        observe = self.core.options.observe
        images = self.core.options.images
        car_observations: Any = core.vectors()
        if observe is not None:
            grid = core.grid
            car_observations = [observe.of(grid, car) for car in range(core.n_cars)]
        of_cars = {}
        for car, agent in enumerate(self.possible_agents):
            car_arrays = {
                key: array[car].copy() for key, array in core.seen.items() if key != "observation"
            }
            car_images = {}
            if images is not None:
                car_images = images.of_car(core.images, car)
            of_cars[agent] = {"observation": car_observations[car], **car_arrays, **car_images}
        return Observations(of_cars, core.task, bool(core.episodes.t[0] == 0))

    def state(self) -> NDArray[np.int32]:
        """Return the global state: the rows of all entities, flattened, as ``state_space`` says."""
        return self.core.state()


class ParallelConstruction(CarWorld, ParallelEnv[str, Observation, int]):
    """A task for cars that share one reward."""

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Observation], Infos]:
        """Begin an episode; see :meth:`craftsim.envs.core.Core.reset` for the options."""
        infos = self.core.reset(seed, options)
        self.agents = self.possible_agents[:]
        return self.observe_all(), dict(zip(self.agents, infos, strict=True))

    def step(self, actions: dict[str, int]) -> ParallelStep:
        """Let all cars act once.

        Raises InputError where no episode runs, and if an agent's action is missing or no number from 0 to 14.
        """
        agents = self.agents
        reward, terminated, truncated, infos = self.core.step(by_agent(actions, agents))
        if terminated or truncated:
            self.agents = []
        return (
            self.observe_all(),
            dict.fromkeys(agents, reward),
            dict.fromkeys(agents, terminated),
            dict.fromkeys(agents, truncated),
            dict(zip(agents, infos, strict=True)),
        )
