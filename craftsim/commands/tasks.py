"""``craftsim tasks``: the paper's tasks, built again and again with all cars at work at once."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

from rich.console import Console
from rich.table import Table

from craftsim.commands.progress import counting
from craftsim.discrete.errors import InputError
from craftsim.report import output_directory, write_report

if TYPE_CHECKING:
    from craftsim.validation.jobs.trials import JobRecord

Task = Literal["strip", "block", "simple_two_story", "complex_two_story", "free_building", "breaking_barrier"]


def tasks(
    task: Task | Literal["all"] = "all",
    seeds: int = 20,
    seed: int = 0,
    noise: bool = True,
    workers: int = 1,
    out: Path = Path("out/tasks"),
) -> int:
    """Build the paper's tasks in physics, many cars at once, under noise and randomised physics.

    Each task is also built twice under exact senses and nominal physics, one action after the other and
    concurrently, to compare how long that takes. Exit status 0 when every building reached its goal.

    Args:
        task: which one.
        seeds: how many times to build each.
        seed: the first of that many seeds in a row.
        noise: draw senses and physics from the seed; without it all seeds are alike.
        workers: processes to share the work; results do not depend on it.
        out: folder for report.json.
    """
    if seeds < 0 or workers < 1:
        raise InputError("--seeds must be at least 0 and --workers at least 1")
    started = time.perf_counter()
    console = Console()
    output_directory(out)

    from craftsim.skills.gains import load_gains
    from craftsim.validation.jobs.trials import JobTrial, run_job_trial
    from craftsim.validation.workers import in_order

    names = get_args(Task) if task == "all" else (task,)
    trials = [JobTrial(name, seed, order, False) for name in names for order in ("sequential", "concurrent")]
    trials += [JobTrial(name, seed + i, "concurrent", noise) for name in names for i in range(seeds)]
    records: list[JobRecord] = []
    with counting(console, "buildings", len(trials)) as tell:
        for record in in_order(run_job_trial, trials, workers):
            records.append(record)
            tell(record.agrees)
    figures: dict[str, Any] = {"tasks": {}, "records": records[2 * len(names) :]}
    for i, name in enumerate(names):
        one_by_one, at_once = records[2 * i], records[2 * i + 1]
        own = [record for record in figures["records"] if record.trial.task == name]
        figures["tasks"][name] = {
            "built": sum(record.reached for record in own),
            "without_failure": sum(record.agrees for record in own),
            "seeds": len(own),
            "max_car_error_mm": 1e3 * max((r.car_error_m for r in own), default=0.0),
            "max_heading_error_mrad": 1e3 * max((r.heading_error_rad for r in own), default=0.0),
            "max_placed_error_mm": 1e3 * max((r.placed_error_m for r in own), default=0.0),
            "sequential_s": one_by_one.makespan_s,
            "concurrent_s": at_once.makespan_s,
            "makespan_ratio": at_once.makespan_s / one_by_one.makespan_s,
            "nominal_built": one_by_one.agrees and at_once.agrees,
        }
    console.print(_table(figures["tasks"]))
    for record in records:
        for failure in record.failures:
            console.print(
                f"{record.trial.task} seed {record.trial.seed}: {failure}", soft_wrap=True, markup=False
            )
    config = {"gains": load_gains(), "noise": noise, "seeds": seeds, "tasks": names}
    wall = {"total_s": time.perf_counter() - started, "workers": workers}
    report = write_report(out, figures, command="tasks", seed=seed, config=config, wall=wall)
    console.print(f"Report: {report}", soft_wrap=True)
    built = sum(record.reached for record in records)
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
            f"{row['sequential_s']:.1f} s",
            f"{row['concurrent_s']:.1f} s",
            f"{100 * row['makespan_ratio']:.0f} %",
        )
    return table
