"""Worlds that were reached once, kept in a file, as the starts of later episodes."""

from __future__ import annotations

import zipfile
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Final

import numpy as np

from craftsim.discrete.grid import CarField, Grid, Kind
from craftsim.discrete.tasks.task import Task
from craftsim.errors import InputError

_ARRAYS: Final = tuple(field.name for field in fields(Grid))


def save_starts(path: Path, grids: Sequence[Grid]) -> None:
    """Write worlds of one size and number of cars into an ``.npz`` file; raises InputError if they differ."""
    shapes = {(grid.size, grid.n_cars) for grid in grids}
    if len(shapes) != 1:
        raise InputError(f"{path}: starts must be of one size and number of cars, not {sorted(shapes)}")
    arrays = {name: np.stack([getattr(grid, name) for grid in grids]) for name in _ARRAYS}
    with open(path, "wb") as file:
        np.savez_compressed(file, allow_pickle=False, **arrays)


def load_starts(path: Path) -> list[Grid]:
    """Return the worlds of a file that :func:`save_starts` wrote; raises InputError for any other."""
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in _ARRAYS}
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error
    except (KeyError, ValueError, EOFError, zipfile.BadZipFile) as error:
        raise InputError(f"{path}: not a file of starts ({error}); write one with save_starts") from error
    return [Grid(*(arrays[name][i] for name in _ARRAYS)) for i in range(len(arrays["kind"]))]


def check_start(task: Task, grid: Grid) -> None:
    """Raise InputError for a world that cannot be a start of a task: another size, other things than it observes."""
    first, layout = task.starts[0], task.layout
    if (grid.size, grid.n_cars) != (first.size, first.n_cars):
        raise InputError(
            f"the start has size {grid.size} and {grid.n_cars} cars; task '{task.name}' has {first.size} and "
            f"{first.n_cars}"
        )
    for car, cell in enumerate(grid.cars[:, : CarField.Z + 1].tolist()):
        # A car may stand above the highest cell; compiled rules would read past their arrays elsewhere.
        if not (
            0 <= cell[0] < first.size[0]
            and 0 <= cell[1] < first.size[1]
            and 1 <= cell[2] <= first.size[2] + 1
        ):
            raise InputError(
                f"car {car} of the start is at {tuple(cell)}, outside the map of size {first.size}"
            )
    things = [*grid.kind.ravel().tolist(), *grid.cars[:, CarField.LOAD].tolist()]
    for what, count, most in (
        ("blocks", things.count(Kind.BLOCK), layout.n_blocks),
        ("slopes", things.count(Kind.FSLOPE) + things.count(Kind.BODY), layout.n_slopes),
    ):
        if count > most:
            raise InputError(f"the start has {count} {what}; task '{task.name}' observes at most {most}")


@dataclass(frozen=True)
class StoredStarts(Task):
    """A task whose episodes start with worlds drawn from a list instead of its start files."""

    grids: tuple[Grid, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.grids:
            raise InputError(f"task '{self.name}' needs at least one stored start")
        for grid in self.grids:
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
    known = {field.name: getattr(task, field.name) for field in fields(Task)}
    return StoredStarts(**known, grids=tuple(grids))
