"""Progress of long work: done, failed, rate and remaining time, as a bar or, without a terminal, as lines."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from operator import itemgetter
from threading import Event, Thread
from typing import Any, Final

_LINE_EVERY_S: Final = 20.0
"""Interval of the lines."""

_Progress = Callable[[int | None], AbstractContextManager[Callable[[Any], None]]]


def counting(items: str, good: Callable[[Any], bool] = itemgetter("agrees")) -> _Progress:
    """Return a progress display: a function from the number of items, None if it is not known, to a context that is
    called with each result.

    ``good`` says whether a result counts as a success.
    """
    return partial(_count, items, good)


@contextmanager
def print_regularly(lines: Callable[[], Iterable[str]], every_s: float) -> Iterator[None]:
    """Print some lines from time to time, from a thread, until the block ends."""
    from craftsim.reports.terminal import Terminal

    over = Event()

    def tell() -> None:
        while not over.wait(every_s):
            for line in lines():
                Terminal().print(line, markup=False, soft_wrap=True)

    thread = Thread(target=tell, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


def without_error(record: Any) -> bool:
    """Return whether a trial finished."""
    return record["error"] is None


def counting_kinds() -> _Progress:
    """Return the progress display of a minimization."""
    return counting("kinds of failure minimized", lambda minimized: minimized.folder is not None)


@contextmanager
def _count(
    items: str, good: Callable[[Any], bool], total: int | None
) -> Iterator[Callable[[Any], None]]:
    start_s = time.perf_counter()
    done = 0
    failed = 0
    with progress_of(items, total, _LINE_EVERY_S) as tell:

        def on_result(result: Any) -> None:
            nonlocal done, failed
            done += 1
            if not good(result):
                failed += 1
            rate = done / (time.perf_counter() - start_s)
            if total is None:
                line = f"{done}, {failed} failed, {rate:.1f}/s"
            else:
                left_s = (total - done) / rate
                line = f"{done} of {total}, {failed} failed, about {left_s:.0f} s left"
            tell(done, f"{rate:.1f}/s, {failed} failed,", line)

        yield on_result


@contextmanager
def stage_display(work: str, every_s: float) -> Iterator[Callable[[str, int], None]]:
    """Show the stage of work of unknown length; without a terminal print a line from time to time.

    Yields what is to be called with the stage, and with the number of simulations so far.
    """
    from rich.markup import escape

    from craftsim.reports.terminal import Terminal

    console = Terminal()
    start_s = time.perf_counter()
    printed_s = start_s
    with console.status(escape(work)) as status:

        def tell(stage: str, predictions: int) -> None:
            nonlocal printed_s
            now_s = time.perf_counter()
            line = f"{work}: {stage}, {predictions} simulations, {now_s - start_s:.0f} s"
            status.update(escape(line))
            if not console.is_terminal and now_s - printed_s >= every_s:
                printed_s = now_s
                console.print(line, markup=False, soft_wrap=True)

        yield tell


@contextmanager
def progress_of(
    items: str, total: int | None, every_s: float, done: int = 0
) -> Iterator[Callable[[int, str, str], None]]:
    """Show a bar for a total, if it is known, of which some is done; without a terminal print a line from time to time.

    Yields what is to be called with how much is done, words beside the bar, and those of a line.
    """
    from rich.markup import escape
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeRemainingColumn,
    )

    from craftsim.reports.terminal import Terminal

    console = Terminal()
    description = escape(escape(items))
    printed_s = time.perf_counter()
    texts = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[how]}"),
    )
    with Progress(
        *texts,
        TimeRemainingColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,
    ) as bar:
        task = bar.add_task(description, total=total, completed=done, how="")

        def tell(done: int, status: str, line: str) -> None:
            nonlocal printed_s
            bar.update(task, completed=done, how=status)
            if not console.is_terminal and time.perf_counter() - printed_s >= every_s:
                printed_s = time.perf_counter()
                console.print(f"{description}: {line}", soft_wrap=True)

        yield tell
