"""What a backend is: how a tick of all cars happens, and what it reports."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.files.design import Design
from craftsim.discrete.grid import Cell, Grid
from craftsim.discrete.tasks.episodes import Episodes

if TYPE_CHECKING:
    from craftsim.checking.attempt import Attempt

MOTION_FPS: Final = 10
"""Pictures a simulated second of the motion between two ticks (``rgb_array_list`` in physics)."""


@dataclass(frozen=True)
class Tick:
    """The result of a tick."""

    applied: NDArray[np.bool_]
    """(n,): by car, whether the rules allowed what it was to do when its turn came."""
    duration_s: float
    """Simulated time."""
    problems: tuple[str, ...] = ()
    """Why the world cannot be read as a grid any more, in words; empty when it can."""
    of_car: tuple[dict[str, Any], ...] = field(default=())
    """By car: further entries of its info; empty when there are none."""
    durations_s: tuple[float, ...] = ()
    """By car: how long its action took."""
    attempts: tuple[Attempt | None, ...] = ()
    """By car: what the judge found; empty on the grid."""
    contacts: tuple[Any, ...] | None = None
    """What touched what; None where that is not logged."""


class Backend(Protocol):
    """One world in which ticks happen.

    What is seen of it is kept in a batch of one of :class:`Episodes`, together with what the action helper has queued.
    """

    def start(self, grid: Grid, rng: np.random.Generator, design: Design | None = None) -> Grid:
        """Begin an episode as a grid says and return the world as it is seen; ``rng`` draws what is imperfect.

        ``design`` is given where each episode has its own: it is marked for people, and changes nothing else.
        """

    def tick(self, episodes: Episodes, actions: NDArray[np.int64], order: NDArray[np.int64]) -> Tick:
        """Let all cars act, ``actions`` (n,) by car in the ``order`` (n,), and bring what is seen up to date."""

    def images(self) -> dict[str, NDArray[Any]]:
        """Return what cameras see now, by kind of image, of each camera; empty where no images are observed."""

    def picture(self, grid: Grid, goal: Cell | None) -> NDArray[np.uint8]:
        """Return the world as a picture, shape (height, width, 3)."""

    def pictures(self, grid: Grid, goal: Cell | None) -> list[NDArray[np.uint8]]:
        """Return pictures of what has happened since the last call, the latest last; one or more."""

    def show(self, grid: Grid, goal: Cell | None) -> None:
        """Show the world to a person."""

    def close(self) -> None:
        """Release what is held."""
