"""Starts of episodes: worlds with what is to be built in each, in two splits that have none in common, and in files.

A digest of a start decides to which split it belongs, so that those to train from and the held-out ones are disjoint
by construction.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Final, Literal, Protocol, Self, get_args

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.files.design import Design
from craftsim.discrete.grid import FILE_DTYPES, Grid, Kind, Piece, check_grid
from craftsim.errors import InputError, suggestion
from craftsim.storage.limits import START_WORLDS, STARTS, size_text
from craftsim.storage.reading import NamedArrays, read_arrays
from craftsim.storage.writing import whole

Targets = NDArray[np.int64]
"""(..., T, 5): what is to be built, rows (kind, x, y, z, yaw); yaw -1 where it does not matter, kind 0 in rows that are
not needed."""

Split = Literal["train", "test"]
_SPLITS: Final[tuple[str, ...]] = get_args(Split)
_TEST_EVERY: Final = 8
"""One digest of so many is held out."""
_FOLDER: Final = Path(__file__).parents[1] / "data" / "splits"
_ARRAYS: Final = tuple(FILE_DTYPES)


def targets_of(design: Design | None) -> Targets:
    """Return the targets of a design, (T, 5), yaw -1 where any will do; no rows without a design."""
    rows = []
    if design:
        rows = [(target.kind, *target.cell, target.yaw) for target in design.targets]
    return np.array(rows, np.int64).reshape(-1, 5)


@dataclass(frozen=True, eq=False)
class Starts:
    """The starts of n episodes; as a sampler, a list from which starts are drawn with replacement."""

    grids: Grid
    """A batch of n worlds."""
    designs: Targets
    """(n, T, 5)."""

    @classmethod
    def of(cls, grids: Sequence[Grid], designs: Targets) -> Self:
        """Return the starts of some worlds, one or more; ``designs`` (n, T, 5), or (T, 5) for all of them."""
        return cls(
            Grid.stack(grids), np.broadcast_to(designs, (len(grids), *designs.shape[-2:])).copy()
        )

    @classmethod
    def joined(cls, parts: Sequence[Starts]) -> Self:
        """Return the starts of several batches, one after the other."""
        cells = np.concatenate([starts.grids.cells for starts in parts])
        cars = np.concatenate([starts.grids.cars for starts in parts])
        designs = np.concatenate([starts.designs for starts in parts])
        return cls(Grid(cells, cars), designs)

    def __len__(self) -> int:
        """Return how many there are."""
        return len(self.designs)

    def draw(self, rng: np.random.Generator, n: int) -> Starts:
        """Return n of them, each as likely."""
        return self.take(rng.integers(len(self), size=n))

    def take(self, rows: NDArray[np.integer]) -> Starts:
        """Return copies of some of them."""
        return Starts(self.grids[rows], self.designs[rows])

    def put(self, rows: NDArray[np.integer], starts: Starts) -> None:
        """Replace the starts ``rows`` by others, in the same order."""
        self.grids.cells[rows] = starts.grids.cells
        self.grids.cars[rows] = starts.grids.cars
        self.designs[rows] = starts.designs

    def grid(self, i: int) -> Grid:
        """Return a copy of one world."""
        return self.grids[i].copy()

    def design(self, i: int, name: str) -> Design:
        """Return what is to be built in one world."""
        rows = self.designs[i].tolist()
        targets = (Piece(Kind(kind), (x, y, z), yaw) for kind, x, y, z, yaw in rows if kind)
        return Design(Path(name), tuple(targets))

    def digests(self) -> list[bytes]:
        """Return a digest (SHA-256) of each start with its design; cars are alike, whatever their numbers."""
        digests = []
        arrays = self.grids.to_arrays()
        for kind, yaw, cars, design in zip(
            arrays["kind"], arrays["yaw"], arrays["cars"], self.designs, strict=True
        ):
            digest = hashlib.sha256(repr(kind.shape).encode())
            digest.update(kind.tobytes() + yaw.tobytes())
            digest.update(cars[np.lexsort(cars.T)].tobytes())
            digest.update(design[design[:, 0] != 0].tobytes())
            digests.append(digest.digest())
        return digests


class StartSampler(Protocol):
    """A source of the starts of a task's episodes, in place of its start files."""

    def draw(self, rng: np.random.Generator, n: int) -> Starts:
        """Return n starts; only the generator decides which."""


def belongs(digests: Sequence[bytes], split: Split) -> NDArray[np.bool_]:
    """Return (n,): which digests belong to a split; each belongs to one."""
    held_out = np.array([digest[0] % _TEST_EVERY == 0 for digest in digests], np.bool_)
    if split == "test":
        return held_out
    return ~held_out


def check_split(split: str) -> None:
    """Raise InputError for an unknown split."""
    if split not in _SPLITS:
        raise InputError(
            f"unknown split '{split}'{suggestion(split, _SPLITS)}; there are {' and '.join(_SPLITS)}"
        )


def split_name(task: str, split: Split) -> str:
    """Return the name of a task with its split, where that is not the one to train from."""
    if split == "test":
        return f"{task}@{split}"
    return task


def split_path(task: str, split: Split) -> Path:
    """Return the file of the shipped starts of a task and a split."""
    return _FOLDER / f"{task}_{split}.npz"


@cache
def read_split(task: str, split: Split) -> tuple[Starts, NDArray[np.int64]]:
    """Return the shipped starts of a task and a split, and (n,) the ticks of a plan for each, 0 where none is known."""
    arrays = read_arrays(split_path(task, split), STARTS)
    marks = dict.fromkeys(("top", "back"), np.zeros_like(arrays["kind"]))
    starts = Starts(Grid.from_arrays({**arrays, **marks}), arrays["designs"].astype(np.int64))
    starts.grids.derive_marks()
    return starts, arrays["ticks"].astype(np.int64)


def save_starts(path: Path, grids: Sequence[Grid]) -> None:
    """Write worlds of one size and number of cars into an ``.npz`` file, which is whole or as it was.

    Raises InputError if they differ, or are what :func:`load_starts` would refuse, and where the disk takes no more.
    """
    shapes = {(grid.size, grid.n_cars) for grid in grids}
    if len(shapes) != 1:
        raise InputError(
            f"{path}: starts must be of one size and number of cars, not {sorted(shapes)}"
        )
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


def _grids(path: Path, arrays: NamedArrays) -> list[Grid]:
    """Return the worlds of stacked arrays, checked; raise InputError for others."""
    shapes = {name: arrays[name].shape for name in _ARRAYS}
    cells = {shape for name, shape in shapes.items() if name != "cars"}
    if len(cells) > 1 or () in shapes.values() or len({shape[0] for shape in shapes.values()}) > 1:
        words = "one world after another, those of cells of one shape"
        raise InputError(
            f"{path}: not a file of starts: its arrays are of {shapes}; allowed: {words}"
        )
    n = len(arrays["kind"])
    n_bytes = sum(arrays[name].nbytes for name in _ARRAYS)
    if n > START_WORLDS or n_bytes > STARTS.content_bytes:
        raise InputError(
            f"{path}: {n} worlds of {size_text(n_bytes)}; allowed: at most {START_WORLDS} of "
            f"{size_text(STARTS.content_bytes)} together"
        )
    grids = []
    for i in range(n):
        try:
            grids.append(Grid.from_arrays({name: arrays[name][i] for name in _ARRAYS}))
            check_grid(grids[i])
        except InputError as error:
            raise InputError(f"{path}: world {i}: {error}") from None
    return grids
