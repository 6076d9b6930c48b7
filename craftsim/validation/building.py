"""A task with a plan, and the episode in which the plan was executed in physics."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from craftsim.checking.attempt import Attempt
from craftsim.checking.episode import Episode, Watch, unwatched
from craftsim.checking.setup import SetUp, Setup, set_up
from craftsim.discrete.files.design import read_design
from craftsim.discrete.files.plan import Plan, read_plan
from craftsim.discrete.files.shipped import shipped_plan
from craftsim.discrete.tasks import TASK_NAMES, Task, as_task
from craftsim.errors import InputError
from craftsim.logs.log import Log
from craftsim.rendering.trajectory import Trajectory
from craftsim.validation.rollout import PlanOrder, Run, roll_out, steps_of


@dataclass(frozen=True)
class Building:
    """A task with a plan and, once it was executed, its episode and recordings."""

    task: Task
    plan: Plan
    episode: Episode | None = None
    trajectory: Trajectory | None = None
    logs: Mapping[int, Log] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Name of the task."""
        return self.task.name

    @property
    def n_actions(self) -> int:
        """Number of actions in the plan."""
        return sum(len(tick) for tick in self.plan.ticks)

    @property
    def attempts(self) -> tuple[Attempt, ...]:
        """The attempts at the plan's actions; empty before the execution."""
        return self.episode.attempts if self.episode is not None else ()

    @property
    def n_agree(self) -> int:
        """Number of actions that did what the rules predict, within all limits."""
        return sum(attempt.agrees for attempt in self.attempts)

    @property
    def reached(self) -> bool | None:
        """Whether the goal is reached; None without a goal."""
        return self.episode.reached if self.episode is not None else None

    @property
    def good(self) -> bool:
        """Whether every action of the plan agrees and no goal was missed."""
        return self.n_agree == self.n_actions and self.reached is not False

    def run(
        self, setup: Setup, seed: int, order: PlanOrder, watch: Watch = unwatched, where: SetUp = set_up
    ) -> Building:
        """Execute the plan in a world that ``where`` sets up, and return the building with its episode."""
        steps = steps_of(self.plan.ticks, order, self.plan.after)
        run = Run(key=self.name, world=self.task, by=steps, seed=seed, setup=setup, record=True, set_up=where)
        done = roll_out(run, watch)
        return replace(self, episode=done.episode, trajectory=done.trajectory, logs=done.logs)

    @property
    def figures(self) -> dict[str, Any]:
        """Metrics for the report; lengths in mm, angles in mrad, None where nothing was measured."""
        assert self.episode is not None

        def worst(name: str) -> float | None:
            values = [getattr(attempt, name) for attempt in self.attempts]
            return max((1e3 * value for value in values if value is not None), default=None)

        return {
            "actions": self.attempts,
            "agree": self.n_agree,
            "total": self.n_actions,
            "ticks": len(self.plan.ticks),
            "matches_goal": self.reached,
            "simulated_s": round(self.episode.end_s, 6),
            "makespan_s": self.episode.makespan_s,
            "capped_steps": sum(attempt.capped_steps for attempt in self.attempts),
            "retried": sum(attempt.tries > 1 for attempt in self.attempts),
            "max_car_error_mm": worst("car_error_m"),
            "max_car_heading_error_mrad": worst("heading_error_rad"),
            "max_placed_error_mm": worst("placed_error_m"),
            "max_bystander_displacement_mm": worst("bystander_displacement_m"),
        }

    @property
    def files(self) -> dict[str, str | None]:
        """Names of its files, and the task's digest."""
        task = self.task
        return {
            "task": self.name,
            "task_digest": task.digest,
            "blueprint": task.starts[0].path.name,
            "plan": self.plan.path.name,
            "goal": task.design.path.name if task.design else None,
        }


def read_building(task: str, plan: Path | None = None, goal: Path | None = None) -> Building:
    """Return a task with its plan, its own or that of a file, and with the design in the file ``goal``, if given.

    Raises InputError for an invalid file, and if there is no plan for this task.
    """
    found = as_task(task)
    if plan is None and found.name not in TASK_NAMES:
        raise InputError(
            f"there is no shipped plan for {task}; give one with --plan "
            f"(shipped ones: {', '.join(TASK_NAMES)})"
        )
    if goal is not None:
        found = replace(found, design=read_design(goal), success="built")
    return Building(found, read_plan(plan or shipped_plan(found.name), found.layout.n_cars))
