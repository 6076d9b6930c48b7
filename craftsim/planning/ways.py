"""Ways of one car alone in a world that stands still: which state follows which, and how far it is.

States are those of the action helper's search (:mod:`craftsim.discrete.kernel.search`): cell and yaw. Legality is
asked of the rules; distances are counted in actions.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.grid import CarField, Cell, Grid, Kind
from craftsim.discrete.kernel.codes import LEGAL
from craftsim.discrete.kernel.jit import compiled
from craftsim.discrete.kernel.rules import why
from craftsim.discrete.kernel.search import SUCCESSORS, after, node_of
from craftsim.discrete.kernel.state import AIR, BODY, FOOT, FSLOPE, Pose, World, kind_at, standable
from craftsim.discrete.kinds import CellField, Correction
from craftsim.discrete.rules import Rules

Nodes = NDArray[np.int32]

FAR: Final = 1 << 28
"""A distance that no way has."""
N_STEPS: Final = len(SUCCESSORS)
HALF_TURN: Final = 2
"""A car below a slope heads uphill: the slope's yaw is half a turn from its own."""
_DISTANCES: Final = 16
"""So many distances in one world are kept, each way."""
_KEPT_BYTES: Final = 30_000_000
"""Steps of worlds that are kept; their distances may take five times as much."""


class Ways:
    """All that a car with a load, or without one, could do in a world without other cars."""

    def __init__(self, grid: Grid, rules: Rules, load: Kind = Kind.AIR) -> None:
        """Work out every step of a car that carries ``load``."""
        length, width, height = grid.size
        self.size = grid.size
        self.steps = np.full((length * width * (height + 2) * 4, N_STEPS), -1, np.int32)
        """(nodes, 6): the state after each of SUCCESSORS, -1 where that is forbidden."""
        alone = Grid(grid.cells, np.zeros((1, len(CarField)), np.int16))
        _fill_steps(alone.world(rules.corrections), int(load), self.steps)
        self._firsts: Nodes | None = None
        self._befores: Nodes | None = None
        self._from: dict[tuple[int, ...], Nodes] = {}
        self._to: dict[tuple[int, ...], Nodes] = {}

    def node(self, cell: Cell, yaw: int) -> int:
        """Return the number of a state."""
        return node_number(self.size, cell, yaw)

    def nodes(self, cell: Cell, yaws: Iterable[int]) -> list[int]:
        """Return the numbers of the states in a cell with some yaws."""
        return [self.node(cell, yaw) for yaw in yaws]

    def from_nodes(self, nodes: list[int]) -> Nodes:
        """Return how many steps each state is from the nearest of some, shape (nodes,); FAR where no way leads."""
        return self._kept(self._from, nodes, self._spread)

    def to_nodes(self, nodes: list[int]) -> Nodes:
        """Return how many steps it is from each state to the nearest of some, shape (nodes,)."""
        return self._kept(self._to, nodes, self._spread_back)

    def _kept(
        self,
        known: dict[tuple[int, ...], Nodes],
        nodes: list[int],
        spread: Callable[[Nodes, int, Nodes], None],
    ) -> Nodes:
        """Return the distances of some nodes, which are worked out at most once while they are kept."""
        key = tuple(nodes)
        if key not in known:
            if len(known) >= _DISTANCES:
                known.clear()
            known[key] = distances = np.full(len(self.steps), FAR, np.int32)
            queue = np.empty(len(self.steps), np.int32)
            queue[: len(nodes)] = nodes
            distances[nodes] = 0
            spread(queue, len(nodes), distances)
        return known[key]

    def _spread(self, queue: Nodes, size: int, distances: Nodes) -> None:
        _spread(self.steps, queue, size, distances)

    def _spread_back(self, queue: Nodes, size: int, distances: Nodes) -> None:
        if self._firsts is None or self._befores is None:
            self._firsts = np.zeros(len(self.steps) + 1, np.int32)
            self._befores = np.empty(self.steps.size, np.int32)
            _reverse(self.steps, self._firsts, self._befores)
        _spread_back(self._firsts, self._befores, queue, size, distances)


class Maps:
    """The ways of all worlds that were looked at lately: attempts at one plan see the same ones again and again."""

    def __init__(self, rules: Rules) -> None:
        self.rules = rules
        self._known: dict[tuple[bytes, ...], Ways] = {}

    def ways(self, grid: Grid, load: Kind = Kind.AIR) -> Ways:
        """Return the ways of a car with a load in a world without other cars."""
        # Where marks follow from what is there, they make no difference.
        derived = Correction.derived_marks in self.rules.corrections
        key = bytes([load]), (grid.cells[..., : CellField.OCCUPANT] if derived else grid.cells).tobytes()
        found = self._known.get(key)
        if found is None:
            found = Ways(grid, self.rules, load)
            if len(self._known) * found.steps.nbytes > _KEPT_BYTES:
                self._known.clear()
            self._known[key] = found
        return found


def node_number(size: Cell, cell: Cell, yaw: int) -> int:
    """Return the number of a state in a world of a size."""
    return ((cell[0] * size[1] + cell[1]) * (size[2] + 2) + cell[2]) * 4 + yaw


def cell_of_node(size: Cell, node: int) -> tuple[Cell, int]:
    """Return cell and yaw of a state."""
    rest, yaw = divmod(node, 4)
    rest, z = divmod(rest, size[2] + 2)
    x, y = divmod(rest, size[1])
    return (x, y, z), yaw


@compiled
def slope_state(w: World, x: int, y: int, z: int) -> int:
    """Return the slope state of a car in a cell."""
    if kind_at(w, x, y, z) == FOOT:
        return 1
    return 2 if kind_at(w, x, y, z - 1) == BODY else 0


@compiled
def can_be_in(w: World, x: int, y: int, z: int) -> bool:
    """Return whether something in a cell's column bears a car there."""
    below = kind_at(w, x, y, z - 1)
    return standable(below) or below == BODY


@compiled
def _fill_steps(w: World, load: int, steps: Nodes) -> None:
    length, width, layers = w.cells.shape[:3]
    for x in range(length):
        for y in range(width):
            for z in range(1, layers + 1):
                if not can_be_in(w, x, y, z):
                    continue
                slope = slope_state(w, x, y, z)
                for yaw in range(4):
                    load_yaw = (yaw + HALF_TURN) & 3 if load == FSLOPE else 0
                    car = Pose(x, y, z, yaw, load, load_yaw, slope)
                    node = node_of(w, car)
                    for i in range(N_STEPS):
                        if why(w, 0, car, SUCCESSORS[i]) == LEGAL:
                            steps[node, i] = node_of(w, after(w, car, SUCCESSORS[i]))


@compiled
def _spread(steps: Nodes, queue: Nodes, size: int, distances: Nodes) -> None:
    head = 0
    while head < size:
        node = queue[head]
        head += 1
        for i in range(N_STEPS):
            there = steps[node, i]
            if there >= 0 and distances[there] == FAR:
                distances[there] = distances[node] + 1
                queue[size] = there
                size += 1


@compiled
def _reverse(steps: Nodes, firsts: Nodes, befores: Nodes) -> None:
    """Write from which states each one is reached: ``befores[firsts[n]:firsts[n + 1]]``."""
    n_nodes = steps.shape[0]
    for node in range(n_nodes):
        for i in range(N_STEPS):
            if steps[node, i] >= 0:
                firsts[steps[node, i] + 1] += 1
    for node in range(n_nodes):
        firsts[node + 1] += firsts[node]
    for node in range(n_nodes):
        for i in range(N_STEPS):
            there = steps[node, i]
            if there >= 0:
                befores[firsts[there]] = node
                firsts[there] += 1
    for node in range(n_nodes, 0, -1):
        firsts[node] = firsts[node - 1]
    firsts[0] = 0


@compiled
def _spread_back(firsts: Nodes, befores: Nodes, queue: Nodes, size: int, distances: Nodes) -> None:
    head = 0
    while head < size:
        node = queue[head]
        head += 1
        for k in range(firsts[node], firsts[node + 1]):
            there = befores[k]
            if distances[there] == FAR:
                distances[there] = distances[node] + 1
                queue[size] = there
                size += 1


def is_free(grid: Grid, cell: Cell) -> bool:
    """Return whether nothing stands in a cell, and something to stand on is below."""
    return grid.kind_at(cell) == AIR and grid.kind_at((cell[0], cell[1], cell[2] - 1)) in (
        Kind.GROUND,
        Kind.BLOCK,
    )
