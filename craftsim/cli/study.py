"""``craftsim train study``: training runs over tasks, algorithms and seeds, with their statistics."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from craftsim.choices import Engine
from craftsim.cli.options import Dir
from craftsim.options import number
from craftsim.storage.folders import owning
from craftsim.storage.limits import TIMEOUT_S, WORKERS
from craftsim.training.extra import need_torch


@owning
def study(
    what: Annotated[str, Parameter(metavar="NAME|FILE")],
    *,
    workers: Annotated[int, number(WORKERS)] = 1,
    engine: Engine = "local",
    timeout: Annotated[float, number(TIMEOUT_S, "SECONDS")] = 7200.0,
    resume: bool = False,
    out: Dir = Path("out/study"),
) -> int:
    """Train on every task of a study by every algorithm with every seed, evaluate, and say what may be concluded.

    Results are over training runs, each of another seed: the interquartile mean with its stratified bootstrap interval,
    learning curves and performance profiles. What is evaluated counts once where it repeats itself. Ctrl-C keeps what
    is finished, and --resume goes on, within a run too. Exit status 0 when all runs reached the study's success rate, 1
    when not, 2 for wrong input.

    Args:
        what: a YAML file, or a shipped study such as paper or quick.
        workers: processes to share the runs; results do not depend on it.
        engine: processes of this machine, or an existing Ray cluster to which the output folder is shared.
        timeout: seconds after which a run counts as hanging.
        resume: go on with what an interrupted study has left in the output folder.
        out: folder for report.json, study.md, curves.png, profiles.png, trials.jsonl and a folder of each run.
    """
    need_torch()
    from craftsim.cli.study_progress import watching
    from craftsim.experiments.experiment import RunOptions
    from craftsim.reports.json_file import document
    from craftsim.reports.terminal import Terminal
    from craftsim.studies.report import study_report, write_markdown
    from craftsim.studies.results import figures_of, plot_results
    from craftsim.studies.runs import run_study
    from craftsim.studies.study import read_study

    asked = read_study(what)
    console, begun = Terminal(), time.perf_counter()
    options = RunOptions(workers, engine, resume, progress=lambda total: watching(console, asked, out))
    records = run_study(asked, out, options, timeout)
    figures = figures_of(asked, records)
    write_markdown(out / "study.md", asked, figures)
    pictures = plot_results(out, asked, figures)
    config: dict[str, Any] = {"study": asked, "what": what}
    wall = {
        "this_call_s": time.perf_counter() - begun,
        "cpu_s": {record["key"]: record["extra"].get("cpu_s") for record in records},
    }
    written = document(figures, command="study", seed=0, config=config, wall=wall)
    reached = sum(record["agrees"] for record in records)
    return study_report(asked, reached, written, pictures).publish(out, console)
