"""Mutated recordings and files of starts, read as ``conformance`` and ``train --starts`` read them."""

import gzip
import io
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np

from craftsim.discrete.records.traces import read_records, recorded_grid
from craftsim.discrete.tasks import make_task
from craftsim.discrete.tasks.starts import load_starts, starting_from
from craftsim.errors import InputError

DATA = Path(__file__).parents[1] / "data"
VALUES = (
    b"-1",
    b"0",
    b"99",
    b"1e400",
    b"NaN",
    b"null",
    b"[]",
    b"{}",
    b'"x"',
    b"9" * 5000,
    b"[" * 300,
    b"true",
)
NUMBERS = (-32768, -3, -1, 2, 4, 7, 9, 99, 127)


def mutated(rng: np.random.Generator, data: bytes) -> bytes:
    """Return bytes that are cut, flipped, swapped, or have something put in."""
    place, end = sorted(int(n) for n in rng.integers(0, len(data) + 1, 2))
    match int(rng.integers(5)):
        case 0:
            return data[:place]
        case 1:
            return data[:place] + bytes([int(rng.integers(256))]) + data[place + 1 :]
        case 2:
            return data[:place] + data[place : place + 40] * 2 + data[place + 40 :]
        case 3:
            return data[:place] + data[min(end, place + 20) :]
    return data[:place] + rng.bytes(4) + data[place:]


@cache
def _lines() -> tuple[bytes, ...]:
    every = b"".join(
        gzip.decompress((DATA / f"{name}.jsonl.gz").read_bytes()) for name in ("traces", "plans")
    )
    return tuple(every.splitlines(keepends=True)[::40])


def _other_value(rng: np.random.Generator, line: bytes) -> bytes:
    """Return a line with another value in place of one of its numbers."""
    places = [place for place, byte in enumerate(line) if 48 <= byte <= 57]
    place = places[int(rng.integers(len(places)))]
    return line[:place] + VALUES[int(rng.integers(len(VALUES)))] + line[place + 1 :]


def recording(rng: np.random.Generator, folder: Path) -> None:
    """Attack a recording: its packing, its text or one of its values."""
    line = _lines()[int(rng.integers(len(_lines())))]
    kind = int(rng.integers(4))
    if kind:
        line = (_other_value if kind > 1 else mutated)(rng, line)
    data = gzip.compress(line, 1)
    path = folder / "recording.jsonl.gz"
    path.write_bytes(data if kind else mutated(rng, data))
    try:
        for _, record in read_records(path):
            for state in ("before", "after"):
                if state in record:
                    recorded_grid(record["size"], record[state])
    except InputError:
        return


@cache
def _starts() -> dict[str, np.ndarray]:
    grid = make_task("strip").draw(np.random.default_rng(0))
    names = ("kind", "yaw", "cars", "top", "back")
    return {name: np.stack([getattr(grid, name)] * 2) for name in names}


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
    path.write_bytes(file.getvalue() if kind else mutated(rng, file.getvalue()))
    try:
        starting_from(make_task_once(), load_starts(path))
    except InputError:
        return


@cache
def make_task_once():
    """Return the task whose starts are attacked."""
    return make_task("strip")


TARGETS: dict[str, Callable[[np.random.Generator, Path], None]] = {"recording": recording, "starts": starts}


def attack(rng: np.random.Generator, folder: Path) -> None:
    """Make one mutated case of any of the formats and read it."""
    list(TARGETS.values())[int(rng.integers(len(TARGETS)))](rng, folder)
