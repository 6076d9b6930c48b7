"""The joint plan of all cars: each makes one turn after the other, planned as a whole before the next one is.

A turn's path avoids what all turns before it do. Then everything is played again by the rules: where somebody's action
has become forbidden the new path avoids that place at that time, or the turn begins later. What a car does after its
turn, out of the others' way, is given up for its next one. A path is found by A* over states and ticks; a step is
possible if the rules allow it both before and after what the others do in its tick, whatever their order.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from craftsim.compiled.jit import compiled
from craftsim.discrete.grid import CarField, Cell, Grid, Kind, Piece
from craftsim.discrete.kernel.codes import LAST_MOVE, ROTATE_LEFT
from craftsim.discrete.kernel.rules import act, legal_actions
from craftsim.discrete.kernel.search import SUCCESSORS, node_of
from craftsim.discrete.kernel.state import DERIVED_MARKS, World, after, car_in, derive_marks
from craftsim.discrete.kinds import Action, PlanTick
from craftsim.discrete.move_graph import (
    N_STEPS,
    UNREACHABLE,
    Distances,
    MoveGraph,
    MoveGraphs,
    cell_of_node,
    node_number,
    state_at_node,
)
from craftsim.planning.assembly import rebuilt

WAIT: Final = -1
"""No action: the car does nothing in this tick."""
FLAP_TICKS: Final = 10
"""Ticks that FOLD and UNFOLD take beyond the one of other actions."""
_DETOURS: Final = 24
"""Searches for one path, each with one more place to avoid."""
_DELAYS: Final = 6
"""Attempts to begin a turn later; the last one begins when all others have ended."""
_LEFT_OUT: Final = (-9, -9, -9, 0, Kind.AIR, 0, 0)
"""A car that is left out, fields as CarField: far from all cells, so that no rule sees it."""
_FIRST_TICKS: Final = 64
_MAX_TICKS: Final = 320
"""Longest path."""

Parking = Callable[[MoveGraph, Grid], list[int]]
"""Returns the states in which a car may stay when its turn is done."""
Saved = tuple[NDArray[np.int8], tuple[int, ...]]
"""A plan that has grown so far: its actions, and when each car's last turn ends."""


class Turn(NamedTuple):
    """A car's task: to bring a thing from where it stands, or from the car, to where it is to stand."""

    car: int
    source: Piece | None
    """None: the car carries it."""
    target: Piece
    step: int | None = None
    """The step of the order of assembly that it makes; None where it clears the way."""
    hold: bool = False
    """The car keeps the thing there, and waits."""

    @property
    def stays(self) -> bool:
        """Whether a slope is only folded or unfolded, where it stands."""
        source = self.source
        target = self.target
        return (
            source is not None and source != target and source == target._replace(kind=source.kind)
        )


class JointPlan:
    """The actions of all cars by tick, (T, n), and the worlds that follow from them by the rules."""

    def __init__(
        self, grid: Grid, graphs: MoveGraphs, check_time: Callable[[], None] = lambda: None
    ) -> None:
        """Begin with a world; ``check_time`` is called now and then, and raises TimeoutError when the time is up."""
        self._check_time = check_time
        self.size = grid.size
        self.n_cars = grid.n_cars
        self.rules = graphs.rules
        self._graphs = graphs
        self.actions = np.full((_FIRST_TICKS, grid.n_cars), WAIT, np.int8)
        self.n_ticks = 0
        """The first tick in which nothing is done any more."""
        self.ready = [0] * grid.n_cars
        """The tick in which each car's last turn ends; what it does after that is given up for the next."""
        self._grids = Grid.stack([grid] * _FIRST_TICKS)
        """The worlds before tick 0, 1, 2, ..."""
        self._others = self._grids.copy()
        self._n_nodes = node_number(grid.size, (grid.size[0], 0, 0), 0)
        self._searches = 0
        self._heads = np.empty(2 * _MAX_TICKS + 2, np.int32)
        self._make_states(0)

    @property
    def end(self) -> Grid:
        """The world when everything planned so far is done."""
        return self.grid(self.n_ticks)

    def grid(self, tick: int) -> Grid:
        """Return the world before a tick."""
        return self._grids[tick].copy()

    def node(self, car: int, tick: int | None = None) -> int:
        """Return a car's state before a tick; unless given, when its last turn has ended."""
        if tick is None:
            tick = self.ready[car]
        x, y, z, yaw = self._grids.cars[tick, car, :4].tolist()
        return node_number(self.size, (x, y, z), yaw)

    def load(self, car: int) -> Kind:
        """Return what a car carries once its last turn has ended."""
        return Kind(int(self._grids.cars[self.ready[car], car, CarField.LOAD]))

    def ticks(self) -> tuple[PlanTick, ...]:
        """Return the plan."""
        ticks = []
        for actions in self.actions[: self.n_ticks].tolist():
            tick = [(car, Action(action)) for car, action in enumerate(actions) if action != WAIT]
            ticks.append(tuple(tick))
        return tuple(ticks)

    def saved(self) -> Saved:
        """Return what is planned, for :meth:`restore`."""
        return self.actions[: self.n_ticks].copy(), tuple(self.ready)

    def restore(self, saved: Saved) -> None:
        """Plan again what was saved."""
        actions, ready = saved
        self._reserve(len(actions))
        self.actions[:] = WAIT
        self.actions[: len(actions)] = actions
        self._shorten()
        self.replay(0)
        self.ready[:] = ready

    def write(self, car: int, tick: int, actions: list[int]) -> int | None:
        """Let a car do these actions from a tick on, and nothing after them; return as :meth:`replay` does."""
        self._reserve(max(self.n_ticks, tick + len(actions)))
        self.actions[tick:, car] = WAIT
        self.actions[tick : tick + len(actions), car] = actions
        self._shorten()
        return self.replay(max(0, tick - 1))

    def replay(self, tick: int) -> int | None:
        """Work out the worlds after a tick; return the first tick with an action that is forbidden, or None."""
        worlds = self._grids.world(self.rules.corrections, self.rules.patterns)
        bad = int(_replay(worlds, self.actions, tick, self.n_ticks, -1))
        if bad < 0:
            return None
        return bad

    def without(self, car: int, tick: int) -> World:
        """Return the worlds as they are from a tick on if a car does not exist any more; valid until the next call."""
        self._others.cells[tick] = self._grids.cells[tick]
        self._others.cars[tick] = self._grids.cars[tick]
        self._others.cars[tick, car] = _LEFT_OUT
        without = self._others.world(self.rules.corrections, self.rules.patterns)
        _replay(without, self.actions, tick, self.n_ticks, car)
        return without

    def trim(self, reached: Callable[[Grid], bool]) -> None:
        """Take the last actions of each car away as long as a goal is reached without them."""
        for car in range(self.n_cars):
            for tick in np.flatnonzero(self.actions[:, car] != WAIT)[::-1].tolist():
                action = self.actions[tick, car]
                self.actions[tick, car] = WAIT
                if self.replay(tick) is None and reached(self.end):
                    continue
                self.actions[tick, car] = action
                self.replay(tick)
                break
        self._shorten()

    def take_over(self, turn: Turn, parking: Parking) -> bool:
        """Plan a turn as early as it can be; return whether there was a way."""
        saved = self.saved()
        ready = self.ready[turn.car]
        not_before = 0
        for attempt in range(_DELAYS + 1):
            last = attempt == _DELAYS or not_before >= self.n_ticks > 0
            # To wait where one would have stayed anyway disturbs nobody.
            begin = ready
            if last:
                begin = max(ready, self._end_of_last(turn.car))
            conflict = self._plan(turn, begin, not_before, parking)
            if conflict is None:
                return True
            self.restore(saved)
            if last:
                break
            # Where there is no way now there may be one when all others have ended.
            late = conflict < 0 or attempt == _DELAYS - 1
            if late:
                not_before = self.n_ticks
            else:
                not_before = max(conflict, not_before) + 1
        return False

    def move_aside(self, car: int, keep_free: Collection[Cell]) -> bool:
        """Let a car that waits go to the nearest cell of the floor outside of some; return whether it could."""
        saved = self.saved()
        ready = self.ready[car]
        self._erase(car, ready)
        grid = self.end
        graph = self._graphs.graph(grid)
        reached = graph.distances_from([self.node(car)]) < UNREACHABLE
        occupied = {tuple(row[:3]) for i, row in enumerate(grid.cars.tolist()) if i != car}.union(
            keep_free
        )
        goals = []
        for node in np.flatnonzero(reached).tolist():
            cell = cell_of_node(self.size, node)
            if (
                cell not in occupied
                and cell[2] == 1
                and grid.kind_at(cell) in (Kind.AIR, Kind.BLOCK)
            ):
                goals.append(node)
        moved = bool(goals) and self._drive(car, ready, graph.distances_to(goals)) is not None
        if moved:
            self.ready[car] = self._end_of_last(car)
        if not moved or self.replay(0) is not None:
            self.restore(saved)
            return False
        return True

    def _erase(self, car: int, tick: int) -> None:
        """Let a car do nothing from a tick on.

        The worlds stay as they are: while it has not left yet, actions of others may be forbidden that are not later.
        """
        self.actions[tick:, car] = WAIT
        self._shorten()

    def _end_of_last(self, car: int) -> int:
        acting = np.flatnonzero(self.actions[:, car] != WAIT)
        if len(acting):
            return int(acting[-1]) + 1
        return 0

    def _plan(self, turn: Turn, tick: int, not_before: int, parking: Parking) -> int | None:
        """Plan a turn from a tick on; return None if all is well, the tick of a conflict, or -1 without a path."""
        car = turn.car
        self._erase(car, tick)
        if turn.stays:
            if turn.target.kind == Kind.BODY:
                action = Action.UNFOLD
            else:
                action = Action.FOLD
            after = self._act_at(car, tick, turn.target, action, not_before)
        else:
            after = self._carry(turn, tick, not_before)
        if after is None:
            return -1
        self.ready[car] = after
        self.replay(0)
        grid = self.end
        graph = self._graphs.graph(grid)
        goals = []
        if not turn.hold:
            goals = parking(graph, grid)
        parked = not goals or self._drive(car, after, graph.distances_to(goals)) is not None
        # A car that stays above the floor blocks all others.
        if not parked and turn.target.cell[2] > 1:
            return after
        return self.replay(0)

    def _carry(self, turn: Turn, tick: int, not_before: int) -> int | None:
        """Bring a thing to its place; return the tick after, or None if there is no way."""
        car = turn.car
        source = turn.source
        target = turn.target
        if source is not None:
            nodes = self._pick_up(source, target, self.node(car, tick))
            if source.kind == Kind.BODY:
                action = Action.FOLD
            else:
                action = Action.LIFT
            after_lift = None
            if nodes:
                after_lift = self._act_at(car, tick, source, action, not_before, nodes)
            if after_lift is None:
                return None
            if source.kind == Kind.BODY:
                self.write(car, after_lift, [Action.LIFT])
                after_lift += 1
            tick = after_lift
            not_before = 0
        last = None
        if not turn.hold:
            last = Action.DROP
        after = self._act_at(car, tick, target, last, not_before, load=target.load)
        if after is None or turn.hold or target.kind != Kind.BODY:
            return after
        return self._swing(car, after, Action.UNFOLD)

    def _act_at(
        self,
        car: int,
        tick: int,
        place: Piece,
        action: Action | None,
        not_before: int,
        nodes: list[int] | None = None,
        load: Kind = Kind.AIR,
    ) -> int | None:
        """Drive to the place of a thing, or to some states there, and act; return the tick after, or None."""
        graph = self._graphs.graph(self.end, load)
        if nodes is None:
            nodes = graph.nodes(place)
        distances = graph.distances_to(nodes)
        after = self._drive(car, tick, distances, load, action, not_before)
        if after is None or action not in (Action.FOLD, Action.UNFOLD):
            return after
        # It has been written for the moment at which it can begin; it ends much later.
        return self._swing(car, after - 1, action)

    def _swing(self, car: int, tick: int, action: Action) -> int:
        self.write(car, tick, [*[WAIT] * FLAP_TICKS, action])
        return tick + FLAP_TICKS + 1

    def _pick_up(self, source: Piece, target: Piece, start: int) -> list[int]:
        """Return the states in which to take up a thing so that the way there and on to its place is short."""
        grid = self.end
        graph = self._graphs.graph(grid)
        loaded = self._graphs.graph(rebuilt(grid, [source]), source.load)
        approach = graph.distances_from([start])
        onward = loaded.distances_to(loaded.nodes(target))
        costs = {}
        for node in graph.nodes(source):
            if approach[node] < UNREACHABLE and onward[node] < UNREACHABLE:
                costs[node] = int(approach[node]) + int(onward[node])
        lowest = min(costs.values(), default=0)
        return [node for node, cost in costs.items() if cost == lowest]

    def _drive(
        self,
        car: int,
        tick: int,
        distances: Distances,
        load: Kind = Kind.AIR,
        last: Action | None = None,
        not_before: int = 0,
    ) -> int | None:
        """Write a path to the goals and the last action; return the tick after it, or None if there is no way.

        ``distances``, (nodes,), are 0 at the goals; states with UNREACHABLE are not looked at. There the action
        ``last`` must be legal, not before some tick.
        """
        avoid: list[tuple[int, Cell]] = []
        for _ in range(_DETOURS):
            self._check_time()
            self.write(car, tick, [])
            path = self._path(car, tick, distances, load, last, not_before, avoid)
            if path is None:
                return None
            if last is None:
                actions = path
            else:
                actions = [*path, last]
            bad = self.write(car, tick, actions)
            after = tick + len(actions)
            if bad is None or bad >= after:
                return after
            for at in (bad, bad + 1):
                x, y, z = self._grids.cars[at, car, :3].tolist()
                avoid.append((at, (x, y, z)))
        return None

    def _path(
        self,
        car: int,
        tick: int,
        distances: Distances,
        load: Kind,
        last: Action | None,
        not_before: int,
        avoid: list[tuple[int, Cell]],
    ) -> list[int] | None:
        """Return the actions, WAIT among them, that bring a car to a goal, or None.

        ``avoid`` has ticks before which the car must not be in a cell.
        """
        worlds = self.without(car, tick)
        start = self.node(car, tick)
        end = max(self.n_ticks, tick)
        nearest = int(distances[start])
        if nearest >= UNREACHABLE:
            return None
        span = min(_MAX_TICKS, max(end, not_before) - tick + nearest + 24)
        if len(self._parents) < span * self._n_nodes:
            self._make_states(span * self._n_nodes)
        self._searches += 1
        self._heads[:] = -1
        for at, cell in avoid:
            state = (at - tick) * self._n_nodes + node_number(self.size, cell, 0)
            if tick < at < tick + span:
                # What counts as seen is not looked at.
                self._seen[state : state + 4] = self._searches
        action = -1
        if last is not None:
            action = int(last)
        state = _find_path(
            worlds,
            car,
            start,
            tick,
            end,
            int(load),
            distances,
            action,
            not_before,
            span,
            self._searches,
            self._parents,
            self._steps,
            self._seen,
            self._next,
            self._heads,
        )
        if state < 0:
            return None
        actions = []
        while self._parents[state] >= 0:
            actions.append(int(self._steps[state]))
            state = self._parents[state]
        return actions[::-1]

    def _make_states(self, n: int) -> None:
        self._parents = np.empty(n, np.int32)
        self._steps = np.empty(n, np.int8)
        self._seen = np.zeros(n, np.int32)
        self._next = np.empty(n, np.int32)

    def _reserve(self, n_ticks: int) -> None:
        while len(self.actions) <= n_ticks:
            self.actions = np.concatenate([self.actions, np.full_like(self.actions, WAIT)])
        while len(self._grids) <= n_ticks + 1:
            self._grids = Grid(
                np.concatenate([self._grids.cells] * 2), np.concatenate([self._grids.cars] * 2)
            )
            self._others = Grid(
                np.concatenate([self._others.cells] * 2), np.concatenate([self._others.cars] * 2)
            )

    def _shorten(self) -> None:
        acting = np.flatnonzero((self.actions != WAIT).any(1))
        if len(acting):
            self.n_ticks = int(acting[-1]) + 1
        else:
            self.n_ticks = 0


@compiled
def _replay(worlds: World, actions: NDArray[np.int8], first: int, end: int, left_out: int) -> int:
    """Write the worlds after each tick; return the first tick with an action that is forbidden, or -1.

    A car that is left out does nothing; -1 for none.
    """
    _, length, width, layers, cell_fields = worlds.cells.shape
    _, n_cars, car_fields = worlds.cars.shape
    bad = -1
    for tick in range(first, end):
        for x in range(length):
            for y in range(width):
                for z in range(layers):
                    for field in range(cell_fields):
                        worlds.cells[tick + 1, x, y, z, field] = worlds.cells[tick, x, y, z, field]
        for car in range(n_cars):
            for field in range(car_fields):
                worlds.cars[tick + 1, car, field] = worlds.cars[tick, car, field]
        w = World(
            worlds.cells[tick + 1], worlds.cars[tick + 1], worlds.corrections, worlds.patterns
        )
        for car in range(n_cars):
            if car == left_out or actions[tick, car] < 0:
                continue
            if not act(w, car, int(np.int64(actions[tick, car]))) and bad < 0:
                bad = tick
        if w.corrections & DERIVED_MARKS:
            derive_marks(w)
    return bad


@compiled
def _find_path(
    worlds: World,
    me: int,
    start: int,
    first: int,
    end: int,
    load: int,
    distances: Distances,
    last: int,
    not_before: int,
    span: int,
    number: int,
    parents: NDArray[np.int32],
    steps: NDArray[np.int8],
    met: NDArray[np.int32],
    following: NDArray[np.int32],
    heads: NDArray[np.int32],
) -> int:
    """Return the last state of a path, or -1; a state is a node in a tick. Buckets hold states of equal rank."""
    n_nodes = distances.shape[0]
    parents[start] = -1
    met[start] = number
    following[start] = -1
    rank = distances[start]
    heads[rank] = start
    while rank < heads.shape[0]:
        state = heads[rank]
        if state < 0:
            rank += 1
            continue
        heads[rank] = following[state]
        since = state // n_nodes
        node = state % n_nodes
        tick = first + since
        before = min(tick, end)
        following_tick = min(tick + 1, end)
        before_tick = World(
            worlds.cells[before], worlds.cars[before], worlds.corrections, worlds.patterns
        )
        after_tick = World(
            worlds.cells[following_tick],
            worlds.cars[following_tick],
            worlds.corrections,
            worlds.patterns,
        )
        car = state_at_node(before_tick, node, load)
        arrived = distances[node] == 0 and tick >= not_before
        if arrived and last < 0:
            return int(state)
        if since + 1 >= span:
            continue
        # The action at the goal comes first, then staying, then the steps.
        if arrived:
            legal = legal_actions(before_tick, me, car, last, last) & legal_actions(
                after_tick, me, car, last, last
            )
            if legal & (1 << last):
                return int(state)
        legal = legal_actions(before_tick, me, car, ROTATE_LEFT, LAST_MOVE)
        legal &= legal_actions(after_tick, me, car, ROTATE_LEFT, LAST_MOVE)
        for i in range(-1, N_STEPS):
            action = WAIT if i == -1 else SUCCESSORS[i]
            if i >= 0 and not legal & (1 << action):
                continue
            new = car if i == -1 else after(before_tick, car, action)
            new_node = node if i == -1 else node_of(before_tick, new)
            if (
                distances[new_node] >= UNREACHABLE
                or car_in(after_tick, me, new.x, new.y, new.z, False) >= 0
            ):
                continue
            new_state = (since + 1) * n_nodes + new_node
            new_rank = since + 1 + distances[new_node]
            if met[new_state] == number or new_rank >= heads.shape[0]:
                continue
            met[new_state] = number
            parents[new_state] = state
            steps[new_state] = action
            following[new_state] = heads[new_rank]
            heads[new_rank] = new_state
            rank = min(rank, new_rank)
    return -1
