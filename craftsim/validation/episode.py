"""Episodes: what a plan, a policy, random play or a planner did in physics, and what was recorded of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from craftsim.checking.attempt import Attempt
from craftsim.checking.measurements import SUMMARIZED, Measurement
from craftsim.checking.recipe import Recipe
from craftsim.discrete.grid import Grid
from craftsim.discrete.kinds import PlanTick
from craftsim.rendering.trajectory import Trajectory
from craftsim.robots.log import Log
from craftsim.tasks import Task


@dataclass(frozen=True, kw_only=True)
class Episode:
    """A run of a plan, a policy, random play or a planner in physics, with its recordings if any."""

    task: Task
    """The task of this episode: where each has a design of its own, with that."""
    start: Grid
    ticks: tuple[PlanTick, ...] | None = None
    """The ticks of the plan that was executed, given or drawn by random play; None for a policy and for a planner."""
    recipe: Recipe
    """Its start and all its steps, from which it can be repeated bit for bit."""
    steps: tuple[tuple[Attempt, ...], ...]
    """The attempts of each step, forbidden ones included."""
    reached: bool | None
    """Whether the goal is reached in physics; None without a goal."""
    reached_by_rules: bool | None
    """Whether the same plan or policy reaches it by the rules alone."""
    end_s: float
    """Simulated time."""
    problems: tuple[str, ...]
    """Why the world at the end cannot be read as a grid; empty if it can."""
    ending: Mapping[str, str | float] | None = None
    """The result of building with replanning; None without it.

    ``ended`` is ``built``, ``gave up`` or ``not readable``, and ``why`` says why it is not built; ``replans`` counts
    further plans, ``seated`` loads that sat off their seats and were lifted again; ``planned_s`` is the makespan of the
    first plan by the table of durations, and ``disturbed`` describes a declared disturbance. Texts may be empty.
    """
    recovery: Mapping[str, str | int] | None = None
    """What a policy needed with recovery; None without: why the planner went on in its place, if it did, as
    ``replaces``, the number of ``plans``, and that of loads that were ``seated`` again."""
    trajectory: Trajectory | None = None
    """None unless it was recorded."""
    logs: Mapping[int, Log] = field(default_factory=dict)
    """Logs by car; empty unless it was recorded."""

    @property
    def attempts(self) -> tuple[Attempt, ...]:
        """All attempts."""
        attempts = []
        for step in self.steps:
            for attempt in step:
                attempts.append(attempt)
        return tuple(attempts)

    @property
    def forbidden(self) -> tuple[Attempt, ...]:
        """What the rules forbid, and was not tried."""
        return tuple(attempt for attempt in self.attempts if not attempt.legal)

    @property
    def agrees(self) -> bool:
        """Whether all that the rules allow did what they predict, within all limits."""
        return all(attempt.agrees for attempt in self.attempts if attempt.legal)

    @property
    def n_ticks(self) -> int:
        """Ticks that were begun."""
        return 1 + max((attempt.tick for attempt in self.attempts), default=-1)

    @property
    def makespan_s(self) -> float:
        """Simulated time from the start of the first action to the end of the last."""
        performed = [attempt for attempt in self.attempts if attempt.performed]
        end_s = max((attempt.start_s + attempt.duration_s for attempt in performed), default=0.0)
        start_s = min((attempt.start_s for attempt in performed), default=0.0)
        return round(end_s - start_s, 6)

    @property
    def first_disagreement(self) -> int | None:
        """The first step in which something allowed did not go as predicted."""
        for number, step in enumerate(self.steps):
            if any(attempt.legal and not attempt.agrees for attempt in step):
                return number
        return None

    def until(self, step: int) -> Recipe:
        """Return the recipe that ends with a step."""
        return replace(self.recipe, steps=self.recipe.steps[: step + 1])

    @property
    def name(self) -> str:
        """Name of the task."""
        return self.task.name

    @property
    def n_planned(self) -> int:
        """Number of actions in the plan, with replanning of all that were begun; 0 without one."""
        if self.ending is not None:
            return sum(attempt.performed for attempt in self.attempts)
        return sum(len(tick) for tick in self.ticks or ())

    @property
    def n_agree(self) -> int:
        """Number of actions that did what the rules predict, within all limits."""
        return sum(attempt.agrees for attempt in self.attempts)

    @property
    def succeeded(self) -> bool:
        """Whether every action of the plan agrees and no goal was missed; with replanning, whether it is built."""
        if self.ending is not None:
            return self.ending["ended"] == "built"
        return self.n_agree == self.n_planned and self.reached is not False

    @property
    def figures(self) -> dict[str, Any]:
        """Metrics of an executed plan for a report; lengths in mm, angles in mrad, None where nothing was measured."""
        attempts = self.attempts
        return {
            "actions": attempts,
            "agree": self.n_agree,
            "total": self.n_planned,
            "ticks": self.n_ticks if self.ticks is None else len(self.ticks),
            "matches_goal": self.reached,
            "simulated_s": round(self.end_s, 6),
            "makespan_s": self.makespan_s,
            "capped_steps": sum(attempt.capped_steps for attempt in attempts),
            "retried": sum(attempt.tries > 1 for attempt in attempts),
            **{row.largest_name: self._largest(row) for row in SUMMARIZED},
        }

    def _largest(self, measurement: Measurement) -> float | None:
        """Return the largest value of the attempts, in the unit of reports; None where nothing was measured."""
        factor = measurement.unit.factor
        values = [getattr(attempt, measurement.name) for attempt in self.attempts]
        return max((factor * value for value in values if value is not None), default=None)
