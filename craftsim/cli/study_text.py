"""What ``craftsim study`` says of its runs."""

from __future__ import annotations

from typing import Any

from craftsim.cli.tables import Cells
from craftsim.studies.study import Study


def runs_table(study: Study, figures: dict[str, Any]) -> Cells:
    """Return the table by task, what was played and algorithm; starts are the different ones of an evaluation.

    Its last column, what others have published, is there if the study knows of any.
    """
    head = ("task", "algo", "IQM", "95 %", "starts", "steps", *(("published",) if study.reference else ()))
    rows = []
    for row in figures["rows"]:
        estimate, low, high = row["success"]["iqm"]
        published = "" if row["published"] is None else f"{row['published']:.2f}"
        last = (published,) if study.reference else ()
        # A split of the task that it was trained on says so by its name.
        own = row["played"].partition("@")[0] == row["task"]
        task = row["played"] if own else f"{row['played']} by {row['task']}"
        steps = f"{row['median_steps'] / 1000:,.0f} k"
        success = f"{estimate:.3f}", "one run" if study.seeds == 1 else f"{low:.3f}-{high:.3f}"
        rows.append((task, row["algo"], *success, str(row["distinct_starts"]), steps, *last))
    seeds = f"{study.seeds} seed{'s' if study.seeds > 1 else ''}"
    return Cells(f"{study.title}: success over {seeds} of training", head, tuple(rows))


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
        lines.append(
            f"A run of {a} beats one of {b} with probability {likely:.2f} ({low:.2f} to {high:.2f})."
        )
    lines += [f"{run['key']}: {run['error']}" for run in figures["runs"] if run["error"]]
    return lines
