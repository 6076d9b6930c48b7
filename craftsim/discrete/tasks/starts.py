"""Worlds that were reached once, kept in a file, as the starts of later episodes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from craftsim.discrete.grid import FILE_DTYPES, CarField, Grid, Kind, beside
from craftsim.discrete.grid_checks import check_grid
from craftsim.discrete.tasks.task import Task
from craftsim.errors import InputError
from craftsim.storage.limits import START_WORLDS, STARTS, size_text
from craftsim.storage.reading import Arrays, read_arrays
from craftsim.storage.writing import whole

_ARRAYS: Final = tuple(FILE_DTYPES)


def save_starts(path: Path, grids: Sequence[Grid]) -> None:
    """Write worlds of one size and number of cars into an ``.npz`` file, which is whole or as it was.

    Raises InputError if they differ, or are what :func:`load_starts` would refuse, and where the disk takes no more.
    """
    shapes = {(grid.size, grid.n_cars) for grid in grids}
    if len(shapes) != 1:
        raise InputError(f"{path}: starts must be of one size and number of cars, not {sorted(shapes)}")
    arrays = Grid.stack(grids).to_arrays()
    _grids(path, arrays)
    with whole(path) as partial, partial.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **arrays)


def load_starts(path: Path) -> list[Grid]:
    """Return the worlds of a file that :func:`save_starts` wrote; raises InputError for any other."""
    arrays = read_arrays(path, STARTS)
    missing = [name for name in _ARRAYS if name not in arrays]
    if missing:
        raise InputError(
            f"{path}: not a file of starts: it has no array '{missing[0]}'; write one with save_starts"
        )
    return _grids(path, arrays)


def _grids(path: Path, arrays: Arrays) -> list[Grid]:
    """Return the worlds of stacked arrays, checked; raise InputError for others."""
    shapes = {name: arrays[name].shape for name in _ARRAYS}
    counts = {shape[:1] for shape in shapes.values()}
    if len(counts) > 1 or counts == {()}:
        raise InputError(
            f"{path}: not a file of starts: its arrays are of {shapes}, and not one world after another"
        )
    n = len(arrays["kind"])
    n_bytes = sum(arrays[name].nbytes for name in _ARRAYS)
    if n > START_WORLDS or n_bytes > STARTS.content_bytes:
        raise InputError(
            f"{path}: {n} worlds of {size_text(n_bytes)}; allowed: at most {START_WORLDS} of "
            f"{size_text(STARTS.content_bytes)} together"
        )
    if len({shapes[name] for name in ("kind", "yaw", "top", "back")}) > 1:
        raise InputError(
            f"{path}: not a file of starts: its arrays are of {shapes}; those of cells must agree"
        )
    grids = []
    for i in range(n):
        try:
            grid = Grid.from_arrays({name: arrays[name][i] for name in _ARRAYS})
            check_grid(grid)
        except InputError as error:
            raise InputError(f"{path}: world {i}: {error}") from None
        grids.append(grid)
    return grids


def check_start(task: Task, grid: Grid) -> None:
    """Raise InputError for a world that cannot be a start of a task: another size, other things than it observes."""
    check_grid(grid)
    first, layout = task.starts[0], task.layout
    if (grid.size, grid.n_cars) != (first.size, first.n_cars):
        raise InputError(
            f"the start has size {grid.size} and {grid.n_cars} cars; task '{task.name}' has {first.size} and "
            f"{first.n_cars}"
        )
    things = [*grid.kind.ravel().tolist(), *grid.cars[:, CarField.LOAD].tolist()]
    slopes = things.count(Kind.FSLOPE) + things.count(Kind.BODY) + _lone_feet(grid)
    for what, count, most in (
        ("blocks", things.count(Kind.BLOCK), layout.n_blocks),
        ("slopes", slopes, layout.n_slopes),
    ):
        if count > most:
            raise InputError(f"the start has {count} {what}; task '{task.name}' observes at most {most}")


def _lone_feet(grid: Grid) -> int:
    """Return the number of feet whose slope has no body: each takes a row of observations as a whole slope does."""
    feet = [(int(x), int(y), int(z)) for x, y, z in np.argwhere(grid.kind == Kind.FOOT)]
    bodies = set()
    for x, y, z in np.argwhere(grid.kind == Kind.BODY):
        cell = int(x), int(y), int(z)
        bodies.add((beside(cell, int(grid.yaw[cell])), int(grid.yaw[cell])))
    return sum((cell, int(grid.yaw[cell])) not in bodies for cell in feet)


@dataclass(frozen=True)
class StoredStarts(Task):
    """A task whose episodes start with worlds drawn from a list instead of its start files."""

    grids: tuple[Grid, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.grids:
            raise InputError(f"task '{self.name}' needs at least one stored start")
        # One world may stand in the list many times.
        for grid in {id(grid): grid for grid in self.grids}.values():
            check_start(self, grid)

    def draw(self, rng: np.random.Generator) -> Grid:
        """Return a copy of one of the worlds."""
        return self.grids[int(rng.integers(len(self.grids)))].copy()

    @property
    def always_starts_the_same(self) -> bool:
        """Whether every episode starts with the same world."""
        return False


def starting_from(task: Task, grids: Sequence[Grid]) -> Task:
    """Return the task with the given worlds as its starts; raises InputError for one that does not fit it."""
    return StoredStarts(**task.parts, grids=tuple(grids))
