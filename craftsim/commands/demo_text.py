"""What ``craftsim demo`` says on the screen; everything fits in 80 columns."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

from rich.console import Console
from rich.table import Table

from craftsim.checking.checked_run import CheckedRun
from craftsim.validation.jobs.figures import job_figures
from craftsim.validation.jobs.job import Job, JobResult

_OTHER_GOALS: Final[dict[str, tuple[str, str]]] = {
    "free_building": ("all blocks form one platform", "the blocks do NOT form one platform"),
    "breaking_barrier": ("the flag is at the goal", "the flag is NOT at the goal"),
}
"""What to say of goals that are no building, reached and missed."""


def actions_table(run: CheckedRun) -> Table:
    """Return a table with a row for each action of a run."""
    caption = "cell, heading, load, low or high on a slope; mm, mrad: error of the car"
    table = Table(title="Predicted by the rules, read from poses", caption=caption, box=None, pad_edge=False)
    for heading in ("tick", "car", "action", "predicted", "read", "verdict"):
        table.add_column(heading, no_wrap=heading != "verdict", overflow="fold")
    for heading in ("s", "mm", "mrad"):
        table.add_column(heading, justify="right", no_wrap=True)
    for record in run.records:
        verdict = str(record.verdict.finding) + ("" if record.outcome.succeeded else f"; {record.outcome}")
        good = record.legal and record.verdict.agrees
        table.add_row(
            str(record.tick),
            str(record.car),
            record.action.name,
            record.predicted,
            "same" if record.read == record.predicted else record.read,
            f"[{'green' if good else 'red'}]{verdict}[/]",
            f"{record.outcome.duration_s:.2f}",
            f"{record.car_error_m * 1e3:.2f}",
            f"{record.car_heading_error_rad * 1e3:+.2f}",
        )
    return table


def summary(results: Sequence[JobResult]) -> Table:
    """Return a table with a row for each job."""
    caption = "s simulated; at worst: mm, mrad of cars, set: mm of things set down, others: mm moved"
    table = Table(title="Built in physics, checked by the rules", caption=caption, box=None, pad_edge=False)
    table.add_column("task", no_wrap=True)
    for heading in ("ticks", "agree", "goal", "s", "mm", "mrad", "set", "others"):
        table.add_column(heading, justify="right", no_wrap=True)
    for result in results:
        figures = job_figures(result)
        worst = ("car_error_mm", "car_heading_error_mrad", "placed_error_mm", "others_moved_mm")
        goal = {None: "none", True: "[green]reached[/]", False: "[red]missed[/]"}[result.reached]
        table.add_row(
            result.job.name,
            str(figures["ticks"]),
            f"[{'green' if result.run.agrees else 'red'}]{figures['agree']} of {figures['total']}[/]",
            goal,
            f"{figures['simulated_s']:.1f}",
            *(f"{figures[f'max_{name}']:.2f}" for name in worst),
        )
    return table


def print_worst(console: Console, figures: dict[str, Any]) -> None:
    """Say how inexact the worst action of a run was."""
    console.print(
        f"At worst: cars {figures['max_car_error_mm']:.2f} mm and "
        f"{figures['max_car_heading_error_mrad']:.2f} mrad off, things set down "
        f"{figures['max_placed_error_mm']:.2f} mm off, others moved {figures['max_others_moved_mm']:.2f} mm. "
        f"{figures['simulated_s']:.1f} s simulated.",
        soft_wrap=True,
    )


def print_differences(console: Console, result: JobResult, name_task: bool) -> None:
    """Say for each action that did not do what the rules predicted what was different."""
    prefix = f"{result.job.name}, " if name_task else ""
    for record in result.run.records:
        for difference in record.verdict.differences:
            console.print(
                f"{prefix}tick {record.tick}, car {record.car} {record.action.name}: {difference}",
                soft_wrap=True,
            )


def conclusion(results: Sequence[JobResult]) -> str:
    """Return the last line: how many actions agree, and whether the goal, or each goal, is reached."""
    agree, total = sum(result.agree for result in results), sum(len(r.run.records) for r in results)
    actions = f"{agree} of {total} actions agree with the rules"
    if len(results) > 1:
        return f"{actions}; {sum(r.reached is True for r in results)} of {len(results)} goals are reached."
    return f"{actions}; {_goal_words(results[0].job, results[0].reached)}."


def _goal_words(job: Job, reached: bool | None) -> str:
    if reached is None:
        return "no goal was given"
    words = ("the building matches its goal", "the building does NOT match its goal")
    if job.task is not None and job.design is None:
        words = _OTHER_GOALS[job.task]
    return words[0] if reached else words[1]
