"""The sensors of all cars: exact, or with noise, delay and lag that are declared, seeded, and off unless asked for."""

from __future__ import annotations

import math
from dataclasses import astuple, fields
from typing import Final

import numpy as np

from craftsim.compiled.arrays import Arrays, Floats, Records
from craftsim.compiled.jit import compiled, layout, records
from craftsim.discrete.kernel.rotation import wrap
from craftsim.models.config import Amount
from craftsim.models.measuring import (
    READING,
    CarMeasurement,
    exact_reader,
    measurement_of,
    wire_cars,
    wire_undersides,
)
from craftsim.models.world import PhysicsWorld
from craftsim.storage.records import record
from craftsim.workers.copying import Copyable


@record()
class SensorNoise:
    """What one car's sensors and motors lack; hashable. Raises InputError for a negative figure, or one of 1 or more.

    All sensors are read at the control rate of 50 Hz, and localisations arrive as often unless a period is given. All
    noise is drawn for each car; standard deviations are those of white noise, but of a drift and of jitter.

    Example:
        >>> import craftsim
        >>> craftsim.SensorNoise(position_m=0.001, heading_rad=0.003).silent
        False
    """

    position_m: Amount = 0.0
    """Standard deviation of each position coordinate of one localisation, white."""
    heading_rad: Amount = 0.0
    """Standard deviation of the heading of one localisation, white."""
    position_bias_m: Amount = 0.0
    """By so much each car is localised beside its place, in a horizontal direction of the world that is drawn once."""
    heading_bias_rad: Amount = 0.0
    """By so much each car's heading is localised off, to a side that is drawn once."""
    position_drift_m: Amount = 0.0
    """Standard deviation of what the bias of x and that of y walk in a second: sqrt(t) as much in t seconds."""
    heading_drift_rad: Amount = 0.0
    """Standard deviation of what the heading's bias walks in a second."""
    min_delay_s: Amount = 0.0
    """Least age of a localisation; each car's own delay is drawn once, uniformly up to ``max_delay_s``."""
    max_delay_s: Amount = 0.0
    jitter_s: Amount = 0.0
    """Standard deviation of the age of single localisations; none comes before it was taken."""
    localisation_period_s: Amount = 0.0
    """Time between two localisations, as of a camera; a car reads the last one until then. Each car has its own phase.
    0: the control period."""
    lost_share: Amount = 0.0
    """Share of the localisations that do not arrive: the car reads the one before."""
    outlier_share: Amount = 0.0
    """Share of the localisations that are wrong..."""
    outlier_m: Amount = 0.0
    """...and by how much, in a horizontal direction that is drawn each time."""
    encoder_lag_s: Amount = 0.0
    """Time constant of the wheel speeds' low-pass filter."""
    encoder_step_rad: Amount = 0.0
    """Angle of one count of a wheel's encoder; speeds are differences of counts over a control period. 0: the speed of
    the moment."""
    motor_lag_s: Amount = 0.0
    """Time constant with which a wheel's commanded speed reaches its servo."""
    tilt_rad: Amount = 0.0
    """Standard deviation of pitch and of roll."""
    tilt_bias_rad: Amount = 0.0
    """By so much pitch and roll are off, up or down, drawn once each."""
    board_m: Amount = 0.0
    """Standard deviation of the board's height."""
    board_bias_m: Amount = 0.0
    """By so much the board's height is off, up or down, drawn once."""
    board_force_n: Amount = 0.0
    """Standard deviation of the force of the board's motor."""
    board_force_bias_n: Amount = 0.0
    """By so much that force is off, drawn once."""
    hinge_rad: Amount = 0.0
    """Standard deviation of the hinge angle of a docked slope."""
    hinge_bias_rad: Amount = 0.0
    """By so much that angle is off, drawn once."""
    line_m: Amount = 0.0
    """Standard deviation of where a line sensor sees a line."""
    undocked_share: Amount = 0.0
    """Share of the readings in which the plug of a docked slope has no contact: the car feels no slope, and its command
    does not reach the hinge."""

    def __post_init__(self) -> None:
        if self.max_delay_s < self.min_delay_s:
            raise ValueError("max_delay_s must not be below min_delay_s")

    @property
    def exact_pose(self) -> bool:
        """Whether localisations are exact and in time."""
        names = [f.name for f in fields(self)]
        # The figures of localisations stand first.
        return not any(getattr(self, name) for name in names[: names.index("outlier_m")])

    @property
    def silent(self) -> bool:
        """Whether a car measures all that it measures exactly and at once."""
        return not any(getattr(self, f.name) for f in fields(self) if f.name != "motor_lag_s")


EXACT = SensorNoise()
"""No noise, no delay, no lag."""

ASSUMED = SensorNoise(
    position_m=0.001,
    heading_rad=0.003,
    position_bias_m=0.005,
    heading_bias_rad=0.01,
    # A bias that is learnt is not kept for ever: 1 mm and 2 mrad in a minute and a half.
    position_drift_m=0.0001,
    heading_drift_rad=0.0002,
    max_delay_s=0.15,
    jitter_s=0.01,
    line_m=0.0004,
)
"""The noise that cars assume of their sensors unless configured otherwise: where they start from before they find out.
Only what the pose estimate uses is in it."""


def measure(physics: PhysicsWorld, car: int) -> CarMeasurement:
    """Return what car number ``car`` measures now."""
    return Sensors(physics).measure(car)


_JITTER_CUT: Final = 4.0
"""Jitter is cut off at so many deviations."""
_N_NORMALS: Final = 9
"""White normal numbers for each reading of a car: x, y, z, heading, pitch, roll, board, its force, hinge."""
_BIASES: Final = {
    "pitch": "tilt_bias_rad",
    "roll": "tilt_bias_rad",
    "board_m": "board_bias_m",
    "board_force_n": "board_force_bias_n",
    "hinge_rad": "hinge_bias_rad",
}
"""Readings whose bias has a sign that is drawn, and the figures of that bias."""

_NOISE: Final = layout(f8=" ".join([*(f.name for f in fields(SensorNoise)), "encoder_share"]))
"""A SensorNoise with times in control periods, drifts as what walks in one, and the share by which a filtered speed
approaches a new one in a period."""

_OWN: Final = layout(f8=" ".join(["delay phase off_x off_y off_heading", *_BIASES]), i8="last")
"""A car's: delay and phase of its localisations in periods, their bias as it has drifted, the biases of its other
readings, and the number of its last localisation."""

_ENCODERS: Final = layout(i8x4="joints", f8x4="before counts")
"""A car's: where its wheels' angles lie in MjData.qpos; by wheel the angle before the first count, and its counts."""


class Sensors(Copyable):
    """The sensors of all cars of a PhysicsWorld; :meth:`observe` takes one set of readings each control period.

    Example:
        >>> import craftsim
        >>> import numpy as np
        >>> site = craftsim.PhysicsWorld(craftsim.Grid.empty((3, 1, 1), n_cars=1))
        >>> sensors = craftsim.Sensors(site, craftsim.SensorNoise(position_m=0.001), np.random.default_rng(0))
        >>> abs(sensors.measure(0).x - craftsim.Sensors(site).measure(0).x) < 0.005
        True
    """

    _bound = ("plugs", "_read_exactly")

    def __init__(
        self,
        physics: PhysicsWorld,
        noise: SensorNoise = EXACT,
        rng: np.random.Generator | None = None,
    ) -> None:
        """Measure on a PhysicsWorld with this noise; ``rng`` draws it and is needed only where there is some.

        What each car's sensors have of their own is drawn here: delays from ``rng``, all else from generators apart.
        Whatever there is of that, the white noise is then the same.
        """
        self.physics = physics
        self.noise = noise
        self._exact = noise.silent
        self.cars = wire_cars(physics)
        """(n,) WIRING: where cars lie in MuJoCo's arrays."""
        self._bind()
        n_cars = len(physics.cars)
        period_s = physics.config.control_period_s
        self._true = self._readings = records(n_cars, READING)
        if self._exact:
            return
        if rng is None:
            raise ValueError("noisy sensors need a random generator")
        self._rng = rng
        self._more, self._of_lines = rng.spawn(2)
        bias_rng = self._more
        self._readings = records(n_cars, READING)
        self._levels = _in_periods(noise, period_s)
        self._own = biases = records(n_cars, _OWN)
        biases["delay"] = rng.uniform(noise.min_delay_s, noise.max_delay_s, n_cars) / period_s
        towards = bias_rng.uniform(0, math.tau, n_cars)
        biases["off_x"] = noise.position_bias_m * np.cos(towards)
        biases["off_y"] = noise.position_bias_m * np.sin(towards)
        biases["off_heading"] = noise.heading_bias_rad * bias_rng.choice((-1.0, 1.0), n_cars)
        biases["phase"] = bias_rng.uniform(0, 1, n_cars) * self._levels["localisation_period_s"]
        for reading, figure in _BIASES.items():
            biases[reading] = getattr(noise, figure) * bias_rng.choice((-1.0, 1.0), n_cars)
        late = noise.max_delay_s + _JITTER_CUT * noise.jitter_s
        depth = math.ceil(late / period_s) + bool(noise.localisation_period_s) + 2
        self._past = np.zeros((n_cars, depth, 4))
        """x, y, z and heading in the last periods, the newest first."""
        self._n_periods = 0
        # What is drawn for a period, by car.
        self._white = np.zeros((n_cars, _N_NORMALS))
        """White noise."""
        self._contacts = np.zeros(n_cars)
        """Whether a docked slope's plug has contact."""
        self._normals = np.zeros((n_cars, 4))
        """Jitter, and the drifts of x, y and heading."""
        self._uniforms = np.zeros((n_cars, 3))
        """Losses, outliers, and the directions of these."""
        self._line_normals = np.zeros((n_cars, 4))
        self._encoders: Records | None = None
        if noise.encoder_step_rad:
            self._encoders = _encoders(physics, noise.encoder_step_rad, *rng.spawn(1))
        self.observe()

    def _bind(self) -> None:
        undersides = wire_undersides(self.physics)
        self.plugs = undersides[len(self.physics.tables) :]
        """(n,) UNDERSIDE, by slope."""
        self._read_exactly = exact_reader(self.physics, self.cars, undersides)

    @property
    def delays_s(self) -> Floats:
        """(n,): the age of each car's localisations, as it was drawn."""
        if self._exact:
            return np.zeros(len(self.physics.cars))
        return self._own["delay"] * self.physics.config.control_period_s

    def observe(self) -> None:
        """Take the readings of this moment; call it once after each control period."""
        if self._exact:
            return
        physics = self.physics
        true = self._true
        out = self._readings
        levels = self._levels
        self._read_exactly(physics.data.time, true)
        if self._encoders is not None:
            step_rad = float(levels["encoder_step_rad"][0])
            _count(
                physics.data.qpos, self._encoders, step_rad, physics.config.control_period_s, true
            )
        for car, normals in enumerate(self._white):
            self._rng.standard_normal(out=normals)
            self._contacts[car] = self._rng.random()
        self._more.standard_normal(out=self._normals)
        self._more.random(out=self._uniforms)
        noises = self._white, self._normals, self._uniforms
        _localise(true, self._own, self._past, self._n_periods, levels, noises, out)
        self._n_periods += 1
        _disturb(true, levels, self._own, self._white, self._contacts, out)
        self._of_lines.standard_normal(out=self._line_normals)
        out["lines"] = true["lines"] + levels["line_m"] * self._line_normals

    def read(self) -> Records:
        """Return the newest readings of all cars, shape (n,) of READING; the array is used again by the next ones."""
        if self._exact:
            self._read_exactly(self.physics.data.time, self._true)
        return self._readings

    def measure(self, car: int) -> CarMeasurement:
        """Return the newest reading of a car."""
        return measurement_of(self.read()[car])


def _in_periods(noise: SensorNoise, period_s: float) -> Records:
    """Return the noise as a record, shape (1,) of _NOISE."""
    record = records(1, _NOISE)
    share = 1.0
    if noise.encoder_lag_s:
        share = 1 - math.exp(-period_s / noise.encoder_lag_s)
    record[0] = (*astuple(noise), share)
    for name in ("jitter_s", "localisation_period_s"):
        record[name] /= period_s
    for name in ("position_drift_m", "heading_drift_rad"):
        record[name] *= math.sqrt(period_s)
    return record


@compiled
def _localise(
    true: Records,
    biases: Records,
    past: Floats,
    n_periods: int,
    levels: Records,
    noises: Arrays,
    out: Records,
) -> None:
    """Take in the exact poses of a period; where nothing arrives the pose stays, and is not fresh."""
    white, normals, uniforms = noises
    noise = levels[0]
    oldest = min(n_periods, past.shape[1] - 1)
    for i in range(len(true)):
        car = biases[i]
        reading = out[i]
        real = true[i]
        for row in range(past.shape[1] - 1, 0, -1):
            for k in range(4):
                past[i, row, k] = past[i, row - 1, k]
        past[i, 0, 0] = real.x
        past[i, 0, 1] = real.y
        past[i, 0, 2] = real.z
        past[i, 0, 3] = real.heading
        if n_periods:
            car.off_x += noise.position_drift_m * normals[i, 1]
            car.off_y += noise.position_drift_m * normals[i, 2]
            car.off_heading += noise.heading_drift_rad * normals[i, 3]
        since = 0.0
        arrives = True
        if noise.localisation_period_s > 0.0:
            number = math.floor((n_periods - car.phase) / noise.localisation_period_s)
            arrives = number != car.last
            car.last = number
            if n_periods:
                since = n_periods - car.phase - number * noise.localisation_period_s
        # There is always a first one.
        reading.fresh = (
            1 if n_periods == 0 or (arrives and uniforms[i, 0] >= noise.lost_share) else 0
        )
        if reading.fresh:
            # The pose of so many periods ago.
            back = min(max(car.delay + since + noise.jitter_s * normals[i, 0], 0.0), float(oldest))
            newer = math.floor(back)
            older = math.ceil(back)
            share = back - newer
            a = past[i, newer]
            b = past[i, older]
            reading.x = a[0] + share * (b[0] - a[0]) + noise.position_m * white[i, 0]
            reading.y = a[1] + share * (b[1] - a[1]) + noise.position_m * white[i, 1]
            reading.z = a[2] + share * (b[2] - a[2]) + noise.position_m * white[i, 2]
            heading = a[3] + share * wrap(b[3] - a[3]) + noise.heading_rad * white[i, 3]
            # That lies beside the car's place.
            reading.x += car.off_x
            reading.y += car.off_y
            reading.heading = wrap(heading + car.off_heading)
            if uniforms[i, 1] < noise.outlier_share:
                reading.x += noise.outlier_m * math.cos(2 * math.pi * uniforms[i, 2])
                reading.y += noise.outlier_m * math.sin(2 * math.pi * uniforms[i, 2])


@compiled
def _disturb(
    true: Records, levels: Records, biases: Records, normals: Floats, uniforms: Floats, out: Records
) -> None:
    noise = levels[0]
    for i in range(len(true)):
        real = true[i]
        reading = out[i]
        bias = biases[i]
        reading.time_s = real.time_s
        for wheel in range(4):
            old = reading.wheel_speeds[wheel]
            reading.wheel_speeds[wheel] = real.wheel_speeds[wheel]
            if noise.encoder_share < 1.0:
                reading.wheel_speeds[wheel] = old + noise.encoder_share * (
                    real.wheel_speeds[wheel] - old
                )
        reading.pitch = real.pitch + noise.tilt_rad * normals[i, 4] + bias.pitch
        reading.roll = real.roll + noise.tilt_rad * normals[i, 5] + bias.roll
        reading.board_m = real.board_m + noise.board_m * normals[i, 6] + bias.board_m
        reading.board_force_n = (
            real.board_force_n + noise.board_force_n * normals[i, 7] + bias.board_force_n
        )
        docked = real.slope >= 0 and uniforms[i] >= noise.undocked_share
        if docked:
            reading.slope = real.slope
            reading.hinge_rad = real.hinge_rad + noise.hinge_rad * normals[i, 8] + bias.hinge_rad
        else:
            reading.slope = -1
            reading.hinge_rad = 0.0
        reading.position_std_m = reading.heading_std_rad = 0.0


def _encoders(physics: PhysicsWorld, step_rad: float, rng: np.random.Generator) -> Records:
    """Return the encoders, (n,) of _ENCODERS, where the cars stand; ``rng`` draws how far the next counts are."""
    model = physics.model
    data = physics.data
    encoders = records(len(physics.cars), _ENCODERS)
    encoders["before"] = step_rad * rng.uniform(0, 1, (len(physics.cars), 4))
    for row, car in zip(encoders, physics.cars, strict=True):
        row["joints"] = model.jnt_qposadr[model.dof_jntid[car.wheel_dofs]]
    encoders["counts"] = np.floor((encoders["before"] + data.qpos[encoders["joints"]]) / step_rad)
    return encoders


@compiled
def _count(qpos: Floats, encoders: Records, step_rad: float, period_s: float, out: Records) -> None:
    """Replace the speeds in exact readings by those of a control period's counts."""
    for i in range(len(encoders)):
        encoder = encoders[i]
        for wheel in range(4):
            angle = encoder.before[wheel] + qpos[encoder.joints[wheel]]
            counts = math.floor(angle / step_rad)
            out[i].wheel_speeds[wheel] = (counts - encoder.counts[wheel]) * step_rad / period_s
            encoder.counts[wheel] = counts
