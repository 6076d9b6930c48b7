"""The console on which tables and progress are shown."""

from __future__ import annotations

from typing import Any

from rich.console import Console
from rich.text import Text

from craftsim.cli.text import clean


class Terminal(Console):
    """A console that shows text from files and from others' code as text: nothing in it steers the terminal."""

    def render_str(self, text: str, *arguments: Any, **options: Any) -> Text:
        """Return a text with its markup, cleaned."""
        return super().render_str(clean(text), *arguments, **options)

    def on_broken_pipe(self) -> None:
        """Leave it to the command line what follows when nobody reads any more."""
        raise


def cell(text: object) -> Text:
    """Return a text of others for a table: cleaned, and without markup."""
    return Text(clean(text))
