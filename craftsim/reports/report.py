"""What a report says, however it is rendered: a verdict, key figures, and sections of text, tables, drawings and cases.

All text is plain text: it is escaped when it is rendered, wherever it comes from.
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

    from craftsim.reports.terminal import Terminal


class Tone(StrEnum):
    """What a colour says."""

    PLAIN = "plain"
    GOOD = "good"
    CAUTION = "caution"
    BAD = "bad"
    MUTED = "muted"


@dataclass(frozen=True)
class Headline:
    """The verdict: a word or two on a coloured ground, and one sentence."""

    badge: str
    tone: Tone
    sentence: str


@dataclass(frozen=True)
class KeyFigure:
    """One of the few figures that stand at the top of the page."""

    value: str
    label: str
    note: str = ""


@dataclass(frozen=True)
class Cell:
    """A cell of a table that is more than its text."""

    text: str
    tone: Tone = Tone.PLAIN
    share: tuple[float, float, float] | None = None
    """A share with the bounds of its interval, which the page draws as a bar."""
    link: str = ""
    """A file to open, relative to the report's folder; without it there is no link."""
    tip: str = ""


Value: TypeAlias = Cell | str | int | None
"""What a cell may be; None reads as "none"."""


@dataclass(frozen=True)
class Column:
    """The head of a table's column."""

    name: str
    kind: Literal["text", "number", "path", "wide"] = "text"
    """Numbers are aligned to the right; paths may be broken after slashes; wide columns hold sentences."""
    tip: str = ""
    """What the name means, where it does not say so itself."""
    terminal: bool = True
    """Whether the terminal has room for it."""


def numbers(first: str, *names: str) -> tuple[Column, ...]:
    """Return the heads of a table of numbers, one of which is named by the first column of each row."""
    return Column(first), *(Column(name, "number") for name in names)


@dataclass(frozen=True)
class DataTable:
    """A table."""

    columns: Sequence[Column]
    rows: Sequence[Sequence[Value]]
    title: str = ""
    note: str = ""
    folded: bool = False
    """Whether the page opens it only when it is asked to."""
    tall: bool = False
    """Whether it may be long: the page then scrolls within it."""
    most: int = 40
    """Rows on the terminal, none for a table of the page alone; the page has all."""

    @property
    def stacks(self) -> bool:
        """Whether a narrow page shows each row as a card, since some of its cells are long."""
        return any(column.kind in ("path", "wide") for column in self.columns) and len(self.columns) > 2

    def as_markdown(self) -> str:
        """Return it as Markdown has it, its title above it."""
        lines = [[column.name for column in self.columns], ["---"] * len(self.columns)]
        lines += [[text_of(value) for value in row] for row in self.rows]
        return "\n".join([f"{self.title}:", "", *(f"| {' | '.join(line)} |" for line in lines)])


@dataclass(frozen=True)
class Drawing:
    """A figure that the page draws; the terminal has none."""

    draw: Callable[[Figure], None]
    height_in: float
    caption: str
    label: str
    """Text alternative, for screen readers."""
    width_in: float = 6.6
    wide: bool = False
    """Whether it takes the whole width of the page."""
    style: Mapping[str, Any] = field(default_factory=dict)
    """Settings of matplotlib, on top of those of all drawings."""

    @classmethod
    def of_axes(cls, draw: Callable[[Axes], None], height_in: float, caption: str, label: str) -> Drawing:
        """Return a drawing of one diagram."""
        return cls(lambda figure: draw(figure.subplots()), height_in, caption, label)


@dataclass(frozen=True)
class Case:
    """A failure, to be watched and replayed. Its files are relative to the report's folder, and need not be there."""

    title: str
    result: str
    tone: Tone
    reason: str
    differences: tuple[str, ...] = ()
    again: tuple[str | Path, ...] = ()
    """Words of the command that shows it again, empty where there is none. Paths are relative to the report's folder,
    where the page says to run it; the terminal says it for the present folder."""
    film: str = ""
    trajectory: str = ""


@dataclass(frozen=True)
class Cases:
    """Failures in detail, each a card on the page."""

    cases: Sequence[Case]
    unfilmed: int | None = None
    """How many of the first the page shows even without a film of them, where a table lists all; None for all."""
    most: int = 1
    """How many the terminal shows."""


@dataclass(frozen=True)
class Group:
    """Parts of a page's section that are folded together under one line."""

    title: str
    blocks: Sequence[Block]
    badge: str = ""
    tone: Tone = Tone.PLAIN
    open: bool = False


Block: TypeAlias = str | DataTable | Drawing | Cases | Group
"""What a section is made of; a text is a paragraph, or where it has several lines, shown as it is."""


@dataclass(frozen=True)
class Section:
    """A part of a report."""

    id: str
    title: str
    lead: str
    blocks: Sequence[Block]
    terminal: bool = False
    """Whether it is short enough for the terminal."""
    page: bool = True
    """Whether the page has it, too, which says more elsewhere where it has not."""


@dataclass(frozen=True)
class Report:
    """The report of a run. :meth:`publish` renders it."""

    title: str
    subtitle: str
    headline: Headline
    key_figures: Sequence[KeyFigure] = ()
    sections: Sequence[Section] = ()
    notes: Sequence[str] = ()
    """Remarks on how to read the figures."""
    files: Mapping[str, str | Path] = field(default_factory=dict)
    """What else was written, by what it is."""
    document: Mapping[str, Any] | None = None
    """What ``report.json`` holds (:func:`~craftsim.reports.json_file.document`); None where it has been written."""
    exit_code: int = 0

    def publish(self, out: Path | None, console: Terminal | None = None) -> int:
        """Write ``report.json`` and ``report.html`` into a folder, if there is one, print, and return the exit status.

        Raises InputError where the folder cannot be written to.
        """
        from craftsim.reports.html import write_html
        from craftsim.reports.json_file import write_json
        from craftsim.reports.terminal import Terminal as Screen
        from craftsim.reports.terminal import print_report

        files = dict(self.files)
        if out is not None:
            if self.document is not None:
                write_json(out, self.document)
            files |= {"Report": out / "report.json", "Page": write_html(out, self)}
        print_report(console or Screen(), self, out, files)
        return self.exit_code


SHARE = (Column("share", "number"), Column("95 % interval", "number"))
"""The columns of :func:`share_cells`."""


def share_cells(p: Any) -> tuple[Value, Value]:
    """Return a :class:`~craftsim.experiments.intervals.Proportion` as two cells: its rate with a bar, its interval."""
    if p.rate is None:
        return None, None
    bar = (p.rate, p.wilson_low, p.wilson_high)
    return Cell(percent(p.rate), share=bar), interval(p.wilson_low, p.wilson_high)


def percent(share: float | None) -> str:
    """Return a share as percents, 100 % only if it is all."""
    if share is None:
        return "none"
    digits = 0 if share in (0.0, 1.0) else 1
    text = f"{100 * share:.{digits}f}"
    return f"{'> 99.9' if text == '100.0' else '< 0.1' if text == '0.0' else text} %"


def interval(low: float, high: float) -> str:
    """Return an interval of shares as percents."""
    return f"{100 * low:.1f} to {100 * high:.1f} %"


def count(number: int, thing: str, things: str = "") -> str:
    """Return a number with its thing, in the plural where it needs one."""
    return f"{number:,} {thing if number == 1 else things or f'{thing}s'}"


def text_of(value: Value) -> str:
    """Return the text of a cell."""
    match value:
        case Cell():
            return value.text
        case None:
            return "none"
        case int():
            return f"{value:,}"
        case _:
            return value
