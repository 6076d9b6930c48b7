"""A small replay bundle."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

from craftsim.checking.recipe import Recipe, Step
from craftsim.discrete.files.blueprint import blueprint_text
from craftsim.discrete.grid import Grid, Kind
from craftsim.discrete.kinds import Action
from craftsim.experiments.bundle import AFTER, BEFORE, BUNDLE_FILE, PHYSICS_FILE, write_bundle


@cache
def bundle_files() -> dict[str, bytes]:
    """Return the files of a small bundle by name."""
    grid = Grid.empty((3, 2, 2), 2)
    grid.cars[:, :4] = [[0, 0, 1, 0], [0, 1, 1, 0]]
    grid.kind[2, 1, 1] = Kind.BLOCK
    grid.derive_marks()
    turns = [(0, Action.STOP), (1, Action.STOP)]
    steps = (Step.single(0, 0, Action.STOP), Step.of_ticks(1, turns))
    with TemporaryDirectory() as folder:
        write_bundle(Path(folder), "two stops", Recipe(blueprint_text(grid), steps))
        return {
            name: (Path(folder) / name).read_bytes()
            for name in (BUNDLE_FILE, PHYSICS_FILE, BEFORE, AFTER)
        }
