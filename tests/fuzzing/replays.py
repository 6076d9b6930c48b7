"""Damaged replay bundles."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from craftsim.checking.episode import Recipe, Step
from craftsim.discrete.files.blueprint import blueprint_text
from craftsim.discrete.grid import Grid, Kind
from craftsim.discrete.kinds import Action
from craftsim.experiments.bundle import AFTER, BEFORE, PHYSICS, TEXT, read_bundle, write_bundle
from fuzzing.mutations import mutated_bytes, mutated_document


@cache
def bundle_files() -> dict[str, bytes]:
    """Return the files of a small bundle by name."""
    grid = Grid.empty((3, 2, 2), 2)
    grid.cars[:, :4] = [[0, 0, 1, 0], [0, 1, 1, 0]]
    grid.kind[2, 1, 1] = Kind.BLOCK
    grid.derive_marks()
    turns = [(0, Action.STOP), (1, Action.STOP)]
    steps = (Step.single(0, 0, Action.STOP), Step.joint(1, turns))
    with TemporaryDirectory() as folder:
        write_bundle(Path(folder), "two stops", Recipe(blueprint_text(grid), steps))
        return {name: (Path(folder) / name).read_bytes() for name in (TEXT, PHYSICS, BEFORE, AFTER)}


def attack_bundle(rng: np.random.Generator, folder: Path) -> None:
    """Read a bundle of which one file is changed."""
    files = dict(bundle_files())
    name = [TEXT, TEXT, TEXT, PHYSICS, BEFORE, AFTER][rng.integers(6)]
    if name == TEXT and rng.random() < 0.7:
        document = json.loads(files[TEXT])
        for _ in range(rng.integers(1, 4)):
            mutated_document(document, rng)
        files[TEXT] = json.dumps(document).encode()
    else:
        files[name] = mutated_bytes(files[name], rng)
    for name, data in files.items():
        (folder / name).write_bytes(data)
    read_bundle(folder)


TARGETS = {"replay bundle": attack_bundle}
