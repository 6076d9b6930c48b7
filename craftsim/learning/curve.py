"""The learning curve: its points, as a table, as a picture, and for trackers such as TensorBoard."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

from craftsim.errors import InputError
from craftsim.experiments.intervals import wilson
from craftsim.storage.folders import directory_within
from craftsim.storage.limits import TABLE
from craftsim.storage.reading import read_text
from craftsim.storage.writing import whole, write_whole
from craftsim.workers.modules import find_named

CURVE_FILE: Final = "curve.csv"
TENSORBOARD: Final = "tensorboard"
"""A tracker, and the folder of its log in that of a training run."""


@dataclass(frozen=True)
class EvaluationResult:
    """The result of an evaluation."""

    episodes: int
    successes: int
    mean_return: float
    mean_ticks: float  # of all episodes, those that ran out of time included
    starts: int  # different worlds, with what is to be built in them, that episodes began with
    solved: int  # of these, those from which every episode succeeded
    trajectories: int  # different episodes: in what the cars saw or did

    @property
    def success(self) -> float:
        """The share of the episodes that succeeded."""
        return self.successes / self.episodes

    @property
    def interval(self) -> tuple[float, float] | None:
        """Wilson's interval at 95 % of the share of starts that are solved; none where there is but one start."""
        if self.starts == 1:
            return None
        return wilson(self.solved, self.starts)

    @property
    def in_words(self) -> str:
        """How much succeeded, and among how many different episodes."""
        if self.interval is None:
            return (
                f"success {self.success:.3f} from its one start, in {self.trajectories} different "
                f"trajector{'y' if self.trajectories == 1 else 'ies'} ({self.episodes} episodes)"
            )
        low, high = self.interval
        solved = f"{self.solved} of {self.starts} different starts solved ({low:.3f} to {high:.3f})"
        return f"success {self.success:.3f}, {solved}"

    def as_figures(self) -> dict[str, Any]:
        """Return what a report holds of it."""
        low, high = self.interval or (None, None)
        return {
            "success": {
                "rate": self.success,
                "successes": self.successes,
                "trials": self.episodes,
                "wilson_low": low,
                "wilson_high": high,
            },
            "starts": {"distinct": self.starts, "solved": self.solved},
            "trajectories": self.trajectories,
            "mean_return": self.mean_return,
            "mean_ticks": self.mean_ticks,
        }


@dataclass(frozen=True)
class CurvePoint(EvaluationResult):
    """A point of the learning curve: how well a policy did on fresh episodes after so much training."""

    steps: int  # ticks played, all worlds together

    def __post_init__(self) -> None:
        counts = (
            self.episodes >= 1 and 0 <= self.successes <= self.episodes and 0 <= self.steps < 2**60
        )
        if not (
            counts and 0 <= self.solved <= self.starts <= self.episodes and self.trajectories >= 1
        ):
            raise InputError(
                f"a point of the curve has {self.successes} of {self.episodes} episodes after {self.steps} ticks"
            )


def last_fifth(rates: Sequence[float]) -> float:
    """Return the mean success of the last fifth of a run's evaluations, at least of one; 0 where there is none."""
    last = rates[-max(1, len(rates) // 5) :]
    if last:
        return sum(last) / len(last)
    return 0.0


def share_reaching(returns: Sequence[tuple[int, float]], least: float, last: float) -> float:
    """Return the share of evaluations in the last part of a run whose mean return is ``least`` or more; 0 for none.

    Args:
        returns: steps and mean return of each evaluation, in the order of the run.
        least: the threshold.
        last: share of the run's steps that counts, from its end.
    """
    if not returns:
        return 0.0
    first_step = (1 - last) * returns[-1][0]
    counted = [mean_return for steps, mean_return in returns if steps >= first_step]
    reaching = [mean_return for mean_return in counted if mean_return >= least]
    return len(reaching) / len(counted)


def write_curve(path: Path, curve: Sequence[CurvePoint]) -> Path:
    """Write one line a point as CSV and return the path; raises InputError where the disk does not take it."""
    names = ("steps", *(field.name for field in fields(EvaluationResult)))
    text = io.StringIO(newline="")
    writer = csv.writer(text)
    writer.writerow(names)
    writer.writerows([getattr(point, name) for name in names] for point in curve)
    return write_whole(path, text.getvalue())


def last_point(path: Path) -> CurvePoint | None:
    """Return the last point of a curve that :func:`write_curve` has written; None where it has none yet.

    Raises InputError for a file that is none or is too large, and for a damaged last line.
    """
    rows = read_text(path, TABLE).splitlines()
    if len(rows) < 2:
        return None
    names = rows[0].split(",")
    numbers = rows[-1].split(",")
    kinds = {field.name: int if field.type == "int" else float for field in fields(CurvePoint)}
    if set(names) != kinds.keys() or len(numbers) != len(names):
        raise InputError(
            f"{path}:{len(rows)}: no point of a learning curve; allowed: {', '.join(kinds)}"
        )
    values: dict[str, Any] = {}
    for name, number in zip(names, numbers, strict=True):
        try:
            values[name] = kinds[name](number)
        except ValueError:
            raise InputError(
                f"{path}:{len(rows)}: {name} is '{number[:40]}', not a number"
            ) from None
    try:
        return CurvePoint(**values)
    except InputError as error:
        raise InputError(f"{path}:{len(rows)}: {error}") from None


def plot_curve(path: Path, title: str, curve: Sequence[CurvePoint]) -> Path:
    """Draw success, with its interval where starts differ, and return over the steps played; return the path.

    Raises InputError where the disk does not take it.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 4.0), layout="constrained")
    success_axes = figure.subplots()
    return_axes = success_axes.twinx()
    steps = [point.steps for point in curve]
    success_axes.plot(steps, [point.success for point in curve], color="tab:blue", label="success")
    bands = [(point.steps, *point.interval) for point in curve if point.interval is not None]
    if bands:
        at, lows, highs = zip(*bands, strict=True)
        success_axes.fill_between(at, lows, highs, color="tab:blue", alpha=0.2)
    return_axes.plot(
        steps, [point.mean_return for point in curve], color="tab:orange", label="return"
    )
    success_axes.set(xlabel="steps of all worlds together", ylabel="success", ylim=(-0.02, 1.02))
    success_axes.set_title(title, parse_math=False)  # a file's name may have a $ in it
    return_axes.set_ylabel("mean return")
    figure.legend(loc="outside lower center", ncols=2)
    with whole(path) as partial:
        figure.savefig(partial, dpi=120)
    return path


Tracker = Callable[[dict[str, float], int], object]
"""Takes the figures of an evaluation by name, and the steps played so far, of all worlds together."""


class TrackedCurve:
    """Gives the points of a learning curve to a tracker as they come.

    Their figures are ``eval/success``, ``eval/return`` and ``eval/ticks``. The tracker of a run that goes on gets its
    earlier points again, for what it had may lack the last ones.
    """

    def __init__(self, name: str, folder: Path, curve: Sequence[CurvePoint]) -> None:
        """Begin with the points that a run has already.

        Args:
            name: ``tensorboard``, for a log in the run's ``folder``, or ``module:function`` of a :data:`Tracker`.
            folder: of the run.
            curve: its points.

        Raises InputError where TensorBoard is not installed, and for what is no tracker.
        """
        self._name = name
        if name == TENSORBOARD:
            self._track = _tensorboard(folder)
        else:
            self._track = find_named(
                name, f"tracker '{name}'", "module:function, such as mine:track", TENSORBOARD
            )
        if not callable(self._track):
            raise InputError(f"tracker '{name}' is a {type(self._track).__name__}, not a function")
        for point in curve:
            self.add(point)

    def add(self, point: CurvePoint) -> None:
        """Give a point to the tracker. Raises InputError, naming the tracker, where that fails."""
        values = {
            "eval/success": point.success,
            "eval/return": point.mean_return,
            "eval/ticks": point.mean_ticks,
        }
        try:
            self._track(values, point.steps)
        except Exception as error:
            raise InputError(
                f"tracker '{self._name}' raised {type(error).__name__}: {error}; --resume goes on with the run"
            ) from error


def _tensorboard(folder: Path) -> Tracker:
    """Return what writes a log for TensorBoard, in place of the one that a run has in its folder."""
    if find_spec("tensorboard") is None:
        raise InputError(
            "--tracker tensorboard needs tensorboard, not installed here; try: pip install tensorboard"
        )
    from torch.utils.tensorboard import SummaryWriter

    place = directory_within(folder, TENSORBOARD)
    for old in place.glob("events.out.tfevents.*"):
        old.unlink()
    log = SummaryWriter(str(place))

    def track(values: dict[str, float], steps: int) -> None:
        for name, value in values.items():
            log.add_scalar(name, value, steps)
        log.flush()

    return track
