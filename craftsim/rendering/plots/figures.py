"""Plots of a recorded run, each by itself or all on one page: paths, and diagrams over time.

Diagrams show what each car did, errors and loads below it against their limits, and what went wrong.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from craftsim.checking.attempt import Attempt
from craftsim.checking.contacts import impact_limit_n
from craftsim.discrete.drawing import car_colour
from craftsim.rendering.plots.paths import draw_paths, paths_height_in
from craftsim.rendering.plots.signals import (
    NOTE_IN,
    Floats,
    end_s,
    failures_of,
    finite,
    mark,
    motor_forces,
    notes_of,
    performed,
    thinned,
    tracking_error,
    write_notes,
)
from craftsim.rendering.plots.style import DENSE, ROW_IN, WIDTH_IN, dash, line_of, paper, save, shade
from craftsim.rendering.trajectory import Trajectory
from craftsim.reports.report import Drawing
from craftsim.storage.folders import output_directory

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

FORMATS: Final = ("pdf", "png")
PAGE: Final = "all"
"""Name of the page with all figures."""
_MOST_POINTS: Final = 3000
"""Of a line on paper."""
_TITLE_IN: Final = 0.3
_LANE_IN: Final = 0.17
_AXIS_IN: Final = 0.5
_SIGN_IN: Final = 0.07
"""Width of an action's sign."""
_MOST_CARS: Final = 24
"""With a diagram of their own."""
_OFFSET: Final = {"textcoords": "offset points"}

SIGNS: Final = {
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


def plots_of(trajectory: Trajectory, most: int = _MOST_POINTS) -> dict[str, Drawing]:
    """Return the figures that there are of a run, by name, their lines of about ``most`` points at most.

    Raises InputError where this version of craftsim makes another world of it.
    """
    caption = "Each car's way from above, over the world as it was at the start."
    height = paths_height_in(trajectory)
    plots = {"paths": _drawing(caption, height, lambda figure: draw_paths(figure, trajectory))}
    for name, (make, caption) in _ROWS.items():
        if rows := make(trajectory, most):
            plots[name] = _over_time(caption, trajectory, rows)
    return plots


def _drawing(caption: str, height_in: float, draw: Callable[[Figure | SubFigure], None]) -> Drawing:
    return Drawing(draw, height_in, caption, caption, WIDTH_IN, wide=True, style=DENSE)


def _over_time(caption: str, trajectory: Trajectory, rows: Sequence[Diagram]) -> Drawing:
    lanes = _LANE_IN * (len(trajectory.physics.cars) + 1)
    height_in = lanes + _AXIS_IN + sum(ROW_IN * row.height for row in rows)
    height_in += NOTE_IN * len(notes_of(trajectory))
    return _drawing(caption, height_in, lambda figure: _draw_rows(figure, trajectory, rows))


def write_figures(folder: Path, trajectory: Trajectory) -> Iterator[Path]:
    """Write each figure of a run as PDF and PNG into a folder, and all on one page as PDF; yield the paths.

    Raises InputError where the disk does not take it, or this version of craftsim makes another world of the run.
    """
    from matplotlib.figure import Figure

    output_directory(folder)
    with paper():
        plots = plots_of(trajectory)
        for name, plot in plots.items():
            figure = Figure(figsize=(WIDTH_IN, plot.height_in), layout="constrained")
            plot.draw(figure)
            for ending in FORMATS:
                yield save(figure, folder / f"{name}.{ending}")
        rows = [row for make, _ in _ROWS.values() for row in make(trajectory, _MOST_POINTS)]
        on_page = plots["paths"], _over_time("", trajectory, rows)
        heights = [plot.height_in for plot in on_page]
        page = Figure(figsize=(WIDTH_IN, sum(heights) + _TITLE_IN), layout="constrained")
        page.suptitle(line_of(trajectory.story.title), fontsize=10, weight="bold")
        parts = page.subfigures(2, 1, squeeze=False, height_ratios=heights)
        for plot, part in zip(on_page, parts[:, 0], strict=True):
            plot.draw(part)
        yield save(page, folder / f"{PAGE}.pdf")


def _each_car(cars: Sequence[int], make: Callable[[int], Diagram]) -> list[Diagram]:
    """Return a diagram for each car, as far as they fit on a page."""
    rows = [make(car) for car in cars[:_MOST_CARS]]
    if more := len(cars) - len(rows):
        rows[-1] = rows[-1]._replace(title=f"{rows[-1].title}; {more} more cars are not drawn")
    return rows


def _tracking(trajectory: Trajectory, most: int) -> list[Diagram]:
    """Return a diagram for each car that drove: its measured pose less its path."""
    errors = {car: 1e3 * tracking_error(trajectory, car) for car in range(len(trajectory.physics.cars))}

    def tracking(car: int) -> Diagram:
        def draw(axes: Axes) -> None:
            labels = ("along (mm)", "across (mm)", "heading (mrad)")
            _draw_of_car(axes, trajectory.time, errors[car], labels, car, most)
            axes.axhline(0, color="0.6", lw=0.5)
            _draw_legend(axes, 3)

        return Diagram(f"car {car}: off its path", "mm, mrad", draw, car)

    return _each_car([car for car, error in errors.items() if np.isfinite(error).any()], tracking)


def _torques(trajectory: Trajectory, most: int) -> list[Diagram]:
    """Return a diagram of the wheel torques of each car that acted."""

    def torques(car: int) -> Diagram:
        def draw(axes: Axes) -> None:
            limit_nm = trajectory.physics.cars[car].parameters.wheel_torque_nm
            labels = ("front left", "front right", "rear left", "rear right")
            _draw_of_car(axes, trajectory.time, motor_forces(trajectory, car)[0], labels, car, most)
            _draw_limit(axes, limit_nm, "limit")
            _draw_limit(axes, -limit_nm, "")
            axes.set_ylim(-1.25 * limit_nm, 1.25 * limit_nm)
            _draw_legend(axes, 4)

        return Diagram(f"car {car}: wheel torques", "Nm", draw, car)

    cars = range(len(trajectory.physics.cars))
    return _each_car([car for car in cars if performed(trajectory, car)], torques)


def _boards(trajectory: Trajectory, most: int) -> list[Diagram]:
    """Return diagrams of the boards' heights and forces, and of the hinges where there are slopes."""
    physics, time_s = trajectory.physics, trajectory.time
    forces = [motor_forces(trajectory, car)[1] for car in range(len(physics.cars))]
    limit_n = max((car.parameters.board_force_n for car in physics.cars), default=0.0)

    def heights(axes: Axes) -> None:
        for car, machine in enumerate(physics.cars):
            name = f"car {car}" if len(physics.cars) <= 6 else str(car)
            values = 1e3 * trajectory.qpos[:, machine.board.qpos]
            _draw_line(axes, time_s, values, name, car, car_colour(car), most)
        _draw_legend(axes, min(12, len(physics.cars)))

    def board_forces(axes: Axes) -> None:
        for car, force in enumerate(forces):
            _draw_line(axes, time_s, force, str(car), car, car_colour(car), most)
        words = f"limit {limit_n:.0f} N"
        if max(float(np.nanmax(np.abs(force), initial=0)) for force in forces) > limit_n / 2:
            _draw_limit(axes, limit_n, words)
        else:
            note = f"{words}, above this diagram"
            axes.annotate(note, (0.003, 0.86), xycoords="axes fraction", fontsize=6.5)

    def hinges(axes: Axes) -> None:
        for number, slope in enumerate(physics.slopes):
            angle = np.rad2deg(trajectory.qpos[:, slope.hinge.qpos])
            _draw_line(axes, time_s, angle, f"slope {number}", number, shade(number), most)
        _draw_legend(axes, min(8, len(physics.slopes)))

    rows = []
    if physics.cars:
        rows += [
            Diagram("height of the boards", "mm", heights),
            Diagram("force of the boards", "N", board_forces),
        ]
    if physics.slopes:
        rows.append(Diagram("angle of the hinges", "degrees", hinges))
    return rows


def _contact(trajectory: Trajectory, most: int) -> list[Diagram]:
    """Return the diagram of the largest force between any two machines; none where contacts were not looked at."""
    force, setup = finite(trajectory.contact), trajectory.story.recipe.setup
    if np.isnan(force).all():
        return []
    limit_n = setup.thresholds.force * impact_limit_n(setup.machines)

    def draw(axes: Axes) -> None:
        _draw_line(axes, trajectory.time, force, "largest of all", 0, shade(1), most)
        _draw_limit(axes, limit_n, f"limit {limit_n:.0f} N")
        axes.set_ylim(0.0, 1.12 * max(limit_n, float(np.nanmax(force))))

    return [Diagram("largest force between two machines", "N", draw, height=1.6)]


_ROWS: Final[dict[str, tuple[Callable[[Trajectory, int], list[Diagram]], str]]] = {
    "tracking": (_tracking, "How far each car was from its path; bands are its actions."),
    "torques": (_torques, "Wheel torques against their limit; gaps are where a car sleeps."),
    "boards": (_boards, "Boards and hinges; no force is worked out while a car sleeps."),
    "contact": (_contact, "The largest force between any two machines, against its limit."),
}


def _draw_line(
    axes: Axes, time_s: Floats, values: Floats, label: str, number: int, colour: Any, most: int
) -> None:
    """Draw a line of about ``most`` points at most; ``number`` decides its dashes, and gaps are where there is none."""
    axes.plot(*thinned(time_s, values, most), color=colour, ls=dash(number), lw=0.8, label=label)


def _draw_of_car(
    axes: Axes, time_s: Floats, values: Floats, labels: Sequence[str], car: int, most: int
) -> None:
    """Draw a line for each column (n, m), the first in the car's colour."""
    for number, (label, column) in enumerate(zip(labels, values.T, strict=True)):
        colour = shade(number - 1) if number else car_colour(car)
        _draw_line(axes, time_s, column, label, number, colour, most)


def _draw_limit(axes: Axes, value: float, words: str) -> None:
    """Draw a value that is not to be passed."""
    axes.axhline(value, color=shade(0), lw=0.8, ls=(0, (8, 2)))
    corner: dict[str, Any] = {"xycoords": ("axes fraction", "data"), **_OFFSET}
    axes.annotate(words, (0, value), (2, 1.5), **corner, fontsize=6.5, color=shade(0))


def _draw_legend(axes: Axes, columns: int) -> None:
    """Draw a legend above a diagram, at its right."""
    place: dict[str, Any] = {"loc": "lower right", "bbox_to_anchor": (1, 0.98), "borderaxespad": 0}
    axes.legend(**place, ncols=columns, handlelength=2.2 if columns < 6 else 1.5, columnspacing=1.2)


def _draw_rows(figure: Figure | SubFigure, trajectory: Trajectory, rows: Sequence[Diagram]) -> None:
    """Draw the actions, below them diagrams over the same time, and below these what went wrong."""
    heights = [_LANE_IN * (len(trajectory.physics.cars) + 1), *(ROW_IN * row.height for row in rows)]
    axes = figure.subplots(len(heights), 1, sharex=True, height_ratios=heights)
    _draw_actions(axes[0], trajectory)
    for one, row in zip(axes[1:], rows, strict=True):
        one.set_title(row.title, loc="left", pad=3)
        one.set_ylabel(row.unit)
        _draw_bands(one, trajectory, row.car)
        row.draw(one)
    axes[-1].set_xlabel("simulated time (s)")
    time_s = trajectory.time
    axes[0].set_xlim(time_s[0], max(time_s[-1], time_s[0] + 0.1))
    write_notes(figure, trajectory)


def _draw_actions(axes: Axes, trajectory: Trajectory) -> None:
    span, n_cars = max(trajectory.duration_s, 0.1), len(trajectory.physics.cars)
    axes.set_yticks(range(n_cars), [f"car {car}" for car in range(n_cars)])
    axes.set_ylim(n_cars - 0.5, -0.9)
    axes.tick_params(axis="y", length=0)
    axes.grid(visible=False)
    for spine in axes.spines.values():
        spine.set_visible(False)
    for car in range(n_cars):
        for attempt in performed(trajectory, car):
            _draw_action(axes, attempt, WIDTH_IN * 0.85 * attempt.duration_s / span > _SIGN_IN)
    for number, attempt in enumerate(failures_of(trajectory), 1):
        axes.annotate(mark(number), (end_s(attempt), attempt.car - 0.42), ha="center", weight="bold")


def _draw_action(axes: Axes, attempt: Attempt, signed: bool) -> None:
    frame: dict[str, Any] = {} if attempt.agrees else {"edgecolor": shade(0), "linewidth": 1.4, "zorder": 3}
    bar: dict[str, Any] = {"height": 0.78, "facecolor": (*car_colour(attempt.car), 0.3)} | frame
    axes.barh(attempt.car, attempt.duration_s, left=attempt.start_s, **bar)
    axes.vlines(attempt.start_s, attempt.car - 0.39, attempt.car + 0.39, color=car_colour(attempt.car), lw=1)
    if signed:
        middle = attempt.start_s + attempt.duration_s / 2
        place: dict[str, Any] = {"ha": "center", "va": "center_baseline", "fontsize": 6.5, "clip_on": True}
        axes.text(middle, attempt.car, SIGNS.get(attempt.action, ""), **place)


def _draw_bands(axes: Axes, trajectory: Trajectory, car: int | None) -> None:
    """Mark when a car acts, and where its actions, or any, went wrong."""
    for attempt in () if car is None else performed(trajectory, car):
        axes.axvspan(attempt.start_s, end_s(attempt), color="0.5", alpha=0.12, lw=0)
    for number, attempt in enumerate(failures_of(trajectory), 1):
        if car in (None, attempt.car):
            axes.axvline(end_s(attempt), color=shade(0), lw=0.9, ls=(0, (1, 1)))
            place: dict[str, Any] = {"xycoords": ("data", "axes fraction"), **_OFFSET}
            axes.annotate(mark(number), (end_s(attempt), 1), (-2, -8), **place, ha="right", weight="bold")
