"""What a trajectory has to show over time, by car, and what went wrong in it; arrays have a row a sample."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from craftsim.checking.attempt import Attempt
from craftsim.discrete.geometry import CELL_PITCH_M, LEVEL_HEIGHT_M
from craftsim.rendering.plots.style import line_of
from craftsim.rendering.trajectory import Trajectory

if TYPE_CHECKING:
    from matplotlib.figure import Figure, SubFigure

Floats = NDArray[np.float64]

_STEP_M: Final = 0.002
"""Between two points of a path that is drawn."""
NOTE_IN: Final = 0.14
_MOST_NOTES: Final = 6
_LONGEST: Final = 135
"""Letters in a note."""


def finite(values: NDArray[Any]) -> Floats:
    """Return numbers with nan in place of what is infinite."""
    return np.where(np.isfinite(values), values, np.nan).astype(np.float64)


def end_s(attempt: Attempt) -> float:
    """Return when an action ended."""
    return attempt.start_s + attempt.duration_s


def performed(trajectory: Trajectory, car: int) -> list[Attempt]:
    """Return the actions of a car that were carried out."""
    return [attempt for attempt in trajectory.story.attempts if attempt.performed and attempt.car == car]


def failures_of(trajectory: Trajectory) -> list[Attempt]:
    """Return the actions that were carried out and did not do as predicted, by the time of their end."""
    return sorted((a for a in trajectory.story.attempts if a.performed and not a.agrees), key=end_s)


def place_of(trajectory: Trajectory, car: int) -> Floats:
    """Return where a car truly was, (n, 3): x and y in cells, and the level; at the edge what is far outside."""
    position = trajectory.pose(f"car {car}")[:, :3] / (CELL_PITCH_M, CELL_PITCH_M, LEVEL_HEIGHT_M)
    length, width, height = trajectory.story.recipe.grid.size
    return np.clip(position + np.array([-0.5, -0.5, 1]), (-1, -1, 1), (length, width, height + 1))


def tracking_error(trajectory: Trajectory, car: int) -> Floats:
    """Return a car's measured pose less its path, (n, 3): along and across the car in metres, and heading in radians.

    It is nan where the car does not drive.
    """
    path = finite(trajectory.path[:, car])
    apart = finite(trajectory.measured[:, car]) - path
    cos, sin = np.cos(path[:, 2]), np.sin(path[:, 2])
    along, across = cos * apart[:, 0] + sin * apart[:, 1], cos * apart[:, 1] - sin * apart[:, 0]
    return np.stack([along, across, (apart[:, 2] + np.pi) % (2 * np.pi) - np.pi], axis=1)


def motor_forces(trajectory: Trajectory, car: int) -> tuple[Floats, Floats]:
    """Return the torques of a car's wheels (n, 4) in Nm and the force of its board (n,) in N; nan where it sleeps."""
    machine, forces = trajectory.physics.cars[car], finite(trajectory.force)
    torque, board = forces[:, machine.wheel_actuators], forces[:, machine.board.actuator]
    # MuJoCo works out no forces of what sleeps; an awake car's are never all exactly zero.
    asleep = (torque == 0).all(axis=1) & (board == 0)
    return np.where(asleep[:, None], np.nan, torque), np.where(asleep, np.nan, board)


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


def mark(number: int) -> str:
    """Return the sign of a failure, as drawings and notes have it."""
    return f"✗{number}"


def notes_of(trajectory: Trajectory) -> list[str]:
    """Return what went wrong in words, numbered as in the drawings."""
    notes, failures = [], failures_of(trajectory)
    for number, attempt in enumerate(failures[:_MOST_NOTES], 1):
        words = attempt.action.lower().replace("_", " ")
        text = f"{mark(number)} {end_s(attempt):.1f} s, car {attempt.car} {words}: {attempt.result}. {attempt.reason}"
        notes.append(line_of(text if len(text) <= _LONGEST else f"{text[: _LONGEST - 3]}..."))
    if more := len(failures) - len(notes):
        notes.append(f"and {more} more")
    return notes


def write_notes(figure: Figure | SubFigure, trajectory: Trajectory) -> None:
    """Say below a figure what went wrong."""
    if notes := notes_of(trajectory):
        figure.supxlabel("\n".join(notes), x=0.01, ha="left", fontsize=6.5)
