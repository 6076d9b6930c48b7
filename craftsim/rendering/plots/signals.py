"""What a trajectory has to show over time, by car and by slope, with the limits that it is held against."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from craftsim.checking.attempt import Attempt
from craftsim.checking.contacts import impact_limit_n
from craftsim.discrete.geometry import CELL_PITCH_M, LEVEL_HEIGHT_M
from craftsim.discrete.grid import Piece
from craftsim.rendering.trajectory import Trajectory

Floats = NDArray[np.float64]

_STEP_M: Final = 0.002
"""Between two points of a path that is drawn."""


@dataclass(frozen=True, eq=False)
class CarSignals:
    """One car over time; arrays have a row a sample."""

    car: int
    attempts: tuple[Attempt, ...]
    """Its actions that were carried out."""
    place: Floats
    """(n, 3) true position: x and y in cells, and the level; what is far outside of the area is at its edge."""
    error: Floats
    """(n, 3) measured pose less the path: along and across the car in metres, and heading in radians; nan where it does
    not drive."""
    torque_nm: Floats
    """(n, 4) of the wheels; nan where the car sleeps."""
    torque_limit_nm: float
    board_m: Floats
    """Its height."""
    board_force_n: Floats
    """Nan where the car sleeps."""
    board_limit_n: float


@dataclass(frozen=True, eq=False)
class Signals:
    """All that is drawn of one trajectory."""

    trajectory: Trajectory
    time_s: Floats
    cars: tuple[CarSignals, ...]
    hinges_rad: tuple[Floats, ...]
    """Of each slope, 0 when unfolded."""
    contact_n: Floats
    """The largest force between any two machines; nan where contacts were not looked at."""
    impact_limit_n: float
    design: tuple[Piece, ...]

    @classmethod
    def of(cls, trajectory: Trajectory) -> Signals:
        """Return what a trajectory has to show; raises InputError where this version makes another world of it."""
        physics, story = trajectory.physics, trajectory.story
        return cls(
            trajectory,
            trajectory.time,
            tuple(_car(trajectory, car) for car in range(len(physics.cars))),
            tuple(trajectory.qpos[:, slope.hinge.qpos] for slope in physics.slopes),
            _finite(trajectory.contact),
            story.recipe.setup.thresholds.force * impact_limit_n(story.recipe.setup.machines),
            trajectory.wanted,
        )

    @property
    def failures(self) -> list[Attempt]:
        """Return the actions that did not do as predicted, by the time of their end."""
        found = [a for a in performed(self.trajectory.story.attempts) if not a.agrees]
        return sorted(found, key=end_s)


def _finite(values: NDArray[Any]) -> Floats:
    """Return numbers with nan in place of what is infinite."""
    return np.where(np.isfinite(values), values, np.nan).astype(np.float64)


def performed(attempts: Sequence[Attempt]) -> list[Attempt]:
    """Return the attempts that were carried out."""
    return [attempt for attempt in attempts if attempt.performed]


def end_s(attempt: Attempt) -> float:
    """Return when an action ended."""
    return attempt.start_s + attempt.duration_s


def _car(trajectory: Trajectory, number: int) -> CarSignals:
    car = trajectory.physics.cars[number]
    forces = _finite(trajectory.force)
    torque, board = forces[:, car.wheel_actuators], forces[:, car.board.actuator]
    # MuJoCo works out no forces of what sleeps; an awake car's are never all exactly zero.
    asleep = (torque == 0).all(axis=1) & (board == 0)
    return CarSignals(
        number,
        tuple(a for a in performed(trajectory.story.attempts) if a.car == number),
        _place(trajectory, number),
        _error(trajectory, number),
        np.where(asleep[:, None], np.nan, torque),
        car.parameters.wheel_torque_nm,
        trajectory.qpos[:, car.board.qpos],
        np.where(asleep, np.nan, board),
        car.parameters.board_force_n,
    )


def _place(trajectory: Trajectory, car: int) -> Floats:
    position = trajectory.pose(f"car {car}")[:, :3] / (CELL_PITCH_M, CELL_PITCH_M, LEVEL_HEIGHT_M)
    length, width, height = trajectory.story.recipe.grid.size
    return np.clip(position + np.array([-0.5, -0.5, 1]), (-1, -1, 1), (length, width, height + 1))


def _error(trajectory: Trajectory, car: int) -> Floats:
    path = _finite(trajectory.path[:, car])
    apart = _finite(trajectory.measured[:, car]) - path
    cos, sin = np.cos(path[:, 2]), np.sin(path[:, 2])
    along, across = cos * apart[:, 0] + sin * apart[:, 1], cos * apart[:, 1] - sin * apart[:, 0]
    return np.stack([along, across, (apart[:, 2] + np.pi) % (2 * np.pi) - np.pi], axis=1)


def thinned(time_s: Floats, values: Floats, most: int) -> tuple[Floats, Floats]:
    """Return a line with about ``most`` points at most: of each stretch the lowest and the highest, so peaks stay."""
    if len(time_s) <= most:
        return time_s, values
    kept = {0, len(time_s) - 1}
    for stretch in np.array_split(np.arange(len(time_s)), max(1, most // 2)):
        part = values[stretch]
        missing = np.isnan(part)
        if missing.any():
            kept.add(int(stretch[missing.argmax()]))
        if not missing.all():
            kept |= {int(stretch[np.nanargmin(part)]), int(stretch[np.nanargmax(part)])}
    chosen = sorted(kept)
    return time_s[chosen], values[chosen]


def path_points(place: Floats) -> list[int]:
    """Return the samples of a path (n, 3) in cells and levels that a drawing of it needs."""
    scale = np.array([CELL_PITCH_M, CELL_PITCH_M, LEVEL_HEIGHT_M])
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(place, axis=0) * scale, axis=1))])
    return sorted({0, *np.flatnonzero(np.diff(np.floor(way / _STEP_M))).tolist(), len(place) - 1})
