"""Progress of long work: done, failed, rate and remaining time, as a bar or, without a terminal, as lines.

The first line comes after two seconds, the others at intervals. The remaining time is said from a tenth of the work on:
what the first items take says little of the others.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import partial
from operator import itemgetter
from threading import Event, Thread
from typing import Any, Final

_LINE_EVERY_S: Final = 20.0
"""Interval of the lines."""
_FIRST_LINE_S: Final = 2.0
"""After so long the first line comes."""
_SLOW: Final = 0.1
"""Items a second below which the seconds of an item are said."""
_LEAST_SHARE: Final = 0.1
"""Share of the work from which on the remaining time is said."""

_Progress = Callable[[int | None], AbstractContextManager[Callable[[Any], None]]]


def counting(items: str, good: Callable[[Any], bool] = itemgetter("agrees")) -> _Progress:
    """Return a progress display: a function from the number of items, None if it is not known, to a context that is
    called with each result.

    ``good`` says whether a result counts as a success.
    """
    return partial(_count, items, good)


@contextmanager
def print_regularly(lines: Callable[[], Iterable[str]], every_s: float) -> Iterator[None]:
    """Print some lines from time to time, from a thread, until the block ends; first after two seconds."""
    from craftsim.reports.terminal import Terminal

    over = Event()

    def tell() -> None:
        wait_s = min(_FIRST_LINE_S, every_s)
        while not over.wait(wait_s):
            wait_s = every_s
            try:
                for line in lines():
                    Terminal().print(line, markup=False, soft_wrap=True)
            except BrokenPipeError:
                return  # The command itself meets it, and ends.

    thread = Thread(target=tell, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


@contextmanager
def working(work: str) -> Iterator[None]:
    """Say what is done until the block ends, where it takes more than two seconds: work that counts nothing."""
    from rich.markup import escape

    from craftsim.reports.terminal import Terminal

    console = Terminal()
    display: AbstractContextManager[Any] = print_regularly(lambda: [work], _LINE_EVERY_S)
    if console.is_terminal:
        display = console.status(escape(work))
    with display:
        yield


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
            remaining = ""
            if total is not None and done >= _LEAST_SHARE * total:
                remaining = f", about {_rounded((total - done) / rate)} s left"
            pace = f"{rate:.1f}/s"
            if rate < _SLOW:
                pace = f"{1 / rate:.0f} s each"
            status = f"{failed} failed, {pace}{remaining}"
            if total is None:
                line = f"{done}, {status}"
            else:
                line = f"{done} of {total}, {status}"
            tell(done, status, line)

        yield on_result


def _rounded(seconds: float) -> int:
    """Return a time with one digit that counts: more are not known."""
    if seconds < 10:
        return round(seconds)
    step = 10 ** int(math.log10(seconds))
    return step * math.ceil(seconds / step)


@contextmanager
def stage_display(work: str, every_s: float) -> Iterator[Callable[[str, int], None]]:
    """Show the stage of work of unknown length; without a terminal print a line from time to time.

    Yields what is to be called with the stage, and with the number of simulations so far.
    """
    from rich.markup import escape

    from craftsim.reports.terminal import Terminal

    console = Terminal()
    start_s = time.perf_counter()
    next_s = start_s + min(_FIRST_LINE_S, every_s)
    with console.status(escape(work)) as status:

        def tell(stage: str, predictions: int) -> None:
            nonlocal next_s
            now_s = time.perf_counter()
            line = f"{work}: {stage}, {predictions} simulations, {now_s - start_s:.0f} s"
            status.update(escape(line))
            if not console.is_terminal and now_s >= next_s:
                next_s = now_s + every_s
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
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

    from craftsim.reports.terminal import Terminal

    console = Terminal()
    description = escape(escape(items))
    latest = "begun"
    if total is not None:
        latest = f"{done:,} of {total:,}"
    texts = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[how]}"),
    )
    lines: AbstractContextManager[None] = nullcontext()
    if not console.is_terminal:
        lines = print_regularly(lambda: [f"{items}: {latest}"], every_s)
    with (
        lines,
        Progress(*texts, console=console, transient=True, disable=not console.is_terminal) as bar,
    ):
        task = bar.add_task(description, total=total, completed=done, how="")

        def tell(done: int, status: str, line: str) -> None:
            nonlocal latest
            bar.update(task, completed=done, how=status)
            latest = line

        yield tell
