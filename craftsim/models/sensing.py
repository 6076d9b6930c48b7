"""What a robot can measure: its own pose, its joints, and the slope that it stands under.

Skills see the world through :class:`CarMeasurement` alone: exact, or with the noise, delay and lag of a SensorNoise.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from craftsim.discrete.grid import Kind
from craftsim.discrete.kernel.jit import records
from craftsim.discrete.readback import Poses
from craftsim.models.disturbing import Disturber
from craftsim.models.encoders import Encoders
from craftsim.models.measuring import READING, Records, Wiring, read_cars
from craftsim.models.noise import EXACT, SensorNoise
from craftsim.models.world import Site

PerWheel = tuple[float, float, float, float]
"""A number for each wheel, in the order of WHEELS."""


class CarMeasurement(NamedTuple):
    """One car's view of itself at one instant; world frame, metres and radians."""

    time_s: float
    x: float
    y: float
    z: float
    """Height of the point on the floor between the wheels."""
    heading: float
    pitch: float
    """Nose up positive."""
    roll: float
    """Left side up positive."""
    wheel_speeds: PerWheel
    """In rad/s."""
    board_m: float
    """Height of the board above its lower stop."""
    board_force_n: float
    """Force of the board's motor, up positive: the weight of board and load when it is at rest."""
    slope: int | None
    """The slope whose plug the car is docked to, if any."""
    hinge_rad: float | None
    """Hinge angle of that slope."""
    position_std_m: float = 0.0
    """How unsure the car is of its position: one standard deviation of x and of y."""
    heading_std_rad: float = 0.0
    """How unsure the car is of its heading."""
    fresh: bool = True
    """Whether a localisation has arrived since the last reading; else x, y, z and heading are as they were."""
    lines: PerWheel = (math.inf, math.inf, math.inf, math.inf)
    """Where the sensors before, behind, left and right in the board see a line above: how far to the left those before
    and behind, how far forward the others; inf where one sees none."""


_WHEELS, _SLOPE, _HINGE, _FRESH, _LINES = map(
    CarMeasurement._fields.index, ("wheel_speeds", "slope", "hinge_rad", "fresh", "lines")
)


def measurement_of(reading: np.void) -> CarMeasurement:
    """Return a reading, a record of READING, as a measurement."""
    values: list[Any] = list(reading.tolist())
    values[_WHEELS] = tuple(values[_WHEELS].tolist())
    values[_LINES] = tuple(values[_LINES].tolist())
    values[_FRESH] = bool(values[_FRESH])
    if values[_SLOPE] < 0:
        values[_SLOPE] = values[_HINGE] = None
    return CarMeasurement(*values)


def write_reading(now: CarMeasurement, reading: Records) -> None:
    """Write a measurement into a record, shape (1,) of READING."""
    docked = now.slope is not None and now.hinge_rad is not None
    reading[0] = tuple(now if docked else now._replace(slope=-1, hinge_rad=0.0))


def measure(site: Site, car: int) -> CarMeasurement:
    """Return what car number ``car`` measures now."""
    return Sensors(site).measure(car)


class Sensors:
    """The sensors of all cars of a Site; :meth:`observe` takes one set of readings each control period.

    Example:
        >>> import craftsim
        >>> import numpy as np
        >>> site = craftsim.Site(craftsim.Grid.empty((3, 1, 1), n_cars=1))
        >>> sensors = craftsim.Sensors(site, craftsim.SensorNoise(position_m=0.001), np.random.default_rng(0))
        >>> abs(sensors.measure(0).x - craftsim.Sensors(site).measure(0).x) < 0.005
        True
    """

    def __init__(
        self, site: Site, noise: SensorNoise = EXACT, rng: np.random.Generator | None = None
    ) -> None:
        """Measure on a Site with this noise; ``rng`` draws it and is needed only where there is some."""
        self.site, self.noise = site, noise
        self.wiring = Wiring(site)
        n = len(site.cars)
        self._true = records(n, READING)
        self._disturber: Disturber | None = None
        self._encoders: Encoders | None = None
        if noise.silent:
            return
        if rng is None:
            raise ValueError("noisy sensors need a random generator")
        self._disturber = Disturber(noise, n, site.config.control_period_s, rng)
        if noise.encoder_step_rad:
            self._encoders = Encoders(site, self.wiring, noise.encoder_step_rad, *rng.spawn(1))
        self.observe()

    def observe(self) -> None:
        """Take the readings of this moment; call it once after each control period."""
        if self._disturber is not None:
            true = self._read()
            if self._encoders is not None:
                self._encoders.read(true)
            self._disturber.disturb(true)

    def read(self) -> Records:
        """Return the newest readings of all cars, shape (n,) of READING; the array is used again by the next ones."""
        return self._read() if self._disturber is None else self._disturber.readings

    def measure(self, car: int) -> CarMeasurement:
        """Return the newest reading of a car."""
        return measurement_of(self.read()[car])

    def _read(self) -> Records:
        """Return what exact sensors read now."""
        read_cars(self.site, self.wiring, self._true)
        return self._true


class PoseReader:
    """Reads the true poses of everything that moves on a Site: cars by id; then blocks, flags and slopes."""

    def __init__(self, site: Site) -> None:
        """Look up where they are."""
        loose = [*site.blocks, *site.flags, *(slope.base for slope in site.slopes)]
        n_still = len(site.blocks) + len(site.flags)
        self._kinds = (Kind.BLOCK,) * len(site.blocks) + (Kind.FLAG,) * len(site.flags)
        self._kinds += (Kind.FSLOPE,) * len(site.slopes)
        self._n_cars, self._qpos = len(site.cars), site.data.qpos
        starts = [*(car.base.qpos for car in site.cars), *(body.qpos for body in loose)]
        self.places = np.array(starts, np.intp)[:, None] + np.arange(7)
        """(n, 7): of each one's pose in qpos."""
        self._hinges = np.array([slope.hinge.qpos for slope in site.slopes], np.intp)
        self._without_hinge = np.full(n_still, math.nan)

    def read(self) -> Poses:
        """Return the poses of this moment."""
        poses, n = self._qpos[self.places], self._n_cars
        return Poses(
            car_positions=poses[:n, :3],
            car_quaternions=poses[:n, 3:],
            kinds=self._kinds,
            positions=poses[n:, :3],
            quaternions=poses[n:, 3:],
            hinges=np.concatenate((self._without_hinge, self._qpos[self._hinges])),
        )


def read_poses(site: Site) -> Poses:
    """Return the true poses of everything that moves on a Site now."""
    return PoseReader(site).read()
