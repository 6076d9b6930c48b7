"""What a report's page is made of; :func:`craftsim.validation.html.writing.write_html` sets it.

All text is plain text: it is escaped when it is set, wherever it comes from.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import ClassVar, TypeAlias


class Tone(StrEnum):
    """What a colour says."""

    PLAIN = "plain"
    GOOD = "good"
    CAUTION = "caution"
    BAD = "bad"
    MUTED = "muted"


@dataclass(frozen=True)
class Share:
    """A share with its interval, shown as a small bar; all from 0 to 1."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Cell:
    """A cell of a table."""

    text: str
    tone: Tone = Tone.PLAIN
    badge: bool = False
    """Whether the text is set as a coloured label."""
    share: Share | None = None
    path: bool = False
    """Whether the text is a path or name that may be broken at its slashes."""
    wide: bool = False
    """Whether the text is long and deserves room."""


@dataclass(frozen=True)
class Column:
    """A column of a table; numbers are set to the right."""

    title: str
    number: bool = False
    tip: str = ""
    """What the title means, where it does not say it itself."""


@dataclass(frozen=True)
class Table:
    """A table; a bare string is a plain cell."""

    kind: ClassVar[str] = "table"
    columns: tuple[Column, ...]
    rows: tuple[tuple[str | Cell, ...], ...]
    caption: str = ""
    note: str = ""
    folded: bool = False
    """Whether it opens only when its caption is clicked."""
    tall: bool = False
    """Whether it scrolls in a box of its own, below a head that stays."""

    @property
    def stacks(self) -> bool:
        """Whether each row becomes a card where the page is narrow: there is long text that needs the width."""
        return any(isinstance(cell, Cell) and cell.wide for row in self.rows for cell in row)


@dataclass(frozen=True)
class Plot:
    """A drawing; its caption says what there is to see."""

    kind: ClassVar[str] = "plot"
    svg: str
    """Drawn by :mod:`craftsim.validation.html.plots`, trusted."""
    caption: str


@dataclass(frozen=True)
class Case:
    """A disagreement, to be watched and replayed."""

    title: str
    result: str
    tone: Tone
    reason: str
    differences: tuple[str, ...] = ()
    bundle: str = ""
    """Folder relative to the page, empty when there is none."""


@dataclass(frozen=True)
class Cases:
    """Disagreements, each with the film that lies in its bundle."""

    kind: ClassVar[str] = "cases"
    cases: tuple[Case, ...]
    filmed_only: bool = False
    """Whether those without a film are left out, because a table beside tells them."""


@dataclass(frozen=True)
class Group:
    """Blocks that belong together, and open only when their title is clicked."""

    kind: ClassVar[str] = "group"
    title: str
    blocks: tuple[Table | Cases, ...]


Block: TypeAlias = Table | Plot | Cases | Group


@dataclass(frozen=True)
class Section:
    """A part of a page."""

    id: str
    """Letters and hyphens; the address within the page."""
    title: str
    lead: str
    blocks: tuple[Block, ...]


@dataclass(frozen=True)
class KeyFigure:
    """One of the few figures that stand at the top."""

    value: str
    label: str
    note: str = ""


@dataclass(frozen=True)
class Headline:
    """The verdict: a word or two on a coloured ground, and one sentence."""

    badge: str
    tone: Tone
    sentence: str


@dataclass(frozen=True)
class Page:
    """A whole report."""

    title: str
    subtitle: str
    headline: Headline
    key_figures: tuple[KeyFigure, ...]
    sections: tuple[Section, ...]
