"""The content of a report: a verdict, key figures, and sections of text, tables, drawings and cases.

All text is plain text, which is escaped when it is rendered.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


class Tone(StrEnum):
    """The meaning of a colour."""

    PLAIN = "plain"
    GOOD = "good"
    CAUTION = "caution"
    BAD = "bad"
    MUTED = "muted"


@dataclass(frozen=True)
class Headline:
    """The verdict: a badge and one sentence."""

    badge: str
    tone: Tone
    sentence: str


@dataclass(frozen=True)
class KeyFigure:
    """A key figure, shown at the top of the page."""

    value: str
    label: str
    note: str = ""


@dataclass(frozen=True)
class TableCell:
    """A cell of a table with more than a text."""

    text: str
    tone: Tone = Tone.PLAIN
    share: tuple[float, float, float] | None = None
    """A share with the bounds of its interval, drawn as a bar."""
    link: str = ""
    tip: str = ""


Value: TypeAlias = TableCell | str | int | None
"""A cell; None is shown as "none"."""


@dataclass(frozen=True)
class Column:
    """The header of a table's column."""

    name: str
    kind: Literal["text", "number", "path", "wide"] = "text"
    """Numbers are aligned to the right; paths may be broken after slashes; wide columns hold sentences."""
    tip: str = ""
    terminal: bool = True


def numbers(first: str, *names: str) -> tuple[Column, ...]:
    """Return the headers of a table of numbers with named rows."""
    return Column(first), *(Column(name, "number") for name in names)


@dataclass(frozen=True)
class DataTable:
    """A table."""

    columns: Sequence[Column]
    rows: Sequence[Sequence[Value]]
    title: str = ""
    note: str = ""
    folded: bool = False
    tall: bool = False
    """Whether it may be long, and is scrollable on the page."""
    most: int = 40

    @property
    def stacks(self) -> bool:
        """Whether a narrow page shows each row as a card, because of long cells."""
        return (
            any(column.kind in ("path", "wide") for column in self.columns)
            and len(self.columns) > 2
        )

    def as_markdown(self) -> str:
        """Return the table with its title as Markdown."""
        rows = [[column.name for column in self.columns], ["---"] * len(self.columns)]
        for row in self.rows:
            rows.append([cell_text(value) for value in row])
        lines = [f"{self.title}:", ""]
        for texts in rows:
            lines.append(f"| {' | '.join(texts)} |")
        return "\n".join(lines)


@dataclass(frozen=True)
class Drawing:
    """A figure on the page."""

    draw: Callable[[Figure], None]
    height_in: float
    caption: str
    label: str
    """Text alternative for screen readers."""
    width_in: float = 6.6

    @classmethod
    def of_axes(
        cls, draw: Callable[[Axes], None], height_in: float, caption: str, label: str
    ) -> Drawing:
        """Return a drawing of one diagram."""
        return cls(lambda figure: draw(figure.subplots()), height_in, caption, label)


@dataclass(frozen=True)
class Case:
    """A failure with its files, relative to the report's folder, which may be missing."""

    title: str
    result: str
    tone: Tone
    reason: str
    differences: tuple[str, ...] = ()
    again: tuple[str | Path, ...] = ()
    """Words of the command that repeats it, if any. Paths are relative to the report's folder; the terminal shows them
    relative to the current one."""
    film: str = ""
    trajectory: str = ""
    recording: str = ""
    """File for the player of the page (craftsim/rendering/player.py)."""


@dataclass(frozen=True)
class Cases:
    """Failures in detail, each a card on the page."""

    cases: Sequence[Case]
    unfilmed: int | None = None
    """Number of cases shown on the page even without a film, if a table lists all; None for all."""
    most: int = 1


@dataclass(frozen=True)
class Group:
    """A collapsible group of blocks on the page."""

    title: str
    blocks: Sequence[Block]
    badge: str = ""
    tone: Tone = Tone.PLAIN


Block: TypeAlias = str | DataTable | Drawing | Cases | Group
"""Part of a section; a text is a paragraph, or preformatted if it has several lines."""


@dataclass(frozen=True)
class Section:
    """A part of a report."""

    id: str
    title: str
    lead: str
    blocks: Sequence[Block]
    terminal: bool = False
    page: bool = True


@dataclass(frozen=True)
class Report:
    """The report of a run."""

    title: str
    subtitle: str
    headline: Headline
    key_figures: Sequence[KeyFigure] = ()
    sections: Sequence[Section] = ()
    notes: Sequence[str] = ()
    files: Mapping[str, str | Path] = field(default_factory=dict)
    """Other files that were written, by description."""
    document: Mapping[str, Any] | None = None
    """Content of ``report.json`` (:func:`~craftsim.reports.json_file.document`); None if already written."""
    exit_code: int = 0


SHARE_COLUMNS = (Column("share", "number"), Column("95 % interval", "number"))
"""The columns of :func:`share_cells`."""


def share_cells(p: Any) -> tuple[Value, Value]:
    """Return a :class:`~craftsim.experiments.intervals.Proportion` as two cells: its rate with a bar, its interval."""
    if p.rate is None:
        return None, None
    bar = (p.rate, p.low, p.high)
    return TableCell(percent(p.rate), share=bar), interval(p.low, p.high)


def percent(share: float | None) -> str:
    """Return a share in percent, 100 % only for 1."""
    if share is None:
        return "none"
    if share in (0.0, 1.0):
        digits = 0
    else:
        digits = 1
    text = f"{100 * share:.{digits}f}"
    # A share that is rounded to all or nothing is neither.
    if text == "100.0":
        text = "> 99.9"
    elif text == "0.0":
        text = "< 0.1"
    return f"{text} %"


def interval(low: float, high: float) -> str:
    """Return an interval of shares in percent."""
    return f"{100 * low:.1f} to {100 * high:.1f} %"


def count(number: int, noun: str, plural: str = "") -> str:
    """Return a number with a noun in singular or plural."""
    if number != 1:
        noun = plural or f"{noun}s"
    return f"{number:,} {noun}"


def cell_text(value: Value) -> str:
    """Return the text of a cell."""
    match value:
        case TableCell():
            return value.text
        case None:
            return "none"
        case int():
            return f"{value:,}"
        case _:
            return value
