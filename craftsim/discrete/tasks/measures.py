"""Numbers that say something about worlds, one or many: what rewards and successes build on."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.files.design import Design
from craftsim.discrete.grid import Cell, Grid
from craftsim.discrete.kernel.jit import compiled
from craftsim.discrete.kernel.state import World, world_at
from craftsim.discrete.tasks.batches import Targets
from craftsim.discrete.tasks.scores import (
    NO_FLAG,
    code_score,
    finished,
    flag_distance,
    largest_platform,
    paper_score,
    ramps,
    storeys,
)
from craftsim.errors import InputError

COMPLETION: Final = 4.0
"""Extra potential of a finished building by the paper's table 1."""

CODE_COMPLETION: Final = 8.0
"""Extra potential of a finished building in CraftEnv's code."""


class Measure:
    """A number for a world. Subclasses override ``of_worlds`` and get ``of`` for a single world from it."""

    def of_worlds(self, worlds: World) -> NDArray[np.float64]:
        """Return the numbers of a batch of B worlds, whose arrays have a leading dimension, shape (B,)."""
        raise NotImplementedError

    def of_episodes(self, worlds: World, designs: Targets) -> NDArray[np.float64]:
        """Return the numbers of B worlds, in which ``designs`` (B, T, 5) are to be built; what is wanted changes no
        number unless a subclass says so."""
        return self.of_worlds(worlds)

    def for_design(self, design: Design | None) -> Measure:
        """Return the same measure for another design, or, for None, for one in each world."""
        return self

    def of(self, grid: Grid) -> float:
        """Return the number of one world."""
        return float(self.of_worlds(Grid.stack([grid]).world())[0])


class Custom(Measure):
    """A measure from any function of a Grid; a batch is looked at world by world."""

    def __init__(self, function: Callable[[Grid], float]) -> None:
        self.function = function

    def of(self, grid: Grid) -> float:
        """Return the number of one world."""
        return float(self.function(grid))

    def of_worlds(self, worlds: World) -> NDArray[np.float64]:
        """Return the numbers of a batch of worlds, shape (B,)."""
        grids = zip(worlds.cells, worlds.cars, strict=True)
        return np.array([self.of(Grid(cells, cars)) for cells, cars in grids], np.float64)


@compiled
def _paper_scores(
    worlds: World, designs: Targets, upper_block: float, completion: float, out: NDArray[np.float64]
) -> None:
    for i in range(out.shape[0]):
        out[i] = paper_score(world_at(worlds, i), designs[i], upper_block, completion)


@compiled
def _code_scores(worlds: World, designs: Targets, completion: float, out: NDArray[np.float64]) -> None:
    for i in range(out.shape[0]):
        out[i] = code_score(world_at(worlds, i), designs[i], completion)


@compiled
def _finished(worlds: World, designs: Targets, out: NDArray[np.float64]) -> None:
    for i in range(out.shape[0]):
        out[i] = finished(world_at(worlds, i), designs[i])


@compiled
def _platforms(
    worlds: World,
    gears_too: bool,
    levels: int,
    seen: NDArray[np.bool_],
    stack: NDArray[np.int64],
    out: NDArray[np.float64],
) -> None:
    for i in range(out.shape[0]):
        out[i] = largest_platform(world_at(worlds, i), gears_too, levels, seen, stack)


@compiled
def _flag_distances(worlds: World, goal: tuple[int, int, int], out: NDArray[np.float64]) -> None:
    for i in range(out.shape[0]):
        out[i] = flag_distance(world_at(worlds, i), goal)


@compiled
def _add_storeys_and_ramps(worlds: World, storey: float, ramp: float, out: NDArray[np.float64]) -> None:
    for i in range(out.shape[0]):
        w = world_at(worlds, i)
        out[i] += storey * storeys(w) + ramp * ramps(w)


def platform_sizes(worlds: World, gears_too: bool, levels: int) -> NDArray[np.float64]:
    """Return the size of the largest platform of each world, shape (B,)."""
    length, width = worlds.cells.shape[1:3]
    seen, stack = np.empty((length, width), np.bool_), np.empty((length * width, 2), np.int64)
    out = np.empty(len(worlds.cells))
    _platforms(worlds, gears_too, levels, seen, stack, out)
    return out


def target_array(design: Design | None) -> Targets:
    """Return the targets (T, 5) as rows (kind, x, y, z, yaw), yaw -1 where the drawing does not say; none of none."""
    rows = [(t.kind, *t.cell, design.yaw(t)) for t in design.targets] if design else []
    return np.array(rows, np.int64).reshape(-1, 5)


class BuildingMeasure(Measure):
    """A number that says how far a building is: one design for all worlds, or, where that is None, one for each."""

    def __init__(self, design: Design | None) -> None:
        self.targets = None if design is None else target_array(design)

    def of_worlds(self, worlds: World) -> NDArray[np.float64]:
        """Return the number of each building, shape (B,); raise InputError where there is no one design."""
        if self.targets is None:
            raise InputError(
                "this task has a design of its own in each episode; task.for_episode(rng) is the task of one"
            )
        return self.of_episodes(worlds, np.repeat(self.targets[None], len(worlds.cells), axis=0))

    def of_episodes(self, worlds: World, designs: Targets) -> NDArray[np.float64]:
        """Return the number of each building, shape (B,)."""
        out = np.empty(len(worlds.cells))
        self._fill(worlds, designs, out)
        return out

    def for_design(self, design: Design | None) -> Measure:
        """Return the same for another design, or for one in each world."""
        other = copy(self)
        other.targets = None if design is None else target_array(design)
        return other

    def _fill(self, worlds: World, designs: Targets, out: NDArray[np.float64]) -> None:
        raise NotImplementedError


class PaperBuilding(BuildingMeasure):
    """Potential of a building by table 1; ``upper_block`` is that of a block above the floor level."""

    def __init__(self, design: Design | None, upper_block: float) -> None:
        super().__init__(design)
        self.upper_block = upper_block

    def _fill(self, worlds: World, designs: Targets, out: NDArray[np.float64]) -> None:
        _paper_scores(worlds, designs, self.upper_block, COMPLETION, out)


class CodeBuilding(BuildingMeasure):
    """Potential of a building as CraftEnv's code computes it."""

    def _fill(self, worlds: World, designs: Targets, out: NDArray[np.float64]) -> None:
        _code_scores(worlds, designs, CODE_COMPLETION, out)


class Finished(BuildingMeasure):
    """1 where a design is built, else 0."""

    def _fill(self, worlds: World, designs: Targets, out: NDArray[np.float64]) -> None:
        _finished(worlds, designs, out)


class PaperPlatform(Measure):
    """Blocks of the largest platform less one (equation 3); 0 without blocks."""

    def of_worlds(self, worlds: World) -> NDArray[np.float64]:
        """Return the number of each world, shape (B,)."""
        return np.maximum(platform_sizes(worlds, False, worlds.cells.shape[3] - 1) - 1, 0)


class CodePlatform(Measure):
    """Blocks and gears of the largest platform, 0 for a single one; the top level is not looked at."""

    def of_worlds(self, worlds: World) -> NDArray[np.float64]:
        """Return the number of each world, shape (B,)."""
        sizes = platform_sizes(worlds, True, worlds.cells.shape[3] - 2)
        return np.where(sizes > 1, sizes, 0.0)


class FlagNearness(Measure):
    """Minus the Manhattan distance of the flag to the goal; a lost flag is farther than any cell."""

    def __init__(self, goal: Cell) -> None:
        self.goal = goal

    def of_worlds(self, worlds: World) -> NDArray[np.float64]:
        """Return the number of each world, shape (B,)."""
        out = np.empty(len(worlds.cells))
        _flag_distances(worlds, self.goal, out)
        return np.where(out == NO_FLAG, -float(sum(worlds.cells.shape[1:4])), -out)


class OnePlatform(Measure):
    """1 where all n blocks form one platform, else 0."""

    def __init__(self, n_blocks: int) -> None:
        self.n_blocks = n_blocks

    def of_worlds(self, worlds: World) -> NDArray[np.float64]:
        """Return 1 or 0 for each world, shape (B,)."""
        return (PaperPlatform().of_worlds(worlds) == self.n_blocks - 1).astype(np.float64)


class FlagAtGoal(Measure):
    """1 where the flag, carried or not, is in the goal cell, else 0."""

    def __init__(self, goal: Cell) -> None:
        self.nearness = FlagNearness(goal)

    def of_worlds(self, worlds: World) -> NDArray[np.float64]:
        """Return 1 or 0 for each world, shape (B,)."""
        return (self.nearness.of_worlds(worlds) == 0).astype(np.float64)


@dataclass(frozen=True)
class Complexity(Measure):
    """How elaborate a building is: a weighted sum of three counts."""

    platform: float = 1.0
    """Weight of the blocks of the largest platform less one."""
    storey: float = 1.0
    """Weight of each level that a block stands above the floor."""
    ramp: float = 1.0
    """Weight of each unfolded slope that leads up to a block."""

    def of_worlds(self, worlds: World) -> NDArray[np.float64]:
        """Return the number of each world, shape (B,)."""
        out = self.platform * PaperPlatform().of_worlds(worlds)
        _add_storeys_and_ramps(worlds, self.storey, self.ramp, out)
        return out
