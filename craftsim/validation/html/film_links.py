"""Films within a page: the bytes themselves while there is room, then links to the files beside it."""

from __future__ import annotations

import base64
from collections.abc import Iterable
from pathlib import Path
from typing import Final
from urllib.parse import quote

from craftsim.validation.html.page import Case
from craftsim.validation.replays.bundle import FILM

BUDGET_BYTES: Final = 20_000_000
"""Of all films within one page, as base64: more would make it slow to open and hard to send."""


class Films:
    """The films of one page, within a budget; the first ones that fit are embedded."""

    def __init__(self, out: Path, budget_bytes: int = BUDGET_BYTES) -> None:
        """Look for films below ``out``, the page's folder."""
        self.out = out
        self.left_bytes = budget_bytes

    def beside(self, cases: Iterable[Case], filmed_only: bool = False) -> list[tuple[Case, str | None]]:
        """Return each case with the address of its bundle's film, those without one only where they are wanted.

        An address is a ``data:`` one with the film itself, or a path relative to the page.
        """
        found = [(case, self._film(case.bundle)) for case in cases]
        return [(case, film) for case, film in found if film or not filmed_only]

    def _film(self, bundle: str) -> str | None:
        """Return the address of the film in a bundle, None when there is none, or it lies outside of the folder."""
        if not bundle:
            return None
        path = (self.out / bundle / FILM).resolve()
        root = self.out.resolve()
        if not (path.is_relative_to(root) and path.is_file()):
            return None
        size = -(-path.stat().st_size // 3) * 4
        if size > self.left_bytes:
            return quote(path.relative_to(root).as_posix())
        self.left_bytes -= size
        return "data:video/mp4;base64," + base64.b64encode(path.read_bytes()).decode()
