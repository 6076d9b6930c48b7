"""Progress of long work: done, failed, rate and remaining time, as a bar or, without a terminal, as lines."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from operator import itemgetter
from threading import Event, Thread
from typing import Any, Final

LINE_EVERY_S: Final = 20.0
"""Interval of the lines."""

Progress = Callable[[int], AbstractContextManager[Callable[[Any], None]]]


def counting(what: str, good: Callable[[Any], bool] = itemgetter("agrees")) -> Progress:
    """Return a progress display: a function from the number of items to a context that is called with each result.

    Args:
        what: name of the items.
        good: whether a result counts as a success.
    """
    return partial(_count, what, good)


@contextmanager
def telling(lines: Callable[[], Iterable[str]], every_s: float) -> Iterator[None]:
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


def counting_kinds() -> Progress:
    """Return the progress display of a minimization."""
    return counting("kinds of failure minimized", lambda minimized: minimized.folder is not None)


@contextmanager
def _count(what: str, good: Callable[[Any], bool], total: int) -> Iterator[Callable[[Any], None]]:
    from rich.markup import escape
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    from craftsim.reports.terminal import Terminal

    console = Terminal()
    bar = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]:.1f}/s, {task.fields[failed]} failed,"),
        TimeRemainingColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,
    )
    what = escape(escape(what))
    begun = said = time.perf_counter()
    done = failed = 0
    with bar as progress:
        task = progress.add_task(what, total=total, rate=0.0, failed=0)

        def on_result(result: Any) -> None:
            nonlocal done, failed, said
            done, failed, now = done + 1, failed + (not good(result)), time.perf_counter()
            rate = done / (now - begun)
            progress.update(task, advance=1, rate=rate, failed=failed)
            if not console.is_terminal and now - said > LINE_EVERY_S:
                said = now
                left = (total - done) / rate
                console.print(f"{what}: {done} of {total}, {failed} failed, about {left:.0f} s left")

        yield on_result
