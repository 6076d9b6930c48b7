"""Goals of plans, and plans as they are handed out."""

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
    """The actions and those that each waits for."""
    makespan_s: float
    """Time at which the last action ends, by the table of durations, if each waits only for those that it needs."""
    work_s: float
    """Sum of the durations of all actions."""
    bound_s: float
    """Lower bound of the makespan of any plan; 0 where none is known."""
    rounds: int
    """Number of attempts."""
    optimal: bool = False
    """It is proved that no plan is better, by the objective of the search."""

    def cost(self, objective: Objective) -> tuple[float, float]:
        """Return what is to be small, the objective first."""
        costs = self.makespan_s, self.work_s
        if objective == "makespan":
            return costs
        return costs[::-1]


@dataclass(frozen=True)
class BuildingGoal:
    """A goal of a plan: a building of things without names, or anything that can be said of a world."""

    reached: Callable[[Grid], bool]
    """Function that tells whether a world will do."""
    building: State | None = None
    """The things that must stand; None where there is no drawing."""
    platform: int = 0
    """Number of blocks that are to form one platform, wherever; 0 if none are."""


def make_goal(goal: Design | Task | Callable[[Grid], float | bool]) -> BuildingGoal:
    """Return the goal that a design, a task or a function of a world stands for."""
    if isinstance(goal, Task) and not goal.has_goal:
        raise NoPlanError(
            f"task '{goal.name}' has no goal; give it a design, or a flag and where it goes"
        )
    if isinstance(goal, Task) and goal.design is not None:
        goal = goal.design
    if isinstance(goal, Design):
        building = []
        for target in goal.targets:
            if target.kind != Kind.FOOT:
                building.append(target._replace(yaw=max(target.yaw, 0)))
        return BuildingGoal(goal.satisfied, frozenset(building))
    if not isinstance(goal, Task):
        if not callable(goal):
            raise InputError(
                f"the goal is {goal!r}; allowed: a Design, a Task, or a function of a Grid"
            )
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
    want = Counter(piece.load for piece in building)
    for kind, count in sorted(want.items()):
        if count > have[kind]:
            objects = KINDS[kind].plural
            raise NoPlanError(
                f"no plan: not enough {objects}; the design has {count}, the start {have[kind]}"
            )
    occupied: dict[Cell, Piece] = {}
    for piece in sorted(building):
        # A folded slope may stand as it likes, and its gear may hang or lie beside the area.
        cells = piece.cells[:1]
        if piece.kind == Kind.BODY:
            cells = piece.cells
        for cell in cells:
            if not start.inside(cell):
                raise NoPlanError(f"no plan: {cell} is outside the area of {start.size} cells")
            if start.kind_at(cell) == Kind.WALL:
                raise NoPlanError(
                    f"no plan: {cell} is to hold {NAMES[piece.kind]}, but there is a wall"
                )
            if cell in occupied:
                raise NoPlanError(f"no plan: {cell} is to hold two things")
            occupied[cell] = piece
    for x, y, z in occupied:
        below = occupied.get((x, y, z - 1))
        if z > 1 and (below is None or below.kind != Kind.BLOCK):
            raise NoPlanError(
                f"no plan: what is to be at {(x, y, z)} has nothing below it that bears it"
            )
    if have[Kind.FSLOPE] or (start.cars[:, CarField.Z] != 1).any():
        return
    standing = {(piece.kind, piece.cell) for piece in start.pieces()}
    for piece in sorted(building):
        if piece.cell[2] > 1 and (piece.kind, piece.cell) not in standing:
            raise NoPlanError(
                f"no plan: {piece.cell} is above the floor, and there is no slope to drive up"
            )


def platforms(start: Grid, n_blocks: int, rng: np.random.Generator) -> Iterator[State]:
    """Yield buildings of so many blocks side by side on the floor, around those that stand; without end.

    Raises NoPlanError where no part of the floor between walls has so many cells.
    """
    length, width, _ = start.size
    parts = _floor_regions(start)
    largest = max(map(len, parts), default=0)
    if largest < n_blocks:
        raise NoPlanError(
            f"no plan: {n_blocks} blocks are to form one platform, and no part of the floor between walls has more "
            f"than {largest} cells"
        )
    large_enough = set()
    for region in parts:
        if len(region) >= n_blocks:
            for cell in region:
                large_enough.add(cell)
    blocks = [block.cell for block in start.pieces(Kind.BLOCK) if block.cell in large_enough]
    standing = set(blocks)
    middle = (length // 2, width // 2, 1)
    if middle not in large_enough:
        middle = min(large_enough)
    while True:
        seed = middle
        if blocks:
            seed = blocks[int(rng.integers(len(blocks)))]
        centre = np.mean(blocks or [seed], axis=0)
        pull = rng.uniform(0, 1.5)
        keep = rng.uniform(0, 4)
        chosen = {seed}
        while len(chosen) < n_blocks:
            around = set()
            for cell in chosen:
                for yaw in range(4):
                    neighbour = beside(cell, yaw)
                    if start.inside(neighbour) and start.kind_at(neighbour) != Kind.WALL:
                        around.add(neighbour)
            edge = sorted(around - chosen)
            if not edge:
                break
            away = np.abs(np.array(edge)[:, :2] - centre[:2]).sum(axis=1)
            stands = np.array([cell in standing for cell in edge])
            scores = keep * stands - pull * away / 2 + rng.random(len(edge))
            chosen.add(edge[int(np.argmax(scores))])
        if len(chosen) == n_blocks:
            yield frozenset(Piece(Kind.BLOCK, cell) for cell in chosen)


def _floor_regions(start: Grid) -> list[set[Cell]]:
    """Return the cells of the floor that are no walls, those together that lie side by side."""
    length, width, _ = start.size
    unvisited = set()
    for x in range(length):
        for y in range(width):
            if start.kind_at((x, y, 1)) != Kind.WALL:
                unvisited.add((x, y, 1))
    parts = []
    while unvisited:
        edge = [unvisited.pop()]
        region = set(edge)
        while edge:
            cell = edge.pop()
            new = {beside(cell, yaw) for yaw in range(4)} & unvisited
            unvisited -= new
            region |= new
            edge += new
        parts.append(region)
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
    pieces = list(start.pieces())
    standing = {(piece.kind, piece.cell) for piece in pieces}
    has_ramp = any(piece.kind == Kind.BODY for piece in pieces)
    by_load: dict[Kind, list[Cell]] = {}
    for piece in pieces:
        by_load.setdefault(piece.load, []).append(piece.cell)
    places = {load: np.array(cells)[:, :2] for load, cells in by_load.items()}
    carried = set(start.cars[:, CarField.LOAD].tolist())
    work = [0.0]
    for piece in building:
        # What is carried may be above its place already.
        if piece.load in carried or (piece.kind, piece.cell) in standing:
            continue
        lowest = 0.0
        if piece.load in places:
            distances = np.abs(places[piece.load] - piece.cell[:2]).sum(axis=1)
            lowest = float(move * distances.min())
        if piece.kind == Kind.BODY and not has_ramp:
            lowest += unfold
        if lowest > unfold or piece.kind != Kind.BODY:
            lowest += lift
            if piece.kind != Kind.FLAG:
                lowest += drop
        work.append(lowest)
    return float(max(sum(work) / max(start.n_cars, 1), *work))
