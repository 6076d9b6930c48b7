"""The learning curve as a table and as a picture."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from craftsim.training.trainer import Point

Interval = tuple[float, float]


def write_curve(path: Path, curve: Sequence[Point]) -> Path:
    """Write one line a point as CSV and return the path."""
    names = ("steps", "episodes", "successes", "mean_return", "mean_ticks")
    with open(path, "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(names)
        writer.writerows([getattr(point, name) for name in names] for point in curve)
    return path


def plot_curve(path: Path, title: str, curve: Sequence[Point], intervals: Sequence[Interval]) -> Path:
    """Draw success, with its confidence ``intervals``, and return over the steps played; return the path."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 4.0), layout="constrained")
    left = figure.subplots()
    right = left.twinx()
    steps = [point.steps for point in curve]
    left.plot(steps, [point.success for point in curve], color="tab:blue", label="success")
    left.fill_between(
        steps, [low for low, _ in intervals], [high for _, high in intervals], color="tab:blue", alpha=0.2
    )
    right.plot(steps, [point.mean_return for point in curve], color="tab:orange", label="return")
    left.set(xlabel="grid steps", ylabel="success", ylim=(-0.02, 1.02), title=title)
    right.set_ylabel("mean return")
    figure.legend(loc="outside lower center", ncols=2)
    figure.savefig(path, dpi=120)
    return path
