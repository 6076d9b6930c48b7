"""What ``craftsim margins`` prints."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console
from rich.table import Table

from craftsim.cli.terminal import cell
from craftsim.cli.text import say
from craftsim.validation.margins.margins import Margin, Margins


def print_margins(console: Console, out: Path, result: Margins) -> None:
    """Print the margins of each action, and what fails first along each axis."""
    weakest, axes = result.weakest, result.telling
    table = Table(box=None, pad_edge=False, padding=(0, 1, 0, 0))
    table.add_column("up to", no_wrap=True)
    for action in weakest:
        table.add_column(action, justify="right")
    for axis in axes:
        numbers = [
            cell(weakest[action][axis.name].number) for action in weakest if axis.name in weakest[action]
        ]
        table.add_row(f"{axis.words}, {axis.unit}", *numbers)
    console.print(table)
    say("(-: no effect; >=: all trials stand the largest value tried; base: not stood even without it)")
    for axis in axes:
        first = min((by[axis.name] for by in weakest.values() if axis.name in by), key=lambda one: one.rank)
        if first.limit.reason:
            say(_first_failure(out, first))
    quiet = [axis for axis in dict.fromkeys(one.axis for one in result.margins) if axis not in axes]
    if quiet:
        say(f"no effect on any action: {', '.join(axis.words for axis in quiet)}")
    for one in result.margins:
        if one.before is not None and one.before.margin != one.limit.margin:
            was = "not even the base" if one.before.margin is None else one.axis.text(one.before.margin)
            say(f"{one.scenario}, {one.axis.words}: {one.text}, was {was}")
    if errors := sum(record["error"] is not None for record in result.records):
        say(f"{errors} searches came to no end; the report has the reasons")


def _first_failure(out: Path, one: Margin) -> str:
    at = "in the base" if one.limit.fails_at is None else f"at {one.axis.text(one.limit.fails_at)}"
    text = f"{one.axis.words}: {one.scenario} first, {at}: {one.limit.reason}"
    return f"{text}\n  craftsim replay {out / one.bundle}" if one.bundle else text
