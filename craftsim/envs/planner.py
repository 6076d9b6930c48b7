"""Plans as policies: one that is given, or the planner's, made again whenever the world is not as the plan predicts."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from contextlib import suppress
from typing import Any, Final

from craftsim.discrete.grid import Grid
from craftsim.discrete.kinds import Action
from craftsim.discrete.schedule import ScheduledAction, make_schedule
from craftsim.envs.single_world import SingleWorld
from craftsim.errors import InputError
from craftsim.planning import NoPlanError, plan_building
from craftsim.planning.plan_file import Plan

ROUNDS: Final = 60
"""Attempts at each plan; more of them take longer and find shorter ones."""


def _due(remaining: dict[int, ScheduledAction]) -> dict[int, Action]:
    """Take what cars are to do now out of what is left of a schedule, by car; any acting order of it will do.

    Each car acts as soon as the actions that its own depends on are done.
    """
    ready: dict[int, int] = {}
    for index, step in remaining.items():
        if remaining.keys().isdisjoint(step.waits_for):
            ready.setdefault(step.car, index)
    return {car: remaining.pop(index).action for car, index in ready.items()}


def _answer(chosen: Mapping[int, Action], agents: Iterable[str]) -> dict[str, int]:
    return {agent: int(chosen.get(int(agent[4:]), Action.STOP)) for agent in agents}


class PlanPolicy:
    """Plays one episode by a plan, whatever comes of it, from the world in which the first call finds it.

    Each car acts as soon as the actions that its own depends on have been tried, so that the order in which the cars of
    a tick act plays no part; the plan may take other numbers of ticks. What the rules forbid is left out.
    """

    def __init__(self, env: SingleWorld, plan: Plan) -> None:
        self._env = env
        self._plan = plan
        self._left: dict[int, ScheduledAction] | None = None

    def __call__(self, observations: Mapping[str, Any]) -> dict[str, int]:
        """Return one action for each agent."""
        if self._left is None:
            core = self._env.core
            plan = self._plan
            schedule = make_schedule(core.grid, plan.ticks, core.rules, after=plan.after)
            self._left = dict(enumerate(schedule.steps))
        return _answer(_due(self._left), observations)


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

    def __init__(self, env: SingleWorld, rounds: int = ROUNDS, seed: int = 0) -> None:
        """Play in an environment, whose whole world is looked at. Raises InputError for a task that has no goal."""
        if not env.core.task.has_goal:
            raise InputError(
                f"task '{env.core.task.name}' has no goal to plan for; give it a design, or choose another policy"
            )
        self._env = env
        self._rounds = rounds
        self._seed = seed
        self._predicted: Grid | None = None
        self._left: dict[int, ScheduledAction] = {}

    def __call__(self, observations: Mapping[str, Any]) -> dict[str, int]:
        """Return one action for each agent."""
        core = self._env.core
        grid = self._env.core.grid
        if self._predicted is None or not self._predicted.same_visible(grid):
            search_options: Any = {"rounds": self._rounds, "time_s": math.inf, "seed": self._seed}
            self._left = {}
            with suppress(NoPlanError):
                self._left = dict(
                    enumerate(
                        plan_building(
                            grid, core.played, core.rules, **search_options
                        ).schedule.steps
                    )
                )
        chosen = _due(self._left)
        for car, action in chosen.items():
            grid = core.rules.apply(grid, car, action)
        self._predicted = grid
        return _answer(chosen, observations)
