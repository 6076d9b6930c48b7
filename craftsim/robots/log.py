"""A log: what one car was commanded and what it measured, row by row, and its recording.

Row k holds what was measured when the command of that row was given, which then held until row k + 1. Poses are those
that the localisation had reported by then, noisy and late. What was not measured is nan. docs/reference/reports.md
has the columns.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Final, Self

import numpy as np

from craftsim.compiled.arrays import Floats
from craftsim.errors import InputError
from craftsim.mjcf.car import WHEELS
from craftsim.models.measuring import READING
from craftsim.models.world import PhysicsWorld
from craftsim.skills.executor import Executor
from craftsim.skills.state import COMMAND
from craftsim.storage.limits import Range
from craftsim.workers.copying import Copyable

GROUPS: Final[dict[str, tuple[str, ...]]] = {
    "commands": (*(f"cmd_{wheel}_rad_s" for wheel in WHEELS), "cmd_board_m_s", "cmd_hinge_rad_s"),
    "pose": ("x_m", "y_m", "heading_rad"),
    "tilt": ("pitch_rad", "roll_rad"),
    "wheel_speeds": tuple(f"{wheel}_rad_s" for wheel in WHEELS),
    "board": ("board_m", "board_force_n"),
    "docked": ("slope", "hinge_rad"),
}
"""Column names besides the time, by field of :class:`Log`."""
TIME: Final = "time_s"
NEEDED: Final = (TIME, *GROUPS["commands"][:4])
"""Required columns."""

_LIKELY: Final[dict[str, tuple[Range, str]]] = {
    "commands": (Range(-1e3, 1e3), "wheels and hinges in rad/s, boards in m/s"),
    "pose": (Range(-1e4, 1e4), "metres and radians"),
    "tilt": (Range(-1.6, 1.6), "radians"),
    "wheel_speeds": (Range(-1e3, 1e3), "rad/s"),
    "board": (Range(-1e4, 1e4), "metres and newtons"),
    "docked": (Range(-1e4, 1e4), "the slope's number and radians"),
}
"""Ranges and units of the values of a car."""
_MOST_TURN_RAD_S: Final = 50.0
_MOST_SPEED_M_S: Final = 20.0
"""Above the speed of any such car; then a column has another unit."""
LONGEST_GAP: Final = 3.5
"""Largest gap that is interpolated, in rows."""
LONGEST_PAUSE_S: Final = 3600.0
"""Longest time between two rows; a longer one is a clock that was set, or a time that is none."""
PERIODS_S: Final = Range(0.0005, 0.2)
"""Median time between two rows: 5 Hz to 2 kHz."""


@dataclass(frozen=True, eq=False)
class Log:
    """The commands and measurements of one car. Raises InputError for what no car can have logged.

    Example:
        >>> import numpy as np
        >>> rows = {name: np.zeros((3, len(columns))) for name, columns in GROUPS.items()}
        >>> log = Log(np.array([0.0, 0.02, 0.04]), **rows)
        >>> len(log), log.period_s
        (3, 0.02)
    """

    time_s: Floats
    """(n,) seconds, increasing."""
    commands: Floats
    """(n, 6) rad/s of the four wheels in the order of WHEELS, m/s of the board (up positive), rad/s of the hinge of the
    slope that the car is docked to (folding positive); each held until the next row."""
    pose: Floats
    """(n, 3) localised x and y in metres, and heading in radians."""
    tilt: Floats
    """(n, 2) pitch (nose up positive) and roll (left side up positive), in radians."""
    wheel_speeds: Floats
    """(n, 4) rad/s, in the order of WHEELS."""
    board: Floats
    """(n, 2) height above its lower stop in metres, and force of its motor in newtons, up positive."""
    docked: Floats
    """(n, 2) the slope whose plug the car is docked to, and its hinge's angle in radians; nan without one."""
    notes: tuple[str, ...] = ()
    """A sentence for each kind of value that the file has and that was left out, with how many."""

    def __post_init__(self) -> None:
        n = len(self.time_s)
        if n < 2:
            raise InputError(f"a log of {n} rows; allowed: two or more")
        steps = np.diff(self.time_s)
        if not np.isfinite(self.time_s).all() or not (steps > 0).all():
            row = int(np.argmin(np.where(np.isfinite(steps), steps, -1.0))) + 1
            raise InputError(
                f"{TIME} must increase from row to row; row {row + 1} has {self.time_s[row]:g} "
                f"after {self.time_s[row - 1]:g}"
            )
        if not PERIODS_S.low <= self.period_s <= PERIODS_S.high:
            raise InputError(
                f"{TIME} rises by {self.period_s:g} a row; allowed: {PERIODS_S} s. Is it in seconds?"
            )
        if steps.max() > LONGEST_PAUSE_S:
            row = int(steps.argmax()) + 1
            raise InputError(
                f"{TIME} rises by {steps[row - 1]:g} s to row {row + 1}; allowed: {LONGEST_PAUSE_S:g} s. Was the clock "
                "set, or does a message have no time?"
            )
        for name, columns in GROUPS.items():
            values = getattr(self, name)
            if values.shape != (n, len(columns)):
                raise InputError(
                    f"{name} has shape {values.shape}; allowed: ({n}, {len(columns)}), a column for each "
                    f"of {', '.join(columns)}"
                )
            self._check_values(name, values)
        self._check_speeds()

    def _check_values(self, name: str, values: Floats) -> None:
        allowed, units = _LIKELY[name]
        has_value = ~np.isnan(values)
        if name == "commands" and not has_value.all():
            row, column = np.argwhere(~has_value)[0]
            raise InputError(
                f"{GROUPS[name][column]} has no value in row {row + 1}; a command is always known"
            )
        wrong = has_value & ~((values >= allowed.low) & (values <= allowed.high))
        if wrong.any():
            row, column = np.argwhere(wrong)[0]
            raise InputError(
                f"{GROUPS[name][column]} is {values[row, column]:g} in row {row + 1}; allowed: {allowed}. "
                f"Units are {units}"
            )

    def _check_speeds(self) -> None:
        """Raise InputError if the pose seems to have other units than metres and radians."""
        has_pose = np.isfinite(self.pose).all(axis=1)
        if has_pose.sum() < 2:
            return
        time = self.time_s[has_pose]
        pose = self.pose[has_pose]
        intervals_s = np.diff(time)
        speed = np.median(np.hypot(*np.diff(pose[:, :2], axis=0).T) / intervals_s)
        turn = np.median(np.abs(np.diff(np.unwrap(pose[:, 2]))) / intervals_s)
        if speed > _MOST_SPEED_M_S or np.abs(pose[:, 2]).max() > 1e3 or turn > _MOST_TURN_RAD_S:
            raise InputError(
                f"the pose moves with {speed:.3g} m/s and turns with {turn:.3g} rad/s in the middle; are x and y in "
                "metres, and the heading in radians?"
            )

    def __len__(self) -> int:
        return len(self.time_s)

    @property
    def period_s(self) -> float:
        """Median time between two rows."""
        return round(float(np.median(np.diff(self.time_s))), 9)

    @property
    def duration_s(self) -> float:
        """Time from the first row to the last."""
        return float(self.time_s[-1] - self.time_s[0])

    @classmethod
    def of_columns(cls, columns: dict[str, Floats]) -> Self:
        """Return the log of columns by name, NEEDED among them; others that are missing are 0 or were not measured."""
        n = len(columns[TIME])
        groups: dict[str, Any] = {}
        for group, names in GROUPS.items():
            if group == "commands":
                missing = np.zeros(n)
            else:
                missing = np.full(n, np.nan)
            groups[group] = np.column_stack([columns.get(name, missing) for name in names])
        return cls(columns[TIME], **groups)

    @property
    def columns(self) -> dict[str, Floats]:
        """All columns by their names."""
        columns = {TIME: self.time_s}
        for group, names in GROUPS.items():
            columns |= dict(zip(names, getattr(self, group).T, strict=True))
        return columns

    def between(self, start_s: float, end_s: float) -> Self:
        """Return the rows from a time up to another, exclusive. Raises InputError if fewer than two are left.

        Times of rows are sums of periods, so that they are a little off: a microsecond does not count.
        """
        in_range = (self.time_s >= start_s - _SAME_S) & (self.time_s < end_s - _SAME_S)
        groups = {name: getattr(self, name)[in_range] for name in GROUPS}
        return replace(self, time_s=self.time_s[in_range], **groups)

    def resampled(self, period_s: float) -> Self:
        """Return the log with a row each so many seconds: commands held, the rest interpolated, nan in longer gaps."""
        n = int(self.duration_s / period_s + 1e-6) + 1
        time = np.minimum(self.time_s[0] + period_s * np.arange(n), self.time_s[-1])
        latest = np.searchsorted(self.time_s, time + 1e-9, side="right") - 1
        groups = {"commands": self.commands[latest], "docked": self.docked[latest]}
        for group in GROUPS.keys() - groups.keys():
            values = getattr(self, group).copy()
            if group == "pose":
                has_value = np.isfinite(values[:, 2])
                values[has_value, 2] = np.unwrap(values[has_value, 2])
            gap_s = LONGEST_GAP * self.period_s
            columns = []
            for signal in values.T:
                has_value = np.isfinite(signal)
                columns.append(interpolated(time, self.time_s[has_value], signal[has_value], gap_s))
            groups[group] = np.column_stack(columns)
        return replace(self, time_s=time, **groups)


def interpolated(time: Floats, at: Floats, values: Floats, longest_gap_s: float) -> Floats:
    """Return a signal interpolated at other times; nan outside of its times and within longer gaps."""
    if len(at) < 2:
        return np.full(len(time), np.nan)
    signal: Floats = np.interp(time, at, values, left=np.nan, right=np.nan)
    after = np.clip(np.searchsorted(at, time - 1e-9), 1, len(at) - 1)
    between = (time > at[after - 1] + 1e-9) & (time < at[after] - 1e-9)
    signal[between & (at[after] - at[after - 1] > longest_gap_s)] = np.nan
    return signal


_SAME_S: Final = 1e-6
_MOST_ROWS: Final = 250_000
"""Maximum number of rows of all cars together, as readers accept them; later rows are left out."""


class LogRecorder(Copyable):
    """Records the measurements and commands of all cars in every control period."""

    def __init__(self, executor: Executor) -> None:
        self._executor = executor
        self._readings = [executor.fleet.read().tobytes()]
        self._commands: list[bytes] = []
        self._time = [executor.physics.time_s]
        self._most = _MOST_ROWS // max(1, len(executor.physics.cars))
        executor.observers.append(self._look)

    def _look(self, physics: PhysicsWorld) -> None:
        # A simulation that breaks down starts its time over: what it does then is no part of the run.
        if not self._time[-1] < physics.time_s or len(self._time) >= self._most:
            return
        self._commands.append(self._executor.commands.tobytes())
        self._readings.append(self._executor.fleet.read().tobytes())
        self._time.append(physics.time_s)

    def logs(self) -> dict[int, Log]:
        """Return the log of each car; empty if fewer than two control periods have passed."""
        n = len(self._commands)
        if n < 2:
            return {}
        read = np.frombuffer(b"".join(self._readings[:n]), READING).reshape(n, -1)
        commanded = np.frombuffer(b"".join(self._commands), COMMAND).reshape(n, -1)
        time = np.array(self._time[:n])
        return {car: log_of(time, read[:, car], commanded[:, car]) for car in range(read.shape[1])}


def log_of(time_s: np.ndarray, readings: np.ndarray, commands: np.ndarray) -> Log:
    """Return the log of one car: times, records of READING and of COMMAND, each (n,)."""
    docked = readings["slope"] >= 0
    return Log(
        time_s,
        np.column_stack([commands["wheels"], commands["board"], commands["hinge"]]),
        np.column_stack([readings[name] for name in ("x", "y", "heading")]),
        np.column_stack([readings["pitch"], readings["roll"]]),
        readings["wheel_speeds"].copy(),
        np.column_stack([readings["board_m"], readings["board_force_n"]]),
        np.where(
            docked[:, None], np.column_stack([readings["slope"], readings["hinge_rad"]]), np.nan
        ),
    )
