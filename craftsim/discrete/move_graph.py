"""The legal moves of one car alone in a world that stands still, as a graph, and distances in it.

States are those of the action helper's search (:mod:`craftsim.discrete.kernel.search`): cell and yaw. Distances are
counted in actions.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from craftsim.compiled.jit import compiled
from craftsim.discrete.geometry import DIRECTIONS
from craftsim.discrete.grid import CarField, Cell, Grid, Kind, Piece
from craftsim.discrete.kernel.codes import LAST_MOVE, ROTATE_LEFT
from craftsim.discrete.kernel.rules import legal_actions
from craftsim.discrete.kernel.search import SUCCESSORS, node_of
from craftsim.discrete.kernel.state import (
    BODY,
    FOOT,
    FSLOPE,
    SUPPORTS,
    CarState,
    World,
    after,
    kind_at,
)
from craftsim.discrete.kinds import CellField, Correction
from craftsim.discrete.rules import Rules

Distances = NDArray[np.int32]
"""(nodes,)."""
Nodes = Sequence[int] | NDArray[np.integer]
"""Numbers of nodes."""

UNREACHABLE: Final = 1 << 28
"""The distance where no path leads."""
N_STEPS: Final = len(SUCCESSORS)
_KEPT_DISTANCES: Final = 16
"""Number of distances in one world that are kept, in each direction."""
_KEPT_BYTES: Final = 30_000_000
"""Memory of the steps of worlds that are kept; their distances may take five times as much."""


class MoveGraph:
    """The moves of a car with a load, or without one, in a world without other cars."""

    def __init__(self, grid: Grid, rules: Rules, load: Kind = Kind.AIR) -> None:
        """Work out every step of a car that carries ``load``."""
        self.size = grid.size
        self._load = load
        self.steps = np.full(
            (node_number(grid.size, (grid.size[0], 0, 0), 0), N_STEPS), -1, np.int32
        )
        """(nodes, 6): the node after each of SUCCESSORS, -1 where that is forbidden."""
        without_cars = Grid(grid.cells, np.zeros((0, len(CarField)), np.int16))
        _fill_steps(without_cars.world(rules.corrections, rules.patterns), 0, int(load), self.steps)
        self._steps_back: NDArray[np.int32] | None = None
        self._from: dict[bytes, Distances] = {}
        self._to: dict[bytes, Distances] = {}

    @property
    def numbers(self) -> NDArray[np.int64]:
        """(L, W, H + 2, 4): the number of the state of each cell and yaw."""
        length, width, height = self.size
        return np.arange(len(self.steps)).reshape(length, width, height + 2, 4)

    def node(self, cell: Cell, yaw: int) -> int:
        """Return the number of a state's node."""
        return node_number(self.size, cell, yaw)

    def nodes(self, piece: Piece) -> list[int]:
        """Return the nodes of a car below a thing."""
        return [self.node(piece.cell, yaw) for yaw in piece.yaws]

    def nearest(self, distances: Distances, piece: Piece) -> int:
        """Return the distance of the states below a thing."""
        return int(distances[self.nodes(piece)].min())

    def floor_nodes(self, columns: NDArray[np.bool_]) -> NDArray[np.int64]:
        """Return the nodes of a car on the floor of some columns (L, W), its load's gear being there, too."""
        stands = np.repeat(columns[:, :, None], 4, axis=2)
        if self._load == Kind.FSLOPE:
            length, width = columns.shape
            padded = np.pad(columns, 1)
            for yaw, (dx, dy) in enumerate(DIRECTIONS.tolist()):
                stands[:, :, yaw] &= padded[1 - dx : 1 - dx + length, 1 - dy : 1 - dy + width]
        nodes: NDArray[np.int64] = self.numbers[:, :, 1][stands]
        return nodes

    def distances_from(self, nodes: Nodes) -> Distances:
        """Return how many steps each state is from the nearest of some; UNREACHABLE where no path leads."""
        return _cached_distances(self._from, nodes, self.steps)

    def distances_to(self, nodes: Nodes) -> Distances:
        """Return how many steps it is from each state to the nearest of some."""
        if self._steps_back is None:
            self._steps_back = _reversed(self.steps)
        return _cached_distances(self._to, nodes, self._steps_back)


class MoveGraphs:
    """The graphs of all worlds that were looked at lately: attempts at one plan see the same ones again and again."""

    def __init__(self, rules: Rules) -> None:
        self.rules = rules
        self._known: dict[tuple[bytes, ...], MoveGraph] = {}

    def graph(self, grid: Grid, load: Kind = Kind.AIR) -> MoveGraph:
        """Return the moves of a car with a load in a world without other cars."""
        # Where marks follow from what is there, they make no difference.
        cells = grid.cells
        if Correction.derived_marks in self.rules.corrections:
            cells = grid.cells[..., : CellField.OCCUPANT]
        key = bytes([load]), cells.tobytes()
        graph = self._known.get(key)
        if graph is None:
            graph = MoveGraph(grid, self.rules, load)
            if len(self._known) * graph.steps.nbytes > _KEPT_BYTES:
                self._known.clear()
            self._known[key] = graph
        return graph


def node_number(size: Cell, cell: Cell, yaw: int) -> int:
    """Return the number of a state in a world of a size."""
    return ((cell[0] * size[1] + cell[1]) * (size[2] + 2) + cell[2]) * 4 + yaw


def cell_of_node(size: Cell, node: int) -> Cell:
    """Return the cell of a state."""
    column, z = divmod(node // 4, size[2] + 2)
    x, y = divmod(column, size[1])
    return x, y, z


def _cached_distances(
    cache: dict[bytes, Distances], nodes: Nodes, steps: NDArray[np.int32]
) -> Distances:
    """Return the distances from some nodes, which are worked out at most once while they are kept."""
    starts = np.array(nodes, np.int32)
    key = starts.tobytes()
    if key not in cache:
        if len(cache) >= _KEPT_DISTANCES:
            cache.clear()
        cache[key] = distances = np.full(len(steps), UNREACHABLE, np.int32)
        queue = np.empty(len(steps), np.int32)
        queue[: len(starts)] = starts
        distances[starts] = 0
        _spread(steps, queue, len(starts), distances)
    return cache[key]


def _reversed(steps: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return (nodes, m): from which nodes each one is reached, then -1."""
    before, _ = np.nonzero(steps >= 0)
    targets = steps[steps >= 0]
    order = np.argsort(targets, kind="stable")
    before = before[order]
    targets = targets[order]
    column = np.arange(len(targets)) - np.searchsorted(targets, targets)
    sources = np.full((len(steps), column.max(initial=0) + 1), -1, np.int32)
    sources[targets, column] = before
    return sources


@compiled
def state_at_node(w: World, node: int, load: int) -> CarState:
    """Return the state of a car with a load at a node; below a carried slope the car heads uphill."""
    width = w.cells.shape[1]
    layers = w.cells.shape[2] + 1
    yaw = node & 3
    index = node >> 2
    z = index % layers
    index = index // layers
    x = index // width
    y = index % width
    slope = 0
    if kind_at(w, x, y, z) == FOOT:
        slope = 1
    elif kind_at(w, x, y, z - 1) == BODY:
        slope = 2
    load_yaw = (yaw + 2) & 3 if load == FSLOPE else 0
    return CarState(x, y, z, yaw, load, load_yaw, slope)


@compiled
def _fill_steps(w: World, me: int, load: int, steps: NDArray[np.int32]) -> None:
    for first in range(0, steps.shape[0], 4):
        car = state_at_node(w, first, load)
        below = kind_at(w, car.x, car.y, car.z - 1)
        if car.z == 0 or not (below in SUPPORTS or below == BODY):
            continue
        for node in range(first, first + 4):
            car = state_at_node(w, node, load)
            legal = legal_actions(w, me, car, ROTATE_LEFT, LAST_MOVE)
            for i in range(N_STEPS):
                if legal & (1 << SUCCESSORS[i]):
                    steps[node, i] = node_of(w, after(w, car, SUCCESSORS[i]))


@compiled
def _spread(
    steps: NDArray[np.int32], queue: NDArray[np.int32], size: int, distances: NDArray[np.int32]
) -> None:
    """Search in breadth from the first ``size`` nodes of the queue, whose distances are 0."""
    head = 0
    while head < size:
        node = queue[head]
        head += 1
        for i in range(steps.shape[1]):
            next_node = steps[node, i]
            if next_node >= 0 and distances[next_node] == UNREACHABLE:
                distances[next_node] = distances[node] + 1
                queue[size] = next_node
                size += 1
