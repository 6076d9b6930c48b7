"""What commands print besides their results: that the solver gave up, or that cars had to try again."""

from __future__ import annotations

from craftsim.checking.attempt import capped_text
from craftsim.cli.text import say


def print_notes(capped_steps: int, retried: int) -> None:
    """Say in how many physics steps the solver gave up and how many actions were tried again, if any."""
    if capped_steps:
        say(f"Note: {capped_text(capped_steps)}; failures there are reported as numerics.")
    if retried:
        actions = "1 action was" if retried == 1 else f"{retried} actions were"
        say(f"Note: {actions} tried again; what counts is how the last try ended.")
