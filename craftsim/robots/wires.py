"""Records and arrays through which compiled laws measure and command robots that are no part of a PhysicsWorld."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from craftsim.discrete.kernel.jit import records
from craftsim.models.measuring import READING, UNDERSIDE, WIRING, CarMeasurement, Records, write_reading
from craftsim.skills.fleet import Wires
from craftsim.skills.skill import Command

_MOTORS = 5
"""Of a car: four wheels and the board."""


class Harness:
    """The wires of n cars and of the hinges of some slopes, and what was measured last."""

    def __init__(self, n_cars: int, n_slopes: int) -> None:
        """Lay the wires; nothing is commanded."""
        cars, plugs = records(n_cars, WIRING), records(n_slopes, UNDERSIDE)
        for car, row in enumerate(cars):
            row["wheel_motors"] = range(_MOTORS * car, _MOTORS * car + 4)
            row["board_motor"] = _MOTORS * car + 4
        plugs["motor"] = range(_MOTORS * n_cars, _MOTORS * n_cars + n_slopes)
        ctrl = np.zeros(_MOTORS * n_cars + n_slopes)
        self.wires = Wires(cars, plugs, np.zeros((n_cars, 4)), np.ones(1), ctrl)
        self.readings: Records = records(n_cars, READING)
        """(n,) READING."""

    def measured(self, measurements: Sequence[CarMeasurement]) -> None:
        """Take a measurement of each car. Raises ValueError for other slopes than there are."""
        n_slopes = len(self.wires.plugs)
        for car, now in enumerate(measurements):
            if now.slope is not None and not 0 <= now.slope < n_slopes:
                raise ValueError(f"car {car} is docked to slope {now.slope}, and there are {n_slopes}")
            write_reading(now, self.readings[car : car + 1])

    def commands(self) -> tuple[Command, ...]:
        """Return what stands on the wires, for each car; a hinge's is that of the car that is docked to its slope."""
        ctrl, found = self.wires.ctrl.tolist(), []
        hinges = ctrl[_MOTORS * len(self.readings) :]
        for car, slope in enumerate(self.readings["slope"].tolist()):
            fl, fr, rl, rr, board = ctrl[_MOTORS * car : _MOTORS * (car + 1)]
            found.append(Command((fl, fr, rl, rr), board, hinges[slope] if slope >= 0 else 0.0))
        return tuple(found)

    def stop(self, car: int, slope: int) -> None:
        """Command a car's motors to zero, and the hinge of a slope, -1 for none."""
        wires = self.wires
        wires.speeds[car] = 0.0
        wires.ctrl[_MOTORS * car : _MOTORS * (car + 1)] = 0.0
        if slope >= 0:
            wires.ctrl[wires.plugs[slope]["motor"]] = 0.0
