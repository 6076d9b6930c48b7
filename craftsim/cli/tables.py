"""Tables and lines of what was measured, for the terminal and for the documentation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from craftsim.storage.writing import write_whole

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

_FIGURE: Final = 14
"""Characters of a cell that stays in one line."""
_TEXT: Final = 9
"""Characters of a longer one in a line, at least."""


@dataclass(frozen=True)
class Cells:
    """A table of texts."""

    title: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    def for_terminal(self) -> Table:
        """Return it as the terminal shows it; where that is narrow, long texts go over several lines."""
        from rich.box import SIMPLE
        from rich.table import Table

        table = Table(title=self.title, box=SIMPLE)
        widths = [max(map(len, column)) for column in zip(self.head, *self.rows, strict=True)]
        for name, width in zip(self.head, widths, strict=True):
            table.add_column(name, no_wrap=width <= _FIGURE, overflow="fold", min_width=min(width, _TEXT))
        for row in self.rows:
            table.add_row(*row)
        return table

    def as_markdown(self) -> str:
        """Return it as Markdown has it, its title above it."""
        lines = [self.head, ("---",) * len(self.head), *self.rows]
        return "\n".join([f"{self.title}:", "", *(f"| {' | '.join(line)} |" for line in lines)])


def show(tables: Sequence[Cells], lines: Sequence[str], console: Console, page: Path | None = None) -> None:
    """Print tables and then lines, and write them as Markdown if there is to be a page.

    Raises InputError where the disk does not take it.
    """
    for table in tables:
        console.print(table.for_terminal())
    for line in lines:
        console.print(line, soft_wrap=True)
    if page is not None:
        write_whole(page, "\n\n".join([*(table.as_markdown() for table in tables), *listed(lines)]) + "\n")


def listed(lines: Sequence[str]) -> list[str]:
    """Return lines as one paragraph in Markdown, a list; none where there are no lines."""
    return ["\n".join(f"- {line}" for line in lines)] if lines else []
