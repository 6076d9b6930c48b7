"""Figures of a recorded run, each by itself or all on one page: paths from above, and diagrams over time.

Diagrams show what each car did, errors and loads below it against their limits, and what went wrong.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon
from numpy.typing import NDArray

from craftsim.checking.attempt import Attempt
from craftsim.compiled.arrays import Floats
from craftsim.discrete.drawing import INK, car_colour
from craftsim.discrete.geometry import CELL_PITCH_M, LEVEL_HEIGHT_M
from craftsim.rendering.grid_picture import levels_of
from craftsim.rendering.plots.levels import CARS_ZORDER, draw_levels, size_in
from craftsim.rendering.plots.style import ROW_IN, WIDTH_IN, dash, line_of, paper, save, shade
from craftsim.rendering.trajectory import Trajectory
from craftsim.storage.folders import output_directory
from craftsim.storage.limits import shorten

"""A row a sample."""
Plot = tuple[float, Callable[[Figure | SubFigure], None]]
"""Height of a figure in inches, and what draws it."""

_FORMATS: Final = ("pdf", "png")
PAGE: Final = "all"
"""Name of the page with all figures."""
_TITLE_IN: Final = 0.3
_LANE_IN: Final = 0.17
_AXIS_IN: Final = 0.5
_FOOT_IN: Final = 0.15
_NOTE_IN: Final = 0.14
_LEGEND_ROW_IN: Final = 0.16
_SIGN_IN: Final = 0.07  # width of an action's sign
_MOST_CARS: Final = 24  # with a diagram of their own
_MOST_NOTES: Final = 6
_LONGEST_NOTE: Final = 135
_LEGEND_COLUMNS: Final = 8
_STEP_M: Final = 0.002  # between two points of a path that is drawn
_ARROW_EVERY: Final = 0.9  # cells of way between two arrows, at least
_MOST_ARROWS: Final = 100  # of a car
_STAYED: Final = 0.5  # cells of way that are none
_BESIDE: Final = 0.33  # cells in x and in y: where no number of a car stands that began there
_WIDTHS: Final = (
    2.6,
    2.0,
    1.5,
    1.1,
)  # of paths in points, car after car, so that one shows below another

FAILURE_SIGNS: Final = {
    "LIFT": "L",
    "DROP": "D",
    "FOLD": "F",
    "UNFOLD": "U",
    "ROTATE_LEFT": "↺",
    "ROTATE_RIGHT": "↻",
    "MOVE_FORWARD": "↑",
    "MOVE_BACK": "↓",
    "MOVE_LEFT": "←",
    "MOVE_RIGHT": "→",
    "STOP": "·",
}
"""Of actions; moves as on a map with y up."""


class Diagram(NamedTuple):
    """A diagram over time, below the actions."""

    title: str
    unit: str
    draw: Callable[[Axes], None]
    car: int | None = None
    """Whose actions are its bands; None where it is about all."""
    height: float = 1.0


def plots_of(trajectory: Trajectory) -> dict[str, Plot]:
    """Return the figures that there are of a run, by name."""
    rows = {}
    for name, make in _ROWS.items():
        diagrams = make(trajectory)
        if diagrams:
            rows[name] = diagrams
    over_time = {name: _over_time(trajectory, diagrams) for name, diagrams in rows.items()}
    return {"paths": _paths(trajectory)} | over_time


def write_figures(folder: Path, trajectory: Trajectory) -> Iterator[Path]:
    """Write each figure of a run as PDF and PNG into a folder, and all on one page as PDF; yield the paths."""
    output_directory(folder)
    with paper():
        for name, (height_in, draw) in plots_of(trajectory).items():
            figure = Figure(figsize=(WIDTH_IN, height_in), layout="constrained")
            draw(figure)
            for ending in _FORMATS:
                yield save(figure, folder / f"{name}.{ending}")
        rows = []
        for make in _ROWS.values():
            for row in make(trajectory):
                rows.append(row)
        on_page = _paths(trajectory), _over_time(trajectory, rows)
        heights = [height_in for height_in, _ in on_page]
        page = Figure(figsize=(WIDTH_IN, sum(heights) + _TITLE_IN), layout="constrained")
        page.suptitle(line_of(trajectory.story.title), fontsize=10, weight="bold")
        subfigures = page.subfigures(2, 1, squeeze=False, height_ratios=heights)
        for (_, draw), subfigure in zip(on_page, subfigures[:, 0], strict=True):
            draw(subfigure)
        yield save(page, folder / f"{PAGE}.pdf")


# What a trajectory has to show, by car.


def _finite(values: NDArray[Any]) -> Floats:
    return np.where(np.isfinite(values), values, np.nan).astype(np.float64)


def _end_s(attempt: Attempt) -> float:
    return attempt.start_s + attempt.duration_s


def _performed(trajectory: Trajectory, car: int) -> list[Attempt]:
    return [
        attempt for attempt in trajectory.story.attempts if attempt.performed and attempt.car == car
    ]


def _failures(trajectory: Trajectory) -> list[tuple[str, Attempt]]:
    """Return the actions that were carried out and did not do as predicted, as they ended, each with its mark."""
    failed = sorted(
        (a for a in trajectory.story.attempts if a.performed and not a.agrees), key=_end_s
    )
    return [(f"✗{number}", attempt) for number, attempt in enumerate(failed, 1)]


def path_of(trajectory: Trajectory, car: int) -> Floats:
    """Return where a car truly was, (n, 3): x and y in cells, and the level; at the edge what is far outside."""
    position = trajectory.pose(f"car {car}")[:, :3] / (CELL_PITCH_M, CELL_PITCH_M, LEVEL_HEIGHT_M)
    length, width, height = trajectory.story.recipe.grid.size
    return np.clip(position + np.array([-0.5, -0.5, 1]), (-1, -1, 1), (length, width, height + 1))


def tracking_error(trajectory: Trajectory, car: int) -> Floats:
    """Return a car's pose less its path (n, 3): along and across (m), heading (rad); nan where it does not drive."""
    path = _finite(trajectory.path[:, car])
    apart = _finite(trajectory.measured[:, car]) - path
    cos = np.cos(path[:, 2])
    sin = np.sin(path[:, 2])
    along = cos * apart[:, 0] + sin * apart[:, 1]
    across = cos * apart[:, 1] - sin * apart[:, 0]
    return np.stack([along, across, (apart[:, 2] + np.pi) % (2 * np.pi) - np.pi], axis=1)


def motor_forces(trajectory: Trajectory, car: int) -> tuple[Floats, Floats]:
    """Return the torques of a car's wheels (n, 4) in Nm and the force of its board (n,) in N; nan where it sleeps."""
    machine = trajectory.physics.cars[car]
    forces = _finite(trajectory.force)
    torque = forces[:, machine.wheel_actuators]
    board = forces[:, machine.board.actuator]
    # MuJoCo works out no forces of what sleeps; an awake car's are never all exactly zero.
    asleep = (torque == 0).all(axis=1) & (board == 0)
    return np.where(asleep[:, None], np.nan, torque), np.where(asleep, np.nan, board)


def path_points(place: Floats) -> list[int]:
    """Return the samples of a path (n, 3) in cells and levels that a drawing of it needs."""
    scale = np.array([CELL_PITCH_M, CELL_PITCH_M, LEVEL_HEIGHT_M])
    distance_m = np.concatenate(
        [[0.0], np.cumsum(np.linalg.norm(np.diff(place, axis=0) * scale, axis=1))]
    )
    return sorted(
        {0, *np.flatnonzero(np.diff(np.floor(distance_m / _STEP_M))).tolist(), len(place) - 1}
    )


def notes_of(trajectory: Trajectory) -> list[str]:
    """Return what went wrong in words, numbered as in the drawings."""
    notes = []
    failures = _failures(trajectory)
    for mark, attempt in failures[:_MOST_NOTES]:
        words = attempt.action.lower().replace("_", " ")
        text = f"{mark} {_end_s(attempt):.1f} s, car {attempt.car} {words}: {attempt.result}. {attempt.reason}"
        notes.append(line_of(shorten(text, _LONGEST_NOTE)))
    n_left_out = len(failures) - len(notes)
    if n_left_out:
        notes.append(f"and {n_left_out} more")
    return notes


def _write_notes(figure: Figure | SubFigure, trajectory: Trajectory) -> None:
    notes = notes_of(trajectory)
    if notes:
        figure.supxlabel("\n".join(notes), x=0.01, ha="left", fontsize=6.5)


# Diagrams over time.


def _each_car(
    cars: Sequence[int], quantity: str, unit: str, draw: Callable[[int, Axes], None]
) -> list[Diagram]:
    """Return a diagram for each car, as far as they fit on a page."""
    rows = [
        Diagram(f"car {car}: {quantity}", unit, partial(draw, car), car)
        for car in cars[:_MOST_CARS]
    ]
    n_left_out = len(cars) - len(rows)
    if n_left_out:
        rows[-1] = rows[-1]._replace(
            title=f"{rows[-1].title}; {n_left_out} more cars are not drawn"
        )
    return rows


def _tracking(trajectory: Trajectory) -> list[Diagram]:
    errors = [1e3 * tracking_error(trajectory, car) for car in range(len(trajectory.physics.cars))]

    def draw(car: int, axes: Axes) -> None:
        labels = ("along (mm)", "across (mm)", "heading (mrad)")
        _draw_of_car(axes, trajectory.time, errors[car], labels, car)
        axes.axhline(0, color="0.6", lw=0.5)

    driving = [car for car, error in enumerate(errors) if np.isfinite(error).any()]
    return _each_car(driving, "off its path", "mm, mrad", draw)


def _torques(trajectory: Trajectory) -> list[Diagram]:
    def draw(car: int, axes: Axes) -> None:
        limit_nm = trajectory.physics.cars[car].parameters.wheel_torque_nm
        labels = ("front left", "front right", "rear left", "rear right")
        _draw_of_car(axes, trajectory.time, motor_forces(trajectory, car)[0], labels, car)
        _draw_limit(axes, limit_nm, "limit")
        _draw_limit(axes, -limit_nm, "")
        axes.set_ylim(-1.25 * limit_nm, 1.25 * limit_nm)

    acting = [car for car in range(len(trajectory.physics.cars)) if _performed(trajectory, car)]
    return _each_car(acting, "wheel torques", "Nm", draw)


def _boards(trajectory: Trajectory) -> list[Diagram]:
    cars = trajectory.physics.cars
    slopes = trajectory.physics.slopes
    forces = [motor_forces(trajectory, car)[1] for car in range(len(cars))]
    limit_n = max((car.parameters.board_force_n for car in cars), default=0.0)

    def heights(axes: Axes) -> None:
        for car, machine in enumerate(cars):
            if len(cars) <= 6:
                name = f"car {car}"
            else:
                name = str(car)
            values = 1e3 * trajectory.qpos[:, machine.board.qpos]
            _draw_line(axes, trajectory.time, values, name, car, car_colour(car))
        _draw_legend(axes, min(12, len(cars)))

    def board_forces(axes: Axes) -> None:
        for car, force in enumerate(forces):
            _draw_line(axes, trajectory.time, force, str(car), car, car_colour(car))
        words = f"limit {limit_n:.0f} N"
        if max(float(np.nanmax(np.abs(force), initial=0)) for force in forces) > limit_n / 2:
            _draw_limit(axes, limit_n, words)
        else:
            note = f"{words}, above this diagram"
            axes.annotate(note, (0.003, 0.86), xycoords="axes fraction", fontsize=6.5)

    def hinges(axes: Axes) -> None:
        for number, slope in enumerate(slopes):
            angle = np.rad2deg(trajectory.qpos[:, slope.hinge.qpos])
            _draw_line(axes, trajectory.time, angle, f"slope {number}", number, shade(number))
        _draw_legend(axes, min(8, len(slopes)))

    rows = [
        Diagram("height of the boards", "mm", heights),
        Diagram("force of the boards", "N", board_forces),
    ]
    return (rows if cars else []) + (
        [Diagram("angle of the hinges", "degrees", hinges)] if slopes else []
    )


def _contact(trajectory: Trajectory) -> list[Diagram]:
    force = _finite(trajectory.contact)
    setup = trajectory.story.recipe.setup
    if np.isnan(force).all():
        return []
    limit_n = setup.thresholds.impact_n

    def draw(axes: Axes) -> None:
        _draw_line(axes, trajectory.time, force, "largest of all", 0, shade(1))
        _draw_limit(axes, limit_n, f"limit {limit_n:.0f} N")
        axes.set_ylim(0.0, 1.12 * max(limit_n, float(np.nanmax(force))))

    return [Diagram("largest force between two machines", "N", draw, height=1.6)]


_ROWS: Final[dict[str, Callable[[Trajectory], list[Diagram]]]] = {
    "tracking": _tracking,
    "torques": _torques,
    "boards": _boards,
    "contact": _contact,
}


def _draw_line(
    axes: Axes, time_s: Floats, values: Floats, label: str, number: int, colour: Any
) -> None:
    axes.plot(time_s, values, color=colour, ls=dash(number), lw=0.8, label=label)


def _draw_of_car(
    axes: Axes, time_s: Floats, values: Floats, labels: Sequence[str], car: int
) -> None:
    for number, (label, column) in enumerate(zip(labels, values.T, strict=True)):
        _draw_line(
            axes, time_s, column, label, number, shade(number - 1) if number else car_colour(car)
        )
    _draw_legend(axes, len(labels))


def _draw_limit(axes: Axes, value: float, words: str) -> None:
    axes.axhline(value, color=shade(0), lw=0.8, ls=(0, (8, 2)))
    corner: dict[str, Any] = {"xycoords": ("axes fraction", "data"), "textcoords": "offset points"}
    axes.annotate(words, (0, value), (2, 1.5), **corner, fontsize=6.5, color=shade(0))


def _draw_legend(axes: Axes, columns: int) -> None:
    place: dict[str, Any] = {"loc": "lower right", "bbox_to_anchor": (1, 0.98), "borderaxespad": 0}
    axes.legend(**place, ncols=columns, handlelength=2.2 if columns < 6 else 1.5, columnspacing=1.2)


def _over_time(trajectory: Trajectory, rows: Sequence[Diagram]) -> Plot:
    """Return the actions, below them diagrams over the same time, and below these what went wrong."""
    heights = [
        _LANE_IN * (len(trajectory.physics.cars) + 1),
        *(ROW_IN * row.height for row in rows),
    ]

    def draw(figure: Figure | SubFigure) -> None:
        axes = figure.subplots(len(heights), 1, sharex=True, height_ratios=heights)
        _draw_actions(axes[0], trajectory)
        for diagram_axes, row in zip(axes[1:], rows, strict=True):
            diagram_axes.set_title(row.title, loc="left", pad=3)
            diagram_axes.set_ylabel(row.unit)
            _draw_bands(diagram_axes, trajectory, row.car)
            row.draw(diagram_axes)
        axes[-1].set_xlabel("simulated time (s)")
        start_s, end_s = trajectory.time[[0, -1]]
        axes[0].set_xlim(start_s, max(end_s, start_s + 0.1))
        _write_notes(figure, trajectory)

    return sum(heights) + _AXIS_IN + _NOTE_IN * len(notes_of(trajectory)), draw


def _draw_actions(axes: Axes, trajectory: Trajectory) -> None:
    span = max(trajectory.duration_s, 0.1)
    n_cars = len(trajectory.physics.cars)
    axes.set_yticks(range(n_cars), [f"car {car}" for car in range(n_cars)])
    axes.set_ylim(n_cars - 0.5, -0.9)
    axes.tick_params(axis="y", length=0)
    axes.grid(visible=False)
    axes.spines[:].set_visible(False)
    place: dict[str, Any] = {
        "ha": "center",
        "va": "center_baseline",
        "fontsize": 6.5,
        "clip_on": True,
    }
    for car in range(n_cars):
        colour = car_colour(car)
        for attempt in _performed(trajectory, car):
            begun_s = attempt.start_s
            took_s = attempt.duration_s
            frame: dict[str, Any] = {"facecolor": (*colour, 0.3), "height": 0.78}
            if not attempt.agrees:
                frame |= {"edgecolor": shade(0), "linewidth": 1.4, "zorder": 3}
            axes.barh(car, took_s, left=begun_s, **frame)
            axes.vlines(begun_s, car - 0.39, car + 0.39, color=colour, lw=1)
            if WIDTH_IN * 0.85 * took_s / span > _SIGN_IN:
                axes.text(begun_s + took_s / 2, car, FAILURE_SIGNS.get(attempt.action, ""), **place)
    for mark, attempt in _failures(trajectory):
        axes.annotate(mark, (_end_s(attempt), attempt.car - 0.42), ha="center", weight="bold")


def _draw_bands(axes: Axes, trajectory: Trajectory, car: int | None) -> None:
    """Mark when a car acts, and where its actions, or any, went wrong."""
    for attempt in () if car is None else _performed(trajectory, car):
        axes.axvspan(attempt.start_s, _end_s(attempt), color="0.5", alpha=0.12, lw=0)
    place: dict[str, Any] = {"xycoords": ("data", "axes fraction"), "textcoords": "offset points"}
    for mark, attempt in _failures(trajectory):
        if car in (None, attempt.car):
            axes.axvline(_end_s(attempt), color=shade(0), lw=0.9, ls=(0, (1, 1)))
            axes.annotate(mark, (_end_s(attempt), 1), (-2, -8), **place, ha="right", weight="bold")


# The paths of cars from above.


def _paths(trajectory: Trajectory) -> Plot:
    """Return each car's way over the world at the start, level by level, with the design and where actions failed."""
    recipe = trajectory.story.recipe
    n_cars = len(trajectory.physics.cars)
    places = [path_of(trajectory, car) for car in range(n_cars)]
    visited = set()
    for place in places:
        for z in np.unique(np.round(place[:, 2])):
            visited.add(int(z))
    levels = tuple(sorted({*levels_of([recipe.grid], None, trajectory.wanted), *visited}))
    height_in = size_in(recipe.grid.size, len(levels))[1] + _FOOT_IN
    height_in += _LEGEND_ROW_IN * math.ceil(n_cars / _LEGEND_COLUMNS) + _NOTE_IN * len(
        notes_of(trajectory)
    )
    return height_in, partial(_draw_paths, trajectory, places, levels)


def _draw_paths(
    trajectory: Trajectory,
    places: list[Floats],
    levels: tuple[int, ...],
    figure: Figure | SubFigure,
) -> None:
    recipe = trajectory.story.recipe
    design = trajectory.wanted
    goal = None
    if recipe.goals and not design:
        goal = recipe.goals[0]
    by_level = draw_levels(figure, recipe.grid, levels, goal, design)
    for car, place in enumerate(places):
        _draw_path(by_level, place, car)
    box: dict[str, Any] = {
        "bbox": {"facecolor": "white", "alpha": 0.8, "pad": 0.6},
        "weight": "bold",
    }
    for mark, attempt in _failures(trajectory):
        x, y, z = places[attempt.car][trajectory.at(_end_s(attempt))]
        axes = by_level[round(z)]
        axes.plot(x, y, "X", ms=9, mfc="white", mec=INK, mew=1.4, zorder=CARS_ZORDER + 2)
        axes.annotate(
            mark,
            (x, y),
            (6, 4),
            textcoords="offset points",
            color=INK,
            zorder=CARS_ZORDER + 2,
            **box,
        )
    handles = [Line2D([], [], label=f"car {car}", **_style(car)) for car in range(len(places))]
    columns = min(_LEGEND_COLUMNS, len(handles))
    figure.legend(handles=handles, loc="outside upper center", ncols=columns, handlelength=3)
    _write_notes(figure, trajectory)


def _draw_path(by_level: dict[int, Axes], place: Floats, car: int) -> None:
    """Draw a way with arrows on it, and the car's number beside its end."""
    place = place[path_points(place)]
    style = _style(car)
    level = np.round(place[:, 2]).astype(int)
    for z, axes in by_level.items():
        on_level = np.where((level == z)[:, None], place[:, :2], np.nan)
        if np.isfinite(on_level).any():
            axes.plot(*on_level.T, color="white", lw=style["lw"] + 1.4, solid_capstyle="butt")
            axes.plot(*on_level.T, **style)
    distance = np.concatenate(
        [[0.0], np.cumsum(np.linalg.norm(np.diff(place[:, :2], axis=0), axis=1))]
    )
    for at in np.arange(0.5, distance[-1], max(_ARROW_EVERY, distance[-1] / _MOST_ARROWS)):
        i = int(np.searchsorted(distance, at))
        heading = place[i, :2] - place[i - 1, :2]
        heading /= np.linalg.norm(heading)
        tip = np.array([(0.13, 0.0), (-0.07, 0.1), (-0.07, -0.1)]) @ [
            heading,
            (-heading[1], heading[0]),
        ]
        arrow = Polygon(
            place[i, :2] + tip, facecolor=car_colour(car), edgecolor="white", lw=0.6, zorder=3
        )
        by_level[int(level[i])].add_patch(arrow)
    if distance[-1] > _STAYED:
        axes = by_level[int(level[-1])]
        x, y = place[-1, :2] + (_BESIDE, -_BESIDE)
        axes.plot(
            x, y, "o", ms=7.5, mfc=car_colour(car), mec="white", mew=0.8, zorder=CARS_ZORDER + 1
        )
        text: dict[str, Any] = {
            "ha": "center",
            "va": "center_baseline",
            "fontsize": 5.5,
            "weight": "bold",
        }
        axes.text(x, y, str(car), color="white", zorder=CARS_ZORDER + 1, **text)


def _style(car: int) -> dict[str, Any]:
    return {"color": car_colour(car), "lw": _WIDTHS[min(car, len(_WIDTHS) - 1)], "ls": dash(car)}
