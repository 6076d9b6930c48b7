"""The protocol for builders that answer in words: 30 designs, a budget of turns for each, and a score.

The designs are held-out starts of ``designs@test``, the first one of each shape; the budget is twice the ticks of the
plan that is stored with each. Physics is under mild randomization.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Any, Final

from craftsim.checking.setup import RANDOMIZE
from craftsim.designs.tasks import designs_task, shape_digest
from craftsim.discrete.grid import Kind
from craftsim.discrete.kinds import Action
from craftsim.envs.options import BackendName
from craftsim.envs.text import FORBIDDEN, Exchange, Feedback, TextConstruction
from craftsim.tasks.registry import DESIGNS
from craftsim.tasks.starts import read_split
from craftsim.tasks.task import Task

DIFFICULTIES: Final = ("one level", "with a ramp", "two levels")
"""Blocks on the floor; blocks on the floor and a ramp; blocks on blocks, with or without a ramp."""
EACH: Final = 10
"""Number of designs of each difficulty."""
TURNS: Final = 2
"""Turns for each tick of the stored plan."""


@cache
def chosen_rows() -> dict[str, list[int]]:
    """Return by difficulty which of the held-out starts are built, no two designs of one shape."""
    starts, _ = read_split(DESIGNS, "test")
    rows: dict[str, dict[bytes, int]] = {name: {} for name in DIFFICULTIES}
    for row, targets in enumerate(starts.designs):
        kinds = targets[:, 0]
        levels = targets[:, 3]
        difficulty = int((kinds == Kind.BODY).any())
        if levels[kinds == Kind.BLOCK].max() > 1:
            difficulty = 2
        rows[DIFFICULTIES[difficulty]].setdefault(shape_digest(targets), row)
    return {name: list(of_shapes.values())[:EACH] for name, of_shapes in rows.items()}


def design_task(row: int) -> Task:
    """Return the task of building the design of a held-out start from there, within its budget of turns."""
    starts, ticks = read_split(DESIGNS, "test")
    design = starts.design(row, DESIGNS)
    task = designs_task("test").starting_from([starts.grid(row)], design)
    return replace(task, max_steps=TURNS * int(ticks[row]) - 2)


def design_world(row: int, backend: BackendName) -> TextConstruction:
    """Return the environment in which the design of a held-out start is built, on the grid or in physics."""
    options: dict[str, Any] = {}
    if backend == "physics":
        options = {"drive": "wheels", "randomization": RANDOMIZE["mild"]}
    return TextConstruction(design_task(row), backend=backend, **options)


def score(env: TextConstruction, turns: Sequence[Exchange], success: bool) -> dict[str, Any]:
    """Return what an episode with a builder came to, from its environment as it is at the end and from its turns.

    ``built``; ``in_place``, the share of cells that are as required; ``turns``; of the actions but stop those that were
    ``acted``, ``allowed`` by the rules and as ``predicted``; and ``unreadable``, the number of such answers.
    """
    design = env.core.task.design
    assert design is not None
    hits = [hit for _, hit in design.hits(env.grid)]
    acted: list[Feedback] = []
    for turn in turns:
        acted += [of_car for of_car in turn.feedback if of_car.action != Action.STOP]
    return {
        "built": success,
        "in_place": sum(hits) / len(hits),
        "turns": len(turns),
        "predicted": sum(of_car.done for of_car in acted),
        "allowed": sum(of_car.result != FORBIDDEN for of_car in acted),
        "acted": len(acted),
        "unreadable": sum(bool(turn.unreadable) for turn in turns),
    }
