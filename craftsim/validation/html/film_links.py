"""What lies in the bundles beside a page: films, whose bytes are in it while there is room, and trajectories."""

from __future__ import annotations

import base64
from collections.abc import Iterable
from pathlib import Path
from typing import Final
from urllib.parse import quote

from craftsim.experiments.bundle import FILM, TRAJECTORY
from craftsim.validation.html.page import Case

BUDGET_BYTES: Final = 20_000_000
"""Of all films within one page, as base64: more would make it slow to open and hard to send."""


class Films:
    """The films and trajectories of one page; the first films that fit into a budget are embedded."""

    def __init__(self, out: Path, budget_bytes: int = BUDGET_BYTES) -> None:
        """Look for them below ``out``, the page's folder."""
        self.out = out
        self.left_bytes = budget_bytes

    def beside(self, cases: Iterable[Case], filmed_only: bool = False) -> list[tuple[Case, str | None]]:
        """Return each case with the address of its bundle's film, those without one only where they are wanted.

        An address is a ``data:`` one with the film itself, or a path relative to the page.
        """
        found = [(case, self._film(case.bundle)) for case in cases]
        return [(case, film) for case, film in found if film or not filmed_only]

    def _film(self, bundle: str) -> str | None:
        """Return the address of the film in a bundle, None when there is none."""
        if (address := self._file(bundle, FILM)) is None:
            return None
        path = self.out / bundle / FILM
        size = -(-path.stat().st_size // 3) * 4
        if size > self.left_bytes:
            return address
        self.left_bytes -= size
        return "data:video/mp4;base64," + base64.b64encode(path.read_bytes()).decode()

    def trajectory(self, bundle: str) -> str | None:
        """Return the path, relative to the page, of the trajectory in a bundle, None when none was recorded."""
        return self._file(bundle, TRAJECTORY)

    def _file(self, bundle: str, name: str) -> str | None:
        """Return the address of a file in a bundle, None when there is none, or it lies outside of the folder."""
        path, root = (self.out / bundle / name).resolve(), self.out.resolve()
        if not (bundle and path.is_relative_to(root) and path.is_file()):
            return None
        return quote(path.relative_to(root).as_posix())
