"""An identification drive: wheel commands that show what a car's motors, wheels and friction are, in a small free area.

Each manoeuvre goes out and comes back by the same commands with the sign turned, so that the car needs no feedback to
stay in its area. They go through directions, speeds and accelerations in turn: forward, sideways, on the spot, askew,
along curves; slow and fast; along ramps, and on the spot in steps. Between them the car
stands still.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from craftsim.checking.setup import Seed, Setup, set_up
from craftsim.discrete.geometry import CELL_PITCH_M
from craftsim.discrete.grid import CarField, Grid, Kind
from craftsim.errors import InputError
from craftsim.logs.log import Floats, Log
from craftsim.logs.recorder import log_of
from craftsim.mjcf.parameters import SmartcarParameters
from craftsim.models.measuring import READING
from craftsim.skills.fleet import PhysicsFleet
from craftsim.skills.mecanum import Mecanum, Triple
from craftsim.skills.state import COMMAND

_DIRECTIONS: Final[tuple[Triple, ...]] = (
    (1.0, 0.0, 0.0),
    (0.0, 1.0, 0.0),
    (0.0, 0.0, 1.0),
    (0.8, -0.6, 0.0),
    (0.8, 0.0, 0.6),
    (0.0, 0.8, -0.6),
)
"""Of twists; the turning speed at the lever by which wheels turn the car."""
_SPEEDS: Final = (0.08, 0.7, 0.2, 0.45, 0.12, 0.3)
"""Shares of the top speed."""
_ACCELERATIONS: Final = (1.5, 0.5, 2.2, 1.0)
"""In m/s^2, with no wheel at its grip: what a car does there depends on the least things."""
_TURNING: Final = (3.0, 1.5, 0.5, 2.2)
"""The same on the spot, at the lever."""
_STEP_M_S: Final = 0.13
"""Of what is slower on the spot, commands go up and down in steps."""
_CRUISE_S: Final = 1.2
_REST_S: Final = 0.4
_STILL_S: Final = 1.0
"""At both ends: what sensors say of a car at rest."""
_CLEAR_M: Final = 0.25
"""Between the car's centre and the border of its area: half its diagonal, and a decimetre to go astray."""
_BOARD_S: Final = 1.1
"""Longer than the board's way takes at its speed; its motor stops by itself."""
_LOADED_SHARE: Final = 0.25
"""Of the time, where there is a load."""
_LOADED_SPEEDS: Final = (0.2, 0.4)
_LOADED_ACCELERATIONS: Final = (0.5,)
_HALF_BLOCK_M: Final = CELL_PITCH_M / 2


@dataclass(frozen=True)
class Area:
    """The free area of a drive, the car in its centre; raises InputError for one too small to move in."""

    length_m: float = 2.0
    """Along the car's heading."""
    width_m: float = 2.0

    def __post_init__(self) -> None:
        if min(self.length_m, self.width_m) <= 2 * _CLEAR_M:
            raise InputError(
                f"an area of {self.length_m:g} m by {self.width_m:g} m is too small; each side must be above "
                f"{2 * _CLEAR_M:g} m"
            )

    @property
    def cells_behind(self) -> int:
        """How many cells behind the centre a load stands, out of the area."""
        return math.ceil((self.length_m / 2 + _HALF_BLOCK_M) / CELL_PITCH_M)

    @property
    def from_load_m(self) -> float:
        """From under a load to the centre."""
        return self.cells_behind * CELL_PITCH_M

    def reach_m(self, direction: Triple) -> float:
        """Return how far a car may go from the centre in a direction of its own frame."""
        along, across, turn = direction
        reach = min(self.length_m, self.width_m) / 2 - _CLEAR_M if turn else math.inf
        if along:
            reach = min(reach, (self.length_m / 2 - _CLEAR_M) / abs(along))
        if across:
            reach = min(reach, (self.width_m / 2 - _CLEAR_M) / abs(across))
        return reach


def excitation(
    duration_s: float, area: Area, car: SmartcarParameters, period_s: float, loaded: bool = False
) -> Floats:
    """Return the commands of a drive, (n, 6) as of a log, a row each control period.

    ``loaded``: a block stands over the car, behind the area. The drive then begins with lifting it, moves gently with
    it, puts it down and goes out from under it, straight on into the centre of the area.
    """
    drive = _Drive(area, car, period_s, round(duration_s / period_s))
    drive.rest(_STILL_S)
    drive.board(1.0)
    if loaded:
        drive.manoeuvres(int(_LOADED_SHARE * drive.most), _DIRECTIONS[:1] + _DIRECTIONS[2:3], _LOADED_SPEEDS)
    drive.board(-0.5)
    if loaded:
        drive.out()
    drive.manoeuvres(drive.most, _DIRECTIONS, _SPEEDS)
    return drive.commands


class _Drive:
    """Commands that are put one after the other."""

    def __init__(self, area: Area, car: SmartcarParameters, period_s: float, most: int) -> None:
        self.area, self.car, self.period_s, self.most = area, car, period_s, most
        self._kinematics = Mecanum(car)
        self._rows: list[Floats] = []
        self._n = 0
        self._top_m_s = car.wheel_speed_rad_s * car.wheel_radius_m

    @property
    def commands(self) -> Floats:
        """All of them, with rest to the end."""
        rows = np.vstack([*self._rows, np.zeros((max(0, self.most - self._n), 6))])
        return rows[: self.most]

    def rest(self, time_s: float) -> None:
        self._add(np.zeros((round(time_s / self.period_s), 6)))

    def board(self, share: float) -> None:
        """Move the board to its end at a share of its speed, up positive."""
        rows = np.zeros((round(_BOARD_S / abs(share) / self.period_s), 6))
        rows[:, 4] = share * self.car.board_speed_m_s
        self._add(rows)
        self.rest(_REST_S)

    def out(self) -> None:
        """Drive straight from under the load."""
        self._add(self._straight((1.0, 0.0, 0.0), 0.3, 0.5, self.area.from_load_m))
        self.rest(_REST_S)

    def manoeuvres(self, until: int, directions: tuple[Triple, ...], speeds: tuple[float, ...]) -> None:
        """Add manoeuvres as long as they fit in so many rows with rest at the end."""
        still = round(_STILL_S / self.period_s)
        gentle = speeds is _LOADED_SPEEDS
        for number in range(until):
            round_number, which = divmod(number, len(directions))
            speed = speeds[(which + round_number) % len(speeds)] * self._top_m_s
            spot = directions[which][:2] == (0.0, 0.0)
            accelerations = _LOADED_ACCELERATIONS if gentle else _TURNING if spot else _ACCELERATIONS
            acceleration = accelerations[(which + 3 * round_number) % len(accelerations)]
            if spot and speed < _STEP_M_S:
                acceleration = math.inf
            sign = 1.0 if gentle or number % 2 == 0 else -1.0
            ramp_s = abs(speed) / acceleration
            reach = min(self.area.reach_m(directions[which]), abs(speed) * (ramp_s + _CRUISE_S))
            out = self._straight(directions[which], sign * speed, acceleration, reach)
            rest = np.zeros((round(_REST_S / self.period_s), 6))
            if self._n + 2 * (len(out) + len(rest)) + still > until:
                return
            for rows in (out, rest, -out, rest):
                self._add(rows)

    def _straight(self, direction: Triple, speed: float, acceleration: float, way: float) -> Floats:
        """Return the wheels' commands on a trapezoid of speed over a way in metres."""
        ramp_s = abs(speed) / acceleration
        if way < abs(speed) * ramp_s:
            speed = math.copysign(math.sqrt(way * acceleration), speed)
            ramp_s = abs(speed) / acceleration
        cruise_s = way / abs(speed) - ramp_s
        middle = self.period_s * (np.arange(math.ceil((2 * ramp_s + cruise_s) / self.period_s)) + 0.5)
        share = np.ones(len(middle))
        if ramp_s:
            share = np.clip(np.minimum(middle, 2 * ramp_s + cruise_s - middle) / ramp_s, 0.0, 1.0)
        along, across, turn = direction
        wheels = self._kinematics.wheel_speeds((along, across, turn / self._kinematics.lever_m))
        rows = np.zeros((len(middle), 6))
        rows[:, :4] = np.outer(speed * share, wheels)
        limit = self.car.wheel_speed_rad_s
        return np.clip(rows, -limit, limit)

    def _add(self, rows: Floats) -> None:
        self._rows.append(rows)
        self._n += len(rows)


def free_area(area: Area, loaded: bool = False) -> Grid:
    """Return a world of one car in the middle of a free area; ``loaded``: under a block behind it."""
    size = [2 * (math.ceil(side / 2 / CELL_PITCH_M) + 2) + 1 for side in (area.length_m, area.width_m)]
    grid = Grid.empty((size[0], size[1], 2), n_cars=1)
    x, y = size[0] // 2 - area.cells_behind * loaded, size[1] // 2
    grid.cars[0, CarField.X], grid.cars[0, CarField.Y] = x, y
    if loaded:
        grid.kind[x, y, 1] = Kind.BLOCK
    grid.derive_marks()
    return grid


def drive(grid: Grid, setup: Setup, seed: Seed, commands: Floats) -> Log:
    """Return the log of the first car of a world that is driven by commands, (n, 6) as of a log.

    Nothing sleeps in it: a car that MuJoCo has to wake takes a moment that no real one takes.
    """
    setup = replace(setup, simulation=replace(setup.simulation, sleep=False))
    executor = set_up(grid, setup, seed, watch_contacts=False).executor
    physics, fleet = executor.physics, executor.fleet
    assert isinstance(fleet, PhysicsFleet)
    sensors, motors = fleet.sensors, fleet.motors
    readings, commanded = np.zeros(len(commands), READING), np.zeros(len(commands), COMMAND)
    time = np.zeros(len(commands))
    for row, command in enumerate(commands):
        readings[row], time[row] = sensors.read()[0], physics.time_s
        wheels, board = tuple(command[:4].tolist()), float(command[4])
        commanded[row] = (wheels, board, 0.0)
        motors.drive(0, wheels)
        physics.move_board(0, board)
        physics.advance()
        sensors.observe()
    log = log_of(time, readings, commanded)
    return replace(log, time_s=log.time_s - log.time_s[0])
