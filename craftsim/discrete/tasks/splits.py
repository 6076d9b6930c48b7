"""Starts to train from and held-out ones, disjoint by construction: a digest of a start decides to which it belongs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Final, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.grid import Grid
from craftsim.discrete.tasks.batches import Starts
from craftsim.errors import InputError, suggestion
from craftsim.storage.limits import STARTS
from craftsim.storage.reading import read_arrays
from craftsim.storage.writing import whole

Split = Literal["train", "test"]
SPLITS: Final[tuple[str, ...]] = get_args(Split)
_TEST_EVERY: Final = 8
"""One digest of so many is held out."""
_FOLDER: Final = Path(__file__).parents[2] / "data" / "splits"


def belongs(digests: Sequence[bytes], split: Split) -> NDArray[np.bool_]:
    """Return (n,): which digests belong to a split; each belongs to one."""
    held_out = np.array([digest[0] % _TEST_EVERY == 0 for digest in digests], np.bool_)
    return held_out if split == "test" else ~held_out


def check_split(split: str) -> None:
    """Raise InputError for what is no split."""
    if split not in SPLITS:
        raise InputError(
            f"unknown split '{split}'{suggestion(split, SPLITS)}; there are {' and '.join(SPLITS)}"
        )


@dataclass(frozen=True)
class Stored:
    """The shipped starts of a task and a split, drawn from with replacement."""

    task: str
    split: Split

    @property
    def starts(self) -> Starts:
        """All of them."""
        return read_split(self.task, self.split)[0]

    @property
    def ticks(self) -> NDArray[np.int64]:
        """(n,): of a plan that the planner has found for each; 0 where none was asked for."""
        return read_split(self.task, self.split)[1]

    def draw(self, rng: np.random.Generator, n: int) -> Starts:
        """Return n of them."""
        return self.starts.take(rng.integers(len(self.starts), size=n))


def split_path(task: str, split: Split) -> Path:
    """Return the file of the shipped starts of a task and a split."""
    return _FOLDER / f"{task}_{split}.npz"


@cache
def read_split(task: str, split: Split) -> tuple[Starts, NDArray[np.int64]]:
    """Return the shipped starts of a task and a split, and the ticks of a plan for each."""
    arrays = read_arrays(split_path(task, split), STARTS)
    marks = dict.fromkeys(("top", "back"), np.zeros_like(arrays["kind"]))
    starts = Starts(Grid.from_arrays({**arrays, **marks}), arrays["designs"].astype(np.int64))
    starts.grids.derive_marks()
    return starts, arrays["ticks"].astype(np.int64)


def write_split(task: str, split: Split, starts: Starts, ticks: NDArray[np.integer]) -> Path:
    """Write the starts that are shipped with a task and a split; return the file."""
    path = split_path(task, split)
    path.parent.mkdir(exist_ok=True)
    known = starts.grids.to_arrays() | {"designs": starts.designs}
    arrays = {name: known[name].astype(np.int8) for name in ("kind", "yaw", "cars", "designs")}
    with whole(path) as partial, partial.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **arrays, ticks=ticks.astype(np.int16))
    return path
