"""Mutated recordings and files of starts, read as ``conformance`` and ``train --starts`` read them."""

import gzip
import io
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np

from craftsim.discrete.conformance import Checker, read_records
from craftsim.discrete.grid import Grid
from craftsim.discrete.rules import Rules
from craftsim.discrete.tasks import make_task
from craftsim.discrete.tasks.starts import load_starts
from fuzzing.mutations import mutated_bytes, mutated_json

DATA = Path(__file__).parents[1] / "data"
NUMBERS = (-32768, -3, -1, 2, 4, 7, 9, 99, 127)


@cache
def _lines() -> tuple[bytes, ...]:
    every = b"".join(
        gzip.decompress((DATA / f"{name}.jsonl.gz").read_bytes()) for name in ("traces", "plans")
    )
    return tuple(every.splitlines(keepends=True)[::40])


def recording(rng: np.random.Generator, folder: Path) -> None:
    """Attack a recording: its packing, its text or one of its values."""
    line = _lines()[int(rng.integers(len(_lines())))]
    packed = rng.random() < 0.2
    data = gzip.compress(line if packed else mutated_json(line, rng), 1)
    path = folder / "recording.jsonl.gz"
    path.write_bytes(mutated_bytes(data, rng) if packed else data)
    checker = Checker(Rules("published"))
    for number, record in read_records(path):
        checker.check(number, record)


@cache
def _starts() -> dict[str, np.ndarray]:
    grid = make_task("strip").draw(np.random.default_rng(0))
    return Grid.stack([grid] * 2).to_arrays()


def starts(rng: np.random.Generator, folder: Path) -> None:
    """Attack a file of starts: its bytes, the shape or type of an array, or a number in one."""
    path = folder / "starts.npz"
    arrays = dict(_starts())
    name = list(arrays)[int(rng.integers(len(arrays)))]
    array = arrays[name].copy()
    kind = int(rng.integers(5))
    if kind == 1:
        array = array.reshape(-1)[: int(rng.integers(array.size))]
    elif kind == 2:
        array = array.astype(rng.choice(["int8", "int64", "float64", ">i4"]))
    elif kind > 2:
        value = np.array(NUMBERS[int(rng.integers(len(NUMBERS)))])
        array.reshape(-1)[int(rng.integers(array.size))] = value.astype(array.dtype)
    arrays[name] = array
    file = io.BytesIO()
    np.savez(file, **arrays)
    path.write_bytes(file.getvalue() if kind else mutated_bytes(file.getvalue(), rng))
    make_task_once().starting_from(load_starts(path))


@cache
def make_task_once():
    """Return the task whose starts are attacked."""
    return make_task("strip")


TARGETS: dict[str, Callable[[np.random.Generator, Path], None]] = {"recording": recording, "starts": starts}
