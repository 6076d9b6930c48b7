"""In which order a building can be put up: found backwards, by taking the finished one apart.

A step puts a thing to its place, or takes a ramp away that served only for building. It is possible if a car that
comes from free floor can do it in the world as it is then, by the rules: drive there with its load, set it down, and
get out. What can come last in a building can be taken from it first; whoever takes one thing after the other until
nothing is left has the order, backwards. Where nothing can be taken a ramp is missing, and one is put there.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.grid import Grid, Kind, Piece, beside
from craftsim.discrete.kinds import Action
from craftsim.discrete.move_graph import UNREACHABLE, Distances, MoveGraph, MoveGraphs
from craftsim.discrete.rules import Rules
from craftsim.planning.things import put, take, with_car

State = frozenset[Piece]


@dataclass(frozen=True)
class Placing:
    """A thing put to its place, or taken away."""

    thing: Piece
    taken: bool = False

    def after(self, state: State) -> State:
        """Return what stands after it."""
        return state - {self.thing} if self.taken else state | {self.thing}


@dataclass(frozen=True)
class Order:
    """The steps of a building, in an order in which all of them can be made."""

    steps: tuple[Placing, ...]


class Assembly:
    """What is possible in a building under way; ``base`` is the world with its walls alone."""

    def __init__(self, base: Grid, rules: Rules) -> None:
        self.base, self.rules, self.graphs = base, rules, MoveGraphs(rules)
        self._graph = lru_cache(512)(self._make_graph)
        self._grids = lru_cache(512)(self._make_grid)
        self.possible = lru_cache(4096)(self._is_possible)
        """Whether a step can be made in a state, by a car that comes from free floor and goes back there."""

    def grid(self, state: State) -> Grid:
        """Return the world in which some things stand."""
        return self._grids(state)

    def _make_grid(self, state: State) -> Grid:
        grid = self.base.copy()
        put(grid, sorted(state, key=lambda thing: thing.kind == Kind.FSLOPE))
        grid.derive_marks()
        return grid

    def _make_graph(self, state: State, load: Kind) -> tuple[MoveGraph, Distances]:
        grid = self.grid(state)
        graph = self.graphs.graph(grid, load)
        return graph, graph.distances_from(_outside(grid, graph))

    def _is_possible(self, state: State, step: Placing) -> bool:
        if step.taken:
            return self._can_take(state, step.thing)
        return self._can_put(state, step.thing)

    def _can_put(self, state: State, thing: Piece) -> bool:
        grid = self.grid(state)
        nodes = self._reached_below(state, thing, thing.load)
        return bool(nodes) and has_room(grid, self.rules, thing) and self._gets_out(state | {thing}, nodes)

    def _can_take(self, state: State, thing: Piece) -> bool:
        grid = self.grid(state)
        nodes = self._reached_below(state, thing, Kind.AIR)
        if not nodes:
            return False
        yaw = thing.yaws[0]
        rest = state - {thing}
        if thing.kind == Kind.BODY:
            if not self.rules.legal(with_car(grid, thing.cell, yaw), 0, Action.FOLD):
                return False
            grid = self.grid(rest | {thing._replace(kind=Kind.FSLOPE)})
        if not self.rules.legal(with_car(grid, thing.cell, yaw), 0, Action.LIFT):
            return False
        return self._gets_out(rest, nodes, thing.load)

    def _reached_below(self, state: State, thing: Piece, load: Kind) -> list[int]:
        """Return the states below a thing, or its place, that a car with a load can reach from free floor."""
        graph, distances = self._graph(state, load)
        return [node for node in graph.nodes(thing.cell, thing.yaws) if distances[node] < UNREACHABLE]

    def _gets_out(self, state: State, nodes: list[int], load: Kind = Kind.AIR) -> bool:
        graph, _ = self._graph(state, load)
        distances = graph.distances_from(nodes)
        return bool((distances[_outside(self.grid(state), graph)] < UNREACHABLE).any())


def _outside(grid: Grid, graph: MoveGraph) -> NDArray[np.int64]:
    """Return all nodes of a car on the largest free piece of floor; the gear of its load is there, too."""
    free = (grid.kind[:, :, 1] == Kind.AIR).astype(np.uint8)
    _, pieces = cv2.connectedComponents(free, connectivity=4)
    sizes = np.bincount(pieces.ravel(), minlength=2)
    return graph.floor_nodes(pieces == 1 + np.argmax(sizes[1:]))


def has_room(grid: Grid, rules: Rules, thing: Piece) -> bool:
    """Return whether a thing can stand in its place: free, in the area, borne, and so that a car may act there."""
    cells = thing.cells if thing.kind == Kind.BODY else thing.cells[:1]
    for cell in cells:
        inside = all(0 <= c < n for c, n in zip(cell, grid.kind.shape, strict=True))
        below = (cell[0], cell[1], cell[2] - 1)
        if not inside or grid.kind_at(cell) != Kind.AIR:
            return False
        if grid.kind_at(below) not in (Kind.GROUND, Kind.BLOCK):
            return False
        if grid.kind_at((cell[0], cell[1], cell[2] + 1)) not in (Kind.AIR, Kind.GEAR):
            return False
    if thing.load != Kind.FSLOPE:
        return True
    yaw = thing.yaws[0]
    if not rules.legal(with_car(grid, thing.cell, yaw, Kind.FSLOPE), 0, Action.DROP):
        return False
    if thing.kind == Kind.FSLOPE:
        return True
    folded = grid.copy()
    put(folded, [thing._replace(kind=Kind.FSLOPE)])
    folded.derive_marks()
    return rules.legal(with_car(folded, thing.cell, yaw), 0, Action.UNFOLD)


def ramp_places(grid: Grid, rules: Rules) -> Iterator[Piece]:
    """Yield where an unfolded slope has room and leads up to a block, the lowest first."""
    for z in range(1, grid.size[2] + 1):
        for x, y in np.argwhere(grid.kind[:, :, z] == Kind.BLOCK).tolist():
            if grid.kind_at((x, y, z + 1)) not in (Kind.AIR, Kind.BLOCK, Kind.FLAG):
                continue
            for yaw in range(4):
                ramp = Piece(Kind.BODY, beside((x, y, z), yaw), yaw)
                if has_room(grid, rules, ramp):
                    yield ramp


def taken_out(grid: Grid, things: list[Piece]) -> Grid:
    """Return a world without some things."""
    if not things:
        return grid
    rest = grid.copy()
    take(rest, things)
    rest.derive_marks()
    return rest
