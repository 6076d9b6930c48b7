"""One plan from a start to a building: step after step is given to the car that would have made it first."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from functools import cache, partial
from itertools import islice
from typing import Final

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.geometry import DIRECTIONS
from craftsim.discrete.grid import Cell, Grid, Kind, Piece, beside
from craftsim.discrete.kinds import Action
from craftsim.discrete.move_graph import UNREACHABLE, Distances, MoveGraph, cell_of_node
from craftsim.planning.assembly import Assembly, Order, State, loads_of, rebuilt
from craftsim.planning.joint_plan import FLAP_TICKS, JointPlan, Saved, Turn

_FAILURES: Final = 40
"""Number of failed turns that ends an attempt."""
_TRIES: Final = 6
"""Turns that are tried before something is cleared away."""
_AHEAD: Final = 3
"""Steps that are considered next, beyond one for each car."""
_PLACES: Final = 24
"""Places that are considered for an object that is put aside."""


@dataclass(frozen=True)
class Style:
    """What makes one attempt differ from another."""

    noise: float = 0.0
    """By up to this share costs are raised at random."""
    n_cars: int = 1_000
    """So many cars take part at most."""
    together: bool = True
    """Whether the end counts, or only the work."""
    early: float = 0.0
    """How often things in the way are cleared before that has to be."""
    haste: float = 0.0
    """By how many of its ticks a slope's turn of the flap makes a turn seem cheaper, so that it begins early."""
    hold: bool = False
    """Whether cars keep what they clear, if it can be used later."""


class Construction:
    """An attempt to build; :meth:`run` makes the plan, unless it takes more ticks than ``last_tick``.

    It may begin with ``past``, turns of another attempt with what came of each, and go on with the turns ``script``,
    of which those are left out that have become impossible; None is whatever seems best then.
    """

    def __init__(
        self,
        start: Grid,
        assembly: Assembly,
        order: Order,
        fixed: State,
        style: Style,
        rng: np.random.Generator,
        last_tick: float = math.inf,
        past: Sequence[tuple[Turn, Saved]] = (),
        script: Sequence[Turn | None] = (),
    ) -> None:
        self.plan = JointPlan(start, assembly.graphs, assembly.check_time)
        self.assembly = assembly
        self.order = order
        self.style = style
        self.rng = rng
        self.turns = list(past)
        """What was done so far, and the plan after each."""
        self._script = script
        self._last_tick = last_tick
        self._done: set[int] = set()
        self._standing = fixed
        things = [*(step.thing for step in order), *fixed]
        cells = set()
        for thing in things:
            for cell in thing.cells:
                cells.add(cell)
        self._cells = cells
        """Those of the building, and of ramps that serve only for putting it up."""
        self._keep_free = self._cells | {
            beside(thing.cells[1], thing.yaw) for thing in things if thing.kind == Kind.BODY
        }
        around = set()
        for x, y, _ in self._keep_free:
            for dx in range(-2, 3):
                for dy in range(-2, 3):
                    around.add((x + dx, y + dy, 1))
        self._around = around
        """The floor up to two cells away."""
        self._n_slopes = loads_of(start)[Kind.FSLOPE]
        n_cars = min(start.n_cars, style.n_cars)
        self._cars = sorted(self.rng.permutation(start.n_cars)[:n_cars].tolist())
        for turn, _ in past:
            self._note(turn.step)
        if past:
            self.plan.restore(past[-1][1])

    @property
    def n_ticks(self) -> int:
        """How many ticks the turns take that have been planned."""
        return max(self.plan.ready)

    @property
    def n_left(self) -> int:
        """How many things have not been brought to their places."""
        return len(self.order) - len(self._done)

    def missing(self) -> Piece:
        """Return the first thing in the order of assembly that has not been brought to its place."""
        return next(step.thing for k, step in enumerate(self.order) if k not in self._done)

    def run(self) -> bool:
        """Make the plan; return whether it finished."""
        for turn in self._script:
            if turn is None:
                self._place()
            elif self._fits(turn):
                self._take(turn)
            if self.n_ticks > self._last_tick:
                return False
        failures = 0
        while len(self._done) < len(self.order):
            made = bool(self.style.early) and self.rng.random() < self.style.early and self._clear()
            made = made or self._place()
            if not made and not self._clear():
                return False
            failures += not made
            if failures > _FAILURES or self.n_ticks > self._last_tick:
                return False
        return True

    def _fits(self, turn: Turn) -> bool:
        k = turn.step
        source = turn.source
        if k is not None and (
            k in self._done
            or not self.assembly.possible(self._standing, self.order[k])
            or not self._bars_nothing(k)
        ):
            return False
        load = self.plan.load(turn.car)
        if source is None or load != Kind.AIR:
            return source is None and load == turn.target.load
        grid = self.plan.end
        taken = k is not None and self.order[k].taken
        here = grid.pieces() if taken else self._loose(grid).get(source.load, [])
        return source in here and self.assembly.has_room(rebuilt(grid, [source]), turn.target)

    def _take(self, turn: Turn) -> bool:
        """Plan a turn; return whether there is a way. Cars that wait in its way are sent aside once."""
        parking = partial(self._parking, turn.car)
        if not self.plan.take_over(turn, parking) and not (
            self._send_aside(turn) and self.plan.take_over(turn, parking)
        ):
            return False
        self._note(turn.step)
        self.turns.append((turn, self.plan.saved()))
        return True

    def _note(self, k: int | None) -> None:
        if k is not None:
            self._done.add(k)
            self._standing = self.order[k].after(self._standing)

    def _place(self) -> bool:
        """Make the step that is made first, by whom it is made first; return whether one could be made."""
        bars_nothing = cache(self._bars_nothing)
        safe = (turn for turn in self._options() if turn.step is not None and bars_nothing(turn.step))
        return any(map(self._take, islice(safe, _TRIES)))

    def _left(self) -> list[int]:
        left = [k for k in range(len(self.order)) if k not in self._done]
        return left[: len(self._cars) + _AHEAD]

    def _pending(self) -> list[int]:
        return [k for k in self._left() if self.assembly.possible(self._standing, self.order[k])]

    def _bars_nothing(self, k: int) -> bool:
        """Return whether those steps that come before one in the order can still be made after it, with the slopes."""
        state = self.order[k].after(self._standing)
        for step in (self.order[earlier] for earlier in self._left() if earlier < k):
            if not self.assembly.possible(state, step):
                return False
            state = step.after(state)
            if sum(thing.load == Kind.FSLOPE for thing in state) > self._n_slopes:
                return False
        return True

    def _loose(self, grid: Grid) -> dict[Kind, list[Piece]]:
        """Return what can be taken up and does not stand in its place already, by the load that it makes."""
        found: dict[Kind, list[Piece]] = {}
        for thing in grid.pieces():
            as_asked = thing
            if thing.kind == Kind.BLOCK:
                as_asked = thing._replace(yaw=0)
            if thing.kind == Kind.BODY:
                action = Action.FOLD
            else:
                action = Action.LIFT
            if self._standing.isdisjoint({thing, as_asked}) and self.assembly.allows(grid, thing, action):
                found.setdefault(thing.load, []).append(thing)
        return found

    def _options(self) -> Iterator[Turn]:
        """Yield the turns that could make a step next, the cheapest first."""
        grid = self.plan.end
        graphs = self.assembly.graphs
        cars = self._cars
        walking = graphs.graph(grid)
        loose = self._loose(grid)
        loads = [self.plan.load(car) for car in cars]
        far_off = np.full(len(walking.steps), UNREACHABLE, np.int32)
        to_cells = np.stack(
            [
                walking.distances_from([self.plan.node(car)]) if load == Kind.AIR else far_off
                for car, load in zip(cars, loads, strict=True)
            ]
        )
        begun = np.array([self.plan.ready[car] if self.style.together else 0 for car in cars])
        nearby = {load: _nearest(walking, to_cells, things) for load, things in loose.items()}
        groups: list[tuple[int, Piece, Sequence[Piece | None], NDArray[np.int64]]] = []
        costs: list[NDArray[np.float64]] = []
        for k in self._pending():
            step = self.order[k]
            target = step.thing
            if step.taken:
                aside = self._aside(grid, target, lambda moved: True)
                if aside is None:
                    continue
                target = aside
            load = target.load
            loaded = graphs.graph(grid, load)
            onward = loaded.distances_to(loaded.nodes(target))
            if step.taken:
                sources = [step.thing]
            else:
                sources = loose.get(load, [])
            if sources:
                if step.taken:
                    near = _nearest(walking, to_cells, sources)
                else:
                    near = nearby[load]
                far = self._far(grid, sources, target, onward)
                swings = np.array([(one.kind == Kind.BODY) + (target.kind == Kind.BODY) for one in sources])
                pairs = np.argwhere((near < UNREACHABLE) & (far < UNREACHABLE)[:, None])
                i, j = pairs.T
                work = near[i, j] + far[i] + 2 + swings[i] * (FLAP_TICKS + 1)
                groups.append((k, target, sources, pairs))
                costs.append(self._costs(begun[j], work) - swings[i] * self.style.haste * FLAP_TICKS * 2)
            if not step.taken and load in loads:
                far = np.array([onward[self.plan.node(car)] for car in cars])
                pairs = np.argwhere((np.array(loads) == load)[None] & (far < UNREACHABLE))
                j = pairs[:, 1]
                groups.append((k, target, [None], pairs))
                costs.append(self._costs(begun[j], far[j] + 1))
        starts = np.cumsum([0, *map(len, costs)])
        for number in np.argsort(np.concatenate([*costs, []]), kind="stable").tolist():
            group = int(np.searchsorted(starts, number, "right")) - 1
            k, target, sources_of, pairs = groups[group]
            source, car = pairs[number - starts[group]].tolist()
            yield Turn(cars[car], sources_of[source], target, k)

    def _far(
        self, grid: Grid, sources: Sequence[Piece], target: Piece, onward: Distances
    ) -> NDArray[np.int64]:
        """Return (n,): how far it is from each of some things to a place; UNREACHABLE where it has no room there."""
        if target.load == Kind.FSLOPE:
            # It stands in two cells, and can only be driven out of in one direction: so exactly.
            return np.array([self._far_alone(rebuilt(grid, [one]), one, target) for one in sources])
        far = _onward_from(onward, grid, sources)
        room = self.assembly.has_room(grid, target)
        for i, one in enumerate(sources):
            # A thing in the place's own column bears it, or is in its way.
            same = one.cell[:2] == target.cell[:2]
            if not (self.assembly.has_room(rebuilt(grid, [one]), target) if same else room):
                far[i] = UNREACHABLE
        return far

    def _far_alone(self, rest: Grid, source: Piece, target: Piece) -> int:
        """Return how far it is from a thing that has been taken from the world to its place, if it has room there."""
        graph = self.assembly.graphs.graph(rest, target.load)
        far = graph.nearest(graph.distances_to(graph.nodes(target)), source)
        if far < UNREACHABLE and self.assembly.has_room(rest, target):
            return far
        return UNREACHABLE

    def _costs(self, begun: NDArray[np.int64], work: NDArray[np.int64]) -> NDArray[np.float64]:
        return (begun + work) * (1 + self.style.noise * self.rng.random(len(work)))

    def _send_aside(self, turn: Turn) -> bool:
        """Move cars aside that wait in the way of a turn; return whether one was."""
        way = self._way(turn)
        # A load needs room beside its way, too.
        near = way | {beside(cell, yaw) for cell in way for yaw in range(4)}
        grid = self.plan.end
        sent = False
        for other in range(self.plan.n_cars):
            here = tuple(grid.cars[other, :3].tolist())
            if other != turn.car and here in near and self.plan.load(other) == Kind.AIR:
                sent |= any(self.plan.move_aside(other, near | kept) for kept in (self._around, self._cells))
        return sent

    def _way(self, turn: Turn) -> set[Cell]:
        """Return the cells of the straight way to a thing and on to its place, as if there were no other cars."""
        grid = self.plan.end
        graphs = self.assembly.graphs
        source = turn.source
        target = turn.target
        node = self.plan.node(turn.car)
        cells = {target.cell}
        if source is not None:
            graph = graphs.graph(grid)
            cells |= _cells_on_path(graph, node, graph.distances_to(graph.nodes(source)))
            grid = rebuilt(grid, [source])
        graph = graphs.graph(grid, target.load)
        distances = graph.distances_to(graph.nodes(target))
        if source is not None:
            node = min(graph.nodes(source), key=lambda node: int(distances[node]))
        return cells | _cells_on_path(graph, node, distances)

    def _parking(self, car: int, graph: MoveGraph, grid: Grid) -> list[int]:
        """Return where a car may wait: on free floor, best two cells away from what is being built."""
        taken = {tuple(row[:3]) for i, row in enumerate(grid.cars.tolist()) if i != car}
        free = {(x, y, 1) for x, y in np.argwhere(grid.kind[:, :, 1] == Kind.AIR).tolist()} - taken
        for kept in (self._around, self._keep_free):
            cells = sorted(free - kept)
            if cells:
                return [graph.node(cell, yaw) for cell in cells for yaw in range(4)]
        return []

    def _aside(self, grid: Grid, thing: Piece, fits: Callable[[Grid], bool]) -> Piece | None:
        """Return where a thing could stand out of the way: the nearest such place with which a world will do."""
        load = thing.load
        rest = rebuilt(grid, [thing])
        graph = self.assembly.graphs.graph(rest, load)
        distances = graph.distances_from(graph.nodes(thing))
        places = []
        for x, y in np.argwhere(rest.kind[:, :, 1] == Kind.AIR).tolist():
            for yaw in range(4) if load == Kind.FSLOPE else [0]:
                there = Piece(load, (x, y, 1), yaw)
                if self._keep_free.isdisjoint(there.cells) and there.cell != thing.cell:
                    far = graph.nearest(distances, there)
                    if far < UNREACHABLE and self.assembly.has_room(rest, there):
                        places.append((far, there))
        nearest = (there for _, there in sorted(places)[:_PLACES])
        return next((there for there in nearest if fits(rebuilt(rest, put=[there]))), None)

    def _clear(self) -> bool:
        """Move something that bars the next step out of the way; return whether that was possible."""
        grid = self.plan.end
        loose = []
        for things in self._loose(grid).values():
            for thing in things:
                loose.append(thing)
        nodes = [self.plan.node(car) for car in self._cars]
        for step in (self.order[k] for k in self._pending() if not self.order[k].taken):
            barring = self._barring(grid, nodes, loose, step.thing)
            for thing in barring:
                others = [other for other in barring if other != thing]
                fits = partial(self._reaches, nodes=nodes, gone=others, target=step.thing)
                aside = self._aside(grid, thing, fits)
                if aside is None:
                    continue
                free = [car for car in self._cars if self.plan.load(car) == Kind.AIR]
                hold = self.style.hold and len(free) > 1 and self._is_wanted(thing.load)
                for car in sorted(free, key=lambda car: self.plan.ready[car]):
                    if self._take(Turn(car, thing, aside, hold=hold)):
                        return True
        return False

    def _is_wanted(self, load: Kind) -> bool:
        """Return whether more steps need such a load than there are cars that carry one."""
        left = [step for k, step in enumerate(self.order) if k not in self._done and not step.taken]
        wanted = sum(step.thing.load == load for step in left)
        return wanted > sum(self.plan.load(car) == load for car in self._cars)

    def _barring(self, grid: Grid, nodes: list[int], loose: list[Piece], target: Piece) -> list[Piece]:
        """Return the loose things that must go before a place can be filled; none of the others need to."""
        gone = list(loose)
        if not self._reaches(grid, nodes, gone, target):
            return []
        for thing in sorted(loose, key=lambda one: -sum(map(abs, np.subtract(one.cell, target.cell)))):
            fewer = [other for other in gone if other != thing]
            if self._reaches(grid, nodes, fewer, target):
                gone = fewer
        return gone

    def _reaches(self, grid: Grid, nodes: list[int], gone: Collection[Piece], target: Piece) -> bool:
        """Return whether cars that wait can drive a load to a place from somewhere else, once some things are gone."""
        graphs = self.assembly.graphs
        rest = rebuilt(grid, gone)
        if not self.assembly.has_room(rest, target):
            return False
        graph = graphs.graph(rest, target.load)
        distances = graph.distances_to(graph.nodes(target))
        reached = graphs.graph(rest).distances_from(nodes)
        for thing in grid.pieces():
            if thing in self._standing or thing.load != target.load:
                continue
            if thing in gone:
                far = int(_onward_from(distances, rest, [thing])[0])
            else:
                carrying = graphs.graph(rebuilt(rest, [thing]), target.load)
                far = carrying.nearest(carrying.distances_to(carrying.nodes(target)), thing)
                far = max(far, graph.nearest(reached, thing))
            if far < UNREACHABLE:
                return True
        return False


def _nearest(graph: MoveGraph, distances: Distances, things: Sequence[Piece]) -> NDArray[np.int64]:
    """Return (n, m): how far n things are by each of (m, nodes) distances."""
    nodes = np.array([graph.nodes(thing) * (4 // len(thing.yaws)) for thing in things])
    return distances[:, nodes].min(axis=-1).T.astype(np.int64)


def _onward_from(distances: Distances, grid: Grid, things: Sequence[Piece]) -> NDArray[np.int64]:
    """Return (n,): the distances of things of equal yaws once taken up, from there or from the next free cell."""
    length, width, height = grid.size
    by_yaw = distances.reshape(length, width, height + 2, 4)[:, :, : height + 1, list(things[0].yaws)]
    best = by_yaw.min(axis=-1)
    free = np.isin(grid.kind, (Kind.AIR, Kind.GEAR))
    beyond = np.pad(np.where(free, best, UNREACHABLE), ((1, 1), (1, 1), (0, 0)), constant_values=UNREACHABLE)
    x, y, z = np.array([one.cell for one in things]).T
    around = [beyond[x + 1 + dx, y + 1 + dy, z] for dx, dy in DIRECTIONS.tolist()]
    return np.minimum(best[x, y, z], np.min(around, axis=0) + 1).astype(np.int64)


def _cells_on_path(graph: MoveGraph, node: int, distances: Distances) -> set[Cell]:
    """Return the cells of a shortest path from a state to the goals."""
    cells = set[Cell]()
    while 0 < distances[node] < UNREACHABLE:
        # There is one: the path comes from there.
        node = next(
            one for one in graph.steps[node].tolist() if one >= 0 and distances[one] < distances[node]
        )
        cells.add(cell_of_node(graph.size, node))
    return cells
