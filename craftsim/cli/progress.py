"""Progress of long work: what is done, what failed, the rate and the time that remains; lines without a terminal."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from operator import itemgetter
from typing import TYPE_CHECKING, Any, Final

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from craftsim.reports.text import clean

if TYPE_CHECKING:
    from craftsim.validation.minimize import ShrinkProgress

LINE_EVERY_S: Final = 20.0
"""Without a terminal, a line says how far things are so often."""


@contextmanager
def counting(
    console: Console, what: str, total: int, good: Callable[[Any], bool] = itemgetter("agrees")
) -> Iterator[Callable[[Any], None]]:
    """Count ``total`` pieces of work; the function that is given is called with each one's result.

    Args:
        console: where progress shows: as a bar, or as a line now and then where it is no terminal.
        what: what the pieces are called.
        total: how many there are.
        good: whether a result counts as a success.
    """
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
    what = escape(clean(what))
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


def shrinking(console: Console) -> ShrinkProgress:
    """Return what shows how far the shrinking of the failures of a campaign is."""
    return lambda total: counting(
        console, "kinds of failure shrunk", total, lambda shrunk: shrunk.folder is not None
    )
