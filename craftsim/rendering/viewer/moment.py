"""What is known of a run at one moment: of each car its action, its poses and forces, and the verdict on it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from craftsim.checking.attempt import Attempt
from craftsim.checking.judge import Judge
from craftsim.discrete.schedule import ScheduledAction
from craftsim.models.world import PhysicsWorld
from craftsim.rendering.trajectory import Trajectory

_SAME_S = 1e-6


@dataclass(frozen=True)
class Motor:
    """What a motor of a car gives."""

    name: str
    """``wheel_fl`` and its like, or ``board``."""
    force: float
    """Nm of a wheel, N of a board."""
    limit: float
    """The most that it can give, in the same unit."""


@dataclass(frozen=True)
class CarMoment:
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


@dataclass(frozen=True)
class Moment:
    """What is known of a run."""

    time_s: float
    cars: tuple[CarMoment, ...]
    contact_n: float
    """The largest force between any two machines; nan where nobody looks."""


def recorded(trajectory: Trajectory, sample: int) -> Moment:
    """Return what a trajectory knows of one of its samples."""
    time_s = float(trajectory.time[sample])
    cars = []
    for car in range(len(trajectory.physics.cars)):
        attempt = _last(trajectory.story.attempts, car, time_s)
        runs = attempt is not None and time_s < attempt.start_s + attempt.duration_s - _SAME_S
        x, y, heading = trajectory.measured[sample, car].tolist()
        cars.append(
            CarMoment(
                attempt.action if attempt is not None and runs else "",
                _position(trajectory.pose(f"car {car}")[sample]),
                (x, y, heading),
                _motors(trajectory.physics, trajectory.force[sample], car),
                attempt,
            )
        )
    return Moment(time_s, tuple(cars), float(trajectory.contact[sample]))


def live(
    physics: PhysicsWorld,
    judge: Judge | None = None,
    running: dict[int, ScheduledAction] | None = None,
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
        step = (running or {}).get(car)
        believed = None if readings is None else _believed(readings[car])
        cars.append(
            CarMoment(
                "" if step is None else step.action.name,
                _position(physics.free_body_state(machine.base)[0]),
                believed,
                _motors(physics, physics.data.actuator_force, car),
                _last(attempts, car, physics.time_s),
            )
        )
    return Moment(physics.time_s, tuple(cars), np.nan if log is None else log.period_n)


def _last(attempts: Sequence[Attempt], car: int, time_s: float) -> Attempt | None:
    """Return a car's last attempt that has begun."""
    own = (one for one in reversed(attempts) if one.car == car and one.start_s <= time_s + _SAME_S)
    return next(own, None)


def _believed(reading: np.void) -> tuple[float, float, float]:
    """Return x, y and heading of a record of READING."""
    return float(reading["x"]), float(reading["y"]), float(reading["heading"])


def _position(numbers: NDArray[np.floating]) -> tuple[float, float, float]:
    x, y, z = numbers[:3].tolist()
    return x, y, z


def _motors(physics: PhysicsWorld, force: NDArray[np.floating], car: int) -> tuple[Motor, ...]:
    machine, model = physics.cars[car], physics.model
    columns = [*machine.wheel_actuators.tolist(), machine.board.actuator]
    names = [model.actuator(column).name.split("/")[-1] for column in columns]
    limits = model.actuator_forcerange[columns, 1].tolist()
    return tuple(
        Motor(name, float(force[column]), limit)
        for name, column, limit in zip(names, columns, limits, strict=True)
    )
