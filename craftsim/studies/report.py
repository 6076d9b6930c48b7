"""The report of a study: a table of its runs by task and algorithm, and what may be concluded."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from craftsim.experiments.intervals import least_detectable
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
)
from craftsim.storage.writing import write_whole
from craftsim.studies.study import Study


def study_report(study: Study, reached: int, document: Mapping[str, Any], pictures: Sequence[Path]) -> Report:
    """Return the report of a study.

    Args:
        study: what ran.
        reached: how many of its runs reached its success rate.
        document: what ``report.json`` holds.
        pictures: that were drawn of it.
    """
    figures, n = document["figures"], len(study.runs)
    sentence = f"{reached} of {count(n, 'run')} reached a success of {study.goal:g} or more."
    badge, tone = ("All reached", Tone.GOOD) if reached == n else ("Not all reached", Tone.CAUTION)
    overall = {algo: found["iqm"] for algo, found in figures["overall"].items()}
    return Report(
        "Study of training",
        study.title,
        Headline(badge, tone, sentence),
        [
            KeyFigure(
                f"{iqm:.3f}", f"IQM of {algo}", f"{low:.3f} to {high:.3f}" if study.seeds > 1 else "one seed"
            )
            for algo, (iqm, low, high) in overall.items()
        ],
        [
            Section(
                "runs",
                "Runs",
                "Interquartile means over training runs of different seeds, with stratified bootstrap intervals.",
                [runs_table(study, figures)],
                terminal=True,
            )
        ],
        conclusions(figures),
        {"Plots": ", ".join(map(str, pictures))},
        document,
        0 if reached == n else 1,
    )


def runs_table(study: Study, figures: dict[str, Any]) -> DataTable:
    """Return the table by task, what was played and algorithm; starts are the different ones of an evaluation.

    Its last column, what others have published, is there if the study knows of any.
    """
    last = [Column("published", "number")] if study.reference else []
    numbers = ("IQM", "95 %", "starts", "steps")
    columns = (Column("task"), Column("algo"), *(Column(name, "number") for name in numbers), *last)
    rows = []
    for row in figures["rows"]:
        estimate, low, high = row["success"]["iqm"]
        published = "" if row["published"] is None else f"{row['published']:.2f}"
        # A split of the task that it was trained on says so by its name.
        own = row["played"].partition("@")[0] == row["task"]
        task = row["played"] if own else f"{row['played']} by {row['task']}"
        steps = f"{row['median_steps'] / 1000:,.0f} k"
        success = f"{estimate:.3f}", "one run" if study.seeds == 1 else f"{low:.3f}-{high:.3f}"
        cells: list[Value] = [task, row["algo"], *success, str(row["distinct_starts"]), steps]
        rows.append([*cells, *([published] if study.reference else [])])
    seeds = f"{study.seeds} seed{'s' if study.seeds > 1 else ''}"
    return DataTable(columns, rows, f"{study.title}: success over {seeds} of training")


def conclusions(figures: dict[str, Any]) -> list[str]:
    """Return a line an algorithm on all its runs, one a pair of algorithms, and one on each run without a result."""
    lines = []
    for algo, found in figures["overall"].items():
        (estimate, low, high), (gap, *_) = found["iqm"], found["optimality_gap"]
        several = len({run["seed"] for run in figures["runs"]}) > 1
        interval = f" ({low:.3f} to {high:.3f})" if several else ""
        lines.append(f"{algo}, all tasks: IQM {estimate:.3f}{interval}, optimality gap {gap:.3f}.")
    for pair, (likely, low, high) in figures["improvement"].items():
        a, b = pair.split(" over ")
        line = f"A run of {a} beats one of {b} with probability {likely:.2f} ({low:.2f} to {high:.2f})"
        if low == high:
            line += ": the interval has no width, which says nothing of how sure that is"
        elif low <= 0.5 <= high:
            least = least_detectable(low, high)
            line += f": no difference shows; the least detectable one is {least:.2f} from 0.5"
        lines.append(f"{line}.")
    lines += [f"{run['key']}: {run['error']}" for run in figures["runs"] if run["error"]]
    return lines


def write_markdown(path: Path, study: Study, figures: dict[str, Any]) -> None:
    """Write the table and the conclusions of a study as Markdown. Raises InputError where the disk does not take it."""
    lines = "\n".join(f"- {line}" for line in conclusions(figures))
    write_whole(
        path, "\n\n".join([runs_table(study, figures).as_markdown(), *([lines] if lines else [])]) + "\n"
    )
