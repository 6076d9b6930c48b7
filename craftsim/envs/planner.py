"""The planner as a policy: plans at an episode's start, and again whenever the world is not as its plan predicts."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

from craftsim.discrete.actions import Action
from craftsim.discrete.grid import Grid
from craftsim.discrete.schedule import ScheduledAction
from craftsim.envs.parallel import ParallelConstruction
from craftsim.errors import InputError
from craftsim.planning import NoPlanError, plan_building

ROUNDS: Final = 60
"""Attempts at each plan; more of them take longer and find shorter ones."""


class PlannerPolicy:
    """Plays an environment towards its task's goal, on the grid or in physics, from any start.

    Each car acts as soon as the actions that its own depends on are done. Where there is no plan the cars stop.

    Example:
        >>> import craftsim
        >>> from craftsim.envs.planner import PlannerPolicy
        >>> env = craftsim.parallel_env("strip", "grid")
        >>> policy = PlannerPolicy(env)
        >>> seen, _ = env.reset(seed=0)
        >>> while env.agents:
        ...     seen, rewards, ends, _, infos = env.step(policy(seen))
        >>> all(info["success"] for info in infos.values())
        True
    """

    def __init__(self, env: ParallelConstruction, rounds: int = ROUNDS, seed: int = 0) -> None:
        """Play in an environment, whose whole world is looked at.

        Args:
            env: runs the episodes.
            rounds: attempts at each plan.
            seed: of the plans.

        Raises InputError for a task that has no goal.
        """
        if not env.core.task.has_goal:
            raise InputError(
                f"task '{env.core.task.name}' has no goal to plan for; give it a design, or choose another policy"
            )
        self._env, self._rounds, self._seed = env, rounds, seed
        self._rules = env.core.rules
        self._predicted: Grid | None = None
        self._steps: tuple[ScheduledAction, ...] = ()
        self._done: set[int] = set()

    def __call__(self, observations: Mapping[str, Any]) -> dict[str, int]:
        """Return one action for each agent."""
        grid = self._env.grid
        if self._predicted is None or not self._predicted.same_visible(grid):
            self._plan(grid)
        ready: dict[int, tuple[int, Action]] = {}
        for index, step in enumerate(self._steps):
            if index not in self._done and step.waits_for <= self._done and step.car not in ready:
                ready[step.car] = index, step.action
        # What is ready at the same time does not depend on each other: any acting order does.
        for car, (index, action) in ready.items():
            grid = self._rules.apply(grid, car, action)
            self._done.add(index)
        self._predicted = grid
        chosen = {car: action for car, (_, action) in ready.items()}
        return {agent: int(chosen.get(int(agent[4:]), Action.STOP)) for agent in observations}

    def _plan(self, grid: Grid) -> None:
        self._done = set()
        try:
            planned = plan_building(
                *(grid, self._env.core.played, self._rules),
                rounds=self._rounds,
                time_s=math.inf,
                seed=self._seed,
            )
        except NoPlanError:
            self._steps = ()
        else:
            self._steps = planned.schedule.steps
