"""Mutated policy and run files, read as ``validate --policy`` and ``train --resume`` read them."""

import io
import tempfile
import zipfile
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import torch
from training_files import read_content, write_content

from craftsim.training.checkpoint import POLICY_FILE, RUN_FILE, read_policy
from craftsim.training.config import TrainConfig
from craftsim.training.trainer import Trainer

CONFIG = TrainConfig("strip", "ippo", worlds=1, width=4)
VALUES = (
    *(None, -1, 0, 1, 10**6, 2**70, 1e30, float("nan"), float("inf"), "", "x" * 100, "\ud800", True),
    *([], {}, (), [1], {"a": 1}, {1: 2}, [[]]),
    *(torch.zeros(0), torch.zeros(1), torch.full((2, 4), torch.nan), torch.zeros(3, dtype=torch.int64)),
)


@cache
def _saved() -> dict[str, bytes]:
    with tempfile.TemporaryDirectory() as folder:
        trainer = Trainer(CONFIG)
        next(trainer.run(trainer.steps_an_iteration, until=2.0))
        trainer.save(Path(folder))
        return {name: (Path(folder) / name).read_bytes() for name in (POLICY_FILE, RUN_FILE)}


def _paths(value: object, path: tuple = ()) -> list[tuple]:
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [path, *(found for key, item in items for found in _paths(item, (*path, key)))]


@cache
def _places(name: str) -> list[tuple]:
    return _paths(_content(name))[1:]


@cache
def _folder() -> tempfile.TemporaryDirectory:
    folder = tempfile.TemporaryDirectory()
    for name, data in _saved().items():
        (Path(folder.name) / name).write_bytes(data)
    return folder


def _content(name: str):
    return read_content(Path(_folder().name) / name)


def _other_value(rng: np.random.Generator, name: str) -> bytes:
    content = _content(name)
    *way, last = _places(name)[int(rng.integers(len(_places(name))))]
    inner = content
    for key in way:
        inner = inner[key]
    match int(rng.integers(4)):
        case 0:
            del inner[last]
        case 1 if isinstance(inner[last], torch.Tensor) and inner[last].numel():
            inner[last] = inner[last].clone()
            inner[last].reshape(-1)[int(rng.integers(inner[last].numel()))] = int(
                rng.integers(-(2**30), 2**30)
            )
        case 2 if isinstance(inner[last], torch.Tensor):
            inner[last] = inner[last].reshape(-1)[:-1]
        case _:
            inner[last] = VALUES[int(rng.integers(len(VALUES)))]
    try:
        changed = Path(_folder().name) / f"changed-{name}"
        write_content(changed, content)
    except (AttributeError, KeyError, TypeError, ValueError, RuntimeError):  # safetensors holds tensors alone
        return _saved()[name][:-1]
    return changed.read_bytes()


def _other_contents(rng: np.random.Generator, data: bytes) -> bytes:
    """Return a file with bytes of its table of contents changed; an archive has right sums."""
    if not data.startswith(b"PK"):
        content = bytearray(data)
        for _ in range(int(rng.integers(1, 4))):
            content[int(rng.integers(8 + int.from_bytes(data[:8], "little")))] = int(rng.integers(256))
        return bytes(content)
    file = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as old, zipfile.ZipFile(file, "w") as new:
        for member in old.infolist():
            content = bytearray(old.read(member))
            if member.filename.endswith("data.pkl"):
                for _ in range(int(rng.integers(1, 4))):
                    content[int(rng.integers(len(content)))] = int(rng.integers(256))
            new.writestr(member.filename, bytes(content))
    return file.getvalue()


def _damaged(rng: np.random.Generator, name: str) -> bytes:
    data = _saved()[name]
    match int(rng.integers(4)):
        case 0:
            return data[: int(rng.integers(len(data)))]
        case 1:
            place = int(rng.integers(len(data)))
            return data[:place] + rng.bytes(4) + data[place + 4 :]
        case 2:
            return _other_contents(rng, data)
    return _other_value(rng, name)


def policy(rng: np.random.Generator, folder: Path) -> None:
    """Attack a policy file."""
    (folder / POLICY_FILE).write_bytes(_damaged(rng, POLICY_FILE))
    read_policy(folder / POLICY_FILE)


@cache
def _task():
    return Trainer(CONFIG).task


def run(rng: np.random.Generator, folder: Path) -> None:
    """Attack a run file."""
    (folder / RUN_FILE).write_bytes(_damaged(rng, RUN_FILE))
    Trainer.resume(folder, task=_task(), config=CONFIG)


TARGETS: dict[str, Callable[[np.random.Generator, Path], None]] = {"policy": policy, "run": run}
