"""Progress of a study: how many runs are done, and how far those under way are, by the curves in their folders."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Event, Thread
from typing import Final

from rich.console import Console
from rich.live import Live
from rich.text import Text

from craftsim.cli.progress import LINE_EVERY_S
from craftsim.experiments.experiment import TrialRecord
from craftsim.reports.text import clean
from craftsim.studies.runs import RUNS
from craftsim.studies.study import Study, StudyRun
from craftsim.training.curve import CURVE_FILE, read_last

EVERY_S: Final = LINE_EVERY_S
"""Without a terminal, a line says how far things are so often, if there is anything new."""


@contextmanager
def watching(console: Console, study: Study, out: Path) -> Iterator[Callable[[TrialRecord], None]]:
    """Show how far a study is, until the block ends; the function that is given is called with each run's record.

    Args:
        console: where it shows: as lines that change, or as one now and then where it is no terminal.
        study: what runs.
        out: its output folder.
    """
    left = {run.key: run for run in study.runs}
    reached = 0

    def on_record(record: TrialRecord) -> None:
        nonlocal reached
        reached += record["agrees"]
        left.pop(record["key"], None)

    def lines() -> list[str]:
        total = len(study.runs)
        done = f"{total - len(left)} of {total} runs done, {reached} reached {study.goal:g}"
        begun = [(run, out / RUNS / run.key) for run in list(left.values())]
        return [done, *(_how_far(run, folder) for run, folder in begun if folder.is_dir())]

    if console.is_terminal:
        with Live(
            get_renderable=lambda: Text(clean("\n".join(lines()))),
            console=console,
            refresh_per_second=1,
            transient=True,
        ):
            yield on_record
        return
    ended = Event()

    def say() -> None:
        said = ""
        with suppress(OSError):  # nobody reads any more, which the results will show
            while not ended.wait(EVERY_S):
                if (now := "; ".join(lines())) != said:
                    console.print(said := now, soft_wrap=True, markup=False, highlight=False)

    sayer = Thread(target=say, daemon=True)
    sayer.start()
    try:
        yield on_record
    finally:
        ended.set()
        sayer.join()


def _how_far(run: StudyRun, folder: Path) -> str:
    last = read_last(folder / CURVE_FILE)
    if last is None:
        return f"{run.key}: no evaluation yet"
    steps, success = last
    return f"{run.key}: {steps:,} of at most {run.steps:,} steps, success {success:.2f}"
