"""What cars do about blocks that keep a world from being read: where they recover, they lift them anew."""

from __future__ import annotations

from typing import Final

import numpy as np

from craftsim.checking.judge import Judge
from craftsim.checking.seating import FURTHEST_M
from craftsim.discrete.grid import CarField, Kind
from craftsim.discrete.kinds import Action
from craftsim.discrete.readback import TILT_TOLERANCE_RAD

MOST_SEATED: Final = 4
"""Loads that are set right in one episode at most."""
_SEATING: Final[tuple[Action, ...]] = (Action.DROP, Action.LIFT)
"""What a car does whose load sits off its seat; one that stands below it lifts."""


def loads_to_seat(judge: Judge) -> dict[int, tuple[Action, ...]]:
    """Return what idle cars do about blocks that sit off their seats, or stand around them beside the middle, by car.

    Empty where nothing does, or where something else cannot be read. Cars on slopes are left out.
    """
    actions_by_car = dict[int, tuple[Action, ...]]()
    if not judge.problems:
        return actions_by_car
    names = []
    cells = [fit.cell for fit in judge.reading.cars]
    unable = judge.running.keys() | judge.executor.fleet.lost_cars.keys()
    unable = unable | set(np.flatnonzero(judge.grid.cars[:, CarField.SLOPE]).tolist())
    for index, fit in enumerate(judge.reading.objects):
        name = f"{judge.poses.name(index)} "
        is_slope = judge.poses.kinds[index] == Kind.FSLOPE
        if is_slope or not any(text.startswith(name) for text in judge.problems):
            continue
        # A load that sits off its seat leans on the boss.
        car = fit.carrier
        actions = _SEATING
        is_upright = fit.tilt_rad < TILT_TOLERANCE_RAD
        if car is None and is_upright and fit.cell in cells and fit.offset_m < FURTHEST_M:
            car = cells.index(fit.cell)
            actions = _SEATING[1:]
        if car is not None and car not in unable:
            actions_by_car[car] = actions
            names.append(name)
    if not all(text.startswith(tuple(names)) for text in judge.problems):
        return {}
    return actions_by_car
