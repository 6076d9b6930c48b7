"""A film of a whole episode, with what each car does in the caption."""

from __future__ import annotations

from pathlib import Path
from types import TracebackType
from typing import Self

from craftsim.checking.checked_site import CheckedSite
from craftsim.discrete.rules.table import ACTIONS
from craftsim.discrete.schedule import ScheduledAction
from craftsim.models.site import Site
from craftsim.rendering.film import Film


class EpisodeFilm:
    """Context manager that films the episode whose world :meth:`begin` is given."""

    def __init__(
        self,
        path: Path,
        title: str = "",
        size: tuple[int, int] = (1280, 720),
        speed: float = 3.0,
        camera: str = "overview",
    ) -> None:
        """Prepare a film.

        Args:
            path: the MP4 file; its folder must exist.
            title: first line of the caption; none if empty.
            size: width and height in pixels, both even.
            speed: simulated seconds in a second of film.
            camera: of the world.
        """
        self.path, self._title = path, title
        self._size, self._speed, self._camera = size, speed, camera
        self._running: dict[int, ScheduledAction] = {}
        self._film: Film | None = None

    @property
    def frames(self) -> int:
        """Frames written so far."""
        return self._film.frames if self._film is not None else 0

    def begin(self, checked: CheckedSite) -> None:
        """Film a world from now on, at the control period."""
        model = checked.site.model
        self._film = Film(self.path, model, self._camera, size=self._size, speed=self._speed)
        self._film.__enter__()
        self._n_cars = len(checked.site.cars)
        checked.on_change = self._change
        checked.executor.observers.append(self._look)
        self._look(checked.site)

    def _change(self, running: dict[int, ScheduledAction]) -> None:
        self._running = running

    def _look(self, site: Site) -> None:
        if self._film is not None and self._film.due(site.time_s):
            self._film.capture(site.data, [*([self._title] if self._title else []), *self._captions()])

    def _captions(self) -> list[str]:
        """Return what each car does, two cars a line: more lines would hide the building."""
        words = [
            f"car {car}: {ACTIONS[self._running[car].action].words}"
            if car in self._running
            else f"car {car}: waits"
            for car in range(self._n_cars)
        ]
        return ["   ".join(words[i : i + 2]) for i in range(0, self._n_cars, 2)]

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._film is not None:
            self._film.__exit__(kind, error, trace)
