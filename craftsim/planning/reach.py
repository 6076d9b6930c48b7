"""What can be fetched from where, and what must go before that: things within reach of some cars."""

from __future__ import annotations

from collections.abc import Collection

from craftsim.discrete.grid import Cell, Grid, Kind, Piece, beside
from craftsim.discrete.kinds import Action
from craftsim.discrete.move_graph import UNREACHABLE, Distances, MoveGraph
from craftsim.planning.assembly import Assembly, has_room, taken_out
from craftsim.planning.things import with_car


def sources(assembly: Assembly, grid: Grid, standing: Collection[Piece]) -> dict[Kind, list[Piece]]:
    """Return what can be taken up and does not stand in its place already, by the load that it makes."""
    found: dict[Kind, list[Piece]] = {}
    for thing in grid.pieces():
        if thing in standing or (thing.kind == Kind.BLOCK and thing._replace(yaw=0) in standing):
            continue
        if _can_be_taken(assembly, grid, thing):
            found.setdefault(thing.load, []).append(thing)
    return found


def _can_be_taken(assembly: Assembly, grid: Grid, thing: Piece) -> bool:
    yaw = thing.yaws[0]
    action = Action.FOLD if thing.kind == Kind.BODY else Action.LIFT
    return assembly.rules.legal(with_car(grid, thing.cell, yaw), 0, action)


class Reach:
    """What cars that wait in some states can bring."""

    def __init__(self, assembly: Assembly, standing: Collection[Piece], nodes: list[int]) -> None:
        """Take what must stay where it is, and the states."""
        self._assembly, self._standing, self._nodes = assembly, standing, nodes

    def barring(self, grid: Grid, loose: list[Piece], target: Piece) -> list[Piece]:
        """Return the loose things that must go before a place can be filled; none of the others need to."""
        gone = list(loose)
        if not self.reaches(grid, gone, target):
            return []
        near = sorted(loose, key=lambda thing: -_manhattan(thing.cell, target.cell))
        for thing in near:
            fewer = [other for other in gone if other != thing]
            if self.reaches(grid, fewer, target):
                gone = fewer
        return gone

    def reaches(self, grid: Grid, gone: list[Piece], target: Piece) -> bool:
        """Return whether a load can be driven to a place from somewhere else, once some things are gone."""
        rest = taken_out(grid, gone)
        if not has_room(rest, self._assembly.rules, target):
            return False
        graph = self._assembly.graphs.graph(rest, target.load)
        distances = graph.distances_to(graph.nodes(target.cell, target.yaws))
        walking = self._assembly.graphs.graph(rest)
        reached = walking.distances_from(self._nodes)
        for thing in grid.pieces():
            if thing in self._standing or thing.load != target.load:
                continue
            if thing in gone:
                if onward_from(distances, graph, rest, thing) < UNREACHABLE:
                    return True
            else:
                carrying = self._assembly.graphs.graph(taken_out(rest, [thing]), target.load)
                far = nearest(
                    carrying.distances_to(carrying.nodes(target.cell, target.yaws)), carrying, thing
                )
                if far < UNREACHABLE and nearest(reached, graph, thing) < UNREACHABLE:
                    return True
        return False


def nearest(distances: Distances, graph: MoveGraph, thing: Piece) -> int:
    """Return the distance of the states below a thing."""
    return min(int(distances[node]) for node in graph.nodes(thing.cell, thing.yaws))


def onward_from(distances: Distances, graph: MoveGraph, grid: Grid, thing: Piece) -> int:
    """Return the distance from a thing that has been taken up: from there, or from the next cell that is free."""
    far = nearest(distances, graph, thing)
    for direction in range(4):
        cell = beside(thing.cell, direction)
        if all(0 <= c < n for c, n in zip(cell, grid.kind.shape, strict=True)) and grid.kind[cell] in (
            Kind.AIR,
            Kind.GEAR,
        ):
            far = min(far, 1 + nearest(distances, graph, thing._replace(cell=cell)))
    return far


def _manhattan(a: Cell, b: Cell) -> int:
    return sum(abs(i - j) for i, j in zip(a, b, strict=True))
