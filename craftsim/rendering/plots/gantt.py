"""The Gantt chart of a plan: what each car does when, and when it waits."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib import rcParams
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray

from craftsim.discrete.actions import ACTIONS
from craftsim.discrete.drawing import Rgb
from craftsim.discrete.grid import CarField, Kind
from craftsim.discrete.schedule import Schedule
from craftsim.rendering.plots.style import DPI, WIDTH_IN, line_of, paper, save

FORMATS: Final = (".png", ".svg")
VERB_COLOURS: Final[dict[str, Rgb]] = {
    "move": (0.55, 0.71, 0.85),
    "rotate": (0.80, 0.84, 0.88),
    "lift": (0.36, 0.62, 0.36),
    "drop": (0.89, 0.58, 0.22),
    "fold": (0.55, 0.40, 0.65),
    "unfold": (0.78, 0.64, 0.83),
    "stop": (0.93, 0.93, 0.92),
}
"""By the row of an action in the table of durations."""
_REGISTERED: Final[Rgb] = (
    0.80,
    0.47,
    0.65,
)  # of actions that were registered, which have no such row
_HATCH: Final = "////"
_ROW_IN: Final = 0.22
_FRAME_IN: Final = 1.15  # for title, axis and legend
_BAR: Final = 0.72  # height of a bar, of that of its row


def draw_gantt(path: Path, schedule: Schedule, title: str) -> Path:
    """Draw a plan into a PNG or SVG file: bars for actions, hatched where a car is loaded, and lines for waits."""
    n_cars = schedule.final.n_cars
    times = schedule.times()
    legend = {"ncols": len(VERB_COLOURS) + 2, "handlelength": 1.2, "columnspacing": 1.1}
    with paper():
        rcParams["svg.hashsalt"] = "craftsim"
        rcParams["hatch.linewidth"] = 0.5
        figure = Figure(
            figsize=(WIDTH_IN, _FRAME_IN + _ROW_IN * n_cars), dpi=DPI, layout="constrained"
        )
        took = f"{len(schedule.steps)} actions, makespan {schedule.makespan():.1f} s"
        figure.suptitle(line_of(f"{title}: {took}"), fontsize=9, weight="bold")
        axes = figure.add_subplot()
        verbs, loaded = _draw_bars(axes, schedule, times)
        axes.set_yticks(range(n_cars), [f"car {car}" for car in range(n_cars)])
        axes.set_ylim(n_cars - 0.5, -0.5)
        axes.set_xlim(0, max(schedule.makespan(), 0.1))
        axes.tick_params(axis="y", length=0)
        axes.grid(visible=False, axis="y")
        axes.set_xlabel("time at nominal physics (s)")
        named = [
            *(verb for verb in VERB_COLOURS if verb in verbs),
            *sorted(verbs - VERB_COLOURS.keys()),
        ]
        handles = [
            Patch(facecolor=VERB_COLOURS.get(verb, _REGISTERED), label=verb) for verb in named
        ]
        if loaded:
            handles.append(Patch(facecolor="1", hatch=_HATCH, edgecolor="0.3", label="loaded"))
        figure.legend(handles=handles, loc="outside lower center", **legend)
        return save(figure, path)


def _draw_bars(axes: Axes, schedule: Schedule, times: NDArray[np.float64]) -> tuple[set[str], bool]:
    """Draw actions, and lines where a car waits before one; return the verbs, and whether any car is loaded."""
    bars: dict[tuple[int, str, bool], list[tuple[float, float]]] = defaultdict(list)
    free = dict[int, float]()
    waits = []
    for step, (start, end) in zip(schedule.steps, times.tolist(), strict=True):
        car = step.car
        spec = ACTIONS[step.action]
        loads = (grid.cars[car, CarField.LOAD] for grid in (step.before, step.after))
        bars[car, spec.duration or spec.words, Kind.AIR not in loads].append((start, end - start))
        if start > free.get(car, 0.0):
            waits.append((car, free.get(car, 0.0), start))
        free[car] = end
    for (car, verb, loaded), spans in bars.items():
        if loaded:
            look: dict[str, Any] = {"hatch": _HATCH, "edgecolor": "0.3"}
        else:
            look = {"edgecolor": "1"}
        colour = VERB_COLOURS.get(verb, _REGISTERED)
        axes.broken_barh(spans, (car - _BAR / 2, _BAR), facecolor=colour, linewidth=0.4, **look)
    if waits:
        axes.hlines(*zip(*waits, strict=True), color="0.45", lw=1.0, ls=(0, (1, 1)))
    return {verb for _, verb, _ in bars}, any(loaded for _, _, loaded in bars)
