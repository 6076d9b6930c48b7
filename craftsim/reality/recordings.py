"""Recordings of real motion in files: tosses of a cube, drives of a robot with mecanum wheels, and logs of cars.

An ``.npz`` file with the arrays ``states`` and ``length`` holds tosses, as Pfrommer, Halm and Posa published them
(ContactNets, 2020); one with ``wheels`` and ``pose`` holds a drive under motion capture. Single numbers in the same
file, named as the fields of :class:`CubeParameters` and :class:`RobotParameters`, replace what those sets have. Any
other file is a log (docs/reference/reports.md).
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Annotated, Any, Final, TypeVar

import numpy as np

from craftsim.compiled.arrays import Floats
from craftsim.errors import InputError, suggestion
from craftsim.mjcf.drives import Drive
from craftsim.mjcf.machines import NOMINAL, Machines
from craftsim.mjcf.parameters import Friction
from craftsim.robots.log import Log, interpolated
from craftsim.robots.log_files import read_log
from craftsim.storage.limits import ARRAYS, IDENTIFIED_S, UNIT_LENGTH, Range
from craftsim.storage.reading import NamedArrays, read_arrays
from craftsim.storage.records import record
from craftsim.tuning.prediction import machines_of

PERIOD_S: Final = 0.02
"""Period of a drive's rows."""
FEWEST_TOSSES: Final = 4
"""Half of them are fitted to."""
_TOSS_ROWS: Final = Range(10, 10_000)
"""Rows of a toss."""
_FEWEST_ROWS: Final = 50
"""Rows of wheels and of poses of a drive."""
_STATE_COLUMNS: Final = 13
"""Of a toss: position, quaternion, velocity, angular velocity; more are left out."""
_FAR: Final = Range(-1e3, 1e3)
"""Half widths, half widths a second and radians a second of a toss; metres of a drive."""
_CLOCK_S: Final = Range(-1e10, 1e10)
_TICKS: Final = Range(-1e9, 1e9)
_SMOOTHED_POSES: Final = 9
"""Poses of which each is the median: motion capture has single ones that are far off."""
_SMOOTHED_PERIODS: Final = 11
"""Periods over which encoder ticks are smoothed, by parabolas."""
_LONGEST_GAP_S: Final = 0.1
"""Of poses that is interpolated."""
_FREE_GEAR_NM: Final = 1e-4
_STRONG_MOTOR_NM: Final = 50.0
"""Of wheels that turn as they are commanded."""

_Metres = Annotated[float, Range(1e-3, 10.0)]
"""In metres."""
_Parameters = TypeVar("_Parameters")


@record()
class CubeParameters:
    """The cube that was tossed, the board that it fell on, and the rate of the recording.

    Defaults are those of the published set.
    """

    rate_hz: Annotated[float, Range(20.0, 10_000.0)] = 148.0
    half_width_m: _Metres = 0.0524
    mass_kg: Annotated[float, Range(1e-4, 1e3)] = 0.37
    inertia_kgm2: Annotated[float, Range(1e-9, 1e3)] = 0.00081
    """About each axis."""
    friction: Friction = 0.18
    """Of cube and board, as it was measured."""


@record()
class RobotParameters:
    """The nominal parameters of a robot with four mecanum wheels. Defaults are those of the course's robot."""

    wheel_radius_m: _Metres = 0.07
    half_track_m: _Metres = 0.169
    half_wheelbase_m: _Metres = 0.2
    ticks_per_turn: Annotated[float, Range(1.0, 1e7)] = 210.0
    """Encoder ticks of a turn of a wheel: a gear of 5, and 42 ticks a revolution of the motor."""


@dataclass(frozen=True, eq=False)
class Tosses:
    """Tosses of a cube onto a board."""

    name: str
    states: tuple[Floats, ...]
    """Of each toss, (n, 13): position in metres above the board, quaternion w x y z, velocity in m/s, and angular
    velocity about the cube's axes in rad/s."""
    cube: CubeParameters


@dataclass(frozen=True, eq=False)
class DriveRecording:
    """A drive of a robot, whose poses were measured."""

    name: str
    log: Log
    """A row each ``PERIOD_S``: as commands the mean speeds of the wheels up to the next row, and the poses; what was
    not measured is nan."""
    machines: Machines
    """Of one car with the robot's nominal parameters, the wheels of which turn as they are commanded."""

    @property
    def angles(self) -> Floats:
        """Angles in radians by which the wheels have turned, (n, 4), in the order of WHEELS."""
        turned = np.cumsum(self.log.commands[:-1, :4] * PERIOD_S, axis=0)
        return np.vstack([np.zeros(4), turned])

    @property
    def lever_m(self) -> float:
        """Half the track and half the wheelbase: by this wheels turn the robot."""
        return self.machines.car(0).turn_radius_m


def read_recording(path: Path, machines: Machines = NOMINAL) -> Tosses | DriveRecording:
    """Return the recording in a file; ``machines`` are those of a log's car.

    Raises InputError, naming the file and what is wrong, for a missing, damaged or too large file, and for values that
    no recording has.
    """
    if path.suffix.lower() != ".npz":
        return _drive_of_log(path, machines)
    arrays = read_arrays(path, ARRAYS)
    if {"states", "length"} <= arrays.keys():
        return _tosses(path, arrays)
    if {"wheels", "pose"} <= arrays.keys():
        return _drive_of_arrays(path, arrays)
    raise InputError(
        f"{path}: no recording: it holds {', '.join(sorted(arrays)) or 'nothing'}; allowed: 'states' and 'length' of "
        "tosses, or 'wheels' and 'pose' of a drive"
    )


def _parameters(path: Path, arrays: NamedArrays, kind: type[_Parameters]) -> _Parameters:
    """Return the record of single numbers in a file, by the names of its fields; others are its defaults."""
    names = [field.name for field in fields(kind)]  # type: ignore[arg-type]
    numbers = {}
    for name, array in arrays.items():
        if name in ("states", "length", "wheels", "pose"):
            continue
        if name not in names:
            raise InputError(
                f"{path}: unknown array '{name[:40]}'{suggestion(name, names)}; allowed: {', '.join(names)}"
            )
        if array.size != 1:
            raise InputError(f"{path}: '{name}' has shape {array.shape}; allowed: a single number")
        numbers[name] = float(array.item())
    try:
        return kind(**numbers)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _numbers(path: Path, name: str, array: np.ndarray, columns: int) -> Floats:
    """Return an array of numbers with at least so many columns. Raises InputError for another."""
    if array.ndim != 2 or array.shape[1] < columns:
        raise InputError(f"{path}: '{name}' has shape {array.shape}; allowed: (n, {columns})")
    values = array[:, :columns].astype(float)
    if not np.isfinite(values).all():
        row, column = np.argwhere(~np.isfinite(values))[0]
        raise InputError(
            f"{path}: '{name}' is {values[row, column]} in row {row}, column {column}; allowed: finite numbers"
        )
    return values


def _check_range(path: Path, name: str, values: Floats, allowed: Range, unit: str) -> None:
    outside = ~((values >= allowed.low) & (values <= allowed.high))
    if outside.any():
        row, column = np.argwhere(outside)[0]
        raise InputError(
            f"{path}: '{name}' is {values[row, column]:g} in row {row}; allowed: {allowed} {unit}"
        )


def _check_quaternions(path: Path, name: str, quaternions: Floats) -> None:
    length = np.linalg.norm(quaternions, axis=1)
    wrong = np.abs(length - 1) > UNIT_LENGTH
    if wrong.any():
        row = int(np.argmax(wrong))
        raise InputError(
            f"{path}: the quaternion of '{name}' in row {row} has length {length[row]:.4g}; allowed: 1 within "
            f"{UNIT_LENGTH:g}"
        )


def _tosses(path: Path, arrays: NamedArrays) -> Tosses:
    cube = _parameters(path, arrays, CubeParameters)
    states = _numbers(path, "states", arrays["states"], _STATE_COLUMNS)
    lengths = arrays["length"]
    if lengths.ndim != 1 or lengths.dtype.kind not in "iu":
        raise InputError(
            f"{path}: 'length' is of {lengths.dtype} with shape {lengths.shape}; allowed: an integer for each toss"
        )
    if len(lengths) < FEWEST_TOSSES:
        raise InputError(f"{path}: {len(lengths)} tosses; allowed: {FEWEST_TOSSES} or more")
    for number, length in enumerate(lengths.tolist()):
        if length not in _TOSS_ROWS:
            raise InputError(
                f"{path}: 'length' of toss {number} is {length}; allowed: {_TOSS_ROWS} rows"
            )
    total = sum(lengths.tolist())
    if total != len(states):
        raise InputError(
            f"{path}: 'length' sums up to {total} rows, and 'states' has {len(states)}"
        )
    _check_range(path, "states", states, _FAR, "in terms of half a width, and radians")
    _check_quaternions(path, "states", states[:, 3:7])
    states[:, :3] *= cube.half_width_m
    states[:, 7:10] *= cube.half_width_m
    ends = np.cumsum(lengths)
    return Tosses(path.name, tuple(np.split(states, ends[:-1])), cube)


def _drive_of_arrays(path: Path, arrays: NamedArrays) -> DriveRecording:
    robot = _parameters(path, arrays, RobotParameters)
    wheels = _numbers(path, "wheels", arrays["wheels"], 6)
    poses = _numbers(path, "pose", arrays["pose"], 9)
    for name, array in (("wheels", wheels), ("pose", poses)):
        if len(array) < _FEWEST_ROWS:
            raise InputError(
                f"{path}: '{name}' has {len(array)} rows; allowed: {_FEWEST_ROWS} or more"
            )
        _check_range(path, name, array[:, :2], _CLOCK_S, "s")
        if (np.diff(array[:, 1]) < 0).any():
            row = int(np.argmax(np.diff(array[:, 1]) < 0)) + 1
            raise InputError(
                f"{path}: '{name}' was measured at {array[row, 1]:g} s in row {row}, before the row above"
            )
    _check_range(path, "wheels", wheels[:, 2:], _TICKS, "ticks")
    _check_range(path, "pose", poses[:, 2:5], _FAR, "m")
    _check_quaternions(path, "pose", poses[:, 5:9])
    first = max(wheels[0, 1], poses[0, 1])
    last = min(wheels[-1, 1], poses[-1, 1])
    if not 0 < last - first <= IDENTIFIED_S:
        raise InputError(
            f"{path}: wheels and poses were measured together for {last - first:g} s; allowed: above 0 and at most "
            f"{IDENTIFIED_S:g} s"
        )
    time_s = np.arange(first, last, PERIOD_S)
    if len(time_s) < _FEWEST_ROWS:
        raise InputError(
            f"{path}: wheels and poses were measured together for {last - first:g} s; allowed: at least "
            f"{_FEWEST_ROWS * PERIOD_S:g} s"
        )
    log = _log(time_s, _speeds(time_s, wheels, robot.ticks_per_turn), _captured(time_s, poses))
    figures = {
        "smartcar.wheel_radius_m": robot.wheel_radius_m,
        "smartcar.wheel_x_m": robot.half_wheelbase_m,
        "smartcar.wheel_y_m": robot.half_track_m,
    }
    return DriveRecording(path.name, log, with_following_wheels(NOMINAL, figures))


def _speeds(time_s: Floats, wheels: Floats, ticks_per_turn: float) -> Floats:
    """Return the mean speeds of the wheels from each time to the next in rad/s, (n, 4), by their encoders."""
    from scipy.signal import savgol_filter

    # Of two rows of one time the later counts.
    fresh = np.append(np.diff(wheels[:, 1]) > 0, True)
    angles = 2 * np.pi / ticks_per_turn * wheels[fresh, 2:6]
    sampled = [np.interp(time_s, wheels[fresh, 1], angle) for angle in angles.T]
    smooth = savgol_filter(np.column_stack(sampled), _SMOOTHED_PERIODS, 2, axis=0)
    return np.vstack([np.diff(smooth, axis=0) / PERIOD_S, np.zeros(4)])


def _captured(time_s: Floats, poses: Floats) -> Floats:
    """Return x and y in metres in the plane of the motion, and the heading, (n, 3), at some times; nan in gaps.

    Motion capture that has lost its object repeats the last pose: that is no measurement.
    """
    from scipy.ndimage import median_filter

    moved = np.append(True, (np.diff(poses[:, 2:9], axis=0) != 0).any(axis=1))
    later = np.append(np.diff(poses[:, 1]) > 0, True)
    poses = poses[moved & later]
    if len(poses) < 2:
        return np.full((len(time_s), 3), np.nan)
    plane = _plane(poses[:, 2:5])
    across = poses[:, 2:5] @ plane.T
    forward = _forward(poses[:, 5:9]) @ plane.T
    heading = np.unwrap(np.arctan2(forward[:, 1], forward[:, 0]))
    measured = np.column_stack([across[:, :2], heading])
    measured = median_filter(measured, (_SMOOTHED_POSES, 1), mode="nearest")
    columns = []
    for signal in measured.T:
        columns.append(interpolated(time_s, poses[:, 1], signal, _LONGEST_GAP_S))
    return np.column_stack(columns)


def _plane(positions: Floats) -> Floats:
    """Return the axes, (3, 3), of the floor on which positions lie: its x is the recording's, its z is up.

    What was recorded along a line says nothing of the floor's lean across it: then it is level.
    """
    centred = positions - positions.mean(axis=0)
    normal = np.array([0.0, 0.0, 1.0])
    spread = np.linalg.svd(centred[:, :2], compute_uv=False) / np.sqrt(len(centred))
    if spread[-1] > 0.1:
        slopes = np.linalg.lstsq(centred[:, :2], centred[:, 2], rcond=None)[0]
        normal = np.array([-slopes[0], -slopes[1], 1.0])
        normal /= np.linalg.norm(normal)
    x = np.array([1.0, 0.0, 0.0]) - normal[0] * normal
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(normal, x), normal])


def _forward(quaternions: Floats) -> Floats:
    """Return the x axes, (n, 3), of bodies with quaternions x, y, z, w."""
    x, y, z, w = quaternions.T
    return np.column_stack(
        [1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)],
    )


def _drive_of_log(path: Path, machines: Machines) -> DriveRecording:
    log = read_log(path)
    if log.duration_s > IDENTIFIED_S:
        raise InputError(f"{path}: {log.duration_s:g} s long; allowed: {IDENTIFIED_S:g} s")
    if log.duration_s < _FEWEST_ROWS * PERIOD_S:
        raise InputError(
            f"{path}: {log.duration_s:g} s long; allowed: at least {_FEWEST_ROWS * PERIOD_S:g} s"
        )
    if not np.isfinite(log.pose).all(axis=1).any():
        raise InputError(f"{path}: no poses; a drive is compared with the poses of its robot")
    log = log.resampled(PERIOD_S)
    speeds = log.commands[:, :4]
    if np.isfinite(log.wheel_speeds).all(axis=1).mean() > 0.5:
        measured = np.where(np.isfinite(log.wheel_speeds), log.wheel_speeds, speeds)
        speeds = np.vstack([(measured[1:] + measured[:-1]) / 2, np.zeros(4)])
    return DriveRecording(
        path.name, _log(log.time_s, speeds, log.pose), with_following_wheels(machines, {})
    )


def _log(time_s: Floats, speeds: Floats, poses: Floats) -> Log:
    """Return the log of a drive of wheels with some speeds, (n, 4), and poses, (n, 3)."""
    n = len(time_s)
    commands = np.column_stack([speeds, np.zeros((n, 2))])
    pairs = np.full((n, 2), np.nan)
    return Log(time_s - time_s[0], commands, poses, pairs, np.full((n, 4), np.nan), pairs, pairs)


def with_following_wheels(machines: Machines, figures: Mapping[str, float]) -> Machines:
    """Return the first car's machines with some figures, by key, and motors that hardly fall behind.

    It is unchecked whether they fit under blocks, for there are none.
    """
    motors = {
        "smartcar.gear_friction_nm": _FREE_GEAR_NM,
        "smartcar.wheel_torque_nm": _STRONG_MOTOR_NM,
    }
    return machines_of(machines, {**motors, **figures})


def on_drive(machines: Machines, drive: Drive) -> Machines:
    """Return machines on a drive, the rollers as large beside their wheels as those of the nominal car."""
    changed: Machines = copy(machines_of(machines, {}))
    car = changed.cars[0]
    nominal = NOMINAL.car(0)
    scale = car.wheel_radius_m / nominal.wheel_radius_m
    sizes: dict[str, Any] = {
        "roller_radius_m": nominal.roller_radius_m * scale,
        "roller_half_length_m": nominal.roller_half_length_m * scale,
    }
    vars(car).update(sizes)
    vars(changed).update(drive=drive)
    return changed


def joined_log(logs: list[Log], rest_s: float) -> Log:
    """Return one log of drives one after the other, with a rest between them during which nothing was measured."""
    rows = round(rest_s / PERIOD_S)
    speeds = []
    poses = []
    for log in logs:
        speeds += [log.commands[:, :4], np.zeros((rows, 4))]
        poses += [log.pose, np.full((rows, 3), np.nan)]
    n = sum(map(len, speeds))
    return _log(np.arange(n, dtype=float) * PERIOD_S, np.vstack(speeds), np.vstack(poses))


def about(recording: Tosses | DriveRecording) -> dict[str, Any]:
    """Return what a report says of a recording."""
    if isinstance(recording, Tosses):
        return {
            "file": recording.name,
            "kind": "tosses",
            "tosses": len(recording.states),
            "rows": sum(map(len, recording.states)),
            **asdict(recording.cube),
        }
    car = recording.machines.car(0)
    measured = np.isfinite(recording.log.pose).all(axis=1)
    return {
        "file": recording.name,
        "kind": "drive",
        "duration_s": recording.log.duration_s,
        "with_pose": float(measured.mean()),
        "wheel_radius_m": car.wheel_radius_m,
        "lever_m": recording.lever_m,
    }
