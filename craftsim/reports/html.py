"""A report as one HTML file that opens without a server and without a network."""

from __future__ import annotations

import base64
import io
import re
import shlex
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Final
from urllib.parse import quote

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from craftsim.reports.report import Block, Case, Cell, Drawing, Report, Value, text_of
from craftsim.storage.folders import output_directory
from craftsim.storage.writing import write_whole

FILE_NAME: Final = "report.html"
MAX_CASES: Final = 24
"""Failures that a page, or a group of them, shows as cards."""
BUDGET_BYTES: Final = 20_000_000
"""Of all films within one page, as base64: more would make it slow to open and hard to send."""

_VARIABLES: Final = ("ink", "soft", "line", "paper", "good", "caution", "bad", "accent", "muted")
"""The page's own colours, in the order of their stand-ins in :mod:`craftsim.reports.plots`."""
_TEMPLATES: Final = Path(__file__).with_name("template")


def write_html(out: Path, report: Report) -> Path:
    """Write a report as ``report.html`` into the directory ``out`` and return its path.

    The file appears whole or not at all. It loads nothing: styles, drawings and films are within it; films that exceed
    :data:`BUDGET_BYTES` are linked by paths relative to it. Equal reports with equal films give equal files. All text
    is escaped, and a content security policy keeps the page from running or fetching anything.

    Args:
        out: directory, made when missing; the files of the report's cases are looked for in it.
        report: what to render.

    Raises:
        InputError: the directory cannot be written to.
    """
    path = output_directory(out) / FILE_NAME
    template = _environment().get_template("report.html.j2")
    return write_whole(path, template.render(report=report, files=_Files(out)))


class _Files:
    """The files beside one page; the first films that fit into a budget are embedded."""

    def __init__(self, out: Path) -> None:
        self.out = out
        self.left_bytes = BUDGET_BYTES

    def cards(self, cases: Iterable[Case], unfilmed: int | None) -> list[tuple[Case, str | None, str | None]]:
        """Return the cases to show, each with the addresses of its film and its trajectory.

        An address of a film is a ``data:`` one with the film itself, or a path relative to the page; None where there
        is no such file.
        """
        found = [(case, self._film(case.film), self.link(case.trajectory)) for case in cases]
        return [one for number, one in enumerate(found) if one[1] or unfilmed is None or number < unfilmed]

    def _film(self, file: str) -> str | None:
        if (address := self.link(file)) is None:
            return None
        path = self.out / file
        size = -(-path.stat().st_size // 3) * 4
        if size > self.left_bytes:
            return address
        self.left_bytes -= size
        return "data:video/mp4;base64," + base64.b64encode(path.read_bytes()).decode()

    def link(self, file: str) -> str | None:
        """Return the address of a file, None where there is none, or it lies outside of the folder."""
        path, root = (self.out / file).resolve(), self.out.resolve()
        if not (file and path.is_relative_to(root) and path.is_file()):
            return None
        return quote(path.relative_to(root).as_posix())


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("craftsim.reports", "template"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(
        breakable=_breakable,
        cell=_cell,
        css_percent=lambda share: f"{100 * share:.2f}%",
        kind=_kind,
        shell=lambda words: shlex.join(map(str, words)),
        svg=_svg,
    )
    environment.globals.update(max_cases=MAX_CASES)
    return environment


def _kind(block: Block) -> str:
    return type(block).__name__


def _cell(value: Value) -> Cell:
    return value if isinstance(value, Cell) else Cell(text_of(value))


def _breakable(text: str) -> Markup:
    """Return escaped text that may be broken after slashes."""
    return escape(text).replace("/", "/" + Markup("<wbr>"))


def _svg(drawing: Drawing) -> Markup:
    """Draw inline SVG: the same bytes for the same data, in the colours and letters of the page."""
    from matplotlib import style
    from matplotlib.figure import Figure

    with style.context([_TEMPLATES / "drawing.mplstyle", dict(drawing.style)], after_reset=True):
        # Without pyplot's global list of figures.
        figure = Figure(figsize=(drawing.width_in, drawing.height_in), layout="constrained")
        drawing.draw(figure)
        buffer = io.StringIO()
        figure.savefig(buffer, format="svg", metadata=dict.fromkeys(("Creator", "Date", "Format", "Type")))
    return _inline(buffer.getvalue(), drawing.label)


def _inline(text: str, label: str) -> Markup:
    """Return a drawing without what only a file of its own needs, coloured by the page's variables."""
    body = text[text.index("<svg") :]
    body = re.sub(r"<defs>\s*<style.*?</style>\s*</defs>", "", body, count=1, flags=re.DOTALL)
    body = re.sub(r'<g id="[^"]*"', "<g", body)
    body = re.sub(r"(?<=: )#(0[1-9])\1\1\b", lambda found: f"var(--{_VARIABLES[int(found[1]) - 1]})", body)
    return Markup(body.replace("<svg ", f'<svg role="img" aria-label="{escape(label)}" ', 1).strip())
