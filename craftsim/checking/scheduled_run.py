"""Running a whole schedule in physics, many cars at once, and checking where it ends."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from craftsim.discrete.grid import Grid
from craftsim.discrete.readback import Reading, read_grid
from craftsim.discrete.schedule import Schedule, ScheduledAction
from craftsim.discrete.verdict import Verdict, compare, describe_car
from craftsim.models.sensing import read_poses
from craftsim.skills.executor import Executor
from craftsim.skills.outcome import Outcome
from craftsim.skills.skill import Terrain


@dataclass(frozen=True)
class StepRecord:
    """One step of a schedule that was run."""

    index: int
    start_s: float
    end_s: float
    outcome: Outcome
    in_place: bool
    """Whether the car, and every cell that the action changes, read as predicted when it ended."""
    difference: str
    """What read otherwise, in words."""


@dataclass(frozen=True)
class ScheduledRun:
    """A schedule run in physics."""

    records: tuple[StepRecord, ...]
    """In the order in which the steps ended."""
    not_run: tuple[int, ...]
    """Steps that never started, because something that they wait for failed."""
    final: Reading
    verdict: Verdict
    """The final reading against the predicted end of the schedule."""
    makespan_s: float

    @property
    def agrees(self) -> bool:
        """Whether every step ran and ended in place, and the world ended as predicted."""
        return (
            not self.not_run
            and self.verdict.agrees
            and all(r.outcome.succeeded and r.in_place for r in self.records)
        )


def run_schedule(
    executor: Executor,
    schedule: Schedule,
    tell: Callable[[dict[int, ScheduledAction]], None] = lambda running: None,
) -> ScheduledRun:
    """Run the steps of a schedule, each as soon as all that it waits for have ended well.

    A car whose action fails stops there. What depends on a failed step is not run; the others finish.

    Args:
        executor: on a Site that stands as the schedule's first step expects.
        schedule: what to do.
        tell: called with the running steps by car whenever a step begins or ends.
    """
    start_s = executor.site.time_s
    steps = schedule.steps
    waiting = dict(enumerate(steps))
    running: dict[int, tuple[int, float]] = {}
    done: set[int] = set()
    records: list[StepRecord] = []
    reading: Reading | None = None
    while True:
        ready = [i for i, step in waiting.items() if step.waits_for <= done and step.car not in running]
        for index in ready:
            step = waiting.pop(index)
            if step.car in running:
                waiting[index] = step
                continue
            executor.begin(step.car, step.action, Terrain(*step.inclines))
            running[step.car] = index, executor.site.time_s
        if ready:
            tell({car: steps[index] for car, (index, _) in running.items()})
        if not running:
            break
        ended = executor.advance()
        reading = _read(executor) if ended else None
        for car, outcome in ended.items():
            index, began_s = running.pop(car)
            assert reading is not None
            record = _check(reading.grid, steps[index], index, began_s - start_s, outcome)
            records.append(record)
            if outcome.succeeded:
                done.add(index)
            tell({car: steps[index] for car, (index, _) in running.items()})
    makespan_s = executor.site.time_s - start_s
    # The loop ends with an action that has just been read, unless there was none.
    final = reading or _read(executor)
    first = steps[0].before if steps else schedule.final
    verdict = compare(first, schedule.final, final)
    return ScheduledRun(tuple(records), tuple(sorted(waiting)), final, verdict, makespan_s)


def _read(executor: Executor) -> Reading:
    site = executor.site
    return read_grid(read_poses(site), site.size, site.walls)


def _check(read: Grid, step: ScheduledAction, index: int, began_s: float, outcome: Outcome) -> StepRecord:
    """Compare what a step alone is responsible for: its car, and the cells that it changes."""
    ended_s = began_s + outcome.duration_s
    differences = []
    if not np.array_equal(read.cars[step.car], step.after.cars[step.car]):
        differences.append(
            f"car {step.car}: predicted {describe_car(step.after, step.car)}, read {describe_car(read, step.car)}"
        )
    for cell in sorted(step.footprint.changes):
        if read.kind[cell] != step.after.kind[cell] or read.yaw[cell] != step.after.yaw[cell]:
            differences.append(f"cell {cell} does not read as predicted")
    return StepRecord(index, began_s, ended_s, outcome, not differences, "; ".join(differences))
