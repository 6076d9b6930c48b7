"""What a study came to: a table by task and algorithm, statistics over all runs, plots, and the file of results.

The statistics are those that Agarwal et al. advise ("Deep reinforcement learning at the edge of the statistical
precipice", NeurIPS 2021). Their library rliable does not import beside pandas 3 (its dependency arch does not).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.stats import trim_mean

from craftsim.experiments.experiment import TrialRecord
from craftsim.storage.writing import whole
from craftsim.studies.study import Study, StudyRun
from craftsim.training.curve import last_fifth

_POINTS: Final = 60
"""Of each curve."""
REPETITIONS: Final = 2000
"""Of the stratified bootstrap."""
TAUS: Final = np.linspace(0.0, 1.0, 51)
"""Success rates at which performance profiles are drawn."""
Runs = NDArray[np.float64]
"""Success rates, shape (..., seeds, tasks)."""


def iqm(runs: Runs) -> NDArray[np.float64]:
    """Return the interquartile mean over seeds and tasks: of the middle half of all runs, shape (...)."""
    found: NDArray[np.float64] = trim_mean(runs.reshape(*runs.shape[:-2], -1), 0.25, axis=-1)
    return found


MEASURES: Final[Mapping[str, Callable[[Runs], NDArray[np.float64]]]] = {
    "iqm": iqm,
    "mean": lambda runs: runs.mean((-2, -1)),
    "median": lambda runs: np.median(runs.mean(-2), -1),
    "optimality_gap": lambda runs: 1 - np.minimum(runs, 1.0).mean((-2, -1)),
}
"""By name: what is said of all runs of an algorithm; the median is that of the tasks' means."""


def measures(runs: Runs) -> dict[str, list[float]]:
    """Return every measure of an algorithm's runs (seeds, tasks), each as estimate, low and high at 95 %."""
    drawn = _drawn(runs)
    return {
        name: [float(measure(runs)), *np.quantile(measure(drawn), (0.025, 0.975)).tolist()]
        for name, measure in MEASURES.items()
    }


def profile(runs: Runs) -> NDArray[np.float64]:
    """Return (3, len(TAUS)): the share of runs above each success rate, its low and its high at 95 %."""

    def above(some: Runs) -> NDArray[np.float64]:
        shares: NDArray[np.float64] = (some[..., None] > TAUS).mean((-3, -2))
        return shares

    return np.stack([above(runs), *np.quantile(above(_drawn(runs)), (0.025, 0.975), axis=0)])


def improvement(ours: Runs, theirs: Runs) -> list[float]:
    """Return how likely a run of ours is better than one of theirs on a task, ties by half, its low and its high."""

    def better(a: Runs, b: Runs) -> NDArray[np.float64]:
        gap = a[..., :, None, :] - b[..., None, :, :]
        likely: NDArray[np.float64] = ((gap > 0) + 0.5 * (gap == 0)).mean((-3, -2, -1))
        return likely

    bounds = np.quantile(better(_drawn(ours), _drawn(theirs, 1)), (0.025, 0.975))
    return [float(better(ours, theirs)), *bounds.tolist()]


def iqm_curve(runs: Sequence[Sequence[tuple[int, float]]], at: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return (3, len(at)): the interquartile mean over runs of success after so many steps, its low and its high.

    A run, a list of (steps, success), has the success of its last evaluation until then, and 0 before its first one.
    """
    held = np.array([[_held(run, int(step)) for step in at] for run in runs])
    columns = np.moveaxis(_drawn(held), -1, 0)[..., None]
    bounds = np.quantile(iqm(columns), (0.025, 0.975), axis=-1)
    return np.stack([iqm(held.T[..., None]), *bounds])


def _held(run: Sequence[tuple[int, float]], step: int) -> float:
    before = [success for at, success in run if at <= step]
    return before[-1] if before else 0.0


def _drawn(runs: Runs, seed: int = 0) -> Runs:
    """Return (REPETITIONS, seeds, tasks): runs drawn with replacement, those of each task by themselves."""
    rng = np.random.default_rng(seed)
    rows = rng.integers(len(runs), size=(REPETITIONS, *runs.shape))
    return np.take_along_axis(np.broadcast_to(runs, rows.shape), rows, axis=1)


def figures_of(study: Study, records: Sequence[TrialRecord]) -> dict[str, Any]:
    """Return the figures of a report: runs, by task, algorithm and what was played, and statistics of all of them.

    A run without a result counts as success 0.
    """
    found = dict(zip([asked.key for asked in study.runs], records, strict=True))
    runs = [_run(asked, found[asked.key]) for asked in study.runs]
    rows = []
    for task in study.tasks:
        for name in study.tests.get(task, (task,)):
            for algo in study.algos:
                mine = [run for run in runs if (run["task"], run["algo"]) == (task, algo)]
                rates = np.array([_rate(study, run, name) for run in mine])
                rows.append(
                    {
                        "task": task,
                        "played": name,
                        "algo": algo,
                        "seeds": len(mine),
                        "success": measures(rates[:, None]),
                        "by_seed": rates.tolist(),
                        "distinct_starts": _distinct(mine, name),
                        "median_steps": float(np.median([run["steps"] for run in mine])),
                        "published": study.reference.get(task),
                    }
                )
    scores = {algo: _scores(study, runs, algo) for algo in study.algos}
    return {
        "rows": rows,
        "overall": {algo: measures(mine) for algo, mine in scores.items()},
        "improvement": {
            f"{a} over {b}": improvement(scores[a], scores[b]) for a in scores for b in scores if a < b
        },
        "runs": runs,
    }


def _run(asked: StudyRun, record: TrialRecord) -> dict[str, Any]:
    extra = record["extra"] if record["error"] is None else {}
    config = asked.config
    run = {"key": asked.key, "task": config.task, "algo": config.algo, "seed": config.seed}
    return run | {
        "error": record["error"],
        "steps": extra.get("steps", 0),
        "evaluations": extra.get("evaluations", {}),
        "curve": [
            [point["steps"], point["successes"] / point["episodes"]] for point in extra.get("curve", ())
        ],
    }


def _rate(study: Study, run: dict[str, Any], played: str) -> float:
    if study.score == "last_fifth" and played == run["task"]:
        return last_fifth([rate for _, rate in run["curve"]])
    evaluation = run["evaluations"].get(played)
    return 0.0 if evaluation is None else float(evaluation["success"]["rate"])


def _distinct(runs: Sequence[dict[str, Any]], played: str) -> int:
    return max(
        (run["evaluations"][played]["starts"]["distinct"] for run in runs if run["evaluations"]), default=0
    )


def _scores(study: Study, runs: Sequence[dict[str, Any]], algo: str) -> Runs:
    """Return (seeds, tasks): success on the first of what each task is tested on."""
    columns = [
        [
            _rate(study, run, study.tests.get(task, (task,))[0])
            for run in runs
            if (run["task"], run["algo"]) == (task, algo)
        ]
        for task in study.tasks
    ]
    return np.array(columns).T


def plot_results(folder: Path, study: Study, figures: dict[str, Any]) -> list[Path]:
    """Draw learning curves by task and, of more than one task, performance profiles; return the files."""
    return [
        _plot_curves(folder / "curves.png", study, figures),
        _plot_profiles(folder / "profiles.png", study, figures),
    ]


def _plot_curves(path: Path, study: Study, figures: dict[str, Any]) -> Path:
    from matplotlib.figure import Figure
    from matplotlib.ticker import EngFormatter

    columns = min(3, len(study.tasks))
    rows = -(-len(study.tasks) // columns)
    figure = Figure(figsize=(4.2 * columns, 3.2 * rows), layout="constrained")
    for number, task in enumerate(study.tasks):
        axes = figure.add_subplot(rows, columns, number + 1)
        last = max((run["steps"] for run in figures["runs"] if run["task"] == task), default=0)
        at = np.linspace(0, max(last, 1), _POINTS).astype(np.int64)
        for algo in study.algos:
            curves = [run["curve"] for run in figures["runs"] if (run["task"], run["algo"]) == (task, algo)]
            _band(axes, at, iqm_curve(curves, at), study, algo)
        if task in study.reference:
            axes.axhline(study.reference[task], color="gray", linestyle=":", label="published")
        axes.xaxis.set_major_formatter(EngFormatter(sep=""))
        axes.set(ylim=(-0.03, 1.03), xlabel="steps", ylabel="success, IQM over seeds")
        axes.set_title(task, parse_math=False)  # the study's words may have a $ in them
    return _saved(figure, path)


def _plot_profiles(path: Path, study: Study, figures: dict[str, Any]) -> Path:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.5, 3.8), layout="constrained")
    axes = figure.add_subplot()
    for algo in study.algos:
        _band(axes, TAUS, profile(_scores(study, figures["runs"], algo)), study, algo)
    axes.set(xlabel="success rate", ylabel="share of runs above it", ylim=(-0.03, 1.03))
    axes.set_title(study.title, parse_math=False)
    return _saved(figure, path)


def _band(axes: Any, x: NDArray[Any], band: NDArray[np.float64], study: Study, algo: str) -> None:
    # Each line is thinner than those before it, and every second has gaps: of several that lie on each other all show.
    number = study.algos.index(algo)
    width, style = 1.5 + 0.5 * (len(study.algos) - 1 - number), "--" if number % 2 else "-"
    (line,) = axes.plot(x, band[0], style, label=algo, linewidth=width)
    axes.fill_between(x, band[1], band[2], color=line.get_color(), alpha=0.15, linewidth=0)


def _saved(figure: Any, path: Path) -> Path:
    """Write a figure with one legend beside all axes."""
    named = {line.get_label(): line for axes in figure.axes for line in axes.get_lines()}
    figure.legend(named.values(), named.keys(), loc="outside right upper", fontsize="small")
    with whole(path) as partial:
        figure.savefig(partial, dpi=110)
    return path
