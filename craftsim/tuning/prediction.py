"""The unknowns of a car, what a model with them would have measured under a log's commands, and how the log differs.

The model runs once through the whole log from rest. On a flat floor its motion is the same from every place and in
every direction, so that each segment of the log is compared with the model's motion moved and turned to fit the
segment best: errors do not add up over minutes, and no state has to be guessed or set.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass
from functools import lru_cache
from typing import Final, Literal

import numpy as np

from craftsim.compiled.arrays import Floats
from craftsim.errors import InputError
from craftsim.mjcf.machines import Machines
from craftsim.models.config import SimulationConfig
from craftsim.models.measuring import Motors
from craftsim.models.sensing import Sensors
from craftsim.models.world import PhysicsWorld
from craftsim.robots.log import Log
from craftsim.storage.limits import IDENTIFIED_S
from craftsim.tuning.excitation import Area, free_area

_Values = Mapping[str, float]
"""By key."""
_Section = Literal["smartcar", "block", "noise", "mounting"]


@dataclass(frozen=True)
class Unknown:
    """An unknown parameter."""

    section: _Section
    """Of a machine's file, or ``noise`` of the file of noise; ``mounting`` is in neither."""
    name: str
    words: str
    usual: float
    """How far it is commonly from what is assumed, one standard deviation: as a share of a machine's parameter, else in
    its own unit. It scales the search, and a log tells what it narrows to well below that."""
    weighed: int = 0
    """Of several that cannot be told apart, the one with the most is held: it is the easiest to measure otherwise."""
    scales: bool = False
    """Whether it is a force or an inertia by which the car's own motion is decided: all of these in proportion larger
    make no difference to it."""
    limits_motion: bool = False
    """Whether it is a limit, which has no effect in a car that does not reach it."""
    limits: tuple[float, float] = (0.0, 0.0)
    """Between which it is sought; a machine's parameter is sought within a factor of its start."""
    assumed: float = 0.0
    """Where its search starts, not at its limits, where it would be one-sided; a machine's parameter starts at its
    assumed value."""

    @property
    def key(self) -> str:
        """Section and name."""
        return f"{self.section}.{self.name}"

    @property
    def of_machine(self) -> bool:
        """Whether it is a parameter of a machine; then it is above 0 and searched as a share of its start."""
        return self.section in ("smartcar", "block")

    def start(self, machines: Machines) -> float:
        """Return what is assumed of it: where the search starts."""
        parts = {"smartcar": machines.car(0), "block": machines.block}
        if self.of_machine:
            return float(getattr(parts[self.section], self.name))
        return self.assumed

    def value(self, start: float, number: float) -> float:
        """Return what it is where it is so many common errors from its start, as the search counts."""
        if self.of_machine:
            return start * math.exp(self.usual * number)
        return start + self.usual * number

    def bounds(self, start: float) -> tuple[float, float]:
        """Return the least and the largest such number."""
        if self.of_machine:
            return -math.log(_FACTOR) / self.usual, math.log(_FACTOR) / self.usual
        low, high = self.limits
        return (low - start) / self.usual, (high - start) / self.usual

    @property
    def step(self) -> float:
        """Such a number for a difference quotient; lags far below a period of the log have no effect."""
        if self.of_machine:
            return 0.002 / self.usual
        if self.name.endswith("lag_s"):
            return 0.3
        return 0.05


UNKNOWNS: Final = (
    Unknown("smartcar", "wheel_radius_m", "radius of the wheels", 0.02),
    Unknown("smartcar", "wheel_y_m", "half the track", 0.05),
    Unknown("smartcar", "wheel_gain_nms_rad", "gain of the wheel motors", 0.3, 2, True),
    Unknown("smartcar", "wheel_torque_nm", "torque limit of the wheel motors", 0.3, 0, True, True),
    Unknown("smartcar", "gear_friction_nm", "dry friction of the gears", 0.3, 0, True),
    Unknown("smartcar", "wheel_armature_kgm2", "inertia of the wheel motors", 0.3, 1, True),
    Unknown("smartcar", "wheel_mass_kg", "mass of the car, most of it in its wheels", 0.2, 3, True),
    Unknown(
        "smartcar",
        "roller_friction",
        "friction between wheels and floor",
        0.3,
        1,
        limits_motion=True,
    ),
    Unknown("smartcar", "board_mass_kg", "mass of the board", 0.2),
    Unknown("smartcar", "screw_friction_n", "dry friction of the board's screw", 0.3),
    Unknown("smartcar", "board_damping_ns_m", "grease on the board's screw", 0.3, 1),
    Unknown("block", "deck_mass_kg", "mass of the block's deck", 0.2),
    Unknown("noise", "delay_s", "delay of the localisation", 0.03, limits=(0.0, 0.4), assumed=0.02),
    Unknown(
        "noise", "motor_lag_s", "lag of the wheel motors", 0.01, limits=(0.0, 0.3), assumed=0.005
    ),
    Unknown(
        "noise",
        "encoder_lag_s",
        "lag of the wheel encoders",
        0.01,
        1,
        limits=(0.0, 0.3),
        assumed=0.005,
    ),
    Unknown("mounting", "heading_bias_rad", "bias of the heading", 0.01, limits=(-0.2, 0.2)),
    Unknown(
        "mounting", "marker_x_m", "marker ahead of the wheels' centre", 0.005, limits=(-0.1, 0.1)
    ),
    Unknown(
        "mounting", "marker_y_m", "marker left of the wheels' centre", 0.005, limits=(-0.1, 0.1)
    ),
)
_OF_LOAD: Final = ("block.deck_mass_kg",)

_FACTOR: Final = 3.0
"""A figure of a machine is sought within this factor of its start."""


def unknowns_of(loaded: bool) -> list[Unknown]:
    """Return what a log may tell; ``loaded``: a block was lifted."""
    return [unknown for unknown in UNKNOWNS if loaded or unknown.key not in _OF_LOAD]


def machines_of(machines: Machines, values: _Values) -> Machines:
    """Return machines of the first car with some parameters replaced; unchecked, for no block or slope is near."""
    car = copy(machines.car(0))
    block = copy(machines.block)
    changed = copy(machines)
    for key, value in values.items():
        section, _, name = key.partition(".")
        if section in ("smartcar", "block"):
            vars(car if section == "smartcar" else block)[name] = value
    vars(changed).update(cars=(car,), block=block)
    vars(changed).pop("digest", None)  # of the others
    return changed


SEGMENT_S: Final = 2.0
SIGNALS: Final = {
    "position": ("m", slice(0, 2)),
    "heading": ("rad", slice(2, 3)),
    "wheel speeds": ("rad/s", slice(3, 7)),
    "board": ("m", slice(7, 8)),
    "board force": ("N", slice(8, 9)),
}
"""What is compared: its unit, and its columns."""
N_COLUMNS: Final = 9
_SHORTEST_PERIOD_S: Final = 0.005
_FEWEST: Final = 8
"""Differences of which a median says something."""
_TILTED_RAD: Final = 0.05
"""A car that leans more stands on a ramp, of which the model knows nothing."""


class Predictor:
    """Predicts a log; it is resampled to a regular period that physics can be stepped at."""

    def __init__(self, log: Log, machines: Machines, loaded: bool = False) -> None:
        """Take a log; ``loaded``: a block stood over the car. Raises InputError for one without poses and speeds."""
        if log.duration_s > IDENTIFIED_S:
            raise InputError(
                f"the log is {log.duration_s:.0f} s long; allowed: {IDENTIFIED_S:g}; give a part of it"
            )
        self.period_s = max(_SHORTEST_PERIOD_S, log.period_s)
        self.log = log.resampled(self.period_s)
        if not (np.isfinite(self.log.pose).any() or np.isfinite(self.log.wheel_speeds).any()):
            raise InputError(
                "the log has neither poses nor wheel speeds; at least one of them is needed"
            )
        steps = math.ceil(self.period_s / SimulationConfig().timestep_s - 1e-9)
        self.timestep_s = self.period_s / steps
        self._config = SimulationConfig(self.timestep_s, self.period_s, sleep=False)
        self._assumed = machines
        self._grid = free_area(Area(), loaded)
        self._motion = lru_cache(64)(self._run)
        self.predictions = 0
        """How often a car was simulated through the log."""
        self._as_logged = log
        self.measured = np.column_stack([self.log.pose, self.log.wheel_speeds, self.log.board])
        """(n, 9): position, heading, wheel speeds, board and its force; nan where not measured."""
        rows = max(2, round(SEGMENT_S / self.period_s))
        self.segments = [slice(k, k + rows) for k in range(0, len(self.log) - rows + 1, rows)]
        if not self.segments:
            raise InputError(f"the log is shorter than {SEGMENT_S:g} s")
        # Where one of both angles was not measured, the other one decides.
        tilted = np.any(np.abs(self.log.tilt) > _TILTED_RAD, axis=1)
        self.segments = [s for s in self.segments if not tilted[s].any()]
        """Whole ones on level floor."""

    def _run(self, machines: Machines, motor_lag_s: float) -> Floats:
        """Return what a car does under the log's commands, (n, 9), its heading unwrapped."""
        self.predictions += 1
        n = len(self.log)
        motion = np.zeros((n, N_COLUMNS))
        try:
            physics = PhysicsWorld(self._grid, self._config, machines=machines)
        except InputError:
            if machines == self._assumed:
                raise
            return motion  # of parameters of which there is no world: the search turns away
        sensors = Sensors(physics)
        motors = Motors(physics, motor_lag_s)
        for row, command in enumerate(self.log.commands):
            reading = sensors.read()[0]
            motion[row, :3] = reading["x"], reading["y"], reading["heading"]
            motion[row, 3:7] = reading["wheel_speeds"]
            motion[row, 7:] = reading["board_m"], reading["board_force_n"]
            motors.drive(0, command[:4])
            physics.move_board(0, command[4])
            physics.advance()
        motion[:, 2] = np.unwrap(motion[:, 2])
        return motion

    def measured_noise(self, floors: _Values) -> dict[str, float]:
        """Return the standard deviation of white noise in what was measured, by channel, and no less than ``floors``.

        It is that of third differences from row to row, in which a smooth motion cancels: robust in each two seconds,
        so that starts and stops do not count, and the mean square of these. A localisation that stays is no new one.
        """
        log = self._as_logged
        pose = log.pose.copy()
        measured_rows = np.asarray(np.isfinite(pose).all(axis=1))
        pose[measured_rows, 2] = np.unwrap(pose[measured_rows, 2])
        fresh = measured_rows.copy()
        fresh[1:] &= (pose[1:] != pose[:-1]).any(axis=1)
        signals = {
            "position": pose[fresh, :2],
            "heading": pose[fresh, 2:],
            "wheel speeds": log.wheel_speeds,
            "board": log.board[:, :1],
            "board force": log.board[:, 1:],
        }
        return {name: max(floors[name], self._white(signal)) for name, signal in signals.items()}

    def _white(self, signal: Floats) -> float:
        """Return the standard deviation of the white noise of signals, (n, k)."""
        differences = np.abs(np.diff(signal, 3, axis=0)) / math.sqrt(20.0)
        rows = max(10, round(SEGMENT_S / self._as_logged.period_s))
        squares = []
        for first in range(0, len(differences), rows):
            window = differences[first : first + rows]
            window = window[np.isfinite(window)]
            if window.size > _FEWEST:
                squares.append((1.4826 * float(np.median(window))) ** 2)
        if not squares:
            return 0.0
        return math.sqrt(sum(squares) / len(squares))

    def poses(self, machines: Machines) -> Floats:
        """Return where a car is under the log's commands: x and y in metres, and the heading in radians, (n, 3)."""
        return self._motion(machines, 0.0)[:, :3]

    def errors(self, machines: Machines, values: _Values, lead: float = 1.0) -> Floats:
        """Return by how much each segment differs from what is predicted: (segments, rows, 9), nan where unknown.

        ``values`` are of sensors and motors, by key; the prediction is fitted to the first share ``lead`` of a segment.
        """
        motion = self._motion(machines, values.get("noise.motor_lag_s", 0.0))
        bias = values.get("mounting.heading_bias_rad", 0.0)
        c = np.cos(motion[:, 2])
        s = np.sin(motion[:, 2])
        marker_x = values.get("mounting.marker_x_m", 0.0)
        marker_y = values.get("mounting.marker_y_m", 0.0)
        pose = motion[:, :3].copy()
        pose[:, 0] += c * marker_x - s * marker_y
        pose[:, 1] += s * marker_x + c * marker_y
        seen_at = np.arange(len(pose)) - values.get("noise.delay_s", 0.0) / self.period_s
        pose = np.column_stack(
            [np.interp(seen_at, np.arange(len(pose)), signal) for signal in pose.T]
        )
        lagged = self._lagged(motion[:, 3:7], values.get("noise.encoder_lag_s", 0.0))
        errors = np.empty((len(self.segments), *self.measured[self.segments[0]].shape))
        for number, rows in enumerate(self.segments):
            measured = self.measured[rows]
            until = max(2, round(lead * len(measured)))
            errors[number, :, :3] = _aligned(measured[:, :3], pose[rows], bias, until)
            errors[number, :, 3:7] = measured[:, 3:7] - lagged[rows]
            errors[number, :, 7:] = measured[:, 7:] - motion[rows, 7:]
        return errors

    def _lagged(self, speeds: Floats, lag_s: float) -> Floats:
        from scipy.signal import lfilter

        if lag_s <= 0:
            return speeds
        share = 1 - math.exp(-self.period_s / lag_s)
        filtered: Floats = lfilter([share], [1, share - 1], speeds, axis=0)
        return filtered


def _aligned(measured: Floats, model: Floats, bias: float, until: int) -> Floats:
    """Return what is left when a motion, each (n, 3), is moved and turned to fit what was measured up to a row best.

    ``bias`` is by how much measured headings are larger than true ones, which does not turn the way.
    """
    error = np.full(measured.shape, np.nan)
    is_measured = np.asarray(np.isfinite(measured).all(axis=1))
    fitted = is_measured.copy()
    fitted[until:] = False
    if fitted.sum() < 2:
        return error
    turn = measured[:, 2] - model[:, 2]
    reference = turn[fitted][0]
    turn = (turn - reference + np.pi) % (2 * np.pi) - np.pi
    angle = reference + turn[fitted].mean()
    origin = model[fitted, :2].mean(axis=0)
    model_way = model[:, :2] - origin
    measured_way = measured[:, :2] - measured[fitted, :2].mean(axis=0)
    # Headings and positions both say how far to turn; weighed as localisation has them: 1 mm to 3 mrad.
    for _ in range(2):
        c = math.cos(angle - bias)
        s = math.sin(angle - bias)
        turned = model_way @ np.array([[c, s], [-s, c]])
        across = np.column_stack([-turned[:, 1], turned[:, 0]])
        residual = measured_way - turned
        headings = reference + turn[fitted] - angle
        pull = 9.0 * (across[fitted] * residual[fitted]).sum() + headings.sum()
        angle += pull / (9.0 * (across[fitted] ** 2).sum() + fitted.sum())
    c = math.cos(angle - bias)
    s = math.sin(angle - bias)
    residual = measured_way - model_way @ np.array([[c, s], [-s, c]])
    error[:, :2] = residual - residual[fitted].mean(axis=0)
    error[:, 2] = reference + turn - angle
    return error
