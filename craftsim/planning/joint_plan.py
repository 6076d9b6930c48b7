"""The joint plan of all cars: each takes over one delivery after the other, planned as a whole before it is taken over.

A delivery's path avoids what all deliveries before it do. Then everything is played again by the rules: where
somebody's action has become forbidden the new path avoids that place at that time, or the delivery begins later; after
all others have ended it disturbs nobody. What a car does after its delivery, out of the others' way, is given up for
its next one.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.grid import CarField, Cell, Grid, Kind, Piece
from craftsim.discrete.kinds import Action
from craftsim.discrete.move_graph import UNREACHABLE, Distances, MoveGraph, MoveGraphs, cell_of_node
from craftsim.planning.assembly import rebuilt
from craftsim.planning.timeline import WAIT, Timeline

FLAP_TICKS: Final = 10
"""FOLD and UNFOLD take so many ticks longer than other actions."""
_DETOURS: Final = 24
"""So often a path is searched again with one more place to avoid."""
_DELAYS: Final = 6
"""So often a delivery is tried later before all others are let end first."""


@dataclass(frozen=True)
class Delivery:
    """A thing brought from where it stands, or from the car that carries it, to where it is to stand."""

    source: Piece | None
    """None: the car carries it."""
    target: Piece
    hold: bool = False
    """Whether the car keeps it there, and waits."""

    @property
    def stays(self) -> bool:
        """Whether a slope is only folded or unfolded, where it stands."""
        if self.source is None or self.source.kind == self.target.kind:
            return False
        return (self.source.cell, self.source.yaw) == (self.target.cell, self.target.yaw)


Parking = Callable[[MoveGraph, Grid], list[int]]
"""Returns the states in which a car may stay when its delivery is done."""
Saved = tuple[NDArray[np.int8], tuple[int, ...]]
"""A plan that has grown so far: its actions, and when each car's last delivery ends."""


class JointPlan:
    """The cars of a plan that grows."""

    def __init__(self, grid: Grid, graphs: MoveGraphs) -> None:
        self.size, self.n_cars = grid.size, grid.n_cars
        self.timeline = Timeline(grid, graphs.rules)
        self._graphs = graphs
        self.ready = [0] * grid.n_cars
        """The tick in which each car's last delivery ends; what it does after that is given up for the next."""

    @property
    def end(self) -> Grid:
        """The world when everything planned so far is done."""
        return self.timeline.grid(self.timeline.end)

    def saved(self) -> Saved:
        """Return what is planned, for :meth:`restore`."""
        return self.timeline.actions[: self.timeline.end].copy(), tuple(self.ready)

    def restore(self, saved: Saved) -> None:
        """Plan again what was saved."""
        actions, ready = saved
        self.timeline.reserve(len(actions))
        self.timeline.actions[:] = WAIT
        self.timeline.actions[: len(actions)] = actions
        self.timeline.shorten()
        self.timeline.replay(0)
        self.ready[:] = ready

    def node(self, car: int) -> int:
        """Return a car's state once its last delivery has ended."""
        return self.timeline.node(car, self.ready[car])

    def load(self, car: int) -> Kind:
        """Return what a car carries once its last delivery has ended."""
        return Kind(int(self.timeline.worlds.cars[self.ready[car], car, CarField.LOAD]))

    def take_over(self, car: int, delivery: Delivery, parking: Parking) -> bool:
        """Plan a delivery of a car as early as it can be; return whether there was a way."""
        saved, ready = self.saved(), self.ready[car]
        not_before = 0
        for attempt in range(_DELAYS + 1):
            last = attempt == _DELAYS or not_before >= self.timeline.end > 0
            # To wait where one would have stayed anyway disturbs nobody.
            begin = max(ready, self._last_of(car)) if last else ready
            self.timeline.write(car, begin, [])
            conflict = self._plan(car, delivery, begin, not_before, parking)
            if conflict is None:
                return True
            self.restore(saved)
            if last:
                break
            # Where there is no way now there may be one when all others have ended.
            late = conflict < 0 or attempt == _DELAYS - 1
            not_before = self.timeline.end if late else max(conflict, not_before) + 1
        return False

    def move_aside(self, car: int, keep_free: Collection[Cell]) -> bool:
        """Let a car that waits go to the nearest cell of the floor outside of some; return whether it could."""
        saved, ready = self.saved(), self.ready[car]
        self.timeline.write(car, ready, [])
        grid = self.end
        graph = self._graphs.graph(grid)
        reached = graph.distances_from([self.node(car)]) < UNREACHABLE
        others = {tuple(row[:3]) for i, row in enumerate(grid.cars.tolist()) if i != car}
        goals = [
            node
            for node in np.flatnonzero(reached).tolist()
            if (cell := cell_of_node(self.size, node)) not in keep_free
            and cell[2] == 1
            and grid.kind_at(cell) in (Kind.AIR, Kind.BLOCK)
            and cell not in others
        ]
        moved = bool(goals) and self._go(car, ready, Kind.AIR, graph.distances_to(goals), -1, 0) is not None
        if moved:
            self.ready[car] = self._last_of(car)
        if not moved or self.timeline.replay(0) is not None:
            self.restore(saved)
            return False
        return True

    def _last_of(self, car: int) -> int:
        acting = np.flatnonzero(self.timeline.actions[:, car] != WAIT)
        return int(acting[-1]) + 1 if len(acting) else 0

    def _plan(self, car: int, delivery: Delivery, tick: int, not_before: int, parking: Parking) -> int | None:
        """Plan a delivery from a tick on; return None if all is well, the tick of a conflict, or -1 without a path."""
        bring = self._turn_over if delivery.stays else self._carry
        tick = bring(car, delivery, tick, not_before)
        if tick < 0:
            return -1
        self.ready[car] = tick
        self.timeline.replay(0)
        grid = self.end
        graph = self._graphs.graph(grid)
        goals = [] if delivery.hold else parking(graph, grid)
        left = not goals or self._go(car, tick, Kind.AIR, graph.distances_to(goals), -1, 0) is not None
        if not left and delivery.target.cell[2] > 1:
            # Whoever stays up there is in the way of all others.
            return tick
        bad = self.timeline.replay(0)
        return None if bad is None else bad[0]

    def _turn_over(self, car: int, delivery: Delivery, tick: int, not_before: int) -> int:
        """Fold or unfold a slope where it stands; return the tick after, or -1."""
        graph = self._graphs.graph(self.end)
        action = Action.UNFOLD if delivery.target.kind == Kind.BODY else Action.FOLD
        nodes = graph.nodes(delivery.target)
        after = self._go(car, tick, Kind.AIR, graph.distances_to(nodes), action, not_before)
        if after is None:
            return -1
        self.timeline.actions[after - 1, car] = WAIT
        return self._swing(car, after - 1, action)

    def _carry(self, car: int, delivery: Delivery, tick: int, not_before: int) -> int:
        """Bring a thing to its place; return the tick after, or -1."""
        if delivery.source is not None:
            tick = self._fetch(car, delivery.source, delivery.target, tick, not_before)
            if tick < 0:
                return -1
        load = delivery.target.load
        graph = self._graphs.graph(self.end, load)
        goals = graph.nodes(delivery.target)
        not_before = 0 if delivery.source is not None else not_before
        last = -1 if delivery.hold else int(Action.DROP)
        after = self._go(car, tick, load, graph.distances_to(goals), last, not_before)
        if after is None or delivery.hold:
            return -1 if after is None else after
        return self._swing(car, after, Action.UNFOLD) if delivery.target.kind == Kind.BODY else after

    def _fetch(self, car: int, source: Piece, target: Piece, tick: int, not_before: int) -> int:
        """Drive to a thing and take it up; return the tick after, or -1."""
        graph = self._graphs.graph(self.end)
        nodes = self._pick_up(graph, source, target, self.timeline.node(car, tick))
        first = Action.FOLD if source.kind == Kind.BODY else Action.LIFT
        after = self._go(car, tick, Kind.AIR, graph.distances_to(nodes), first, not_before) if nodes else None
        if after is None:
            return -1
        if source.kind == Kind.BODY:
            # FOLD has been written for the moment at which it can begin; it ends much later.
            self.timeline.actions[after - 1, car] = WAIT
            after = self._swing(car, after - 1, Action.FOLD)
            self._append(car, after, [Action.LIFT])
            after += 1
        return after

    def _swing(self, car: int, tick: int, action: Action) -> int:
        self._append(car, tick, [*[WAIT] * FLAP_TICKS, action])
        return tick + FLAP_TICKS + 1

    def _append(self, car: int, tick: int, actions: list[int]) -> None:
        self.timeline.write(car, tick, actions)
        self.timeline.replay(max(0, tick - 1))

    def _pick_up(self, graph: MoveGraph, source: Piece, target: Piece, start: int) -> list[int]:
        """Return the states in which to take up a thing so that the way there and on to its place is short."""
        loaded = self._graphs.graph(rebuilt(self.end, [source]), source.load)
        there = graph.distances_from([start])
        onward = loaded.distances_to(loaded.nodes(target))
        nodes = graph.nodes(source)
        costs = {
            n: int(there[n]) + int(onward[n])
            for n in nodes
            if there[n] < UNREACHABLE and onward[n] < UNREACHABLE
        }
        return [node for node, cost in costs.items() if cost == min(costs.values())]

    def _go(
        self, car: int, tick: int, load: Kind, distances: Distances, last: int, not_before: int
    ) -> int | None:
        """Write a path to the goals and the last action; return the tick after it, or None if there is no way."""
        avoid: list[tuple[int, Cell]] = []
        for _ in range(_DETOURS):
            self.timeline.write(car, tick, [])
            self.timeline.replay(max(0, tick - 1))
            path = self.timeline.find_path(car, tick, load, distances, last, not_before, avoid)
            if path is None:
                return None
            actions = [*path, last] if last >= 0 else path
            self.timeline.write(car, tick, actions)
            bad = self.timeline.replay(max(0, tick - 1))
            after = tick + len(actions)
            if bad is None or bad[0] >= after:
                return after
            for at in (bad[0], bad[0] + 1):
                x, y, z = self.timeline.worlds.cars[at, car, :3].tolist()
                avoid.append((at, (x, y, z)))
        return None


def cells_on_path(graph: MoveGraph, node: int, distances: Distances) -> set[Cell]:
    """Return the cells of a shortest path from a state to the goals."""
    cells = set[Cell]()
    while 0 < distances[node] < UNREACHABLE:
        closer = [
            int(there) for there in graph.steps[node] if there >= 0 and distances[there] < distances[node]
        ]
        if not closer:
            break
        node = closer[0]
        cells.add(cell_of_node(graph.size, node))
    return cells
