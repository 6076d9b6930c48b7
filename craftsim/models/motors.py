"""What becomes of commanded wheel speeds on their way to the servos."""

from __future__ import annotations

import math

import numpy as np

from craftsim.models.sensing import PerWheel
from craftsim.models.site import Site


class Motors:
    """The wheel motors of all cars of a Site, with the lag of a SensorNoise; a stopped drive brakes at once."""

    def __init__(self, site: Site, lag_s: float = 0.0) -> None:
        """Take commands once a control period; ``lag_s`` is the time constant with which they reach the servos."""
        self._site = site
        self._share = 1 - math.exp(-site.config.control_period_s / lag_s) if lag_s else 1.0
        self._speeds = np.zeros((len(site.cars), 4))

    def drive(self, car: int, wheels: PerWheel) -> None:
        """Command the wheels of a car, in rad/s."""
        share = self._share if any(wheels) else 1.0
        if share == 1.0:
            self._speeds[car] = wheels
        else:
            self._speeds[car] += share * (np.array(wheels) - self._speeds[car])
        self._site.drive(car, self._speeds[car])
