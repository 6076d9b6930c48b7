"""``craftsim tasks``: the paper's tasks, built again and again with all cars at work at once."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal, get_args

from rich.table import Table

from craftsim.commands.campaigning import CampaignCommand
from craftsim.discrete.errors import InputError
from craftsim.validation.campaign import Engine

Task = Literal["strip", "block", "simple_two_story", "complex_two_story", "free_building", "breaking_barrier"]


def tasks(
    task: Task | Literal["all"] = "all",
    seeds: int = 20,
    seed: int = 0,
    noise: bool = True,
    workers: int = 1,
    engine: Engine = "local",
    resume: bool = False,
    out: Path = Path("out/tasks"),
) -> int:
    """Build the paper's tasks in physics, many cars at once, under noise and randomised physics.

    Each task is also built twice under exact sensors and nominal physics, one action after the other and
    concurrently, to compare how long that takes. Exit status 0 when every building reached its goal.

    Args:
        task: which one.
        seeds: how many times to build each.
        seed: the first of that many seeds in a row.
        noise: draw sensors and physics from the seed; without it all seeds are alike.
        workers: processes to share the work; results do not depend on it.
        engine: processes of this machine, or an existing Ray cluster to which the output folder is shared.
        resume: go on with what an interrupted run has left in the output folder.
        out: folder for report.json and trials.jsonl.
    """
    if seeds < 0:
        raise InputError(f"--seeds must be at least 0, not {seeds}")
    command = CampaignCommand("tasks", seed, out, workers, engine, resume)
    console = command.console

    from craftsim.skills.gains import load_gains
    from craftsim.validation.jobs.trials import TIMEOUT_S, do_job, items_of, job_trial_figures, reached

    names = get_args(Task) if task == "all" else (task,)
    config = {"gains": load_gains(), "noise": noise, "seeds": seeds, "tasks": names}
    items = items_of(names, seeds, seed, noise)
    records = command.run("buildings", items, do_job, config, timeout_s=TIMEOUT_S)
    figures = job_trial_figures(names, records)
    console.print(_table(figures["tasks"]))
    for record in records:
        for failure in [record["error"]] if record["error"] else record["extra"]["failures"]:
            console.print(f"{record['key']}: {failure}", soft_wrap=True, markup=False)
    report = command.report(figures, config)
    console.print(f"Report: {report}", soft_wrap=True)
    built = sum(map(reached, records))
    console.print(f"{built} of {len(records)} buildings reached their goal.")
    return 0 if built == len(records) else 1


def _table(rows: dict[str, dict[str, Any]]) -> Table:
    table = Table(box=None, pad_edge=False, caption="makespan: nominal physics, one by one and at once")
    for heading in ("task", "built", "car mm", "mrad", "placed mm", "one by one", "at once", "ratio"):
        table.add_column(heading, justify="left" if heading == "task" else "right", no_wrap=True)
    for name, row in rows.items():
        table.add_row(
            name,
            f"{row['built']}/{row['seeds']}",
            f"{row['max_car_error_mm']:.2f}",
            f"{row['max_heading_error_mrad']:.2f}",
            f"{row['max_placed_error_mm']:.2f}",
            _figure(row["sequential_s"], "s"),
            _figure(row["concurrent_s"], "s"),
            _figure(row["makespan_ratio"], "%", scale=100, digits=0),
        )
    return table


def _figure(value: float | None, unit: str, scale: float = 1, digits: int = 1) -> str:
    """Return a figure with its unit; there is none of a building that came to no end."""
    return "-" if value is None else f"{scale * value:.{digits}f} {unit}"
