"""What a study came to: a table by task and algorithm, statistics over all runs, plots, and the file of results.

The statistics are those that Agarwal et al. advise ("Deep reinforcement learning at the edge of the statistical
precipice", NeurIPS 2021). Their library rliable does not import beside pandas 3 (its dependency arch does not).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import permutations, product
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.stats import trim_mean

from craftsim.experiments.experiment import TrialRecord
from craftsim.experiments.intervals import least_detectable
from craftsim.learning.curve import last_fifth, share_reaching
from craftsim.learning.study import Study, StudyRun
from craftsim.reports.report import (
    Column,
    DataTable,
    Headline,
    KeyFigure,
    Report,
    Section,
    Tone,
    Value,
    count,
    numbers,
)
from craftsim.storage.writing import whole, write_whole

_POINTS: Final = 60
"""Of each curve."""
_REPETITIONS: Final = 2000
"""Of the stratified bootstrap."""
TAUS: Final = np.linspace(0.0, 1.0, 51)
"""Success rates at which performance profiles are drawn."""
_Runs = NDArray[np.float64]
"""Success rates, shape (..., seeds, tasks)."""


def iqm(runs: _Runs) -> NDArray[np.float64]:
    """Return the interquartile mean over seeds and tasks: of the middle half of all runs, shape (...)."""
    means: NDArray[np.float64] = trim_mean(runs.reshape(*runs.shape[:-2], -1), 0.25, axis=-1)
    return means


_MEASURES: Final[Mapping[str, Callable[[_Runs], NDArray[np.float64]]]] = {
    "iqm": iqm,
    "mean": lambda runs: runs.mean((-2, -1)),
    "median": lambda runs: np.median(runs.mean(-2), -1),
    "optimality_gap": lambda runs: 1 - np.minimum(runs, 1.0).mean((-2, -1)),
}
"""By name: what is said of all runs of an algorithm; the median is that of the tasks' means."""


def _bounded(measure: Callable[..., Any], *runs: _Runs) -> NDArray[np.float64]:
    """Return (3, ...): a measure of runs, its low and its high at 95 %; those of each task are drawn by themselves."""
    resampled = []
    for seed, task_runs in enumerate(runs):
        rows = np.random.default_rng(seed).integers(
            len(task_runs), size=(_REPETITIONS, *task_runs.shape)
        )
        resampled.append(np.take_along_axis(np.broadcast_to(task_runs, rows.shape), rows, axis=1))
    return np.stack([measure(*runs), *np.quantile(measure(*resampled), (0.025, 0.975), axis=0)])


def measures(runs: _Runs) -> dict[str, list[float]]:
    """Return every measure of an algorithm's runs (seeds, tasks), each as estimate, low and high at 95 %."""
    return {name: _bounded(measure, runs).tolist() for name, measure in _MEASURES.items()}


def profile(runs: _Runs) -> NDArray[np.float64]:
    """Return (3, len(TAUS)): the share of runs above each success rate, its low and its high at 95 %."""
    return _bounded(lambda task_runs: (task_runs[..., None] > TAUS).mean((-3, -2)), runs)


def improvement(ours: _Runs, theirs: _Runs) -> list[float]:
    """Return how likely a run of ours is better than one of theirs on a task, ties by half, its low and its high."""

    def better(a: _Runs, b: _Runs) -> Any:
        gap = a[..., :, None, :] - b[..., None, :, :]
        return ((gap > 0) + 0.5 * (gap == 0)).mean((-3, -2, -1))

    bounds: list[float] = _bounded(better, ours, theirs).tolist()
    return bounds


def iqm_curve(
    runs: Sequence[Sequence[tuple[int, float]]], at: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Return (3, len(at)): the interquartile mean over runs of success after so many steps, its low and its high.

    A run, a list of (steps, success), has the success of its last evaluation until then, and 0 before its first one.
    """
    success = np.array([[_held(run, int(step)) for step in at] for run in runs])
    return _bounded(lambda task_runs: iqm(np.moveaxis(task_runs, -1, 0)[..., None]).T, success)


def _held(run: Sequence[tuple[int, float]], step: int) -> float:
    before = [success for at, success in run if at <= step]
    if before:
        return before[-1]
    return 0.0


def study_figures(study: Study, records: Sequence[TrialRecord]) -> dict[str, Any]:
    """Return the figures of a report: runs, by task, algorithm and what was played, and statistics of all of them.

    A run without a result counts as success 0.
    """
    runs = []
    for study_run, record in zip(study.runs, records, strict=True):
        runs.append(_run(study, study_run, record))
    rows = []
    for task in study.tasks:
        for name, algo in product(study.tests.get(task, (task,)), study.algos):
            mine = _of(runs, algo, task)
            rates = np.array([_rate(study, run, name) for run in mine])
            starts = [
                run["evaluations"][name]["starts"]["distinct"] for run in mine if run["evaluations"]
            ]
            rows.append(
                {
                    "task": task,
                    "played": name,
                    "algo": algo,
                    "seeds": len(mine),
                    "success": measures(rates[:, None]),
                    "by_seed": rates.tolist(),
                    "distinct_starts": max(starts, default=0),
                    "median_steps": float(np.median([run["steps"] for run in mine])),
                    "published": study.reference.get(task, {}).get(algo),
                    "reaching": _mean([run["reaching"] for run in mine]),
                }
            )
    scores = {algo: _scores(study, runs, algo) for algo in study.algos}
    improvements = {}
    for a, b in permutations(scores, 2):
        if a < b:
            improvements[f"{a} over {b}"] = improvement(scores[a], scores[b])
    return {
        "rows": rows,
        "overall": {algo: measures(mine) for algo, mine in scores.items()},
        "improvement": improvements,
        "runs": runs,
    }


def _of(runs: Iterable[dict[str, Any]], algo: str, task: str) -> list[dict[str, Any]]:
    return [run for run in runs if (run["task"], run["algo"]) == (task, algo)]


def _run(study: Study, study_run: StudyRun, record: TrialRecord) -> dict[str, Any]:
    extra = {}
    if record["error"] is None:
        extra = record["extra"]
    config = study_run.config
    run = {"key": study_run.key, "task": config.task, "algo": config.algo, "seed": config.seed}
    return run | {
        "error": record["error"],
        "steps": extra.get("steps", 0),
        "evaluations": extra.get("evaluations", {}),
        "reaching": _reaching(study, study_run, extra.get("curve", ())),
        "curve": [
            [point["steps"], point["successes"] / point["episodes"]]
            for point in extra.get("curve", ())
        ],
    }


def _reaching(
    study: Study, study_run: StudyRun, curve: Sequence[Mapping[str, Any]]
) -> float | None:
    """Return the share of evaluations that count by the threshold of a run's task.

    None where there is no threshold, or the run had another reward than that of CraftEnv's code.
    """
    threshold = study.thresholds.get(study_run.config.task)
    if threshold is None or not study_run.task.reward.is_published:
        return None
    returns = [(point["steps"], point["mean_return"]) for point in curve]
    return share_reaching(returns, threshold.mean_return, threshold.last)


def _mean(values: Sequence[float | None]) -> float | None:
    """Return the mean of those that there are; None where there are none."""
    numbers_of_them = [value for value in values if value is not None]
    if not numbers_of_them:
        return None
    return float(np.mean(numbers_of_them))


def _rate(study: Study, run: dict[str, Any], played: str) -> float:
    if study.score == "last_fifth" and played == run["task"]:
        return last_fifth([rate for _, rate in run["curve"]])
    evaluation = run["evaluations"].get(played)
    if evaluation is None:
        return 0.0
    return float(evaluation["success"]["rate"])


def _scores(study: Study, runs: Sequence[dict[str, Any]], algo: str) -> _Runs:
    """Return (seeds, tasks): success on the first of what each task is tested on."""
    columns = []
    for task in study.tasks:
        first = study.tests.get(task, (task,))[0]
        columns.append([_rate(study, run, first) for run in _of(runs, algo, task)])
    return np.array(columns).T


def plot_results(folder: Path, study: Study, figures: dict[str, Any]) -> list[Path]:
    """Draw learning curves by task and performance profiles; return the files."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import EngFormatter

    runs = figures["runs"]
    columns = min(3, len(study.tasks))
    rows = -(-len(study.tasks) // columns)
    figure = Figure(figsize=(4.2 * columns, 3.2 * rows), layout="constrained")
    for number, task in enumerate(study.tasks):
        axes = figure.add_subplot(rows, columns, number + 1)
        last = max((run["steps"] for run in runs if run["task"] == task), default=0)
        at = np.linspace(0, max(last, 1), _POINTS).astype(np.int64)
        for algo in study.algos:
            _band(
                axes,
                at,
                iqm_curve([run["curve"] for run in _of(runs, algo, task)], at),
                study,
                algo,
            )
        if study.reference.get(task):
            best = max(study.reference[task].values())
            axes.axhline(best, color="gray", linestyle=":", label="best published")
        axes.xaxis.set_major_formatter(EngFormatter(sep=""))
        axes.set(ylim=(-0.03, 1.03), xlabel="steps", ylabel="success, IQM over seeds")
        axes.set_title(task, parse_math=False)  # the study's words may have a $ in them
    curves = _saved(figure, folder / "curves.png")
    figure = Figure(figsize=(5.5, 3.8), layout="constrained")
    axes = figure.add_subplot()
    for algo in study.algos:
        _band(axes, TAUS, profile(_scores(study, runs, algo)), study, algo)
    axes.set(xlabel="success rate", ylabel="share of runs above it", ylim=(-0.03, 1.03))
    axes.set_title(study.title, parse_math=False)
    return [curves, _saved(figure, folder / "profiles.png")]


def _band(axes: Any, x: NDArray[Any], band: NDArray[np.float64], study: Study, algo: str) -> None:
    # Each line is thinner than those before it, and every second has gaps: of several that lie on each other all show.
    number = study.algos.index(algo)
    width = 1.5 + 0.5 * (len(study.algos) - 1 - number)
    if number % 2:
        style = "--"
    else:
        style = "-"
    (line,) = axes.plot(x, band[0], style, label=algo, linewidth=width)
    axes.fill_between(x, band[1], band[2], color=line.get_color(), alpha=0.15, linewidth=0)


def _saved(figure: Any, path: Path) -> Path:
    """Write a figure with one legend beside all axes."""
    named = {}
    for axes in figure.axes:
        for line in axes.get_lines():
            named[line.get_label()] = line
    figure.legend(named.values(), named.keys(), loc="outside right upper", fontsize="small")
    with whole(path) as partial:
        figure.savefig(partial, dpi=110)
    return path


def study_report(
    study: Study, reached: int, document: Mapping[str, Any], pictures: Sequence[Path]
) -> Report:
    """Return the report of a study.

    Args:
        study: what ran.
        reached: how many of its runs reached its success rate.
        document: what ``report.json`` holds.
        pictures: that were drawn of it.
    """
    figures = document["figures"]
    n = len(study.runs)
    sentence = f"{reached} of {count(n, 'run')} reached a success of {study.goal:g} or more."
    if reached == n:
        badge = "All reached"
        tone = Tone.GOOD
    else:
        badge = "Not all reached"
        tone = Tone.CAUTION
    overall = []
    for algo, statistics in figures["overall"].items():
        estimate, low, high = statistics["iqm"]
        interval = "one seed"
        if study.seeds > 1:
            interval = f"{low:.3f} to {high:.3f}"
        overall.append(KeyFigure(f"{estimate:.3f}", f"IQM of {algo}", interval))
    lead = "Interquartile means over training runs of different seeds, with stratified bootstrap intervals."
    return Report(
        "Study of training",
        study.title,
        Headline(badge, tone, sentence),
        overall,
        [Section("runs", "Runs", lead, [learning_table(study, figures)], terminal=True)],
        conclusions(figures),
        {"Plots": ", ".join(map(str, pictures))},
        document,
        0 if reached == n else 1,
    )


def learning_table(study: Study, figures: dict[str, Any]) -> DataTable:
    """Return the table by task, what was played and algorithm; starts are the different ones of an evaluation.

    The last columns are there if the study knows of any: the share of evaluations that count by a threshold of the
    return, and what was published of that algorithm.
    """
    extra = []
    if study.thresholds:
        extra.append("by return")
    if study.reference:
        extra.append("published")
    columns = (Column("task"), *numbers("algo", "IQM", "95 %", "starts", "steps", *extra))
    rows = []
    for row in figures["rows"]:
        estimate, low, high = row["success"]["iqm"]
        # A split of the task that it was trained on says so by its name.
        on_task = row["played"].partition("@")[0] == row["task"]
        if on_task:
            task = row["played"]
        else:
            task = f"{row['played']} by {row['task']}"
        steps = f"{row['median_steps'] / 1000:,.0f} k"
        success = f"{estimate:.3f}", "one run" if study.seeds == 1 else f"{low:.3f}-{high:.3f}"
        cells: list[Value] = [task, row["algo"], *success, str(row["distinct_starts"]), steps]
        if study.thresholds:
            cells.append(_share(row["reaching"]))
        if study.reference:
            cells.append(_share(row["published"]))
        rows.append(cells)
    seeds = f"{study.seeds} seed{'s' if study.seeds > 1 else ''}"
    return DataTable(columns, rows, f"{study.title}: success over {seeds} of training")


def _share(value: float | None) -> str:
    if value is None:
        return ""
    return f"{value:.2f}"


def conclusions(figures: dict[str, Any]) -> list[str]:
    """Return a line an algorithm on all its runs, one a pair of algorithms, and one on each run without a result."""
    lines = []
    for algo, statistics in figures["overall"].items():
        estimate, low, high = statistics["iqm"]
        gap, *_ = statistics["optimality_gap"]
        several = len({run["seed"] for run in figures["runs"]}) > 1
        interval = ""
        if several:
            interval = f" ({low:.3f} to {high:.3f})"
        lines.append(f"{algo}, all tasks: IQM {estimate:.3f}{interval}, optimality gap {gap:.3f}.")
    for pair, (likely, low, high) in figures["improvement"].items():
        a, b = pair.split(" over ")
        line = (
            f"A run of {a} beats one of {b} with probability {likely:.2f} ({low:.2f} to {high:.2f})"
        )
        if low == high:
            line += ": the interval has no width, which says nothing of how sure that is"
        elif low <= 0.5 <= high:
            detectable = least_detectable(low, high)
            line += f": no difference shows; the least detectable one is {detectable:.2f} from 0.5"
        lines.append(f"{line}.")
    lines += [f"{run['key']}: {run['error']}" for run in figures["runs"] if run["error"]]
    return lines


def write_markdown(path: Path, study: Study, figures: dict[str, Any]) -> None:
    """Write the table and the conclusions of a study as Markdown. Raises InputError where the disk does not take it."""
    lines = "\n".join(f"- {line}" for line in conclusions(figures))
    parts = [learning_table(study, figures).as_markdown(), *([lines] if lines else [])]
    write_whole(path, "\n\n".join(parts) + "\n")
