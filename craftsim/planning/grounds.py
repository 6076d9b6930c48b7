"""Where nothing may be put aside, and where cars may wait: on floor that a building leaves free."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Final

import numpy as np

from craftsim.discrete.grid import Grid, Kind, Piece, beside
from craftsim.discrete.move_graph import UNREACHABLE, MoveGraph
from craftsim.planning.assembly import Assembly, has_room, taken_out
from craftsim.planning.things import put

_PLACES: Final = 24
"""So many places where something could be put aside are looked at."""


class Grounds:
    """The cells of a building and around it."""

    def __init__(self, assembly: Assembly, things: Iterable[Piece]) -> None:
        """Take the things of the building, and the ramps that serve only for putting it up."""
        self._assembly, things = assembly, list(things)
        self.cells = {cell for thing in things for cell in thing.cells}
        """Those in which something is to stand."""
        self._keep_free = self.cells | {
            beside(thing.cells[1], thing.yaw) for thing in things if thing.kind == Kind.BODY
        }
        self.around = {
            (x + dx, y + dy, 1) for x, y, _ in self._keep_free for dx in range(-2, 3) for dy in range(-2, 3)
        }
        """The floor up to two cells away."""

    def parking(self, car: int) -> Callable[[MoveGraph, Grid], list[int]]:
        """Return what says where a car may wait: on free floor, best two cells away from what is being built."""

        def places(graph: MoveGraph, grid: Grid) -> list[int]:
            taken = {tuple(row[:3]) for i, row in enumerate(grid.cars.tolist()) if i != car}
            free = {(x, y, 1) for x, y in np.argwhere(grid.kind[:, :, 1] == Kind.AIR).tolist()} - taken
            for kept in (self.around, self._keep_free):
                cells = sorted(free - kept)
                if cells:
                    return [graph.node(cell, yaw) for cell in cells for yaw in range(4)]
            return []

        return places

    def aside(self, grid: Grid, thing: Piece, fits: Callable[[Grid], bool]) -> Piece | None:
        """Return where a thing could stand out of the way: the nearest such place with which a world will do."""
        load = thing.load
        rest = taken_out(grid, [thing])
        graph = self._assembly.graphs.graph(rest, load)
        distances = graph.distances_from(graph.nodes(thing.cell, thing.yaws))
        places = []
        for x, y in np.argwhere(rest.kind[:, :, 1] == Kind.AIR).tolist():
            for yaw in range(4) if load == Kind.FSLOPE else [0]:
                there = Piece(load, (x, y, 1), yaw)
                far = min(int(distances[node]) for node in graph.nodes(there.cell, there.yaws))
                free = set(there.cells).isdisjoint(self._keep_free)
                if (
                    free
                    and far < UNREACHABLE
                    and there.cell != thing.cell
                    and has_room(rest, self._assembly.rules, there)
                ):
                    places.append((far, there))
        for _, there in sorted(places)[:_PLACES]:
            moved = rest.copy()
            put(moved, [there])
            moved.derive_marks()
            if fits(moved):
                return there
        return None
