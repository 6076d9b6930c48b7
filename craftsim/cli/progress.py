"""Progress of long work: what is done, what failed, the rate and the time that remains; lines without a terminal."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from operator import itemgetter
from typing import Any, Final

LINE_EVERY_S: Final = 20.0
"""Without a terminal, a line says how far things are so often."""

Progress = Callable[[int], AbstractContextManager[Callable[[Any], None]]]


def counting(what: str, good: Callable[[Any], bool] = itemgetter("agrees")) -> Progress:
    """Return what, given the number of pieces of work, opens what is called with each one's result.

    Args:
        what: what the pieces are called.
        good: whether a result counts as a success.
    """
    return partial(_count, what, good)


def without_error(record: Any) -> bool:
    """Return whether a trial came to an end."""
    return record["error"] is None


def counting_kinds() -> Progress:
    """Return what shows how far the minimization of the failures of a run is."""
    return counting("kinds of failure shrunk", lambda shrunk: shrunk.folder is not None)


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
