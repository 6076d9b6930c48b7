"""A report as one HTML file, which needs neither server nor network."""

from __future__ import annotations

import base64
import hashlib
import io
import re
import shlex
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Final, NamedTuple
from urllib.parse import quote

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from craftsim.reports.report import Case, Drawing, Report, TableCell, Value, cell_text
from craftsim.storage.folders import output_directory
from craftsim.storage.writing import write_whole

FILE_NAME: Final = "report.html"
MAX_CASES: Final = 24
"""Maximum number of failures that a page or a group shows as cards."""
BUDGET_BYTES: Final = 20_000_000
"""Total size of embedded films and recordings as base64; a larger page is slow to open."""
_POSTER_PIXELS: Final = (640, 640)
"""Largest width and height of a poster."""

_VARIABLES: Final = ("ink", "soft", "line", "paper", "good", "caution", "bad", "accent", "muted")
"""CSS variables of the colours, in the order of the placeholders in :mod:`craftsim.reports.plots`."""
_TEMPLATES: Final = Path(__file__).with_name("template")
_PLAYER: Final = _TEMPLATES / "player"
_SCRIPTS: Final = (
    "geometry.js",
    "recording.js",
    "scene.js",
    "controls.js",
    "player.js",
    "cards.js",
)
"""Of the player, each after those that it imports from."""
_IMPORT_OR_EXPORT: Final = re.compile(r"^import [^;]*;\n|^export ", re.MULTILINE)


def write_html(out: Path, report: Report) -> Path:
    """Write a report as ``report.html`` atomically into the directory ``out``, created if missing, and return its path.

    Styles, drawings, films and recordings are embedded; films that exceed :data:`BUDGET_BYTES` are linked by relative
    paths. Equal reports with equal films give equal files. All text is escaped. A content security policy prevents
    requests, and all scripts but the player of recordings, which a page without recordings has not. Raises InputError
    if the directory cannot be written to.
    """
    path = output_directory(out) / FILE_NAME
    template = _environment().get_template("report.html.j2")
    files = _Files(out)
    # Once without the player, to see whether there is anything to play.
    page = template.render(report=report, files=files, player=None)
    if files.has_recordings:
        player = _player()
        page = template.render(report=report, files=_Files(out), player=player)
    return write_whole(path, page)


class _Card(NamedTuple):
    """A case to show, with what it has: addresses of its film, its poster and its trajectory, and its recording."""

    case: Case
    film: str | None
    poster: str | None
    trajectory: str | None
    recording: str | None
    """As base64."""


class _Files:
    """The files of a page; the first films within a budget are embedded."""

    def __init__(self, out: Path) -> None:
        self.out = out
        self.remaining_bytes = BUDGET_BYTES
        self.has_recordings = False

    def cards(self, cases: Iterable[Case], unfilmed: int | None) -> list[_Card]:
        """Return the cases to show."""
        cards = []
        for number, case in enumerate(cases):
            film = self._film(case.film)
            if film or unfilmed is None or number < unfilmed:
                poster = None
                if film is not None and film.startswith("data:"):
                    poster = _poster(self.out / case.film)
                recording = self._recording(case)
                cards.append(_Card(case, film, poster, self.link(case.trajectory), recording))
        return cards

    def _recording(self, case: Case) -> str | None:
        """Return the recording of a case as base64, None for none and for one beyond the budget."""
        if self.link(case.recording) is None:
            return None
        text = self._within_budget(self.out / case.recording)
        if text is not None:
            self.has_recordings = True
        return text

    def _film(self, file: str) -> str | None:
        address = self.link(file)
        if address is None:
            return None
        text = self._within_budget(self.out / file)
        if text is None:
            return address
        return f"data:video/mp4;base64,{text}"

    def _within_budget(self, path: Path) -> str | None:
        """Return a file as base64, None for one beyond the budget."""
        size = -(-path.stat().st_size // 3) * 4
        if size > self.remaining_bytes:
            return None
        self.remaining_bytes -= size
        return base64.b64encode(path.read_bytes()).decode()

    def link(self, file: str) -> str | None:
        """Return the address of a file; None if it does not exist or is outside of the folder."""
        if not file:
            return None
        path = (self.out / file).resolve()
        root = self.out.resolve()
        if not (path.is_relative_to(root) and path.is_file()):
            return None
        return quote(path.relative_to(root).as_posix())


def _poster(film: Path) -> str | None:
    """Return the first frame of a film as the address of a picture, which phones show before they play it."""
    import av  # a tenth of a second that only pages with films take

    try:
        with av.open(str(film)) as container:
            frame = next(container.decode(video=0))
    except (av.error.FFmpegError, StopIteration):
        return None
    image = frame.to_image()
    image.thumbnail(_POSTER_PIXELS)
    buffer = io.BytesIO()
    image.save(buffer, "JPEG", quality=70)
    return "data:image/jpeg;base64," + base64.b64encode(buffer.getvalue()).decode()


@cache
def _player() -> dict[str, Markup]:
    """Return the player's style, its script in one piece, and the digest by which a browser knows that script."""
    texts = [(_PLAYER / name).read_text(encoding="utf-8") for name in _SCRIPTS]
    script = _IMPORT_OR_EXPORT.sub("", "\n".join(["", *texts]))
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    style = (_PLAYER / "player.css").read_text(encoding="utf-8")
    return {"style": Markup(style), "script": Markup(script), "digest": Markup(digest)}


@cache
def _environment() -> Environment:
    loader = PackageLoader("craftsim.reports", "template")
    environment = Environment(loader=loader, autoescape=True, undefined=StrictUndefined)
    environment.trim_blocks = True
    environment.lstrip_blocks = True
    environment.filters.update(
        # Line breaks are allowed after slashes.
        breakable=lambda text: escape(text).replace("/", "/" + Markup("<wbr>")),
        cell=_cell,
        css_percent=lambda share: f"{100 * share:.2f}%",
        kind=lambda block: type(block).__name__,
        shell=lambda words: shlex.join(map(str, words)),
        svg=_svg,
    )
    environment.globals.update(max_cases=MAX_CASES)
    return environment


def _cell(value: Value) -> TableCell:
    if isinstance(value, TableCell):
        return value
    return TableCell(cell_text(value))


def _svg(drawing: Drawing) -> Markup:
    """Return reproducible inline SVG in the colours and fonts of the page."""
    from matplotlib import style
    from matplotlib.figure import Figure

    with style.context(_TEMPLATES / "drawing.mplstyle", after_reset=True):
        # Not through pyplot, which keeps a global list of figures.
        figure = Figure(figsize=(drawing.width_in, drawing.height_in), layout="constrained")
        drawing.draw(figure)
        buffer = io.StringIO()
        figure.savefig(
            buffer, format="svg", metadata=dict.fromkeys(("Creator", "Date", "Format", "Type"))
        )
    return _inline(buffer.getvalue(), drawing.label)


def _inline(text: str, label: str) -> Markup:
    """Return an SVG document as an inline element with the page's CSS variables as colours."""
    body = text[text.index("<svg") :]
    body = re.sub(r"<defs>\s*<style.*?</style>\s*</defs>", "", body, count=1, flags=re.DOTALL)
    body = re.sub(r'<g id="[^"]*"', "<g", body)
    body = re.sub(
        r"(?<=: )#(0[1-9])\1\1\b", lambda match: f"var(--{_VARIABLES[int(match[1]) - 1]})", body
    )
    return Markup(
        body.replace("<svg ", f'<svg role="img" aria-label="{escape(label)}" ', 1).strip()
    )
