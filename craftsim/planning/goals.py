"""What is to be reached: buildings of things without names, or anything that can be said of a world."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from craftsim.discrete.files.design import Design
from craftsim.discrete.grid import CarField, Cell, Grid, Kind, Piece, beside
from craftsim.discrete.kinds import KINDS, NAMES
from craftsim.discrete.tasks.task import Task
from craftsim.errors import InputError
from craftsim.planning.assembly import State


class NoPlanError(InputError):
    """There is no plan, or none was found; the message says why."""


@dataclass(frozen=True)
class BuildingGoal:
    """A goal of a plan."""

    reached: Callable[[Grid], bool]
    """Whether a world will do."""
    building: State | None = None
    """The things that must stand; None where there is no drawing."""
    platform: int = 0
    """How many blocks are to form one platform, wherever; 0 if none are."""


def make_goal(goal: Design | Task | Callable[[Grid], float | bool]) -> BuildingGoal:
    """Return the goal that a design, a task or a function of a world stands for."""
    if isinstance(goal, Task):
        if not goal.has_goal:
            raise NoPlanError(
                f"task '{goal.name}' has no goal; give it a design, or a flag and where it goes"
            )
        if goal.design is not None:
            return make_goal(goal.design)
        if goal.success == "flag_at_goal":
            flag = Piece(Kind.FLAG, goal.layout.goal_cell)
            return BuildingGoal(goal.succeeded, frozenset({flag}))
        if goal.success == "one_platform":
            return BuildingGoal(goal.succeeded, platform=goal.layout.n_blocks)
        return BuildingGoal(goal.succeeded)
    if isinstance(goal, Design):
        things = frozenset(
            Piece(target.kind, target.cell, max(target.yaw, 0))
            for target in goal.targets
            if target.kind != Kind.FOOT
        )
        return BuildingGoal(goal.satisfied, things)
    return BuildingGoal(lambda grid: bool(goal(grid)))


def check_supplies(start: Grid, building: State) -> None:
    """Raise NoPlanError where a building cannot be: too few things, outside the area, in the air or in each other."""
    have = Counter(thing.load for thing in start.pieces())
    have.update(Kind(int(load)) for load in start.cars[:, CarField.LOAD] if load)
    want = Counter(thing.load for thing in building)
    for kind, count in sorted(want.items()):
        if count > have[kind]:
            what = KINDS[kind].plural
            raise NoPlanError(f"no plan: not enough {what}; the design has {count}, the start {have[kind]}")
    taken: dict[Cell, Piece] = {}
    for thing in sorted(building):
        # A folded slope may stand as it likes, and its gear may hang or lie beside the area.
        for cell in thing.cells if thing.kind == Kind.BODY else (thing.cell,):
            if not all(0 <= c < n for c, n in zip(cell, start.kind.shape, strict=True)):
                raise NoPlanError(f"no plan: {cell} is outside the area of {start.size} cells")
            if start.kind_at(cell) == Kind.WALL:
                raise NoPlanError(f"no plan: {cell} is to hold {NAMES[thing.kind]}, but there is a wall")
            if cell in taken:
                raise NoPlanError(f"no plan: {cell} is to hold two things")
            taken[cell] = thing
    for cell in taken:
        below = (cell[0], cell[1], cell[2] - 1)
        borne = cell[2] == 1 or (below in taken and taken[below].kind == Kind.BLOCK)
        if not borne:
            raise NoPlanError(f"no plan: what is to be at {cell} has nothing below it that bears it")
    there = {(thing.kind, thing.cell) for thing in start.pieces()}
    upper = [
        thing for thing in sorted(building) if thing.cell[2] > 1 and (thing.kind, thing.cell) not in there
    ]
    if upper and not have[Kind.FSLOPE] and (start.cars[:, CarField.Z] == 1).all():
        raise NoPlanError(f"no plan: {upper[0].cell} is above the floor, and there is no slope to drive up")


def platforms(start: Grid, n_blocks: int, rng: np.random.Generator) -> Iterator[State]:
    """Yield buildings of so many blocks side by side on the floor, around those that stand; without end."""
    length, width, _ = start.size
    blocks = [thing.cell for thing in start.pieces() if thing.kind == Kind.BLOCK and thing.cell[2] == 1]
    there = set(blocks)
    while True:
        seed = blocks[int(rng.integers(len(blocks)))] if blocks else (length // 2, width // 2, 1)
        centre = np.mean(blocks or [seed], axis=0)
        pull, keep = rng.uniform(0, 1.5), rng.uniform(0, 4)
        chosen = {seed}
        while len(chosen) < n_blocks:
            edge = sorted(
                {
                    cell
                    for other in chosen
                    for yaw in range(4)
                    if (cell := beside(other, yaw)) not in chosen
                    and 0 <= cell[0] < length
                    and 0 <= cell[1] < width
                    and start.kind_at(cell) != Kind.WALL
                }
            )
            if not edge:
                break
            scores = [
                keep * (cell in there)
                - pull * float(np.abs(np.array(cell[:2]) - centre[:2]).sum()) / 2
                + rng.random()
                for cell in edge
            ]
            chosen.add(edge[int(np.argmax(scores))])
        if len(chosen) == n_blocks:
            yield frozenset(Piece(Kind.BLOCK, cell) for cell in chosen)
