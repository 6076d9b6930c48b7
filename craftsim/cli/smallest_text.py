"""What commands print of failures in their smallest worlds."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from craftsim.cli.progress import counting
from craftsim.cli.text import say
from craftsim.validation.shrinking.campaign import ACTIONS, BLUEPRINT, ShrinkProgress, Shrunk


def shrinking(console: Console) -> ShrinkProgress:
    """Return what shows how far the shrinking of the failures of a campaign is."""
    return lambda total: counting(
        console, "kinds of failure shrunk", total, lambda shrunk: shrunk.folder is not None
    )


def print_smallest(console: Console, out: Path, found: Sequence[Shrunk]) -> None:
    """Print for each failure its smallest world in words, and how to try it again."""
    if found:
        console.print(f"[bold]smallest worlds: {len(found)} kinds of failure")
    for shrunk in found:
        say(f"  {shrunk.sentence}")
        if shrunk.folder is not None:
            left = "" if shrunk.minimal else "; perhaps not the smallest: the trials were used up"
            say(f"    of {shrunk.key}, {shrunk.trials} trials{left}")
            folder = out / shrunk.folder
            rules = f" --rules {shrunk.rules}" if shrunk.rules != "physical" else ""
            say(f"    craftsim validate {folder / BLUEPRINT} --actions {folder / ACTIONS}{rules}")
