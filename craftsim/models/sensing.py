"""What a robot can measure: its own pose, its joints, and the slope that it stands under.

Skills see the world through :class:`CarMeasurement` alone: exact, or with the noise, delay and lag of a SensorNoise.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from operator import mul
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.grid import Kind
from craftsim.discrete.readback import Poses, body_axes
from craftsim.models.noise import EXACT, SensorNoise
from craftsim.models.parts import Drive
from craftsim.models.site import Site

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


def measure(site: Site, car: int) -> CarMeasurement:
    """Return what car number ``car`` measures now."""
    handle = site.cars[car]
    data, start = site.data, handle.base.qpos
    x, y, z, *quaternion = data.qpos[start : start + 7].tolist()
    forward, left, up = body_axes(*quaternion)
    slope = _docked_slope(site, (x, y, z), (forward, left, up)) if site.slopes else None
    return CarMeasurement(
        time_s=site.time_s,
        x=x,
        y=y,
        z=z,
        heading=math.atan2(forward[1], forward[0]),
        pitch=math.asin(max(-1.0, min(1.0, forward[2]))),
        roll=math.asin(max(-1.0, min(1.0, left[2]))),
        wheel_speeds=_per_wheel(handle.wheel_speeds(data)),
        board_m=data.qpos.item(handle.board.qpos),
        board_force_n=_drive_force(site, handle.board),
        slope=slope,
        hinge_rad=None if slope is None else data.qpos.item(site.slopes[slope].hinge.qpos),
    )


def _per_wheel(values: NDArray[np.float64]) -> PerWheel:
    fl, fr, rl, rr = values.tolist()
    return fl, fr, rl, rr


def _drive_force(site: Site, drive: Drive) -> float:
    """Return the force of a position-holding drive; MuJoCo's own figure is 0 while the drive's tree sleeps."""
    model, data, motor = site.model, site.data, drive.actuator
    gain = model.actuator_gainprm.item(motor, 0)
    offset, stiffness, damping = model.actuator_biasprm[motor, :3].tolist()
    force = gain * data.act.item(drive.activation) + offset
    force += stiffness * data.qpos.item(drive.qpos) + damping * data.qvel.item(drive.dof)
    low, high = model.actuator_forcerange[motor].tolist()
    return float(min(max(force, low), high))


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
        self.site, self.noise, self._rng = site, noise, rng
        self._exact = noise.silent
        n = len(site.cars)
        if self._exact:
            return
        if rng is None:
            raise ValueError("noisy sensors need a random generator")
        period = site.config.control_period_s
        self._delays = rng.uniform(noise.min_delay_s, noise.max_delay_s, n) / period
        depth = math.ceil(noise.max_delay_s / period) + 1
        self._past: list[deque[CarMeasurement]] = [deque(maxlen=depth + 1) for _ in range(n)]
        self._encoder_share = 1.0 if not noise.encoder_lag_s else 1 - math.exp(-period / noise.encoder_lag_s)
        self._readings: list[CarMeasurement] = []
        self._speeds: list[PerWheel] = [(0.0, 0.0, 0.0, 0.0)] * n
        self.observe()

    def observe(self) -> None:
        """Take the readings of this moment; call it once after each control period."""
        if self._exact:
            return
        self._readings = [self._read(car) for car in range(len(self.site.cars))]

    def measure(self, car: int) -> CarMeasurement:
        """Return the newest reading of a car."""
        return measure(self.site, car) if self._exact else self._readings[car]

    def _read(self, car: int) -> CarMeasurement:
        assert self._rng is not None
        true = measure(self.site, car)
        past = self._past[car]
        past.append(true)
        back = min(float(self._delays[car]), len(past) - 1)
        newer, share = math.floor(back), back - math.floor(back)
        a, b = past[-1 - newer], past[-1 - min(newer + 1, len(past) - 1)]
        dx, dy, dz, turned = self._rng.normal(size=4).tolist()
        position_m, heading_rad = self.noise.position_m, self.noise.heading_rad
        turn = math.remainder(b.heading - a.heading, math.tau)
        self._speeds[car] = self._lagged(self._speeds[car], true.wheel_speeds)
        return true._replace(
            x=a.x + share * (b.x - a.x) + position_m * dx,
            y=a.y + share * (b.y - a.y) + position_m * dy,
            z=a.z + share * (b.z - a.z) + position_m * dz,
            heading=math.remainder(a.heading + share * turn + heading_rad * turned, math.tau),
            wheel_speeds=self._speeds[car],
            **self._read_joints(true),
        )

    def _read_joints(self, true: CarMeasurement) -> dict[str, Any]:
        """Return what a car measures of its tilt, its board and the slope that it is docked to."""
        assert self._rng is not None
        noise = self.noise
        pitch, roll, height, force, hinge = self._rng.normal(size=5).tolist()
        undocked = self._rng.random() < noise.undocked_share or true.hinge_rad is None
        return {
            "pitch": true.pitch + noise.tilt_rad * pitch,
            "roll": true.roll + noise.tilt_rad * roll,
            "board_m": true.board_m + noise.board_m * height,
            "board_force_n": true.board_force_n + noise.board_force_n * force,
            "slope": None if undocked else true.slope,
            "hinge_rad": None if undocked else true.hinge_rad + noise.hinge_rad * hinge,
        }

    def _lagged(self, before: PerWheel, true: PerWheel) -> PerWheel:
        fl, fr, rl, rr = (
            old + self._encoder_share * (new - old) for old, new in zip(before, true, strict=True)
        )
        return fl, fr, rl, rr


def _docked_slope(site: Site, position: Sequence[float], axes: Sequence[Sequence[float]]) -> int | None:
    """Return the slope right above a car: its plug reaches a car that is centred below it."""
    machines = site.machines
    reach = machines.docking_reach_m
    for index, slope in enumerate(site.slopes):
        there = site.data.qpos[slope.base.qpos : slope.base.qpos + 3].tolist()
        if math.dist(there, position) > reach:
            continue
        offset = [a - b for a, b in zip(there, position, strict=True)]
        forward, left, up = (sum(map(mul, axis, offset)) for axis in axes)
        if (
            math.hypot(forward, left) < machines.slope.docking_range_m
            and abs(up) < machines.block.underside_m / 2
        ):
            return index
    return None


def read_poses(site: Site) -> Poses:
    """Return the true poses of everything that moves: cars by id; then blocks, flags and slopes."""
    objects = [(Kind.BLOCK, b, math.nan) for b in site.blocks] + [
        (Kind.FLAG, f, math.nan) for f in site.flags
    ]
    objects += [(Kind.FSLOPE, s.base, float(site.data.qpos[s.hinge.qpos])) for s in site.slopes]
    cars = [site.free_body_state(car.base) for car in site.cars]
    states = [site.free_body_state(body) for _, body, _ in objects]
    return Poses(
        car_positions=np.array([p for p, _ in cars]).reshape(-1, 3),
        car_quaternions=np.array([q for _, q in cars]).reshape(-1, 4),
        kinds=tuple(kind for kind, _, _ in objects),
        positions=np.array([p for p, _ in states]).reshape(-1, 3),
        quaternions=np.array([q for _, q in states]).reshape(-1, 4),
        hinges=np.array([angle for _, _, angle in objects]),
    )
