"""What a study came to: a table by task and algorithm, statistics over all runs, plots, and the file of results."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from craftsim.experiments.experiment import TrialRecord
from craftsim.storage.writing import whole
from craftsim.studies.scores import TAUS, Runs, improvement, iqm_curve, measures, profile
from craftsim.studies.study import Study, StudyRun
from craftsim.training.curve import last_fifth

_POINTS: Final = 60
"""Of each curve."""


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
    _name_lines(figure)
    with whole(path) as partial:
        figure.savefig(partial, dpi=110)
    return path


def _plot_profiles(path: Path, study: Study, figures: dict[str, Any]) -> Path:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.5, 3.8), layout="constrained")
    axes = figure.add_subplot()
    for algo in study.algos:
        _band(axes, TAUS, profile(_scores(study, figures["runs"], algo)), study, algo)
    axes.set(xlabel="success rate", ylabel="share of runs above it", ylim=(-0.03, 1.03))
    axes.set_title(study.title, parse_math=False)
    _name_lines(figure)
    with whole(path) as partial:
        figure.savefig(partial, dpi=110)
    return path


def _band(axes: Any, x: NDArray[Any], band: NDArray[np.float64], study: Study, algo: str) -> None:
    # Each line is thinner than those before it, and every second has gaps: of several that lie on each other all show.
    number = study.algos.index(algo)
    width, style = 1.5 + 0.5 * (len(study.algos) - 1 - number), "--" if number % 2 else "-"
    (line,) = axes.plot(x, band[0], style, label=algo, linewidth=width)
    axes.fill_between(x, band[1], band[2], color=line.get_color(), alpha=0.15, linewidth=0)


def _name_lines(figure: Any) -> None:
    """Add one legend beside all axes."""
    named = {line.get_label(): line for axes in figure.axes for line in axes.get_lines()}
    figure.legend(named.values(), named.keys(), loc="outside right upper", fontsize="small")
