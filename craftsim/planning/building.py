"""One plan from a start to a building: step after step is given to the car that would have made it first."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final, NamedTuple

import numpy as np

from craftsim.discrete.grid import Cell, Grid, Kind, beside
from craftsim.discrete.move_graph import UNREACHABLE, Distances, MoveGraph
from craftsim.planning.assembly import Assembly, Order, State, has_room, taken_out
from craftsim.planning.grounds import Grounds
from craftsim.planning.joint_plan import FLAP_TICKS, Delivery, JointPlan, Saved, cells_on_path
from craftsim.planning.reach import Reach, nearest, onward_from, sources

_FAILURES: Final = 40
"""So many deliveries in vain end an attempt."""
_TRIES: Final = 6
"""So many deliveries are tried in a turn."""
_AHEAD: Final = 3
"""So many more steps than there are cars are looked at in a turn."""


class Turn(NamedTuple):
    """A delivery and the car that has taken it over."""

    car: int
    delivery: Delivery
    step: int | None
    """Which step of the order it makes; None where it clears the way."""


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
    """By how many of its ticks a slope's turn of the flap makes a delivery seem cheaper, so that it begins early."""
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
        self.plan = JointPlan(start, assembly.graphs)
        self.assembly, self.order, self.style, self.rng = assembly, order, style, rng
        self.turns = list(past)
        """What was done so far, and the plan after each."""
        self._script, self._last_tick = script, last_tick
        self._done: set[int] = set()
        self._standing = fixed
        self._grounds = Grounds(assembly, [*(step.thing for step in order.steps), *fixed])
        n_cars = min(start.n_cars, style.n_cars)
        self._cars = sorted(self.rng.permutation(start.n_cars)[:n_cars].tolist())
        for turn, _ in past:
            self._note(turn.step)
        if past:
            self.plan.restore(past[-1][1])

    def run(self) -> bool:
        """Make the plan; return whether it came to its end."""
        for turn in self._script:
            if turn is None:
                self._place()
            elif self._fits(turn):
                self._take_turn(*turn)
            if self.n_ticks > self._last_tick:
                return False
        failures = 0
        while len(self._done) < len(self.order.steps):
            made = bool(self.style.early) and self.rng.random() < self.style.early and self._clear()
            made = made or self._place()
            if not made and not self._clear():
                return False
            failures += not made
            if failures > _FAILURES or self.n_ticks > self._last_tick:
                return False
        return True

    def _fits(self, turn: Turn) -> bool:
        """Return whether a turn of another attempt can still be tried."""
        car, delivery, k = turn
        if k is not None and not (
            k not in self._done
            and self.assembly.possible(self._standing, self.order.steps[k])
            and self._bars_nothing(k)
        ):
            return False
        if delivery.source is None:
            return self.plan.load(car) == delivery.target.load
        if self.plan.load(car) != Kind.AIR:
            return False
        grid = self.plan.end
        if k is not None and self.order.steps[k].taken:
            here = delivery.source in set(grid.pieces())
        else:
            here = delivery.source in sources(self.assembly, grid, self._standing).get(
                delivery.source.load, []
            )
        return here and has_room(taken_out(grid, [delivery.source]), self.assembly.rules, delivery.target)

    def _take_turn(self, car: int, delivery: Delivery, k: int | None) -> bool:
        """Let a car take over a delivery; return whether it could."""
        if not self._take_over(car, delivery):
            return False
        self._note(k)
        self.turns.append((Turn(car, delivery, k), self.plan.saved()))
        return True

    def _place(self) -> bool:
        """Make the step that is made first, by whom it is made first; return whether one could be made."""
        tries = 0
        safe: dict[int, bool] = {}
        for _, car, k, delivery in self._options():
            if k not in safe:
                safe[k] = self._bars_nothing(k)
            if not safe[k]:
                continue
            if self._take_turn(car, delivery, k):
                return True
            tries += 1
            if tries == _TRIES:
                return False
        return False

    @property
    def n_ticks(self) -> int:
        """How many ticks the deliveries take that have been planned."""
        return max(self.plan.ready)

    def _note(self, k: int | None) -> None:
        if k is not None:
            self._done.add(k)
            self._standing = self.order.steps[k].after(self._standing)

    def _left(self) -> list[int]:
        """Return the first steps that have not been made, in order."""
        left = [k for k in range(len(self.order.steps)) if k not in self._done]
        return left[: len(self._cars) + _AHEAD]

    def _pending(self) -> list[int]:
        """Return the steps that could be made next."""
        return [k for k in self._left() if self.assembly.possible(self._standing, self.order.steps[k])]

    def _bars_nothing(self, k: int) -> bool:
        """Return whether those steps that come before one in the order can still be made after it."""
        state = self.order.steps[k].after(self._standing)
        for earlier in self._left():
            if earlier >= k:
                break
            step = self.order.steps[earlier]
            if not self.assembly.possible(state, step):
                return False
            state = step.after(state)
        return True

    def _options(self) -> list[tuple[float, int, int, Delivery]]:
        """Return what can be done next: cost, car, step and delivery, the cheapest first."""
        grid = self.plan.end
        walking = self.assembly.graphs.graph(grid)
        costs: list[tuple[float, int, int, Delivery]] = []
        to_cells = {car: self._distances(walking, car) for car in self._cars}
        loose = sources(self.assembly, grid, self._standing)
        loaded: dict[Kind, MoveGraph] = {}
        for k in self._pending():
            step = self.order.steps[k]
            target = step.thing
            if step.taken:
                aside = self._grounds.aside(grid, target, lambda moved: True)
                if aside is None:
                    continue
                target = aside
            load = target.load
            if load not in loaded:
                loaded[load] = self.assembly.graphs.graph(grid, load)
            onward = loaded[load].distances_to(loaded[load].nodes(target.cell, target.yaws))
            for source in [step.thing] if step.taken else loose.get(load, []):
                rest = taken_out(grid, [source])
                far = onward_from(onward, walking, grid, source)
                if load == Kind.FSLOPE:
                    # It stands in two cells, and can only be driven out of in one direction: so exactly.
                    graph = self.assembly.graphs.graph(rest, load)
                    far = nearest(graph.distances_to(graph.nodes(target.cell, target.yaws)), graph, source)
                if far >= UNREACHABLE or not has_room(rest, self.assembly.rules, target):
                    continue
                swings = (source.kind == Kind.BODY) + (target.kind == Kind.BODY)
                for car in self._cars:
                    if self.plan.load(car) != Kind.AIR:
                        continue
                    near = nearest(to_cells[car], walking, source)
                    if near < UNREACHABLE:
                        work = near + far + 2 + swings * (FLAP_TICKS + 1)
                        cost = self._cost(car, work) - swings * self.style.haste * FLAP_TICKS * 2
                        costs.append((cost, car, k, Delivery(source, target)))
            for car in self._cars:
                if self.plan.load(car) == load and not step.taken:
                    far = int(onward[self.plan.node(car, self.plan.ready[car])])
                    if far < UNREACHABLE:
                        costs.append((self._cost(car, far + 1), car, k, Delivery(None, target)))
        return sorted(costs, key=lambda cost: cost[0])

    def _cost(self, car: int, work: int) -> float:
        begun = self.plan.ready[car] if self.style.together else 0
        return (begun + work) * (1 + self.style.noise * self.rng.random())

    def _distances(self, walking: MoveGraph, car: int) -> Distances:
        return walking.distances_from([self.plan.node(car, self.plan.ready[car])])

    def _take_over(self, car: int, delivery: Delivery) -> bool:
        """Let a car take over a delivery; cars that wait in its way are sent aside once."""
        if self.plan.take_over(car, delivery, self._grounds.parking(car)):
            return True
        way = self._way(car, delivery)
        # A load needs room beside its way, too.
        near = way | {beside(cell, yaw) for cell in way for yaw in range(4)}
        grid = self.plan.end
        sent = False
        for other in range(self.plan.n_cars):
            here = tuple(grid.cars[other, :3].tolist())
            if other != car and here in near and self.plan.load(other) == Kind.AIR:
                sent |= any(
                    self.plan.move_aside(other, near | kept)
                    for kept in (self._grounds.around, self._grounds.cells)
                )
        return sent and self.plan.take_over(car, delivery, self._grounds.parking(car))

    def _way(self, car: int, delivery: Delivery) -> set[Cell]:
        """Return the cells of the straight way to a thing and on to its place, as if there were no other cars."""
        grid, graphs = self.plan.end, self.assembly.graphs
        node = self.plan.node(car, self.plan.ready[car])
        cells = {delivery.target.cell}
        if delivery.source is not None:
            graph = graphs.graph(grid)
            cells |= cells_on_path(
                graph, node, graph.distances_to(graph.nodes(delivery.source.cell, delivery.source.yaws))
            )
            grid = taken_out(grid, [delivery.source])
        graph = graphs.graph(grid, delivery.target.load)
        distances = graph.distances_to(graph.nodes(delivery.target.cell, delivery.target.yaws))
        if delivery.source is not None:
            node = min(
                graph.nodes(delivery.source.cell, delivery.source.yaws), key=lambda node: int(distances[node])
            )
        return cells | cells_on_path(graph, node, distances)

    def _clear(self) -> bool:
        """Move something that bars the next step out of the way; return whether that was possible."""
        grid = self.plan.end
        loose = [
            thing for things in sources(self.assembly, grid, self._standing).values() for thing in things
        ]
        nodes = [self.plan.node(car, self.plan.ready[car]) for car in self._cars]
        reach = Reach(self.assembly, self._standing, nodes)
        for k in self._pending():
            target, taken = self.order.steps[k].thing, self.order.steps[k].taken
            barring = [] if taken else reach.barring(grid, loose, target)
            for thing in barring:
                others = [other for other in barring if other != thing]
                aside = self._grounds.aside(grid, thing, partial(reach.reaches, gone=others, target=target))
                if aside is None:
                    continue
                free = [car for car in self._cars if self.plan.load(car) == Kind.AIR]
                hold = self.style.hold and len(free) > 1 and self._is_wanted(thing.load)
                for car in sorted(free, key=lambda car: self.plan.ready[car]):
                    if self._take_turn(car, Delivery(thing, aside, hold), None):
                        return True
        return False

    def _is_wanted(self, load: Kind) -> bool:
        """Return whether more steps need such a load than there are cars that carry one."""
        wanted = sum(
            not step.taken and step.thing.load == load
            for k, step in enumerate(self.order.steps)
            if k not in self._done
        )
        return wanted > sum(self.plan.load(car) == load for car in self._cars)
