"""Reports on the terminal, and a console that escapes control characters."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal

from rich.cells import cell_len
from rich.console import Console
from rich.text import Text

from craftsim.reports.report import (
    Cases,
    Column,
    DataTable,
    Report,
    TableCell,
    Tone,
    Value,
    cell_text,
)
from craftsim.reports.text import escape

_STYLES: Final = {
    Tone.PLAIN: "",
    Tone.GOOD: "green",
    Tone.CAUTION: "yellow",
    Tone.BAD: "red",
    Tone.MUTED: "dim",
}
_SHORT: Final = 24
"""Texts of up to so many characters stay on one line."""
_INDENT: Final = 2
_GAP: Final = 2
"""Characters between two columns."""
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
    short_sections = [section for section in report.sections if section.terminal]
    for section in short_sections:
        for block in section.blocks:
            match block:
                case DataTable():
                    print_table(console, block)
                case Cases():
                    _print_cases(console, block, out or Path())
                case str():
                    console.print_safe(block)
    if short_sections:
        console.print()
    for note in report.notes:
        console.print_safe(note)
    width = max(map(len, files), default=0) + 1
    for name, file in files.items():
        console.print_safe(f"{f'{name}:':<{width}} {file}")
    headline = report.headline
    console.print_safe(headline.sentence, _STYLES[headline.tone])


def print_table(console: Terminal, table: DataTable) -> None:
    """Print a table.

    Texts are wrapped between words, and no word is broken. Where the columns do not fit beside each other, a row takes
    several lines, of which all but the first are indented.
    """
    rows = table.rows[: table.most]
    if not rows:
        return
    if table.title:
        console.print(cell(f"\n{table.title}"), style="bold")
    column_numbers = [number for number, column in enumerate(table.columns) if column.terminal]
    columns = [table.columns[number] for number in column_numbers]
    heads = [Text(escape(column.name), "italic") for column in columns]
    cells = []
    for row in rows:
        cells.append([_styled(row[number]) for number in column_numbers])
    lines = _lines(columns, [heads, *cells], console.width)
    for row_cells in (heads, *cells):
        for line in lines:
            for text in _laid_out(console, columns, row_cells, line):
                console.print(text, soft_wrap=True, highlight=False)
    hidden_rows = len(table.rows[table.most :])
    if hidden_rows:
        console.print_safe(f"and {hidden_rows:,} more in the report", "dim")
    if table.note:
        note = cell(table.note)
        note.stylize("dim")
        longest = max((cell_len(word) for word in note.plain.split()), default=0)
        for text in note.wrap(console, max(console.width, longest)):
            text.rstrip()
            console.print(text, soft_wrap=True, highlight=False)


@dataclass(frozen=True)
class _Line:
    """The columns that one line of each row shows, and their widths in characters."""

    indent: int
    widths: Mapping[int, int]
    """By the number of the column, from left to right."""


def _lines(columns: Sequence[Column], rows: Sequence[Sequence[Text]], width: int) -> list[_Line]:
    """Return the lines of each row, of which the first row is the headings."""
    texts_of_columns = list(zip(*rows, strict=True))
    min_widths = [
        _least_width(column, texts) for column, texts in zip(columns, texts_of_columns, strict=True)
    ]
    full_widths = []
    for texts in texts_of_columns:
        full_widths.append(max(text.cell_len for text in texts))
    lines: list[_Line] = []
    for group in _groups(columns, min_widths, width):
        indent = 0
        if lines:
            indent = _INDENT
        sentences = {number for number in group if columns[number].kind == "wide"}
        widths = {number: full_widths[number] for number in group}
        # Sentences give way before names and other short texts.
        for yielding in (sentences, set(group)):
            widths = _narrowed(widths, min_widths, yielding, width - indent)
        lines.append(_Line(indent, widths))
    return lines


def _groups(columns: Sequence[Column], min_widths: Sequence[int], width: int) -> list[list[int]]:
    """Return the numbers of the columns of each line: all in one, or names first, and then as many in each as fit."""
    if _across(min_widths) <= width:
        return [list(range(len(columns)))]
    groups: list[list[int]] = [[]]
    for number, column in enumerate(columns):
        indent = 0
        if len(groups) > 1:
            indent = _INDENT
        together = [*groups[-1], number]
        fits = indent + _across([min_widths[column_number] for column_number in together]) <= width
        after_names = (
            number > 0 and column.kind == "number" and columns[number - 1].kind != "number"
        )
        if groups[-1] and (not fits or (after_names and len(groups) == 1)):
            groups.append([number])
        else:
            groups[-1] = together
    return groups


def _least_width(column: Column, texts: Sequence[Text]) -> int:
    """Return the least width of a column, of which the first text is the heading: numbers and short texts are whole."""
    longest_word = max((cell_len(word) for text in texts for word in text.plain.split()), default=0)
    longest_text = max(text.cell_len for text in texts[1:])
    if column.kind == "number":
        return max(longest_word, longest_text)
    return max(longest_word, min(longest_text, _SHORT))


def _across(widths: Sequence[int]) -> int:
    """Return the width of columns beside each other."""
    return sum(widths) + _GAP * (len(widths) - 1)


def _narrowed(
    widths: Mapping[int, int], min_widths: Sequence[int], yielding: Set[int], width: int
) -> dict[int, int]:
    """Return widths of columns that fit where they can: the widest of the yielding ones give way first."""
    narrowed = dict(widths)
    while _across([*narrowed.values()]) > width:
        wider_than_least = [number for number in yielding if narrowed[number] > min_widths[number]]
        if not wider_than_least:
            break
        widest = max(wider_than_least, key=lambda number: narrowed[number])
        narrowed[widest] -= 1
    return narrowed


def _laid_out(
    console: Terminal, columns: Sequence[Column], texts: Sequence[Text], line: _Line
) -> Iterator[Text]:
    """Yield what is printed of one line of a row: several lines where texts are wrapped."""
    wrapped = {}
    for number, width in line.widths.items():
        if columns[number].kind == "number":
            justify: Literal["left", "right"] = "right"
        else:
            justify = "left"
        wrapped[number] = texts[number].wrap(console, width, justify=justify)
    for position in range(max(map(len, wrapped.values()))):
        printed = Text(" " * line.indent)
        for number, width in line.widths.items():
            if position < len(wrapped[number]):
                piece = wrapped[number][position]
            else:
                piece = Text()
            piece.pad_right(width + _GAP - piece.cell_len)
            printed.append_text(piece)
        printed.rstrip()
        yield printed


def _styled(value: Value) -> Text:
    if value is None:
        return Text("-")
    if isinstance(value, TableCell):
        return Text(escape(value.text), _STYLES[value.tone])
    return Text(escape(cell_text(value)))


def _print_cases(console: Terminal, cases: Cases, out: Path) -> None:
    for case in cases.cases[: cases.most]:
        console.print_safe(f"{case.title}: {case.result}: {case.reason}", _STYLES[case.tone])
        for line in case.differences:
            if line not in case.reason:
                console.print_safe(f"  {line}")
        if case.again:
            words = (str(out / word) if isinstance(word, Path) else word for word in case.again)
            console.print_safe(f"  {shlex.join(words)}")
