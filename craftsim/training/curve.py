"""The learning curve: its points, as a table and as a picture."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from craftsim.errors import InputError
from craftsim.storage.writing import whole, write_whole

Interval = tuple[float, float]


@dataclass(frozen=True)
class Played:
    """The result of an evaluation."""

    episodes: int
    successes: int
    mean_return: float
    mean_ticks: float
    """Of all episodes, those that ran out of time included."""

    @property
    def success(self) -> float:
        """The success rate."""
        return self.successes / self.episodes


@dataclass(frozen=True)
class Point(Played):
    """A point of the learning curve: how well a policy did on fresh episodes after so much training."""

    steps: int
    """Ticks played, all worlds together."""

    def __post_init__(self) -> None:
        if not (self.episodes >= 1 and 0 <= self.successes <= self.episodes and 0 <= self.steps < 2**60):
            raise InputError(
                f"a point of the curve has {self.successes} of {self.episodes} episodes after {self.steps} ticks"
            )


def write_curve(path: Path, curve: Sequence[Point]) -> Path:
    """Write one line a point as CSV and return the path; raises InputError where the disk does not take it."""
    names = ("steps", "episodes", "successes", "mean_return", "mean_ticks")
    text = io.StringIO(newline="")
    writer = csv.writer(text)
    writer.writerow(names)
    writer.writerows([getattr(point, name) for name in names] for point in curve)
    return write_whole(path, text.getvalue())


def plot_curve(path: Path, title: str, curve: Sequence[Point], intervals: Sequence[Interval]) -> Path:
    """Draw success, with its confidence ``intervals``, and return over the steps played; return the path.

    Raises InputError where the disk does not take it.
    """
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
    left.set(xlabel="steps of all worlds together", ylabel="success", ylim=(-0.02, 1.02), title=title)
    right.set_ylabel("mean return")
    figure.legend(loc="outside lower center", ncols=2)
    with whole(path) as partial:
        figure.savefig(partial, dpi=120)
    return path
