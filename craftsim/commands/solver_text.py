"""What commands print when the solver gave up."""

from __future__ import annotations

from craftsim.checking.attempt import capped_text
from craftsim.commands.text import say


def print_capped(steps: int) -> None:
    """Say in how many physics steps the solver gave up, if in any."""
    if steps:
        say(f"Note: {capped_text(steps)}; failures there are reported as numerics.")
