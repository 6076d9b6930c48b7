"""Plans as policies: one that is given, or the planner's, made again whenever the world is not as the plan predicts."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from typing import Any, Final

from craftsim.discrete.grid import Grid
from craftsim.discrete.kinds import Action
from craftsim.discrete.schedule import ScheduledAction, make_schedule
from craftsim.envs.asynchronous_core import AsynchronousCore
from craftsim.envs.core import Core
from craftsim.envs.single_world import SingleWorld
from craftsim.errors import InputError
from craftsim.planning import NoPlanError, plan_building
from craftsim.planning.plan_file import Plan
from craftsim.tasks.asynchronous import BEGUN

ROUNDS: Final = 60
"""Attempts at each plan; more of them take longer and find shorter ones."""
_VISITS: Final = 3
"""A policy that comes to the same world so often goes in circles."""
_PATIENCE: Final = 1 / 3
"""Share of an episode's ticks in which a policy that gets on comes nearer to the goal; the rest is enough for a
plan."""


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

    Each car acts as soon as the actions that its own depends on are done. Where there is no plan the cars stop. With a
    ``policy`` that one plays, and the planner goes on from the world in which it gets no further.

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

    def __init__(
        self,
        env: SingleWorld,
        rounds: int = ROUNDS,
        seed: int = 0,
        policy: Callable[[Any], Mapping[str, int]] | None = None,
        most_plans: int | None = None,
    ) -> None:
        """Play in an environment, whose whole world is looked at; with ``most_plans`` no more are made in an episode.

        Raises InputError for a task that has no goal.
        """
        if not env.core.task.has_goal:
            raise InputError(
                f"task '{env.core.task.name}' has no goal to plan for; give it a design, or choose another policy"
            )
        self._env = env
        self._rounds = rounds
        self._seed = seed
        self._policy = policy
        self._most_plans = most_plans
        self._begin()

    def _begin(self) -> None:
        self.n_plans = 0
        """Number of plans in this episode."""
        self.replaces = ""
        """Why the planner plays in place of the policy; empty while it does not."""
        self._progress = _Progress()
        self._predicted: Grid | None = None
        self._left: dict[int, ScheduledAction] = {}
        self._asked: dict[int, ScheduledAction] = {}
        """Actions of the last answer, which may not have begun."""

    def __call__(self, observations: Mapping[str, Any]) -> dict[str, int]:
        """Return one action for each agent."""
        core = self._env.core
        if getattr(observations, "begins", False):
            self._begin()
        if self._policy is not None:
            self.replaces = self.replaces or self._progress.problem(core)
            if not self.replaces:
                return dict(self._policy(observations))
        if isinstance(core, AsynchronousCore):
            self._note_begun(core)
        if self._predicted is None or not self._predicted.same_visible(core.grid):
            self._plan(core)
        if self._policy is not None and not self._left:
            return dict(self._policy(observations))
        if isinstance(core, AsynchronousCore):
            chosen = self._due_of_deciding(core)
        else:
            chosen = _due(self._left)
            for car, action in chosen.items():
                self._predict(core, car, action)
        return _answer(chosen, observations)

    def _plan(self, core: Core) -> None:
        """Plan from the world that is read, with the effects of what runs."""
        self._predicted = core.grid
        self._left = {}
        if self.n_plans == self._most_plans:
            return
        search_options: Any = {"rounds": self._rounds, "time_s": math.inf, "seed": self._seed}
        with suppress(NoPlanError):
            planned = plan_building(self._predicted, core.played, core.rules, **search_options)
            self.n_plans += 1
            self._left = dict(enumerate(planned.schedule.steps))

    def _predict(self, core: Core, car: int, action: Action) -> None:
        assert self._predicted is not None
        self._predicted = core.rules.apply(self._predicted, car, action)

    def _note_begun(self, core: AsynchronousCore) -> None:
        """Predict what the last answer has begun; what could not begin, for another car's claims, is still left."""
        outcomes = core.episodes.running.outcome[0].tolist()
        for index, step in self._asked.items():
            if outcomes[step.car] == BEGUN:
                self._predict(core, step.car, step.action)
            else:
                self._left[index] = step
        self._left = dict(sorted(self._left.items()))
        self._asked = {}

    def _due_of_deciding(self, core: AsynchronousCore) -> dict[int, Action]:
        """Take what the cars that decide can begin out of what is left, by car."""
        masks = core.masks
        chosen = {}
        for index, step in list(self._left.items()):
            car = step.car
            is_due = car in core.turns and car not in chosen
            if not is_due or not self._left.keys().isdisjoint(step.waits_for):
                continue
            if masks[car, step.action]:
                chosen[car] = step.action
                self._asked[index] = step
        for index in self._asked:
            del self._left[index]
        return chosen


class _Progress:
    """The worlds of an episode that a policy has come to."""

    def __init__(self) -> None:
        self._visits = Counter[bytes]()
        self._best = -math.inf
        """Largest potential so far."""
        self._best_tick = 0
        self._last = b""

    def problem(self, core: Core) -> str:
        """Note the present world; return why the policy gets no further, or nothing."""
        grid = core.grid
        world = grid.cells.tobytes() + grid.cars.tobytes()
        if world != self._last:
            self._visits[world] += 1
        self._last = world
        episodes = core.episodes
        tick = int(episodes.t[0])
        potential = float(episodes.potential[0])
        if potential > self._best:
            self._best = potential
            self._best_tick = tick
        if self._visits[world] >= _VISITS:
            return f"the world was the same {_VISITS} times"
        patience = max(1, round(_PATIENCE * core.played.max_steps))
        if tick - self._best_tick >= patience:
            return f"nothing was gained in {patience} ticks"
        return ""
