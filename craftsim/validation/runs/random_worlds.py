"""Random worlds to validate in: level ground with scattered blocks, ramps with their landings, and cars."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from craftsim.discrete.errors import InputError
from craftsim.discrete.files.blueprint import parse_blueprint
from craftsim.discrete.files.saving import blueprint_text
from craftsim.discrete.geometry import DIRECTIONS
from craftsim.discrete.grid import CarField, Cell, Grid, Kind
from craftsim.discrete.tasks import Task, free_play


@dataclass(frozen=True)
class RandomWorlds:
    """A family of worlds, one drawn for every seed. Raises InputError for figures that do not fit."""

    n_cars: int = 4
    n_blocks: int = 10
    n_slopes: int = 2
    size: Cell = (6, 6, 4)
    max_steps: int = 73
    """An episode has two ticks more (docs/rules.md#episode-length)."""

    def __post_init__(self) -> None:
        length, width, _ = self.size
        room = length * width - 3 * self.n_slopes
        if not 1 <= self.n_cars <= 12 or self.n_blocks < 0 or self.n_cars + self.n_blocks > room:
            raise InputError(
                f"{self.n_cars} cars and {self.n_blocks} blocks; allowed: 1 to 12 cars, and no more than {room} of "
                f"both together on {length} x {width} cells with {self.n_slopes} slopes"
            )
        if self.max_steps < 1:
            raise InputError(f"max_steps is {self.max_steps}; allowed: 1 or more")

    def task(self, rng: np.random.Generator) -> Task:
        """Return a task without a goal that always starts in the world that a generator draws."""
        blueprint = parse_blueprint(blueprint_text(self.grid(rng)), "random")
        return free_play("random", (blueprint,), self.max_steps)

    def grid(self, rng: np.random.Generator) -> Grid:
        """Return the world that a generator draws."""
        grid = Grid.empty(self.size, self.n_cars)
        length, width, _ = self.size
        cells = [(int(i) // width, int(i) % width) for i in rng.permutation(length * width)]
        used: set[tuple[int, int]] = set()
        placed = 0
        for x, y in cells:
            yaw = int(rng.integers(4))
            dx, dy = (int(v) for v in DIRECTIONS[yaw])
            three = {(x, y), (x + dx, y + dy), (x - dx, y - dy)}
            if placed == self.n_slopes or three & used or not three <= set(cells):
                continue
            folded = bool(rng.integers(2))
            grid.kind[x, y, 1] = Kind.FSLOPE if folded else Kind.BODY
            grid.kind[x + dx, y + dy, 1] = Kind.GEAR if folded else Kind.FOOT
            grid.yaw[x, y, 1] = grid.yaw[x + dx, y + dy, 1] = yaw
            grid.kind[x - dx, y - dy, 1] = Kind.BLOCK
            used |= three
            placed += 1
        free = [cell for cell in cells if cell not in used]
        for car in range(self.n_cars):
            grid.cars[car, [CarField.X, CarField.Y]] = free[car]
            grid.cars[car, CarField.YAW] = int(rng.integers(4))
        for x, y in free[self.n_cars : self.n_cars + self.n_blocks]:
            grid.kind[x, y, 1] = Kind.BLOCK
        grid.derive_marks()
        return grid
