"""Orders in which a building can be put up: found backwards, by taking the finished one apart.

A step puts a thing to its place, or takes a ramp away that served only for building. It is possible if a car that
comes from free floor can do it in the world as it is then, by the rules: drive there with its load, set it down, and
get out. What can come last in a building can be taken from it first; whoever takes one thing after the other until
nothing is left has the order, backwards. Where nothing can be taken a ramp is missing, and one is put there.
"""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Collection, Iterable, Iterator
from functools import lru_cache
from heapq import heappop, heappush
from itertools import groupby
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.grid import CarField, Cell, Grid, Kind, Piece, beside
from craftsim.discrete.kinds import Action
from craftsim.discrete.move_graph import UNREACHABLE, Distances, MoveGraph, MoveGraphs
from craftsim.discrete.rules import Rules

State = frozenset[Piece]
"""The things of a building that stand."""

_TRIES: Final = 60
"""Choices of one backward search for an order."""
_CONFIGURATIONS: Final = 600
"""Configurations of ramps that are looked at for a way to some things."""
_SEARCHES: Final = 12
"""Searches for an order, each of which tries equally good steps in another order."""


class Placing(NamedTuple):
    """A step of assembly: a thing is put to its place, or taken away."""

    piece: Piece
    removes: bool = False

    def after(self, state: State) -> State:
        """Return what stands after it."""
        if self.removes:
            return state - {self.piece}
        return state | {self.piece}

    def before(self, state: State) -> State:
        """Return what stood before it."""
        if self.removes:
            return state | {self.piece}
        return state - {self.piece}


Order = tuple[Placing, ...]
"""The steps of a building, in an order in which all of them can be made."""


def without_things(grid: Grid) -> Grid:
    """Return the world with nothing but ground and walls."""
    bare = Grid.empty(grid.size)
    bare.kind[grid.kind == Kind.WALL] = Kind.WALL
    bare.derive_marks()
    return bare


def loads_of(grid: Grid) -> Counter[Kind]:
    """Return how many things of each load there are in a world, those on cars included."""
    loads = Counter(piece.load for piece in grid.pieces())
    for load in grid.cars[:, CarField.LOAD].tolist():
        if load:
            loads[Kind(load)] += 1
    return loads


def rebuilt(grid: Grid, removed: Collection[Piece] = (), added: Collection[Piece] = ()) -> Grid:
    """Return a world without some things and with others; itself where there are none of either."""
    if not removed and not added:
        return grid
    grid = grid.copy()
    for piece in removed:
        grid.take(piece.cell)
    for piece in added:
        grid.put(piece)
    grid.derive_marks()
    return grid


class Assembly:
    """The possible steps of a building under way; ``base`` is the world with its walls alone."""

    def __init__(self, base: Grid, rules: Rules) -> None:
        self.base = base
        self.rules = rules
        self.graphs = MoveGraphs(rules)
        self.until_s = math.inf
        """The monotonic time after which :meth:`check_time` raises TimeoutError, so that all that asks it ends."""
        self.unplaced: State | None = None
        """The fewest things that were left where a search for an order went no further; None if none has yet."""
        self.standing: State = frozenset()
        """All that stands then."""
        self.grid = lru_cache(512)(self._make_grid)
        """The world in which some things stand."""
        self._graph = lru_cache(512)(self._make_graph)
        self._obstacle = lru_cache(4096)(self._find_obstacle)

    def _make_grid(self, state: State) -> Grid:
        return rebuilt(self.base, added=sorted(state, key=lambda piece: piece.kind == Kind.FSLOPE))

    def _make_graph(self, state: State, load: Kind) -> tuple[MoveGraph, Distances]:
        grid = self.grid(state)
        graph = self.graphs.graph(grid, load)
        return graph, graph.distances_from(_outside(grid, graph))

    def check_time(self) -> None:
        """Raise TimeoutError when the time is up."""
        if time.monotonic() > self.until_s:
            raise TimeoutError

    def possible(self, state: State, step: Placing) -> bool:
        """Return whether a step can be made in a state, by a car that comes from free floor and goes back there."""
        return not self.obstacle(state, step)

    def obstacle(self, state: State, step: Placing) -> str:
        """Return why a step cannot be made in a state; empty if it can."""
        self.check_time()
        return self._obstacle(state, step)

    def _find_obstacle(self, state: State, step: Placing) -> str:
        piece = step.piece
        level = piece.cell[2]
        if not _ramps_to(level, state):
            missing = f"no ramp leads to level {level}"
            if level > 2:  # a ramp to level 2 stands on the floor
                missing += (
                    f"; one takes four cells in line on level {level - 1}, on blocks of the design"
                )
            return missing
        grid = self.grid(state)
        load = piece.load
        if step.removes:
            load = Kind.AIR
        graph, distances = self._graph(state, load)
        nodes = [node for node in graph.nodes(piece) if distances[node] < UNREACHABLE]
        if not nodes:
            if step.removes:
                return "no car can drive there"
            return "no car can drive there with it"
        if not step.removes:
            if not self.has_room(grid, piece):
                return "a car cannot set it down there"
            gets_out = self._gets_out(state | {piece}, nodes, Kind.AIR)
        else:
            remaining = state - {piece}
            if piece.kind == Kind.BODY:
                if not self.allows(grid, piece, Action.FOLD):
                    return "a car cannot fold it there"
                grid = self.grid(remaining | {piece._replace(kind=Kind.FSLOPE)})
            if not self.allows(grid, piece, Action.LIFT):
                return "a car cannot lift it there"
            gets_out = self._gets_out(remaining, nodes, piece.load)
        if gets_out:
            return ""
        return "a car could not drive away from there again"

    def _gets_out(self, state: State, nodes: list[int], load: Kind) -> bool:
        graph, _ = self._graph(state, load)
        distances = graph.distances_from(nodes)
        return bool((distances[_outside(self.grid(state), graph)] < UNREACHABLE).any())

    def allows(self, grid: Grid, piece: Piece, action: Action, load: Kind = Kind.AIR) -> bool:
        """Return whether a single car, with a load, can do an action in the place of a thing."""
        yaw = piece.yaws[0]
        load_yaw = 0
        if load == Kind.FSLOPE:
            load_yaw = (yaw + 2) % 4
        car = [*piece.cell, yaw, load, load_yaw, 0]
        return self.rules.legal(Grid(grid.cells, np.array([car], np.int16)), 0, action)

    def has_room(self, grid: Grid, piece: Piece) -> bool:
        """Return whether a thing can stand in its place: free, in the area, borne, and so that a car may act there."""
        self.check_time()
        cells = piece.cells[:1]
        if piece.kind == Kind.BODY:
            cells = piece.cells
        for cell in cells:
            x, y, z = cell
            if not grid.inside(cell) or grid.kind_at(cell) != Kind.AIR:
                return False
            if grid.kind_at((x, y, z - 1)) not in (Kind.GROUND, Kind.BLOCK):
                return False
            if grid.kind_at((x, y, z + 1)) not in (Kind.AIR, Kind.GEAR):
                return False
        if piece.load != Kind.FSLOPE:
            return True
        if not self.allows(grid, piece, Action.DROP, Kind.FSLOPE):
            return False
        folded = piece._replace(kind=Kind.FSLOPE)
        return piece == folded or self.allows(rebuilt(grid, added=[folded]), piece, Action.UNFOLD)

    def find_order(
        self, goal: State, fixed: State, n_slopes: int, rng: np.random.Generator
    ) -> Order | None:
        """Return an order in which the things of a goal can be put to their places, or None if none is found.

        Those that are ``fixed`` stand already. Of all slopes, ``n_slopes``, those that the goal does not have may serve
        for building.
        """
        for _ in range(_SEARCHES):
            search = _Deconstruction(self, fixed, n_slopes, rng)
            path = search.run(goal)
            if path is not None:
                return self._without_needless(tuple(reversed(path)), fixed)
            if search.complete:
                break
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
            removal = step._replace(removes=True)
            if removal in order[i + 1 :] and not step.removes:
                j = order.index(removal, i)
                if all_possible(order[i + 1 : j]):
                    order = (*order[:i], *order[i + 1 : j], *order[j + 1 :])
                    continue
            state = step.after(state)
            i += 1
        return order

    def ramp_places(self, grid: Grid) -> Iterator[Piece]:
        """Yield where an unfolded slope has room and leads up to a block, the lowest first."""
        for z in range(1, grid.size[2] + 1):
            for x, y in np.argwhere(grid.kind[:, :, z] == Kind.BLOCK).tolist():
                if grid.kind_at((x, y, z + 1)) not in (Kind.AIR, Kind.BLOCK, Kind.FLAG):
                    continue
                for yaw in range(4):
                    ramp = Piece(Kind.BODY, beside((x, y, z), yaw), yaw)
                    if self.has_room(grid, ramp):
                        yield ramp


class _Deconstruction:
    """A search for an order, from the last step to the first.

    What is on the highest level is taken as soon as it can be, since it bears nothing and only bars the way: only in
    what is taken from below it is there a choice. The ramps in between can be moved as one likes, too, as they come and
    go by the same ways; which are worth to be put there follows from where cars could drive on each level.
    """

    def __init__(
        self, assembly: Assembly, fixed: State, n_slopes: int, rng: np.random.Generator
    ) -> None:
        self.assembly = assembly
        self.fixed = fixed
        self.n_slopes = n_slopes
        self.rng = rng
        self.complete = True
        """Everything was tried, so that there is no order where none was found."""
        self.n_left = 0
        """Number of ramps that stay where they are when all is done, since nobody could take them away."""

    def run(self, goal: State) -> list[Placing] | None:
        """Return the steps from the last to the first, None where none are found."""
        path: list[Placing] = []
        state = goal
        tried = set[State]()
        branches: list[tuple[int, Iterator[list[Placing]]]] = []
        for _ in range(_TRIES):
            state = self._clear_highest(state, path)
            if state == self.fixed:
                return path[self.n_left :]
            self._note(state)
            building = frozenset(piece for piece in state if piece.kind != Kind.BODY)
            if building not in tried:
                tried.add(building)
                branches.append((len(path), self._from_below(state)))
            steps = None
            while branches:
                length, sequences = branches[-1]
                steps = next(sequences, None)
                if steps is not None:
                    path[length:] = steps
                    break
                branches.pop()
            if steps is None:
                return None
            state = _before(goal, path)
        self.complete = False
        return None

    def _note(self, state: State) -> None:
        """Remember a state from which nothing can be taken any more, if no search has come further."""
        assembly = self.assembly
        remaining = state - self.fixed
        if assembly.unplaced is None or len(remaining) < len(assembly.unplaced):
            assembly.unplaced = remaining
            assembly.standing = state

    def _clear_highest(self, state: State, path: list[Placing]) -> State:
        """Take whatever can be taken from the highest level, add the steps to the path, and return what is left."""
        while True:
            highest = self._removable(state)[0]
            step = next(self._removals(state, highest), None)
            if not step:
                steps = next(self._ramp_sequences(state, highest), None)
            else:
                steps = [step]
            if steps is None and not path:
                steps = next(self._ramp_sequences(state, highest, ramps_stay=True), None)
                self.n_left = len(steps or ())
            if steps is None:
                return state
            state = _before(state, steps)
            path += steps

    def _from_below(self, state: State) -> Iterator[list[Placing]]:
        """Yield steps that take something from below the highest level, the likeliest first."""
        for pieces in self._removable(state)[1:]:
            for step in self._removals(state, pieces):
                yield [step]
            for steps in self._ramp_sequences(state, pieces):
                for step in self._removals(_before(state, steps), pieces):
                    yield [*steps, step]

    def _removable(self, state: State) -> list[list[Piece]]:
        """Return what may be taken of a building by level, the highest first, in random order but for the ramps.

        They come first: on the highest level they lead nowhere that is still to be built.
        """
        pieces = sorted(state - self.fixed)
        pieces = [pieces[i] for i in self.rng.permutation(len(pieces))]
        pieces.sort(key=lambda piece: (-piece.cell[2], piece.kind != Kind.BODY))
        return [list(level) for _, level in groupby(pieces, lambda piece: piece.cell[2])] or [[]]

    def _removals(self, state: State, pieces: list[Piece]) -> Iterator[Placing]:
        for piece in pieces:
            step = Placing(piece)
            if self.assembly.possible(state - {piece}, step):
                yield step

    def _ramp_sequences(
        self, state: State, pieces: list[Piece], ramps_stay: bool = False
    ) -> Iterator[list[Placing]]:
        """Yield how to move ramps so that one of some things, all on one level, can be taken.

        A best-first search, by the number of levels without a ramp that may lead on. With ``ramps_stay`` ramps need not
        be taken away in the end.
        """
        if not pieces or pieces[0].cell[2] == 1:
            return
        useful = self._useful(state, pieces)
        queue = [(0, 0, state, list[Placing]())]
        visited = {state}
        for _ in range(_CONFIGURATIONS):
            if not queue:
                return
            _, _, standing, steps = heappop(queue)
            if steps:
                ramp = steps[-1].piece
                if ramps_stay:
                    check = (standing - {ramp}, Placing(ramp))
                else:
                    check = (standing, steps[-1])
                if not self.assembly.possible(*check):
                    continue
                if all(map(standing.intersection, useful.values())) and next(
                    self._removals(standing, pieces), None
                ):
                    yield steps
            for step in self._ramp_moves(standing, useful):
                if ramps_stay and not step.removes:
                    continue
                before = step.before(standing)
                if before not in visited:
                    visited.add(before)
                    missing = sum(ramps.isdisjoint(before) for ramps in useful.values())
                    heappush(queue, (missing, len(visited), before, [*steps, step]))
        self.complete = False

    def _ramp_moves(self, state: State, useful: dict[int, set[Piece]]) -> Iterator[Placing]:
        """Yield the ramps that may be put somewhere or taken away, those first that may lead up."""
        if self.n_slopes > sum(piece.load == Kind.FSLOPE for piece in state):
            places = list(self.assembly.ramp_places(self.assembly.grid(state)))
            for i in self.rng.permutation(len(places)):
                if places[i] in useful.get(places[i].cell[2], ()):
                    yield Placing(places[i], removes=True)
        ramps = [piece for piece in state - self.fixed if piece.kind == Kind.BODY]
        yield from map(Placing, sorted(ramps, key=lambda ramp: -ramp.cell[2]))

    def _useful(self, state: State, pieces: list[Piece]) -> dict[int, set[Piece]]:
        """Return by level the ramps from which a car might come to some things, all on one level, up further ramps."""
        ramps = {piece for piece in state if piece.kind == Kind.BODY}
        bare = state - ramps
        grid = self.assembly.grid(bare)
        ramps.update(self.assembly.ramp_places(grid))
        graph = self.assembly.graphs.graph(grid, pieces[-1].load)
        cells = {piece.cell for piece in pieces}
        for piece in pieces:
            for yaw in range(4):
                cell = beside(piece.cell, yaw)
                if grid.inside(cell):
                    cells.add(cell)
        goals = []
        for cell in cells:
            for yaw in range(4):
                goals.append(graph.node(cell, yaw))
        useful: dict[int, set[Piece]] = {}
        for level in range(pieces[0].cell[2] - 1, 0, -1):
            distances = graph.distances_to(goals)
            useful[level] = set()
            for ramp in ramps:
                if ramp.cell[2] == level:
                    node = graph.node(_landing(ramp), ramp.yaws[0])
                    if distances[node] < UNREACHABLE:
                        useful[level].add(ramp)
            graph = self.assembly.graphs.graph(grid, Kind.FSLOPE)
            goals = []
            for ramp in sorted(useful[level]):
                for node in graph.nodes(ramp):
                    goals.append(node)
        return useful


def _before(state: State, steps: Iterable[Placing]) -> State:
    """Return what stood before some steps, of which the last comes first."""
    for step in steps:
        state = step.before(state)
    return state


def _ramps_to(level: int, state: State) -> bool:
    """Return whether there is a ramp on each level below one: else no car gets there."""
    ramp_levels = {piece.cell[2] for piece in state if piece.kind == Kind.BODY}
    return ramp_levels.issuperset(range(1, level))


def _outside(grid: Grid, graph: MoveGraph) -> NDArray[np.int64]:
    """Return all nodes of a car on the largest free piece of floor; the gear of its load is there, too."""
    import cv2  # slow to import

    free = (grid.kind[:, :, 1] == Kind.AIR).astype(np.uint8)
    _, pieces = cv2.connectedComponents(free, connectivity=4)
    sizes = np.bincount(pieces.ravel(), minlength=2)
    return graph.floor_nodes(pieces == 1 + np.argmax(sizes[1:]))


def _landing(ramp: Piece) -> Cell:
    x, y, z = beside(ramp.cell, ramp.yaws[0])
    return x, y, z + 1
