"""When each action of a schedule starts and ends at nominal physics: what a plan takes in seconds, without physics."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.durations import nominal_durations, situation
from craftsim.discrete.schedule import Schedule


def timetable(schedule: Schedule) -> NDArray[np.float64]:
    """Return the start and the end of each step in seconds, shape (n, 2).

    A step starts as soon as all that it waits for has ended, and takes the time that was measured for its action at
    nominal physics (:func:`craftsim.discrete.durations.nominal_durations`): a longest path through the dependencies.
    """
    steps = schedule.steps
    times = np.zeros((len(steps), 2))
    if not steps:
        return times
    cars = np.array([step.car for step in steps])
    before, after = (
        np.array([grid.cars[car] for grid, car in zip(grids, cars, strict=True)])
        for grids in ([step.before for step in steps], [step.after for step in steps])
    )
    lasting = nominal_durations()[[step.action for step in steps], situation(before, after)].tolist()
    ends: list[float] = []
    for index, step in enumerate(steps):
        start = max((ends[other] for other in step.waits_for), default=0.0)
        ends.append(start + lasting[index])
        times[index] = start, ends[index]
    return times


def makespan(times: NDArray[np.float64]) -> float:
    """Return when the last step of a timetable (n, 2) ends, in seconds; 0 of an empty one."""
    return float(times[:, 1].max(initial=0.0))
