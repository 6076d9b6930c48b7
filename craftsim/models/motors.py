"""What becomes of commanded wheel speeds on their way to the servos."""

from __future__ import annotations

import math

import numpy as np

from craftsim.discrete.kernel.jit import Record, compiled
from craftsim.models.measuring import Floats, Wiring
from craftsim.models.sensing import PerWheel
from craftsim.models.world import Site


class Motors:
    """The wheel motors of all cars of a Site, with the lag of a SensorNoise; a stopped drive brakes at once."""

    def __init__(self, site: Site, lag_s: float = 0.0) -> None:
        """Take commands once a control period; ``lag_s`` is the time constant with which they reach the servos."""
        self._site = site
        self._wiring = Wiring(site)
        self.share = 1 - math.exp(-site.config.control_period_s / lag_s) if lag_s else 1.0
        """By what share a servo's command approaches a new one in a control period."""
        self.speeds = np.zeros((len(site.cars), 4))
        """(n, 4) rad/s: the servos' commands."""

    def drive(self, car: int, wheels: PerWheel) -> None:
        """Command the wheels of a car, in rad/s."""
        told = np.array(wheels, dtype=float)
        drive_wheels(told, self.speeds[car], self.share, self._wiring.cars[car], self._site.data.ctrl)


@compiled
def drive_wheels(wheels: Floats, speeds: Floats, share: float, car: Record, ctrl: Floats) -> None:
    """Command the wheels of a car whose servos have been told ``speeds``."""
    stopped = wheels[0] == 0.0 and wheels[1] == 0.0 and wheels[2] == 0.0 and wheels[3] == 0.0
    for wheel in range(4):
        if stopped or share == 1.0:
            speeds[wheel] = wheels[wheel]
        else:
            speeds[wheel] += share * (wheels[wheel] - speeds[wheel])
        ctrl[car.wheel_motors[wheel]] = speeds[wheel]
