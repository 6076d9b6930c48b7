"""The backend that follows the rules: nothing fails, and time is looked up."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.files.design import Design
from craftsim.discrete.grid import Cell, Grid
from craftsim.discrete.schedule import car_durations
from craftsim.discrete.tasks.episodes import Episodes
from craftsim.envs.backend import Tick


class GridBackend:
    """A grid world under the rules."""

    def start(self, grid: Grid, rng: np.random.Generator, design: Design | None = None) -> Grid:
        """Begin an episode; there is nothing to draw."""
        return grid

    def tick(self, episodes: Episodes, actions: NDArray[np.int64], order: NDArray[np.int64]) -> Tick:
        """Let all cars act by the rules."""
        before = episodes.grids.cars[0].copy()
        applied = episodes.act(actions[None], order[None])[0]
        seconds = car_durations(before, episodes.grids.cars[0], actions, applied)
        return Tick(applied, float(seconds.max(initial=0.0)), durations_s=tuple(seconds.tolist()))

    def images(self) -> dict[str, NDArray[Any]]:
        """Return nothing: there are no cameras."""
        return {}

    def picture(self, grid: Grid, goal: Cell | None) -> NDArray[np.uint8]:
        """Return the levels of the world side by side."""
        from craftsim.rendering.world_image import world_image

        return world_image(grid, goal)

    def pictures(self, grid: Grid, goal: Cell | None) -> list[NDArray[np.uint8]]:
        """Return the one picture of a tick: there is no motion between two."""
        return [self.picture(grid, goal)]

    def show(self, grid: Grid, goal: Cell | None) -> None:
        """Print the world as coloured text."""
        from rich.console import Console

        from craftsim.discrete.drawing import world_text

        Console(highlight=False).print(world_text(grid, goal))

    def close(self) -> None:
        """Hold nothing."""
