"""Skills: what controls a car while it performs an action.

A built-in skill is a function that sets up a task from a measurement (``begin_...``); the compiled laws of
:mod:`craftsim.skills.laws` then control all cars at once. A user-defined skill is a subclass of :class:`Skill`, stepped
in Python. :mod:`craftsim.skills.library` lists the skill of each action.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, ClassVar, Final

import numpy as np

from craftsim.compiled.jit import records
from craftsim.discrete.geometry import CELL_PITCH_M, DIRECTIONS, yaw_angle
from craftsim.discrete.readback import nearest_yaw
from craftsim.errors import InputError
from craftsim.models.measuring import Wheels, write_reading
from craftsim.models.sensing import CarMeasurement
from craftsim.skills import state
from craftsim.skills.laws import Profile, health_of, step_task
from craftsim.skills.limits import MOVE_LIMITS, TURN_LIMITS, Motion, binding_limits, felt_load
from craftsim.skills.mecanum import Triple
from craftsim.skills.outcome import Outcome, Reason
from craftsim.skills.setup import SkillSetup
from craftsim.storage.limits import Range


@dataclass(frozen=True)
class Command:
    """Commands to a car's motors for one control period.

    Example:
        >>> import craftsim
        >>> craftsim.Command(board=0.02)
        Command(wheels=(0.0, 0.0, 0.0, 0.0), board=0.02, hinge=0.0)
    """

    wheels: Wheels = (0.0, 0.0, 0.0, 0.0)
    """In rad/s."""
    board: Annotated[float, Range(-10.0, 10.0)] = 0.0
    """m/s, up positive."""
    hinge: Annotated[float, Range(-100.0, 100.0)] = 0.0
    """rad/s of the docked slope's hinge, folding positive."""


_FIRST_PACE: Final = 0.2
"""Pace at which a path begins that may wait for its car."""
_ASIDE_M: Final = 0.005
"""By how much further a load is taken past something: as far as it drifts to a side on an uneven floor."""
TaskRecord = np.void
"""A record of TASK."""
Begin = Callable[[SkillSetup, CarMeasurement, TaskRecord], None]
"""Sets up the task of a compiled law from what the car measures."""


def cell_middle(
    measurement: CarMeasurement, yaw: int, along_x: int = 0, along_y: int = 0
) -> Triple:
    """Return the middle of a cell, counted from the one that a car is in, and the heading of a yaw."""
    x = math.floor(measurement.x / CELL_PITCH_M) + along_x
    y = math.floor(measurement.y / CELL_PITCH_M) + along_y
    return (x + 0.5) * CELL_PITCH_M, (y + 0.5) * CELL_PITCH_M, yaw_angle(yaw)


def begin_move(
    setup: SkillSetup,
    measurement: CarMeasurement,
    task: TaskRecord,
    direction: int,
    target: Triple | None = None,
) -> None:
    """Drive in a grid direction 0..3 (+x, +y, -x, -y), keeping the heading; to the neighbour cell unless to a pose."""
    terrain = setup.terrain
    yaw, _ = nearest_yaw(measurement.heading)
    if target is None:
        target = cell_middle(measurement, yaw, *DIRECTIONS[direction].tolist())
    sideways = bool((direction - yaw) % 2)
    move = Motion.of(setup, measurement, sideways)
    limits = binding_limits(move, MOVE_LIMITS)
    begin_path(setup, measurement, task, target, (limits.speed, limits.acceleration))
    drive = task["drive"]
    drive["waits"] = (
        setup.expects_uneven_floor and move.loaded and terrain.tight and not terrain.sloping
    )
    if drive["waits"]:
        drive["pace"] = _FIRST_PACE
        if any(terrain.free_side):
            aside_s = Profile.within(_ASIDE_M, limits.speed, limits.acceleration).duration_s
            drive["aside_x"], drive["aside_y"] = (_ASIDE_M * side for side in terrain.free_side)
            drive["begins_s"] = aside_s
            drive["ends_s"] += 2 * aside_s
    else:
        drive["pace"] = 1.0
    drive["under"] = terrain.tight and not move.loaded
    drive["step_x"], drive["step_y"] = DIRECTIONS[direction]
    drive["sloping"] = terrain.sloping
    drive["start_rad"] = terrain.start_rad
    drive["end_rad"] = terrain.end_rad


def begin_turn(
    setup: SkillSetup,
    measurement: CarMeasurement,
    task: TaskRecord,
    quarter: int,
    target: Triple | None = None,
) -> None:
    """Turn on the spot by a quarter: +1 is left, counter-clockwise, -1 is right; or to a pose in this cell."""
    if target is None:
        yaw, _ = nearest_yaw(measurement.heading)
        target = cell_middle(measurement, yaw + quarter)
    limits = binding_limits(Motion.of(setup, measurement), TURN_LIMITS)
    begin_path(setup, measurement, task, target, (limits.speed, limits.acceleration), turning=True)


def begin_pose(
    setup: SkillSetup, measurement: CarMeasurement, task: TaskRecord, target: Triple
) -> None:
    """Drive to a pose in the car's cell; the path is led by its way or its turn, whichever takes longer."""
    motion = Motion.of(setup, measurement)
    move = binding_limits(motion, MOVE_LIMITS)
    turn = binding_limits(motion, TURN_LIMITS)
    x, y, heading = target
    way_s = math.hypot(x - measurement.x, y - measurement.y) / move.speed
    turn_s = abs(math.remainder(heading - measurement.heading, math.tau)) / turn.speed
    if way_s > turn_s:
        limits = move.speed, move.acceleration
    else:
        limits = turn.speed, turn.acceleration
    begin_path(setup, measurement, task, target, limits, turning=way_s <= turn_s)


def begin_path(
    setup: SkillSetup,
    measurement: CarMeasurement,
    task: TaskRecord,
    target: Triple,
    limits: tuple[float, float],
    turning: bool = False,
) -> None:
    """Follow a smooth path from the measured pose to a target pose, and come to rest on it.

    ``limits`` are of speed and acceleration along the path, in metres, or of a path that is ``turning`` in radians.
    """
    loaded, load_kg = felt_load(setup, measurement)
    x, y, heading = target
    delta = (
        x - measurement.x,
        y - measurement.y,
        math.remainder(heading - measurement.heading, math.tau),
    )
    if turning:
        length = abs(float(delta[2]))
    else:
        length = float(np.hypot(delta[0], delta[1]))
    profile = Profile.within(length, *limits)
    travel = profile.distance(profile.duration_s)
    task["law"] = state.DRIVE
    drive = task["drive"]
    drive["origin"] = measurement.x, measurement.y, measurement.heading
    drive["delta"] = delta
    if travel:
        drive["direction"] = tuple(d / travel for d in delta)
    else:
        drive["direction"] = (0.0, 0.0, 0.0)
    drive["profile"] = profile.cruise_speed, profile.ramp_s, profile.duration_s
    drive["ends_s"] = profile.duration_s
    drive["path"] = measurement.x, measurement.y, measurement.heading
    drive["load_kg"] = load_kg
    drive["loaded"] = loaded
    drive["before"] = drive["origin"]
    drive["wheels_before"] = measurement.wheel_speeds


def begin_board(
    setup: SkillSetup,
    measurement: CarMeasurement,
    task: TaskRecord,
    target_m: float,
    needs_load: bool = False,
) -> None:
    """Bring the board to so much above its lower stop; with ``needs_load`` it must feel a load there."""
    task["law"] = state.BOARD
    board = task["board"]
    board["target_m"] = target_m
    board["last_m"] = measurement.board_m
    board["needs_load"] = needs_load
    travel = abs(target_m - measurement.board_m)
    board["deadline_s"] = travel / setup.machine.board_speed_m_s + setup.gains.board.allowance


def begin_lift(setup: SkillSetup, measurement: CarMeasurement, task: TaskRecord) -> None:
    """Raise the board to its upper stop, where it must feel a load; on an uneven floor the car centres itself first."""
    begin_board(setup, measurement, task, setup.machine.board_travel_m, needs_load=True)
    lean = max(abs(measurement.pitch), abs(measurement.roll))
    if not setup.expects_uneven_floor or lean > setup.gains.hold.level:
        return
    limits = binding_limits(Motion.of(setup, measurement), MOVE_LIMITS)
    target = cell_middle(measurement, nearest_yaw(measurement.heading)[0])
    begin_path(setup, measurement, task, target, (limits.speed, limits.acceleration))
    task["drive"]["centres"] = True


def begin_hinge(
    setup: SkillSetup, measurement: CarMeasurement, task: TaskRecord, folds: bool
) -> None:
    """Bring the hinge of the docked slope, the first in a reading, to one end of its range."""
    task["law"] = state.HINGE
    hinge = task["hinge"]
    if folds:
        hinge["target_rad"] = setup.machines.slope.hinge_range_rad
    else:
        hinge["target_rad"] = 0.0
    hinge["slope"] = -1


def begin_stop(setup: SkillSetup, measurement: CarMeasurement, task: TaskRecord) -> None:
    """Command all motors to zero until the wheels rest."""
    task["law"] = state.STOP


def begin_task(
    begin: Begin, setup: SkillSetup, measurement: CarMeasurement, task: TaskRecord
) -> None:
    """Set up a task; it has ended already for a car that has tipped or whose readings are not finite."""
    status = _health(setup, measurement)
    if status == state.RUNNING:
        begin(setup, measurement, task)
    else:
        begin_stop(setup, measurement, task)
        task["status"] = status
        task["detail"] = measurement.pitch
        task["second_detail"] = measurement.roll


def _health(setup: SkillSetup, measurement: CarMeasurement) -> int:
    if measurement.hinge_rad is None:
        measurement = measurement._replace(hinge_rad=0.0)
    return health_of(measurement, setup.gains.health)


class Skill(ABC):
    """A controller of one action of one car, in Python; subclass it for one of your own.

    It is constructed with a :class:`SkillSetup`, started with a measurement, and stepped with one each control period
    until its outcome is set. It also ends if the car tips or its readings are not finite.

    Example:
        >>> import craftsim
        >>> class Raise(craftsim.Skill):
        ...     def step(self, measurement):
        ...         if measurement.board_m > self.setup.machine.board_travel_m - 0.0005:
        ...             self.succeed()
        ...         return craftsim.Command(board=0.02)
        >>> issubclass(Raise, craftsim.Skill), Raise.time_limit_s
        (True, 60.0)
    """

    time_limit_s: ClassVar[float] = 60.0
    """Simulated time after which it has failed."""

    def __init__(self, setup: SkillSetup) -> None:
        self.setup = setup
        self.outcome: Outcome | None = None
        """Its outcome; None before the end. Commands from then on are ignored."""
        self.elapsed_s = 0.0
        """Simulated time since its start."""

    def start(self, measurement: CarMeasurement) -> None:
        """Derive the goal from what the car measures; nothing unless overridden."""
        return

    @abstractmethod
    def step(self, measurement: CarMeasurement) -> Command:
        """Return the command for the next control period; call :meth:`succeed` or :meth:`fail` at the end."""

    def succeed(self) -> None:
        """End: the goal is reached."""
        self.outcome = Outcome(None, self.elapsed_s)

    def fail(self, reason: Reason, detail: str = "") -> None:
        """End: it is not."""
        self.outcome = Outcome(reason, self.elapsed_s, detail)


class LawSkill(Skill):
    """A compiled law as a part of a user-defined skill: ``LawSkill(setup, begin_lift)``."""

    def __init__(self, setup: SkillSetup, begin: Begin) -> None:
        super().__init__(setup)
        self._begin = begin
        self._cars = records(1, state.CAR)
        self._angles = np.zeros((1, state.n_angles(setup.gains, setup.period_s)))
        self._cars["known"] = setup.constants
        self._cars["task"] = state.NO_TASK

    @property
    def task(self) -> np.void:
        """Its state, a record of TASK."""
        task: TaskRecord = self._cars[0]["task"]
        return task

    def start(self, measurement: CarMeasurement) -> None:
        """Set up the task from a measurement."""
        begin_task(self._begin, self.setup, measurement, self.task)
        self.outcome = state.outcome_of(self.task)

    def step(self, measurement: CarMeasurement) -> Command:
        """Return the command for the next control period; sets the outcome when the task has ended."""
        if self.outcome is not None:
            return Command()
        write_reading(measurement, self._cars["now"])
        step_task(self._cars[0], self._angles[0])
        self.elapsed_s = float(self.task["elapsed_s"])
        self.outcome = state.outcome_of(self.task)
        command = self._cars[0]["command"]
        fl, fr, rl, rr = command["wheels"].tolist()
        return Command((fl, fr, rl, rr), float(command["board"]), float(command["hinge"]))


def start_own(kind: type[Skill], setup: SkillSetup, measurement: CarMeasurement) -> Skill:
    """Return a user-defined skill that is started. Raises InputError if its base class was not initialized."""
    skill = kind(setup)
    if not hasattr(skill, "outcome") or not hasattr(skill, "elapsed_s"):
        raise InputError(f"the skill {kind.__name__}: __init__ must call super().__init__(setup)")
    _check_own(skill, measurement)
    if skill.outcome is None:
        skill.start(measurement)
    return skill


def step_own(skill: Skill, measurement: CarMeasurement) -> Command:
    """Return the command of a user-defined skill, zeros once it has ended; enforce its time limit.

    Raises InputError if it returns no Command, or sets an invalid outcome.
    """
    name = type(skill).__name__
    if skill.outcome is None:
        _check_own(skill, measurement)
    if skill.outcome is not None:
        return Command()
    command = skill.step(measurement)
    if not isinstance(command, Command):
        raise InputError(f"the skill {name}: step() returned {command!r}; it must return a Command")
    if not isinstance(skill.outcome, Outcome | None):
        raise InputError(
            f"the skill {name}: its outcome is {skill.outcome!r}; allowed: None or an Outcome"
        )
    try:
        numbers = [float(number) for number in (*command.wheels, command.board, command.hinge)]
    except (TypeError, ValueError):
        numbers = []
    if len(numbers) != 6:
        raise InputError(
            f"the skill {name}: {command!r} must hold four wheel speeds and two numbers"
        )
    if not all(map(math.isfinite, numbers)):
        skill.fail(Reason.DIVERGED, f"the skill {name} commands what is not finite")
    skill.elapsed_s += skill.setup.period_s
    if skill.outcome is None and skill.elapsed_s >= skill.time_limit_s:
        skill.fail(Reason.TIMEOUT, f"the skill {name} did not end within {skill.time_limit_s:g} s")
    if skill.outcome is not None:
        return Command()
    return command


def _check_own(skill: Skill, measurement: CarMeasurement) -> None:
    skill.outcome = state.ending(
        _health(skill.setup, measurement), skill.elapsed_s, measurement.pitch, measurement.roll
    )
