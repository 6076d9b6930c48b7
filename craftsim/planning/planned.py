"""What is to be reached, and a plan that reaches it as it is handed out."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from craftsim.discrete.files.design import Design
from craftsim.discrete.grid import CarField, Cell, Grid, Kind, Piece, beside
from craftsim.discrete.kinds import KINDS, NAMES, Action, PlanTick
from craftsim.discrete.schedule import Schedule, nominal_durations
from craftsim.errors import InputError
from craftsim.planning.assembly import State, loads_of
from craftsim.planning.search import Objective
from craftsim.tasks.task import Task


class NoPlanError(InputError):
    """There is no plan, or none was found; the message says why."""


@dataclass(frozen=True)
class Planned:
    """A plan, legal under the rules in the order of its actions.

    Example:
        >>> import craftsim, numpy as np
        >>> task = craftsim.make_task("strip")
        >>> planned = craftsim.plan(task.draw(np.random.default_rng(0)), task, rounds=1)
        >>> planned.makespan_s < planned.work_s
        True
    """

    ticks: tuple[PlanTick, ...]
    schedule: Schedule
    """Which action waits for which."""
    makespan_s: float
    """When the last action ends, by the table of durations, if each waits only for those that it needs."""
    work_s: float
    """The sum of the durations of all actions."""
    bound_s: float
    """No plan has a smaller makespan; 0 where that is not known."""
    rounds: int
    """How many attempts were made."""
    optimal: bool = False
    """Whether it is proved that no plan is better, by the objective that was asked for."""

    def cost(self, objective: Objective) -> tuple[float, float]:
        """Return what is to be small, the objective first."""
        both = self.makespan_s, self.work_s
        if objective == "makespan":
            return both
        return both[::-1]


@dataclass(frozen=True)
class BuildingGoal:
    """A goal of a plan: a building of things without names, or anything that can be said of a world."""

    reached: Callable[[Grid], bool]
    """Whether a world will do."""
    building: State | None = None
    """The things that must stand; None where there is no drawing."""
    platform: int = 0
    """How many blocks are to form one platform, wherever; 0 if none are."""


def make_goal(goal: Design | Task | Callable[[Grid], float | bool]) -> BuildingGoal:
    """Return the goal that a design, a task or a function of a world stands for."""
    if isinstance(goal, Task) and not goal.has_goal:
        raise NoPlanError(f"task '{goal.name}' has no goal; give it a design, or a flag and where it goes")
    if isinstance(goal, Task) and goal.design is not None:
        goal = goal.design
    if isinstance(goal, Design):
        targets = (target for target in goal.targets if target.kind != Kind.FOOT)
        return BuildingGoal(goal.satisfied, frozenset(t._replace(yaw=max(t.yaw, 0)) for t in targets))
    if not isinstance(goal, Task):
        if not callable(goal):
            raise InputError(f"the goal is {goal!r}; allowed: a Design, a Task, or a function of a Grid")
        return BuildingGoal(lambda grid: bool(goal(grid)))
    if goal.success == "flag_at_goal":
        return BuildingGoal(goal.succeeded, frozenset({Piece(Kind.FLAG, goal.layout.goal_cell)}))
    platform = 0
    if goal.success == "one_platform":
        platform = goal.layout.n_blocks
    return BuildingGoal(goal.succeeded, platform=platform)


def check_supplies(start: Grid, building: State) -> None:
    """Raise NoPlanError where a building cannot be: too few things, outside the area, in the air or in each other."""
    have = loads_of(start)
    want = Counter(thing.load for thing in building)
    for kind, count in sorted(want.items()):
        if count > have[kind]:
            what = KINDS[kind].plural
            raise NoPlanError(f"no plan: not enough {what}; the design has {count}, the start {have[kind]}")
    taken: dict[Cell, Piece] = {}
    for thing in sorted(building):
        # A folded slope may stand as it likes, and its gear may hang or lie beside the area.
        for cell in thing.cells if thing.kind == Kind.BODY else (thing.cell,):
            if not start.inside(cell):
                raise NoPlanError(f"no plan: {cell} is outside the area of {start.size} cells")
            if start.kind_at(cell) == Kind.WALL:
                raise NoPlanError(f"no plan: {cell} is to hold {NAMES[thing.kind]}, but there is a wall")
            if cell in taken:
                raise NoPlanError(f"no plan: {cell} is to hold two things")
            taken[cell] = thing
    for x, y, z in taken:
        below = taken.get((x, y, z - 1))
        if z > 1 and (below is None or below.kind != Kind.BLOCK):
            raise NoPlanError(f"no plan: what is to be at {(x, y, z)} has nothing below it that bears it")
    there = {(thing.kind, thing.cell) for thing in start.pieces()}
    for thing in sorted(building) if not have[Kind.FSLOPE] and (start.cars[:, CarField.Z] == 1).all() else ():
        if thing.cell[2] > 1 and (thing.kind, thing.cell) not in there:
            raise NoPlanError(f"no plan: {thing.cell} is above the floor, and there is no slope to drive up")


def platforms(start: Grid, n_blocks: int, rng: np.random.Generator) -> Iterator[State]:
    """Yield buildings of so many blocks side by side on the floor, around those that stand; without end.

    Raises NoPlanError where no part of the floor between walls has so many cells.
    """
    length, width, _ = start.size
    parts = _parts_of_floor(start)
    largest = max(map(len, parts), default=0)
    if largest < n_blocks:
        raise NoPlanError(
            f"no plan: {n_blocks} blocks are to form one platform, and no part of the floor between walls has more "
            f"than {largest} cells"
        )
    enough = set()
    for part in parts:
        if len(part) >= n_blocks:
            for cell in part:
                enough.add(cell)
    blocks = [thing.cell for thing in start.pieces(Kind.BLOCK) if thing.cell in enough]
    there = set(blocks)
    middle = (length // 2, width // 2, 1)
    if middle not in enough:
        middle = min(enough)
    while True:
        seed = middle
        if blocks:
            seed = blocks[int(rng.integers(len(blocks)))]
        centre = np.mean(blocks or [seed], axis=0)
        pull = rng.uniform(0, 1.5)
        keep = rng.uniform(0, 4)
        chosen = {seed}
        while len(chosen) < n_blocks:
            around = {beside(other, yaw) for other in chosen for yaw in range(4)} - chosen
            edge = sorted(cell for cell in around if start.inside(cell) and start.kind_at(cell) != Kind.WALL)
            if not edge:
                break
            away = np.abs(np.array(edge)[:, :2] - centre[:2]).sum(axis=1)
            scores = (
                keep * np.array([cell in there for cell in edge]) - pull * away / 2 + rng.random(len(edge))
            )
            chosen.add(edge[int(np.argmax(scores))])
        if len(chosen) == n_blocks:
            yield frozenset(Piece(Kind.BLOCK, cell) for cell in chosen)


def _parts_of_floor(start: Grid) -> list[set[Cell]]:
    """Return the cells of the floor that are no walls, those together that lie side by side."""
    length, width, _ = start.size
    left = set()
    for x in range(length):
        for y in range(width):
            if start.kind_at((x, y, 1)) != Kind.WALL:
                left.add((x, y, 1))
    parts = []
    while left:
        edge = [left.pop()]
        part = set(edge)
        while edge:
            cell = edge.pop()
            new = {beside(cell, yaw) for yaw in range(4)} & left
            left -= new
            part |= new
            edge += new
        parts.append(part)
    return parts


def makespan_bound(start: Grid, building: State) -> float:
    """Return a time in seconds that every plan for a building takes at least.

    Each thing that does not stand must be taken up, carried at least the distance in the plane, and set down; the cars
    share that work, and nobody can carry one thing faster than alone.
    """
    table = nominal_durations()
    lift = table[Action.LIFT, 0]
    drop = table[Action.DROP, 1]
    unfold = table[Action.UNFOLD, 0]
    move = table[Action.MOVE_FORWARD, 1]
    there = list(start.pieces())
    standing = {(thing.kind, thing.cell) for thing in there}
    by_load: dict[Kind, list[Cell]] = {}
    for thing in there:
        by_load.setdefault(thing.load, []).append(thing.cell)
    places = {load: np.array(cells)[:, :2] for load, cells in by_load.items()}
    carried = set(start.cars[:, CarField.LOAD].tolist())
    work = [0.0]
    for thing in building:
        # What is carried may be above its place already.
        if thing.load in carried or (thing.kind, thing.cell) in standing:
            continue
        least = 0.0
        if thing.load in places:
            ways = np.abs(places[thing.load] - thing.cell[:2]).sum(axis=1)
            least = float(move * ways.min())
        if thing.kind == Kind.BODY and all(one.kind != Kind.BODY for one in there):
            least += unfold
        if least > unfold or thing.kind != Kind.BODY:
            least += lift + (drop if thing.kind != Kind.FLAG else 0.0)
        work.append(least)
    return float(max(sum(work) / max(start.n_cars, 1), *work))
