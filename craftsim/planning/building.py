"""One plan from a start to a building: step after step is given to the car that would have made it first."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache, partial
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
    """Parameters in which one attempt differs from another."""

    noise: float = 0.0
    """Largest share by which costs are raised at random."""
    n_cars: int = 1_000
    """Largest number of cars that take part."""
    together: bool = True
    """The end counts, not only the work."""
    early: float = 0.0
    """Probability that things in the way are cleared before that has to be."""
    haste: float = 0.0
    """Share of a flap's ticks by which a turn with a slope seems cheaper, so that it begins early."""
    hold: bool = False
    """Cars keep what they clear, if it can be used later."""


@dataclass(frozen=True, eq=False)
class _WaitingCars:
    """The cars of an attempt after what is planned, a row each."""

    loads: list[Kind]
    ready: NDArray[np.int64]
    """(cars,): the ticks from which on they are free; 0 where the work alone counts."""
    ways: Distances
    """(cars, states): how far empty ones have to each state; UNREACHABLE for the others."""


@dataclass(frozen=True, eq=False)
class _TurnGroup:
    """Turns that could make one step."""

    step: int
    target: Piece
    sources: Sequence[Piece | None]
    """What could be brought to the target; None for what a car carries already."""
    pairs: NDArray[np.int64]
    """(n, 2): the rows of a source and of a car."""
    costs: NDArray[np.float64]
    """(n,) of these."""


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
        """The turns so far, and the plan after each."""
        self._script = script
        self._last_tick = last_tick
        self._done: set[int] = set()
        self._standing = fixed
        pieces = [*(step.piece for step in order), *fixed]
        cells = set()
        for piece in pieces:
            for cell in piece.cells:
                cells.add(cell)
        self._cells = cells
        """Cells of the building, and of ramps that serve only for putting it up."""
        landings = {
            beside(piece.cells[1], piece.yaw) for piece in pieces if piece.kind == Kind.BODY
        }
        self._keep_free = self._cells | landings
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
        """Number of ticks of the turns that have been planned."""
        return max(self.plan.ready)

    @property
    def n_left(self) -> int:
        """Number of things that have not been brought to their places."""
        return len(self.order) - len(self._done)

    def missing(self) -> Piece:
        """Return the first thing in the order of assembly that has not been brought to its place."""
        return next(step.piece for k, step in enumerate(self.order) if k not in self._done)

    def run(self) -> bool:
        """Make the plan; return whether it finished."""
        for turn in self._script:
            if turn is None:
                self._make_step()
            elif self._is_possible(turn):
                self._take_turn(turn)
            if self.n_ticks > self._last_tick:
                return False
        failures = 0
        while len(self._done) < len(self.order):
            progressed = (
                bool(self.style.early) and self.rng.random() < self.style.early and self._clear()
            )
            progressed = progressed or self._make_step()
            if not progressed and not self._clear():
                return False
            failures += not progressed
            if failures > _FAILURES or self.n_ticks > self._last_tick:
                return False
        return True

    def _is_possible(self, turn: Turn) -> bool:
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
        removing = k is not None and self.order[k].removes
        if removing:
            sources = list(grid.pieces())
        else:
            sources = self._loose(grid).get(source.load, [])
        return source in sources and self.assembly.has_room(rebuilt(grid, [source]), turn.target)

    def _take_turn(self, turn: Turn) -> bool:
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

    def _make_step(self) -> bool:
        """Make the step that is made first, by whom it is made first; return whether one could be made."""
        bars_nothing = cache(self._bars_nothing)
        n_tried = 0
        for turn in self._options():
            if turn.step is None or not bars_nothing(turn.step):
                continue
            if self._take_turn(turn):
                return True
            n_tried += 1
            if n_tried == _TRIES:
                break
        return False

    def _next_steps(self) -> list[int]:
        steps = [k for k in range(len(self.order)) if k not in self._done]
        return steps[: len(self._cars) + _AHEAD]

    def _pending(self) -> list[int]:
        return [
            k for k in self._next_steps() if self.assembly.possible(self._standing, self.order[k])
        ]

    def _bars_nothing(self, k: int) -> bool:
        """Return whether those steps that come before one in the order can still be made after it, with the slopes."""
        state = self.order[k].after(self._standing)
        for earlier in self._next_steps():
            if earlier >= k:
                continue
            step = self.order[earlier]
            if not self.assembly.possible(state, step):
                return False
            state = step.after(state)
            if sum(piece.load == Kind.FSLOPE for piece in state) > self._n_slopes:
                return False
        return True

    def _loose(self, grid: Grid) -> dict[Kind, list[Piece]]:
        """Return what can be taken up and does not stand in its place already, by the load that it makes."""
        loose: dict[Kind, list[Piece]] = {}
        for piece in grid.pieces():
            as_asked = piece
            if piece.kind == Kind.BLOCK:
                as_asked = piece._replace(yaw=0)
            if piece.kind == Kind.BODY:
                action = Action.FOLD
            else:
                action = Action.LIFT
            if self._standing.isdisjoint({piece, as_asked}) and self.assembly.allows(
                grid, piece, action
            ):
                loose.setdefault(piece.load, []).append(piece)
        return loose

    def _options(self) -> Iterator[Turn]:
        """Yield the turns that could make a step next, the cheapest first."""
        grid = self.plan.end
        walking = self.assembly.graphs.graph(grid)
        cars = self._waiting_cars(walking)
        loose = self._loose(grid)
        nearby = {load: _nearest(walking, cars.ways, pieces) for load, pieces in loose.items()}
        groups: list[_TurnGroup] = []
        for k in self._pending():
            step = self.order[k]
            target = step.piece
            if step.removes:
                aside = self._place_aside(grid, target, lambda moved: True)
                if aside is not None:
                    approach = _nearest(walking, cars.ways, [target])
                    onward = self._onward_to(aside)
                    groups.append(self._fetching(k, aside, [target], approach, onward, cars))
                continue
            load = target.load
            onward = self._onward_to(target)
            if load in loose:
                sources = loose[load]
                groups.append(self._fetching(k, target, sources, nearby[load], onward, cars))
            if load in cars.loads:
                groups.append(self._bringing(k, target, onward, cars))
        costs = [group.costs for group in groups]
        starts = np.cumsum([0, *map(len, costs)])
        for number in np.argsort(np.concatenate([*costs, []]), kind="stable").tolist():
            place = int(np.searchsorted(starts, number, "right")) - 1
            group = groups[place]
            source, car = group.pairs[number - starts[place]].tolist()
            yield Turn(self._cars[car], group.sources[source], group.target, group.step)

    def _waiting_cars(self, walking: MoveGraph) -> _WaitingCars:
        """Return the cars as they are after what is planned; ``walking`` is the graph of empty ones."""
        loads = [self.plan.load(car) for car in self._cars]
        ready = np.zeros(len(loads), np.int64)
        ways = np.full((len(loads), len(walking.steps)), UNREACHABLE, np.int32)
        for row, car in enumerate(self._cars):
            if self.style.together:
                ready[row] = self.plan.ready[car]
            if loads[row] == Kind.AIR:
                ways[row] = walking.distances_from([self.plan.node(car)])
        return _WaitingCars(loads, ready, ways)

    def _onward_to(self, target: Piece) -> Distances:
        """Return how far a place is from each state of a car with its load."""
        loaded = self.assembly.graphs.graph(self.plan.end, target.load)
        return loaded.distances_to(loaded.nodes(target))

    def _fetching(
        self,
        k: int,
        target: Piece,
        sources: Sequence[Piece],
        approach: NDArray[np.int64],
        onward: Distances,
        cars: _WaitingCars,
    ) -> _TurnGroup:
        """Return the turns in which empty cars fetch one of some things, ``approach`` (sources, cars) away."""
        delivery = self._distances(self.plan.end, sources, target, onward)
        swings = np.zeros(len(sources), np.int64)
        for row, piece in enumerate(sources):
            swings[row] = (piece.kind == Kind.BODY) + (target.kind == Kind.BODY)
        pairs = np.argwhere((approach < UNREACHABLE) & (delivery < UNREACHABLE)[:, None])
        i, j = pairs.T
        work = approach[i, j] + delivery[i] + 2 + swings[i] * (FLAP_TICKS + 1)
        hurry = swings[i] * self.style.haste * FLAP_TICKS * 2
        return _TurnGroup(k, target, sources, pairs, self._costs(cars.ready[j], work) - hurry)

    def _bringing(self, k: int, target: Piece, onward: Distances, cars: _WaitingCars) -> _TurnGroup:
        """Return the turns in which cars bring what they carry."""
        delivery = np.array([onward[self.plan.node(car)] for car in self._cars])
        carries = np.array(cars.loads) == target.load
        pairs = np.argwhere((carries & (delivery < UNREACHABLE))[None])
        j = pairs[:, 1]
        costs = self._costs(cars.ready[j], delivery[j] + 1)
        return _TurnGroup(k, target, [None], pairs, costs)

    def _distances(
        self, grid: Grid, sources: Sequence[Piece], target: Piece, onward: Distances
    ) -> NDArray[np.int64]:
        """Return (n,): how far it is from each of some things to a place; UNREACHABLE where it has no room there."""
        if target.load == Kind.FSLOPE:
            # It stands in two cells, and can only be driven out of in one direction: so exactly.
            exact = []
            for source in sources:
                exact.append(self._distance_alone(rebuilt(grid, [source]), source, target))
            return np.array(exact)
        distances = _onward_from(onward, grid, sources)
        room = self.assembly.has_room(grid, target)
        for i, source in enumerate(sources):
            fits = room
            # A thing in the place's own column bears it, or is in its way.
            if source.cell[:2] == target.cell[:2]:
                fits = self.assembly.has_room(rebuilt(grid, [source]), target)
            if not fits:
                distances[i] = UNREACHABLE
        return distances

    def _distance_alone(self, world: Grid, source: Piece, target: Piece) -> int:
        """Return how far it is from a thing that has been taken from the world to its place, if it has room there."""
        graph = self.assembly.graphs.graph(world, target.load)
        distance = graph.nearest(graph.distances_to(graph.nodes(target)), source)
        if distance < UNREACHABLE and self.assembly.has_room(world, target):
            return distance
        return UNREACHABLE

    def _costs(self, ready: NDArray[np.int64], work: NDArray[np.int64]) -> NDArray[np.float64]:
        return (ready + work) * (1 + self.style.noise * self.rng.random(len(work)))

    def _send_aside(self, turn: Turn) -> bool:
        """Move cars aside that wait in the way of a turn; return whether one was."""
        path = self._path_cells(turn)
        # A load needs room beside its way, too.
        around = path | _neighbours(path)
        grid = self.plan.end
        sent = False
        for car in range(self.plan.n_cars):
            car_cell = tuple(grid.cars[car, :3].tolist())
            if car != turn.car and car_cell in around and self.plan.load(car) == Kind.AIR:
                sent |= self.plan.move_aside(car, around | self._around) or self.plan.move_aside(
                    car, around | self._cells
                )
        return sent

    def _path_cells(self, turn: Turn) -> set[Cell]:
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
        occupied = {tuple(row[:3]) for i, row in enumerate(grid.cars.tolist()) if i != car}
        free = set()
        for x, y in np.argwhere(grid.kind[:, :, 1] == Kind.AIR).tolist():
            if (x, y, 1) not in occupied:
                free.add((x, y, 1))
        for building in (self._around, self._keep_free):
            cells = sorted(free - building)
            if cells:
                return _nodes_in(graph, cells)
        return []

    def _place_aside(self, grid: Grid, piece: Piece, fits: Callable[[Grid], bool]) -> Piece | None:
        """Return where a thing could stand out of the way: the nearest such place with which a world will do."""
        load = piece.load
        remaining = rebuilt(grid, [piece])
        graph = self.assembly.graphs.graph(remaining, load)
        distances = graph.distances_from(graph.nodes(piece))
        yaws = range(1)
        if load == Kind.FSLOPE:
            yaws = range(4)
        places = []
        for x, y in np.argwhere(remaining.kind[:, :, 1] == Kind.AIR).tolist():
            for yaw in yaws:
                place = Piece(load, (x, y, 1), yaw)
                if self._keep_free.isdisjoint(place.cells) and place.cell != piece.cell:
                    distance = graph.nearest(distances, place)
                    if distance < UNREACHABLE and self.assembly.has_room(remaining, place):
                        places.append((distance, place))
        for _, place in sorted(places)[:_PLACES]:
            if fits(rebuilt(remaining, added=[place])):
                return place
        return None

    def _clear(self) -> bool:
        """Move something that bars the next step out of the way; return whether that was possible."""
        grid = self.plan.end
        loose = []
        for pieces in self._loose(grid).values():
            for piece in pieces:
                loose.append(piece)
        nodes = [self.plan.node(car) for car in self._cars]
        for k in self._pending():
            step = self.order[k]
            if step.removes:
                continue
            barring = self._barring(grid, nodes, loose, step.piece)
            for piece in barring:
                remaining = [barrier for barrier in barring if barrier != piece]
                fits = partial(self._reaches, nodes=nodes, removed=remaining, target=step.piece)
                aside = self._place_aside(grid, piece, fits)
                if aside is None:
                    continue
                free = [car for car in self._cars if self.plan.load(car) == Kind.AIR]
                hold = self.style.hold and len(free) > 1 and self._is_wanted(piece.load)
                for car in sorted(free, key=lambda car: self.plan.ready[car]):
                    if self._take_turn(Turn(car, piece, aside, hold=hold)):
                        return True
        return False

    def _is_wanted(self, load: Kind) -> bool:
        """Return whether more steps need such a load than there are cars that carry one."""
        n_needed = 0
        for k, step in enumerate(self.order):
            if k not in self._done and not step.removes and step.piece.load == load:
                n_needed += 1
        return n_needed > sum(self.plan.load(car) == load for car in self._cars)

    def _barring(
        self, grid: Grid, nodes: list[int], loose: list[Piece], target: Piece
    ) -> list[Piece]:
        """Return the loose things that must go before a place can be filled; none of the others need to."""
        barring = list(loose)
        if not self._reaches(grid, nodes, barring, target):
            return []
        for piece in sorted(
            loose, key=lambda piece: -sum(map(abs, np.subtract(piece.cell, target.cell)))
        ):
            fewer = [barrier for barrier in barring if barrier != piece]
            if self._reaches(grid, nodes, fewer, target):
                barring = fewer
        return barring

    def _reaches(
        self, grid: Grid, nodes: list[int], removed: Collection[Piece], target: Piece
    ) -> bool:
        """Return whether cars that wait can drive a load to a place from somewhere else, once some things are gone."""
        graphs = self.assembly.graphs
        remaining = rebuilt(grid, removed)
        if not self.assembly.has_room(remaining, target):
            return False
        graph = graphs.graph(remaining, target.load)
        distances = graph.distances_to(graph.nodes(target))
        reached = graphs.graph(remaining).distances_from(nodes)
        for piece in grid.pieces():
            if piece in self._standing or piece.load != target.load:
                continue
            if piece in removed:
                distance = int(_onward_from(distances, remaining, [piece])[0])
            else:
                carrying = graphs.graph(rebuilt(remaining, [piece]), target.load)
                distance = carrying.nearest(carrying.distances_to(carrying.nodes(target)), piece)
                distance = max(distance, graph.nearest(reached, piece))
            if distance < UNREACHABLE:
                return True
        return False


def _nearest(graph: MoveGraph, distances: Distances, pieces: Sequence[Piece]) -> NDArray[np.int64]:
    """Return (n, m): how far n things are by each of (m, nodes) distances."""
    nodes = np.array([graph.nodes(piece) * (4 // len(piece.yaws)) for piece in pieces])
    return distances[:, nodes].min(axis=-1).T.astype(np.int64)


def _onward_from(distances: Distances, grid: Grid, pieces: Sequence[Piece]) -> NDArray[np.int64]:
    """Return (n,): the distances of things of equal yaws once taken up, from there or from the next free cell."""
    length, width, height = grid.size
    by_yaw = distances.reshape(length, width, height + 2, 4)[
        :, :, : height + 1, list(pieces[0].yaws)
    ]
    best = by_yaw.min(axis=-1)
    free = np.isin(grid.kind, (Kind.AIR, Kind.GEAR))
    padded = np.pad(
        np.where(free, best, UNREACHABLE), ((1, 1), (1, 1), (0, 0)), constant_values=UNREACHABLE
    )
    x, y, z = np.array([piece.cell for piece in pieces]).T
    around = [padded[x + 1 + dx, y + 1 + dy, z] for dx, dy in DIRECTIONS.tolist()]
    return np.minimum(best[x, y, z], np.min(around, axis=0) + 1).astype(np.int64)


def _cells_on_path(graph: MoveGraph, node: int, distances: Distances) -> set[Cell]:
    """Return the cells of a shortest path from a state to the goals."""
    cells = set[Cell]()
    while 0 < distances[node] < UNREACHABLE:
        # There is one: the path comes from there.
        for following in graph.steps[node].tolist():
            if following >= 0 and distances[following] < distances[node]:
                node = following
                break
        cells.add(cell_of_node(graph.size, node))
    return cells


def _neighbours(cells: Iterable[Cell]) -> set[Cell]:
    """Return the cells beside some cells, at the same level."""
    neighbours = set()
    for cell in cells:
        for yaw in range(4):
            neighbours.add(beside(cell, yaw))
    return neighbours


def _nodes_in(graph: MoveGraph, cells: Iterable[Cell]) -> list[int]:
    """Return the states of a car in some cells, with any yaw."""
    nodes = []
    for cell in cells:
        for yaw in range(4):
            nodes.append(graph.node(cell, yaw))
    return nodes
