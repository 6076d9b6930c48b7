"""Reports on the terminal, and a console that escapes control characters."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from rich.console import Console
from rich.table import Table
from rich.text import Text

from craftsim.reports.report import Cases, Cell, DataTable, Report, Tone, Value, text_of
from craftsim.reports.text import escape

_STYLES: Final = {
    Tone.PLAIN: "",
    Tone.GOOD: "green",
    Tone.CAUTION: "yellow",
    Tone.BAD: "red",
    Tone.MUTED: "dim",
}
_ONE_LINE: Final = 14
_NARROWEST: Final = 9
_LEAST_WIDTH: Final = 40
"""In columns. COLUMNS may be 0, as some terminals without a size say."""


class Terminal(Console):
    """A console that escapes control characters in untrusted text, and loses no table on a narrow terminal."""

    def __init__(self, **options: Any) -> None:
        """Take the width of the terminal, or the least one, beyond which lines go on in the next row."""
        super().__init__(**options)
        if self.width < _LEAST_WIDTH:
            self.width = _LEAST_WIDTH

    def render_str(self, text: str, *arguments: Any, **options: Any) -> Text:
        """Return an escaped text with its markup."""
        return super().render_str(escape(text), *arguments, **options)

    def on_broken_pipe(self) -> None:
        """Let the command line handle a closed pipe."""
        raise

    def print_safe(self, text: object, style: str = "") -> None:
        """Print an untrusted text, escaped, without markup and unwrapped."""
        self.print(cell(text), style=style, soft_wrap=True, highlight=False)


def cell(text: object) -> Text:
    """Return an untrusted text for a table, escaped and without markup."""
    return Text(escape(text))


def print_report(
    console: Terminal, report: Report, out: Path | None, files: Mapping[str, str | Path]
) -> None:
    """Print the short sections of a report, its notes, the written files, and the verdict."""
    for section in report.sections:
        for block in section.blocks if section.terminal else ():
            match block:
                case DataTable():
                    print_table(console, block)
                case Cases():
                    _print_cases(console, block, out or Path())
                case str():
                    console.print_safe(block)
    if any(section.terminal for section in report.sections):
        console.print()
    for note in report.notes:
        console.print_safe(note)
    width = max(map(len, files), default=0) + 1
    for name, file in files.items():
        console.print_safe(f"{f'{name}:':<{width}} {file}")
    headline = report.headline
    console.print_safe(headline.sentence, _STYLES[headline.tone])


def print_table(console: Terminal, table: DataTable) -> None:
    """Print a table; long texts are wrapped on a narrow terminal."""
    rows = table.rows[: table.most]
    if not rows:
        return
    if table.title:
        console.print(cell(f"\n{table.title}"), style="bold")
    grid = Table(box=None, pad_edge=False, padding=(0, 1, 0, 0), header_style="italic")
    for number, column in enumerate(table.columns):
        if column.terminal:
            width = max(len(text_of(row[number])) for row in rows)
            justify: Any = "right" if column.kind == "number" else "left"
            one_line = width <= _ONE_LINE or column.kind == "number"
            least = width if one_line else min(width, _NARROWEST)
            how = {"justify": justify, "no_wrap": one_line, "overflow": "fold", "min_width": least}
            grid.add_column(cell(column.name), **how)
    for row in rows:
        grid.add_row(*(_styled(v) for v, column in zip(row, table.columns, strict=False) if column.terminal))
    console.print(grid)
    if more := len(table.rows[table.most :]):
        console.print_safe(f"and {more:,} more in the report", "dim")
    if table.note:
        console.print(cell(table.note), style="dim")


def _styled(value: Value) -> Text:
    tone = value.tone if isinstance(value, Cell) else Tone.PLAIN
    return Text("-" if value is None else escape(text_of(value)), _STYLES[tone])


def _print_cases(console: Terminal, cases: Cases, out: Path) -> None:
    for case in cases.cases[: cases.most]:
        console.print_safe(f"{case.title}: {case.result}: {case.reason}", _STYLES[case.tone])
        for line in case.differences:
            if line not in case.reason:
                console.print_safe(f"  {line}")
        if case.again:
            words = (str(out / word) if isinstance(word, Path) else word for word in case.again)
            console.print_safe(f"  {shlex.join(words)}")
