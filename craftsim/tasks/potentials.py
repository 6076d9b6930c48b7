"""Potentials and goals: what worlds are worth, and whether the work is done, for many worlds at once."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from craftsim.compiled.arrays import Flags, Floats
from craftsim.compiled.jit import seldom
from craftsim.discrete.grid import Grid, Kind
from craftsim.tasks.kernel import (
    count_stacks,
    flag_distances,
    largest_platforms,
    score_buildings,
    score_complexities,
    score_structures,
)
from craftsim.tasks.observation import Layout
from craftsim.tasks.starts import Targets

_score_building = seldom(score_buildings)
_score_complexity = seldom(score_complexities)
_score_structure = seldom(score_structures)
_count_stacks = seldom(count_stacks)

Potential = Callable[[Grid, Targets, Layout], Floats]
"""(B,): a number for each of B worlds, from the worlds, what is to be built in each, and what the task announces."""
_Goal = Callable[[Grid, Targets, Layout], Flags]
"""(B,): whether the work is done in each of B worlds; arguments as of a potential."""

_COMPLETION: Final = 4.0
"""Extra potential of a finished building by the paper's table 1."""
PUBLISHED_COMPLETION: Final = 8.0
"""Extra potential of a finished building in CraftEnv's code."""
STRUCTURE_WEIGHTS: Final = (1.0, 1.0, 5.0, 10.0, 25.0, 50.0)
"""Weights of the parts of :func:`structure`: ``block_near_unfold``, ``block_on_block``, ``fold_on_block``,
``unfold_on_block``, ``block_unfold_on_block`` and ``block_on_block_on_block`` of CraftEnv's ``free.yaml`` and
``flag.yaml``."""
_WEIGHTS: Final = np.array(STRUCTURE_WEIGHTS)


def building(grids: Grid, designs: Targets, layout: Layout) -> Floats:
    """Return how far each building is by table 1."""
    return _building_scores(grids, designs, 1.0, 1.0, _COMPLETION)


def complex_building(grids: Grid, designs: Targets, layout: Layout) -> Floats:
    """Return the same by the row of complex two-story: a block above the floor level counts 3."""
    return _building_scores(grids, designs, 1.0, 3.0, _COMPLETION)


def published_building(grids: Grid, designs: Targets, layout: Layout) -> Floats:
    """Return how far each building is as CraftEnv's code computes it (docs/rules.md#goal-score)."""
    kind, x, y, z = np.moveaxis(designs[..., :4], -1, 0)
    blocks = kind == Kind.BLOCK
    top = grids.size[2]
    standing = grids.kind[np.arange(len(grids))[:, None], x, y, np.minimum(z, top)]
    hits = (
        (kind != Kind.AIR) & (z < top) & ((standing == kind) | (blocks & (standing == Kind.GEAR)))
    )
    finished = hits.sum(1) == (kind != Kind.AIR).sum(1)
    return (blocks & (z == 2)).sum(1) + hits.sum(1) + PUBLISHED_COMPLETION * finished


def platform(grids: Grid, designs: Targets, layout: Layout) -> Floats:
    """Return the blocks of the largest platform less one (equation 3); 0 without blocks."""
    return np.maximum(_platforms(grids, Kind.BLOCK, grids.size[2]) - 1, 0)


def published_platform(grids: Grid, designs: Targets, layout: Layout) -> Floats:
    """Return the blocks and gears of the largest platform, 0 for a single one; the top level is not looked at."""
    sizes = _platforms(grids, Kind.GEAR, grids.size[2] - 1)
    return np.where(sizes > 1, sizes, 0.0)


def flag_nearness(grids: Grid, designs: Targets, layout: Layout) -> Floats:
    """Return minus the Manhattan distance of the flag to the goal; a lost flag is farther than any cell."""
    return -_flag_distances(grids, layout)


def complexity(grids: Grid, designs: Targets, layout: Layout) -> Floats:
    """Return how elaborate a building is: its largest platform, levels of blocks above the floor, ramps to blocks.

    Such a ramp is an unfolded slope with its foot below and a block behind its body.
    """
    extra = np.empty(len(grids))
    if len(grids) == 1:
        score = _score_complexity
    else:
        score = score_complexities
    score(grids.cells, grids.cars, extra)
    return platform(grids, designs, layout) + extra


def structure(grids: Grid, designs: Targets, layout: Layout) -> Floats:
    """Return how elaborate a building is by what CraftEnv's configuration files weigh for large-scale training.

    A block behind the body of an unfolded slope counts 1, a block on a block 1, a folded slope on a block 5, an
    unfolded one 10, and 25 more where it leads to a block, and a stack of three blocks from the floor 50.
    """
    out = np.empty(len(grids))
    if len(grids) == 1:
        score = _score_structure
    else:
        score = score_structures
    score(grids.cells, grids.cars, _WEIGHTS, out)
    return out


GOALS: Final[dict[str, _Goal]] = {
    # Each cell to be built holds its kind with its yaw.
    "built": lambda grids, designs, layout: _building_scores(grids, designs, 0.0, 0.0, 1.0) != 0,
    # All blocks that the task announces form one platform.
    "one_platform": lambda grids, designs, layout: (
        platform(grids, designs, layout) == layout.n_blocks - 1
    ),
    # The flag, carried or not, is in the goal cell.
    "flag_at_goal": lambda grids, designs, layout: _flag_distances(grids, layout) == 0,
    # Three blocks stand on one another from the floor.
    "three_high": lambda grids, designs, layout: _stacks(grids) > 0,
}


def _building_scores(
    grids: Grid, designs: Targets, per_thing: float, upper_block: float, completion: float
) -> Floats:
    out = np.empty(len(grids))
    if len(out) == 1:
        score = _score_building
    else:
        score = score_buildings
    score(grids.cells, grids.cars, designs, per_thing, upper_block, completion, out)
    return out


def _platforms(grids: Grid, extra_kind: Kind, levels: int) -> Floats:
    """Return the size of the largest platform of each world; a thing of ``extra_kind`` counts as a block, too."""
    length, width, _ = grids.size
    visited = np.empty((length, width), np.bool_)
    stack = np.empty((length * width, 2), np.int64)
    out = np.empty(len(grids))
    largest_platforms(grids.cells, grids.cars, int(extra_kind), levels, visited, stack, out)
    return out


def _flag_distances(grids: Grid, layout: Layout) -> Floats:
    """Return (B,): the Manhattan distance of each flag to the goal."""
    out = np.empty(len(grids))
    flag_distances(grids.cells, grids.cars, layout.goal_cell, out)
    return out


def _stacks(grids: Grid) -> Floats:
    """Return (B,): how many stacks of three blocks from the floor each world has."""
    out = np.empty(len(grids))
    if len(grids) == 1:
        count = _count_stacks
    else:
        count = count_stacks
    count(grids.cells, grids.cars, out)
    return out
