"""The progress bar of long work: what is done, what failed, the rate and the time that remains."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn


@contextmanager
def counting(console: Console, what: str, total: int) -> Iterator[Callable[[bool], None]]:
    """Show a bar of ``total`` pieces of work; the function that is given is called with each one's success."""
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
    begun = time.perf_counter()
    done = failed = 0
    with bar as progress:
        task = progress.add_task(what, total=total, rate=0.0, failed=0)

        def tell(succeeded: bool) -> None:
            nonlocal done, failed
            done, failed = done + 1, failed + (not succeeded)
            progress.update(task, advance=1, rate=done / (time.perf_counter() - begun), failed=failed)

        yield tell
