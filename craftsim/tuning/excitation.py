"""An identification drive: wheel commands that show what a car's motors, wheels and friction are, in a small free area.

Each manoeuvre goes out and comes back by the same commands with the sign turned, so that the car needs no feedback to
stay in its area. They go through directions, speeds and accelerations in turn; between them the car stands still.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np

from craftsim.checking.setup import Seed, Setup, set_up
from craftsim.compiled.arrays import Floats
from craftsim.discrete.geometry import CELL_PITCH_M
from craftsim.discrete.grid import CarField, Grid, Kind
from craftsim.errors import InputError
from craftsim.mjcf.parameters import SmartcarParameters
from craftsim.models.effects import ROLLERS
from craftsim.models.measuring import READING
from craftsim.models.world import PhysicsWorld
from craftsim.robots.log import Log, log_of
from craftsim.skills.fleet import PhysicsFleet
from craftsim.skills.mecanum import Mecanum, Triple
from craftsim.skills.skill import Command
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


Drawn = dict[str, list[float]]
"""What was drawn of a car, or is as assumed where nothing is drawn: by name with the unit, of each wheel or of the
car."""


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
        sides = (
            (self.length_m, along),
            (self.width_m, across),
            (min(self.length_m, self.width_m), bool(turn)),
        )
        return min((side / 2 - _CLEAR_M) / abs(share) for side, share in sides if share)


def excitation(
    duration_s: float, area: Area, car: SmartcarParameters, period_s: float, loaded: bool = False
) -> Floats:
    """Return the commands of a drive, (n, 6) as of a log, a row each control period.

    ``loaded``: a block stands over the car, behind the area. The drive then begins with lifting it, moves gently with
    it, puts it down and goes out from under it, straight on into the centre of the area.
    """
    n_rows = round(duration_s / period_s)
    standstill = _still(_REST_S, period_s)
    rows = [_still(_STILL_S, period_s), _board(1.0, car, period_s), standstill]
    if loaded:
        rows += _manoeuvres(
            int(_LOADED_SHARE * n_rows) - sum(map(len, rows)), True, area, car, period_s
        )
    rows += [_board(-0.5, car, period_s), standstill]
    if loaded:
        rows += [_straight(_DIRECTIONS[0], 0.3, 0.5, area.from_load_m, car, period_s), standstill]
    rows += _manoeuvres(n_rows - sum(map(len, rows)), False, area, car, period_s)
    commands = np.vstack([*rows, np.zeros((max(0, n_rows - sum(map(len, rows))), 6))])
    return commands[:n_rows]


def _still(time_s: float, period_s: float) -> Floats:
    return np.zeros((round(time_s / period_s), 6))


def _board(share: float, car: SmartcarParameters, period_s: float) -> Floats:
    """Return the commands that move the board to its end at a share of its speed, up positive."""
    rows = _still(_BOARD_S / abs(share), period_s)
    rows[:, 4] = share * car.board_speed_m_s
    return rows


def _manoeuvres(
    n_rows: int, loaded: bool, area: Area, car: SmartcarParameters, period_s: float
) -> list[Floats]:
    """Return manoeuvres as long as they fit into ``n_rows`` rows with rest at the end; gentle ones with a load."""
    directions = _DIRECTIONS
    if loaded:
        directions = (_DIRECTIONS[0], _DIRECTIONS[2])
    speeds = _LOADED_SPEEDS if loaded else _SPEEDS
    standstill = _still(_REST_S, period_s)
    still = round(_STILL_S / period_s)
    rows: list[Floats] = []
    for number in range(n_rows):
        round_number, which = divmod(number, len(directions))
        direction = directions[which]
        speed = speeds[(which + round_number) % len(speeds)] * (
            car.wheel_speed_rad_s * car.wheel_radius_m
        )
        spot = direction[:2] == (0.0, 0.0)
        accelerations = _LOADED_ACCELERATIONS if loaded else _TURNING if spot else _ACCELERATIONS
        acceleration = accelerations[(which + 3 * round_number) % len(accelerations)]
        if spot and speed < _STEP_M_S:
            acceleration = math.inf
        if loaded or number % 2 == 0:
            sign = 1.0
        else:
            sign = -1.0
        reach = min(area.reach_m(direction), speed * (speed / acceleration + _CRUISE_S))
        out = _straight(direction, sign * speed, acceleration, reach, car, period_s)
        if sum(map(len, rows)) + 2 * (len(out) + len(standstill)) + still > n_rows:
            break
        rows += [out, standstill, -out, standstill]
    return rows


def _straight(
    direction: Triple,
    speed: float,
    acceleration: float,
    distance_m: float,
    car: SmartcarParameters,
    period_s: float,
) -> Floats:
    """Return the wheels' commands on a trapezoid of speed over a way in metres."""
    if distance_m < abs(speed) * (abs(speed) / acceleration):
        speed = math.copysign(math.sqrt(distance_m * acceleration), speed)
    ramp_s = abs(speed) / acceleration
    whole_s = 2 * ramp_s + (distance_m / abs(speed) - ramp_s)
    middle = period_s * (np.arange(math.ceil(whole_s / period_s)) + 0.5)
    share = np.ones(len(middle))
    if ramp_s:
        share = np.clip(np.minimum(middle, whole_s - middle) / ramp_s, 0.0, 1.0)
    along, across, turn = direction
    kinematics = Mecanum(car)
    rows = np.zeros((len(middle), 6))
    wheels = kinematics.wheel_speeds((along, across, turn / kinematics.lever_m))
    rows[:, :4] = np.outer(speed * share, wheels)
    return np.clip(rows, -car.wheel_speed_rad_s, car.wheel_speed_rad_s)


def free_area(area: Area, loaded: bool = False) -> Grid:
    """Return a world of one car in the middle of a free area; ``loaded``: under a block behind it."""
    size = [
        2 * (math.ceil(side / 2 / CELL_PITCH_M) + 2) + 1 for side in (area.length_m, area.width_m)
    ]
    grid = Grid.empty((size[0], size[1], 2), n_cars=1)
    x = size[0] // 2 - area.cells_behind * loaded
    y = size[1] // 2
    grid.cars[0, CarField.X] = x
    grid.cars[0, CarField.Y] = y
    if loaded:
        grid.kind[x, y, 1] = Kind.BLOCK
    grid.derive_marks()
    return grid


class Driven(NamedTuple):
    """What came of driving a simulated car."""

    log: Log
    drawn: Drawn
    """What the car is."""
    capped_steps: int
    """Physics steps in which the solver gave up: with any the log is of no physics."""


def drive(grid: Grid, setup: Setup, seed: Seed, commands: Floats) -> Driven:
    """Return the log of the first car of a world that is driven by commands, (n, 6) as of a log, and what it is.

    Nothing sleeps in it: a car that MuJoCo has to wake takes a moment that no real one takes.
    """
    setup = replace(setup, simulation=replace(setup.simulation, sleep=False))
    executor = set_up(grid, setup, seed, watch_contacts=False).executor
    physics = executor.physics
    fleet = executor.fleet
    assert isinstance(fleet, PhysicsFleet)
    parameters = _drawn(physics, fleet)
    readings = np.zeros(len(commands), READING)
    commanded = np.zeros(len(commands), COMMAND)
    time = np.zeros(len(commands))
    for row, command in enumerate(commands):
        readings[row], time[row] = fleet.read()[0], physics.time_s
        wheels = tuple(command[:4].tolist())
        board = float(command[4])
        commanded[row] = (wheels, board, 0.0)
        fleet.drive(0, Command(wheels, board), -1)
        fleet.advance()
    log = log_of(time, readings, commanded)
    return Driven(replace(log, time_s=log.time_s - log.time_s[0]), parameters, physics.capped_steps)


def _drawn(physics: PhysicsWorld, fleet: PhysicsFleet) -> Drawn:
    """Return what was drawn of a world's first car."""
    model = physics.model
    baseline = physics.baseline
    car = physics.cars[0]
    motors = list(car.wheel_actuators)
    gear_friction = baseline.dof_frictionloss[list(car.wheel_dofs)]
    mass_kg = float(model.body_subtreemass[model.dof_bodyid[car.base.dof]])
    down = -float(model.opt.gravity[2]) / float(np.linalg.norm(model.opt.gravity))
    (touching,) = np.flatnonzero(model.geom_contype == ROLLERS)[:1]
    return {
        "mass of the car, kg": [mass_kg],
        "torque limit of the wheel motors, Nm": baseline.actuator_forcerange[motors, 1].tolist(),
        "gain of the wheel motors, Nm s/rad": baseline.actuator_gainprm[motors, 0].tolist(),
        "dry friction of the gears, Nm": gear_friction.tolist(),
        "friction between wheels and floor": [float(baseline.geom_friction[touching, 0])],
        "dry friction of the board's screw, N": [float(model.dof_frictionloss[car.board.dof])],
        "grease on the board's screw, N s/m": [float(model.dof_damping[car.board.dof])],
        "tilt of the floor, mrad": [1e3 * math.acos(min(1.0, down))],
        "delay of the localisation, ms": [1e3 * float(fleet.sensors.delays_s[0])],
    }
