"""One plan from a start to a building: step after step is given to the car that would have made it first."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from craftsim.discrete.actions import Action
from craftsim.discrete.grid import Cell, Grid, Kind, beside
from craftsim.planning.assembly import Assembly, Order, State, Step, has_room, taken_out
from craftsim.planning.crew import FLAP_TICKS, Crew, Job
from craftsim.planning.things import Thing, things_in, with_car
from craftsim.planning.ways import FAR, Nodes, Ways, is_free

_FAILURES: Final = 40
"""So many jobs in vain end an attempt."""


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
    """By how many of its ticks a slope's turn of the flap makes a job seem cheaper, so that it begins early."""
    hold: bool = False
    """Whether cars keep what they clear, if it can be used later."""


class Building:
    """An attempt to build; :meth:`run` makes the plan."""

    def __init__(
        self,
        start: Grid,
        assembly: Assembly,
        order: Order,
        fixed: State,
        style: Style,
        rng: np.random.Generator,
    ) -> None:
        self.crew = Crew(start, assembly.rules)
        self.assembly, self.order, self.style, self.rng = assembly, order, style, rng
        self._done: set[int] = set()
        self._standing = set(fixed)
        self._goal_cells = {cell for step in order.steps for cell in step.thing.cells} | {
            cell for thing in fixed for cell in thing.cells
        }
        self._keep_free = self._goal_cells | {
            beside(thing.cells[1], thing.yaw)
            for thing in [*(step.thing for step in order.steps), *fixed]
            if thing.kind == Kind.BODY
        }
        n_cars = min(start.n_cars, style.n_cars)
        self._cars = sorted(rng.permutation(start.n_cars)[:n_cars].tolist())

    def run(self) -> bool:
        """Make the plan; return whether it came to its end."""
        failures = 0
        while len(self._done) < len(self.order.steps):
            made = bool(self.style.early) and self.rng.random() < self.style.early and self._clear()
            options = [] if made else self._options()
            for _, car, k, job in options[:6]:
                if self._take_over(car, job):
                    made = True
                    if k is not None:
                        self._done.add(k)
                        self._note(self.order.steps[k])
                    break
            if not made and not self._clear():
                return False
            failures += not made
            if failures > _FAILURES:
                return False
        return True

    def _note(self, step: Step) -> None:
        if step.taken:
            self._standing.discard(step.thing)
        else:
            self._standing.add(step.thing)

    def _pending(self) -> list[int]:
        """Return the steps that can be made next."""
        return [k for k, needs in enumerate(self.order.needs) if k not in self._done and needs <= self._done][
            : 2 * len(self._cars) + 4
        ]

    def _options(self) -> list[tuple[float, int, int | None, Job]]:
        """Return what can be done next: cost, car, step and job, the cheapest first."""
        grid = self.crew.end
        walking = Ways(grid, self.assembly.rules)
        costs: list[tuple[float, int, int | None, Job]] = []
        to_cells = {car: self._distances(walking, car) for car in self._cars}
        sources = self._sources(grid)
        loaded: dict[Kind, Ways] = {}
        for k in self._pending():
            step = self.order.steps[k]
            target = step.thing
            if step.taken:
                aside = self._aside(grid, target)
                if aside is None:
                    continue
                target = aside
            load = target.load
            if load not in loaded:
                loaded[load] = Ways(grid, self.assembly.rules, load)
            onward = loaded[load].to_nodes(_nodes_at(loaded[load], target))
            for source in [step.thing] if step.taken else sources.get(load, []):
                far = _nearest(onward, walking, source, around=True)
                if far >= FAR or not has_room(taken_out(grid, [source]), self.assembly.rules, target):
                    continue
                swings = (source.kind == Kind.BODY) + (target.kind == Kind.BODY)
                for car in self._cars:
                    if self.crew.load(car) != Kind.AIR:
                        continue
                    near = _nearest(to_cells[car], walking, source)
                    if near < FAR:
                        work = near + far + 2 + swings * (FLAP_TICKS + 1)
                        cost = self._cost(car, work) - swings * self.style.haste * FLAP_TICKS * 2
                        costs.append((cost, car, k, Job(source, target)))
            for car in self._cars:
                if self.crew.load(car) == load and not step.taken:
                    far = int(onward[self.crew.node(car, self.crew.ready[car])])
                    if far < FAR:
                        costs.append((self._cost(car, far + 1), car, k, Job(None, target)))
        return sorted(costs, key=lambda cost: cost[0])

    def _cost(self, car: int, work: int) -> float:
        begun = self.crew.ready[car] if self.style.together else 0
        return (begun + work) * (1 + self.style.noise * self.rng.random())

    def _distances(self, walking: Ways, car: int) -> Nodes:
        return walking.from_nodes([self.crew.node(car, self.crew.ready[car])])

    def _sources(self, grid: Grid) -> dict[Kind, list[Thing]]:
        """Return what stands free to be used, by the load that it makes."""
        found: dict[Kind, list[Thing]] = {}
        for thing in things_in(grid):
            if thing in self._standing or (
                thing.kind == Kind.BLOCK and thing._replace(yaw=0) in self._standing
            ):
                continue
            if self._can_be_taken(grid, thing):
                found.setdefault(thing.load, []).append(thing)
        return found

    def _can_be_taken(self, grid: Grid, thing: Thing) -> bool:
        yaw = (thing.yaw + 2) % 4 if thing.load == Kind.FSLOPE else 0
        action = Action.FOLD if thing.kind == Kind.BODY else Action.LIFT
        return self.assembly.rules.legal(with_car(grid, thing.cell, yaw), 0, action)

    def _take_over(self, car: int, job: Job) -> bool:
        """Let a car take over a job; cars that wait in its way are sent aside once."""
        if self.crew.take_over(car, job, self._parking(car)):
            return True
        cells = set(self._goal_cells)
        sent = False
        grid = self.crew.end
        ways = Ways(grid, self.assembly.rules)
        goal = job.source.cell if job.source is not None else job.target.cell
        distances = ways.to_nodes([ways.node(goal, yaw) for yaw in range(4)])
        others = self.crew.blockers(car, distances)
        if job.source is not None:
            carrying = Ways(taken_out(grid, [job.source]), self.assembly.rules, job.source.load)
            others += _on_way(grid, carrying, job, self.crew.n_cars)
        for other in dict.fromkeys(others):
            if other != car and self.crew.load(other) == Kind.AIR:
                cells |= {job.target.cell, goal}
                sent |= self.crew.move_aside(other, cells)
        return sent and self.crew.take_over(car, job, self._parking(car))

    def _parking(self, car: int):
        def places(ways: Ways, grid: Grid) -> list[int]:
            taken = {tuple(row[:3]) for i, row in enumerate(grid.cars.tolist()) if i != car}
            free = [
                (x, y, 1)
                for x, y in np.argwhere(grid.kind[:, :, 1] == Kind.AIR).tolist()
                if (x, y, 1) not in taken and (x, y, 1) not in self._keep_free
            ]
            return [ways.node(cell, yaw) for cell in free for yaw in range(4)]

        return places

    def _aside(self, grid: Grid, thing: Thing) -> Thing | None:
        """Return where a thing could stand out of the way: the nearest such place."""
        kind = thing.load
        ways = Ways(taken_out(grid, [thing]), self.assembly.rules, kind)
        rest = taken_out(grid, [thing])
        yaws = [(thing.yaw + 2) % 4] if kind == Kind.FSLOPE else range(4)
        distances = ways.from_nodes([ways.node(thing.cell, yaw) for yaw in yaws])
        best: tuple[int, Thing] | None = None
        for x, y in np.argwhere(rest.kind[:, :, 1] == Kind.AIR).tolist():
            for yaw in range(4) if kind == Kind.FSLOPE else [0]:
                there = Thing(kind, (x, y, 1), yaw)
                if not set(there.cells).isdisjoint(self._keep_free) or not all(
                    0 <= c < n for c, n in zip(there.cells[-1], rest.kind.shape, strict=True)
                ):
                    continue
                if not all(is_free(rest, cell) for cell in there.cells):
                    continue
                far = min(int(distances[node]) for node in _nodes_at(ways, there))
                if far < FAR and (best is None or far < best[0]):
                    best = far, there
        return best and best[1]

    def _clear(self) -> bool:
        """Move something that bars the next step out of the way; return whether that was possible."""
        grid = self.crew.end
        loose = [thing for things in self._sources(grid).values() for thing in things]
        for k in self._pending():
            for thing in self._barring(grid, loose, k):
                aside = self._aside(grid, thing)
                if aside is None:
                    continue
                free = [car for car in self._cars if self.crew.load(car) == Kind.AIR]
                hold = self.style.hold and len(free) > 1 and self._is_wanted(thing.load)
                for car in sorted(free, key=lambda car: self.crew.ready[car]):
                    if self._take_over(car, Job(thing, aside, hold)):
                        return True
        return False

    def _is_wanted(self, load: Kind) -> bool:
        """Return whether more steps need such a load than there are cars that carry one."""
        wanted = sum(
            not step.taken and step.thing.load == load
            for k, step in enumerate(self.order.steps)
            if k not in self._done
        )
        return wanted > sum(self.crew.load(car) == load for car in self._cars)

    def _barring(self, grid: Grid, loose: list[Thing], k: int) -> list[Thing]:
        """Return the loose things that must go before a step can be made; none of the others need to."""
        step = self.order.steps[k]
        if step.taken:
            return []
        gone = list(loose)
        if not self._reaches(grid, gone, step.thing):
            return []
        near = sorted(loose, key=lambda thing: -_manhattan(thing.cell, step.thing.cell))
        for thing in near:
            fewer = [other for other in gone if other != thing]
            if self._reaches(grid, fewer, step.thing):
                gone = fewer
        return gone

    def _reaches(self, grid: Grid, gone: list[Thing], target: Thing) -> bool:
        """Return whether a load can be driven to a place from somewhere else, once some things are gone."""
        rest = taken_out(grid, gone)
        if not has_room(rest, self.assembly.rules, target):
            return False
        ways = Ways(rest, self.assembly.rules, target.load)
        distances = ways.to_nodes(_nodes_at(ways, target))
        walking = Ways(rest, self.assembly.rules)
        reached = np.min([self._distances(walking, car) for car in self._cars], axis=0)
        left = [
            thing for thing in things_in(rest) if thing not in self._standing and thing.load == target.load
        ]
        if not left:
            return bool((distances < FAR).sum() > 4)
        return any(
            _nearest(distances, ways, thing, around=True) < FAR and _nearest(reached, ways, thing) < FAR
            for thing in left
        ) or any(thing.load == target.load for thing in gone)


def _nodes_at(ways: Ways, thing: Thing) -> list[int]:
    """Return the states in which a car is below a thing."""
    yaws = [(thing.yaw + 2) % 4] if thing.load == Kind.FSLOPE else range(4)
    return [ways.node(thing.cell, yaw) for yaw in yaws]


def _nearest(distances: Nodes, ways: Ways, thing: Thing, around: bool = False) -> int:
    """Return the distance of the states below a thing; ``around``: or of those one step further."""
    nodes = _nodes_at(ways, thing)
    far = min(int(distances[node]) for node in nodes)
    if around:
        x, y, z = thing.cell
        for direction in range(4):
            cell = beside((x, y, z), direction)
            if 0 <= cell[0] < ways.size[0] and 0 <= cell[1] < ways.size[1]:
                yaws = [(thing.yaw + 2) % 4] if thing.load == Kind.FSLOPE else range(4)
                far = min(far, 1 + min(int(distances[ways.node(cell, yaw)]) for yaw in yaws))
    return far


def _on_way(grid: Grid, ways: Ways, job: Job, n_cars: int) -> list[int]:
    """Return the cars that stand on the straight way of a load."""
    from craftsim.planning.ways import cell_of_node

    assert job.source is not None
    distances = ways.to_nodes(_nodes_at(ways, job.target))
    node = min(_nodes_at(ways, job.source), key=lambda node: int(distances[node]))
    cells: set[Cell] = {job.target.cell}
    while 0 < distances[node] < FAR:
        node = min((int(n) for n in ways.steps[node] if n >= 0), key=lambda n: int(distances[n]))
        cells.add(cell_of_node(ways.size, node)[0])
    return [car for car in range(n_cars) if tuple(grid.cars[car, :3]) in cells]


def _manhattan(a: Cell, b: Cell) -> int:
    return sum(abs(i - j) for i, j in zip(a, b, strict=True))
