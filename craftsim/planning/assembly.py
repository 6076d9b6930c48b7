"""In which order a building can be put up: found backwards, by taking the finished one apart.

A step puts a thing to its place, or takes a ramp away that served only for building. It is possible if a car that
comes from free floor can do it in the world as it is then, by the rules: drive there with its load, set it down, and
get out. What can come last in a building can be taken from it first; whoever takes one thing after the other until
nothing is left has the order, backwards. Where nothing can be taken a ramp is missing, and one is put there.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from functools import lru_cache
from typing import Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.grid import Grid, Kind, Piece, beside
from craftsim.discrete.kinds import Action
from craftsim.discrete.move_graph import UNREACHABLE, Distances, MoveGraph, MoveGraphs
from craftsim.discrete.rules import Rules

State = frozenset[Piece]
"""What stands of a building."""

_TRIES: Final = 200
"""Steps of one backward search for an order, beyond six for each object."""
_SEARCHES: Final = 12
"""Searches for an order, each of which tries equally good steps in another order."""


class Placing(NamedTuple):
    """A thing put to its place, or taken away."""

    thing: Piece
    taken: bool = False

    def after(self, state: State) -> State:
        """Return what stands after it."""
        return state - {self.thing} if self.taken else state | {self.thing}

    def before(self, state: State) -> State:
        """Return what stood before it."""
        return state | {self.thing} if self.taken else state - {self.thing}


Order = tuple[Placing, ...]
"""The steps of a building, in an order in which all of them can be made."""


def without_things(grid: Grid) -> Grid:
    """Return the world with nothing but ground and walls."""
    bare = Grid.empty(grid.size)
    bare.kind[grid.kind == Kind.WALL] = Kind.WALL
    bare.derive_marks()
    return bare


def rebuilt(grid: Grid, taken: Collection[Piece] = (), put: Collection[Piece] = ()) -> Grid:
    """Return a world without some things and with others; itself where there are none of either."""
    if not taken and not put:
        return grid
    grid = grid.copy()
    for thing in taken:
        grid.take(thing.cell)
    for thing in put:
        grid.put(thing)
    grid.derive_marks()
    return grid


class Assembly:
    """What is possible in a building under way; ``base`` is the world with its walls alone."""

    def __init__(self, base: Grid, rules: Rules) -> None:
        self.base, self.rules, self.graphs = base, rules, MoveGraphs(rules)
        self.grid = lru_cache(512)(self._make_grid)
        """The world in which some things stand."""
        self._graph = lru_cache(512)(self._make_graph)
        self.possible = lru_cache(4096)(self._is_possible)
        """Whether a step can be made in a state, by a car that comes from free floor and goes back there."""

    def _make_grid(self, state: State) -> Grid:
        return rebuilt(self.base, put=sorted(state, key=lambda thing: thing.kind == Kind.FSLOPE))

    def _make_graph(self, state: State, load: Kind) -> tuple[MoveGraph, Distances]:
        grid = self.grid(state)
        graph = self.graphs.graph(grid, load)
        return graph, graph.distances_from(_outside(grid, graph))

    def _is_possible(self, state: State, step: Placing) -> bool:
        thing = step.thing
        if not _ramps_to(thing.cell[2], state):
            return False
        grid = self.grid(state)
        graph, distances = self._graph(state, Kind.AIR if step.taken else thing.load)
        nodes = [node for node in graph.nodes(thing) if distances[node] < UNREACHABLE]
        if not nodes:
            return False
        if not step.taken:
            return self.has_room(grid, thing) and self._gets_out(state | {thing}, nodes, Kind.AIR)
        rest = state - {thing}
        if thing.kind == Kind.BODY:
            if not self.allows(grid, thing, Action.FOLD):
                return False
            grid = self.grid(rest | {thing._replace(kind=Kind.FSLOPE)})
        return self.allows(grid, thing, Action.LIFT) and self._gets_out(rest, nodes, thing.load)

    def _gets_out(self, state: State, nodes: list[int], load: Kind) -> bool:
        graph, _ = self._graph(state, load)
        distances = graph.distances_from(nodes)
        return bool((distances[_outside(self.grid(state), graph)] < UNREACHABLE).any())

    def allows(self, grid: Grid, thing: Piece, action: Action, load: Kind = Kind.AIR) -> bool:
        """Return whether a single car, with a load, can do an action in the place of a thing."""
        yaw = thing.yaws[0]
        car = [*thing.cell, yaw, load, (yaw + 2) % 4 if load == Kind.FSLOPE else 0, 0]
        return self.rules.legal(Grid(grid.cells, np.array([car], np.int16)), 0, action)

    def has_room(self, grid: Grid, thing: Piece) -> bool:
        """Return whether a thing can stand in its place: free, in the area, borne, and so that a car may act there."""
        for cell in thing.cells if thing.kind == Kind.BODY else thing.cells[:1]:
            x, y, z = cell
            if not grid.inside(cell) or grid.kind_at(cell) != Kind.AIR:
                return False
            if grid.kind_at((x, y, z - 1)) not in (Kind.GROUND, Kind.BLOCK):
                return False
            if grid.kind_at((x, y, z + 1)) not in (Kind.AIR, Kind.GEAR):
                return False
        if thing.load != Kind.FSLOPE:
            return True
        if not self.allows(grid, thing, Action.DROP, Kind.FSLOPE):
            return False
        folded = thing._replace(kind=Kind.FSLOPE)
        return thing == folded or self.allows(rebuilt(grid, put=[folded]), thing, Action.UNFOLD)

    def find_order(self, goal: State, fixed: State, n_slopes: int, rng: np.random.Generator) -> Order | None:
        """Return an order in which the things of a goal can be put to their places, or None if none is found.

        Args:
            goal: the finished building.
            fixed: those of its things that stand already.
            n_slopes: how many slopes there are; those that the goal does not have may serve for building.
            rng: decides between steps that are equally good.
        """
        for i in range(_SEARCHES):
            path = self._search(goal, fixed, n_slopes, rng, from_below=i % 4 == 3)
            if path is not None:
                return self._without_needless(tuple(reversed(path)), fixed)
        return None

    def _without_needless(self, order: Order, state: State) -> Order:
        """Return an order without those of its ramps without which all other steps are possible, too."""

        def all_possible(steps: Order) -> bool:
            standing = state
            for step in steps:
                if not self.possible(standing, step):
                    return False
                standing = step.after(standing)
            return True

        i = 0
        while i < len(order):
            step = order[i]
            if (gone := step._replace(taken=True)) in order[i + 1 :] and not step.taken:
                j = order.index(gone, i)
                if all_possible(order[i + 1 : j]):
                    order = (*order[:i], *order[i + 1 : j], *order[j + 1 :])
                    continue
            state = step.after(state)
            i += 1
        return order

    def _search(
        self, goal: State, fixed: State, n_slopes: int, rng: np.random.Generator, from_below: bool
    ) -> list[Placing] | None:
        """Return the steps from the last to the first; ``from_below``: the lowest level may go while others stand."""
        seen: set[State] = {goal}
        path: list[Placing] = []
        states, branches = [goal], [self._options(goal, fixed, n_slopes, rng, from_below)]
        for _ in range(_TRIES + 6 * len(goal)):
            if states[-1] == fixed:
                return path
            step = next(branches[-1], None)
            if step is None:
                branches.pop()
                states.pop()
                if not branches:
                    return None
                path.pop()
                continue
            before = step.before(states[-1])
            if before not in seen:
                seen.add(before)
                path.append(step)
                states.append(before)
                branches.append(self._options(before, fixed, n_slopes, rng, from_below))
        return None

    def _options(
        self, state: State, fixed: State, n_slopes: int, rng: np.random.Generator, from_below: bool
    ) -> Iterator[Placing]:
        """Yield the steps that may have come last, the likeliest first."""
        rest = sorted(state - fixed)
        rest = [rest[i] for i in rng.permutation(len(rest))]
        ramps = [thing for thing in rest if thing.kind == Kind.BODY]
        things = [thing for thing in rest if thing.kind != Kind.BODY]
        upper = [thing for thing in things if thing.cell[2] > 1]
        highest = max((thing.cell[2] for thing in things), default=0)
        ramps_left = n_slopes - sum(thing.load == Kind.FSLOPE for thing in state)
        # A ramp goes as soon as it leads nowhere that is still to be built.
        yield from self._last(state, [thing for thing in ramps if thing.cell[2] >= highest])
        barren: dict[Placing, None] = {}
        for level in range(highest, 1, -1):
            here = [thing for thing in upper if thing.cell[2] == level]
            yield from self._last(state, here)
            if ramps_left > 0 and here:
                places = list(self._ramp_places(self.grid(state)))
                for i in rng.permutation(len(places)):
                    step = Placing(places[i], taken=True)
                    if self._serves(state, step, here):
                        yield step
                    else:
                        barren[step] = None
        # A ramp elsewhere may do; the floor level comes last, for what stands on it is driven on.
        yield from self._last(state, [thing for thing in ramps if thing.cell[2] < highest])
        yield from (step for step in barren if self.possible(step.before(state), step))
        if from_below or not upper:
            yield from self._last(state, [thing for thing in things if thing.cell[2] == 1])

    def _last(self, state: State, things: list[Piece]) -> Iterator[Placing]:
        """Yield the placings of some things that may have come last."""
        for thing in things:
            if self.possible(state - {thing}, step := Placing(thing)):
                yield step

    def _serves(self, state: State, step: Placing, upper: list[Piece]) -> bool:
        """Return whether a ramp may have been taken away last, and before it some thing of a level been put there."""
        before = step.before(state)
        return (
            _ramps_to(upper[0].cell[2], before)
            and self.possible(before, step)
            and any(self.possible(before - {thing}, Placing(thing)) for thing in upper)
        )

    def _ramp_places(self, grid: Grid) -> Iterator[Piece]:
        """Yield where an unfolded slope has room and leads up to a block, the lowest first."""
        for z in range(1, grid.size[2] + 1):
            for x, y in np.argwhere(grid.kind[:, :, z] == Kind.BLOCK).tolist():
                if grid.kind_at((x, y, z + 1)) not in (Kind.AIR, Kind.BLOCK, Kind.FLAG):
                    continue
                for yaw in range(4):
                    ramp = Piece(Kind.BODY, beside((x, y, z), yaw), yaw)
                    if self.has_room(grid, ramp):
                        yield ramp


def _ramps_to(level: int, state: State) -> bool:
    """Return whether there is a ramp on each level below one: else no car gets there."""
    return {thing.cell[2] for thing in state if thing.kind == Kind.BODY}.issuperset(range(1, level))


def _outside(grid: Grid, graph: MoveGraph) -> NDArray[np.int64]:
    """Return all nodes of a car on the largest free piece of floor; the gear of its load is there, too."""
    free = (grid.kind[:, :, 1] == Kind.AIR).astype(np.uint8)
    _, pieces = cv2.connectedComponents(free, connectivity=4)
    sizes = np.bincount(pieces.ravel(), minlength=2)
    return graph.floor_nodes(pieces == 1 + np.argmax(sizes[1:]))
