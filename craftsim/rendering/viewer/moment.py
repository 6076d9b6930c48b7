"""What is known of a run at one moment, of each car its action, poses, forces and verdict; and that as HTML."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from types import MappingProxyType
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from craftsim.checking.attempt import Attempt
from craftsim.checking.judge import Judge
from craftsim.discrete.schedule import ScheduledAction
from craftsim.models.world import PhysicsWorld
from craftsim.rendering.trajectory import Trajectory

_SAME_S: Final = 1e-6
LISTED: Final = 9
"""Actions in the list at one time."""
_GOOD, _BAD, _QUIET = "#2b8a3e", "#c92a2a", "#868e96"
_ROWS: Final = "<table style='width:100%;font-size:0.8em;border-spacing:0 0.15em'>"


class Motor(NamedTuple):
    """What a motor of a car gives."""

    name: str
    """``wheel_fl`` and its like, or ``board``."""
    force: float
    """Nm of a wheel, N of a board."""
    limit: float
    """The most that it can give, in the same unit."""


class CarMoment(NamedTuple):
    """What is known of a car."""

    action: str
    """Name of the action that runs; empty where there is none."""
    pose: tuple[float, float, float]
    """x, y and z in metres, where it is."""
    measured: tuple[float, float, float] | None
    """x and y in metres and heading in radians, as it measures them; None where nobody knows."""
    motors: tuple[Motor, ...]
    attempt: Attempt | None
    """The verdict on its action, where that is known, or else on its last one; None before its first."""


class Moment(NamedTuple):
    """What is known of a run."""

    time_s: float
    cars: tuple[CarMoment, ...]
    contact_n: float
    """The largest force between any two machines; nan where nobody looks."""


def recorded(trajectory: Trajectory, sample: int) -> Moment:
    """Return what a trajectory knows of one of its samples."""
    time_s, physics = float(trajectory.time[sample]), trajectory.physics
    cars = []
    for car in range(len(physics.cars)):
        attempt = _last(trajectory.story.attempts, car, time_s)
        runs = attempt is not None and time_s < attempt.start_s + attempt.duration_s - _SAME_S
        action = attempt.action if attempt is not None and runs else ""
        pose, measured = trajectory.pose(f"car {car}")[sample, :3], trajectory.measured[sample, car]
        motors = _motors(physics, trajectory.force[sample], car)
        cars.append(CarMoment(action, _triple(pose), _triple(measured), motors, attempt))
    return Moment(time_s, tuple(cars), float(trajectory.contact[sample]))


def live(
    physics: PhysicsWorld,
    judge: Judge | None = None,
    running: Mapping[int, ScheduledAction] = MappingProxyType({}),
    attempts: Sequence[Attempt] = (),
) -> Moment:
    """Return what is known of a PhysicsWorld now.

    Args:
        physics: the world.
        judge: the judge on it, where there is one.
        running: the actions on their way, by car.
        attempts: those that have been judged.
    """
    readings = None if judge is None else judge.executor.readings()
    log = None if judge is None else judge.log
    cars = []
    for car, machine in enumerate(physics.cars):
        action = running[car].action.name if car in running else ""
        read = None if readings is None else [readings[car][name] for name in ("x", "y", "heading")]
        pose = _triple(physics.free_body_state(machine.base)[0])
        motors = _motors(physics, physics.data.actuator_force, car)
        attempt = _last(attempts, car, physics.time_s)
        cars.append(CarMoment(action, pose, None if read is None else _triple(read), motors, attempt))
    return Moment(physics.time_s, tuple(cars), np.nan if log is None else log.period_n)


def _last(attempts: Sequence[Attempt], car: int, time_s: float) -> Attempt | None:
    """Return a car's last attempt that has begun."""
    own = (one for one in reversed(attempts) if one.car == car and one.start_s <= time_s + _SAME_S)
    return next(own, None)


def _triple(numbers: Iterable[float]) -> tuple[float, float, float]:
    first, second, third = map(float, numbers)
    return first, second, third


def _motors(physics: PhysicsWorld, force: NDArray[np.floating], car: int) -> tuple[Motor, ...]:
    machine, model = physics.cars[car], physics.model
    columns = [*machine.wheel_actuators.tolist(), machine.board.actuator]
    names = [model.actuator(column).name.split("/")[-1] for column in columns]
    return tuple(map(Motor, names, force[columns].tolist(), model.actuator_forcerange[columns, 1].tolist()))


def title_html(title: str) -> str:
    """Return what stands above all."""
    return _framed(f"<b>{escape(title)}</b>")


def car_html(moment: Moment, car: int) -> str:
    """Return what is known of a car."""
    state = moment.cars[car]
    x, y, z = state.pose
    rows = [
        ("time", f"{moment.time_s:.2f} s"),
        ("action", escape(state.action) or "waits"),
        ("pose", f"{x:z.3f}, {y:z.3f}, {z:z.3f} m"),
    ]
    if state.measured is not None:
        x, y, heading = state.measured
        rows.append(("measured", f"{x:z.3f}, {y:z.3f} m, {math.degrees(heading):z.1f}°"))
    *wheels, board = state.motors
    rows.append(("wheels (Nm)", "".join(_bar(motor, motor.name[-2:]) for motor in wheels)))
    rows.append(("board (N)", _bar(board, "")))
    if not math.isnan(moment.contact_n):
        rows.append(("largest contact", f"{moment.contact_n:.0f} N, of all machines"))
    cells = "".join(f"<tr><td style='color:{_QUIET}'>{name}</td><td>{text}</td></tr>" for name, text in rows)
    return _framed(f"{_ROWS}{cells}</table>{_verdict(state)}")


def list_html(attempts: Sequence[Attempt], time_s: float) -> str:
    """Return the actions around a moment: when each began, of which car, and the verdict on it."""
    if not attempts:
        return _framed(f"<span style='color:{_QUIET}'>no actions yet</span>")
    ordered = sorted(attempts, key=lambda one: (one.start_s, one.car))
    begun = sum(one.start_s <= time_s + 1e-6 for one in ordered)
    first = max(0, min(begun - LISTED // 2 - 1, len(ordered) - LISTED))
    rows = []
    for number, one in enumerate(ordered[first : first + LISTED], first):
        runs = one.start_s <= time_s < one.start_s + one.duration_s
        style = "font-weight:600;background:#e7f5ff" if runs else f"color:{_QUIET}" if number >= begun else ""
        texts = (f"{one.start_s:.1f} s", f"car {one.car}", escape(one.action), _mark(one))
        rows.append(f"<tr style='{style}'>{''.join(f'<td>{text}</td>' for text in texts)}</tr>")
    return _framed(f"{_ROWS}{''.join(rows)}</table>")


def _verdict(state: CarMoment) -> str:
    attempt = state.attempt
    if attempt is None:
        return ""
    which = "" if attempt.action == state.action else f"last: {escape(attempt.action)}, "
    reason = f"<br>{escape(attempt.reason)}" if attempt.reason else ""
    return f"<div style='font-size:0.85em;margin-top:0.3em'>{which}{_mark(attempt)}{reason}</div>"


def _mark(attempt: Attempt) -> str:
    return f"<span style='color:{_GOOD if attempt.agrees else _BAD}'>{escape(attempt.result)}</span>"


def _bar(motor: Motor, name: str) -> str:
    """Return what a motor gives, over a bar that is full at its limit."""
    share = min(1.0, abs(motor.force) / motor.limit) if motor.limit else 0.0
    bar = f"<span style='display:block;width:{100 * share:.0f}%;height:0.3em;background:#4dabf7'></span>"
    style = "display:inline-block;width:24%;margin-right:1%;font-size:0.9em"
    return f"<span style='{style}' title='of {motor.limit:g}'>{name} {motor.force:z.2f}{bar}</span>"


def _framed(content: str) -> str:
    return f"<div style='padding:0 0.75em'>{content}</div>"
