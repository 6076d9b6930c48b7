"""Tasks with random starts, things and cars anywhere and turned anyhow: the paper's six, and the large ones.

The large tasks of the paper's section 4.4, a tower and free building, are not shipped with CraftEnv. Each has 20 blocks
and 4 slopes in 10 x 10 x 4 cells, and 4 or 8 cars.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Final, cast

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.files.blueprint import Blueprint
from craftsim.discrete.files.design import read_design
from craftsim.discrete.files.placement import free_floor
from craftsim.discrete.files.shipped import shipped_blueprint
from craftsim.discrete.geometry import DIRECTIONS
from craftsim.discrete.grid import SECOND_PART, CarField, Cell, Grid, Kind, Piece, check_size
from craftsim.errors import InputError, suggestion
from craftsim.tasks.rewards import Reward, Weights
from craftsim.tasks.starts import (
    Split,
    Starts,
    belongs,
    check_split,
    read_split,
    split_name,
    targets_of,
)
from craftsim.tasks.task import TASK_NAMES, Task, make_task

RANDOM_PREFIX: Final = "random_"
RANDOM_NAMES: Final = tuple(f"{RANDOM_PREFIX}{name}" for name in TASK_NAMES)
STEP_LIMITS: Final = {
    "strip": 30,
    "block": 29,
    "simple_two_story": 51,
    "complex_two_story": 104,
    "free_building": 51,
    "breaking_barrier": 36,
}
"""Step limits: about 1.5 times what 95 % of the planner's plans for random starts take (docs/reference/tasks.md)."""
_LARGE: Final[dict[str, tuple[int, int]]] = {
    "large_tower_4": (4, 236),
    "large_tower_8": (8, 196),
    "large_free_building_4": (4, 236),
    "large_free_building_8": (8, 196),
}
"""Cars and step limit, about 1.3 times the longest of the plans for the tower in docs/results/large.md."""
LARGE_NAMES: Final = tuple(_LARGE)
_TRIES: Final = 1000
_YAWS: Final = 4


@dataclass(frozen=True)
class RandomPlacement:
    """Random starts of a task and its split, drawn as they are needed: what its blueprint lists stands, all else is
    placed at random.

    A start at which the work is done already is none.
    """

    task: Task
    flag_x: int = -1
    """The lowest x at which a flag is placed; -1 for none."""
    apart: bool = False
    """A start with two slopes back to back, neither of which a car can drive under, is none, too."""

    def draw(self, rng: np.random.Generator, n: int) -> Starts:
        """Return n starts; raises InputError where things find no room."""
        starts, missing = self._place(rng, n)
        for _ in range(_TRIES):
            if not len(missing):
                return starts
            redrawn, wrong = self._place(rng, len(missing))
            starts.put(missing, redrawn)
            missing = missing[wrong]
        plan = self.task.starts[0]
        raise InputError(
            f"task '{self.task.name}': no room for {plan.n_cars} cars, {plan.n_slopes} slopes and {plan.n_blocks} "
            f"blocks in an area of {plan.size[:2]} cells; try a larger one, or fewer of them"
        )

    @cached_property
    def _bare(self) -> Starts:
        """The world before anything is placed."""
        plan = self.task.starts[0]
        bare = replace(plan, n_cars=0, n_blocks=plan.listed(Kind.BLOCK), n_slopes=0)
        grid = bare.grid(np.random.default_rng(0))
        grid.cars = np.zeros((plan.n_cars, len(CarField)), np.int16)
        grid.cars[:, CarField.Z] = 1
        return Starts.of([grid], targets_of(self.task.design))

    def _place(self, rng: np.random.Generator, n: int) -> tuple[Starts, NDArray[np.int64]]:
        """Return n starts, and which of them are not valid."""
        plan = self.task.starts[0]
        starts = self._bare.take(np.zeros(n, np.int64))
        kinds = [Kind.FLAG] * (self.flag_x >= 0) + [Kind.FSLOPE] * plan.n_slopes
        kinds += [Kind.BLOCK] * (plan.n_blocks - plan.listed(Kind.BLOCK))
        chances = rng.random((n, len(kinds) + 2 * plan.n_cars))
        found_room = _place_things(starts.grids, kinds, self.flag_x, chances[:, : len(kinds)])
        found_room &= _place_cars(starts.grids, chances[:, len(kinds) :])
        starts.grids.derive_marks()
        done = self.task.reached(starts.grids, starts.designs)
        if self.apart:
            found_room &= ~back_to_back(starts.grids)
        mine = belongs(starts.digests(), self.task.split or "train")
        return starts, np.flatnonzero(~found_room | done | ~mine)


def _place_things(
    grids: Grid, kinds: list[Kind], flag_x: int, chances: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Place things on the floor of each of B worlds, one after the other; return (B,) where all found room.

    ``flag_x`` is the lowest x of a flag; ``chances`` (B, things), from 0 to below 1, decide.
    """
    kind = grids.kind[..., 1]
    yaw = grids.yaw[..., 1]
    rows = np.arange(len(grids))
    found_room = np.ones(len(grids), np.bool_)
    for new_kind, chance in zip(kinds, chances.T, strict=True):
        free = free_floor(kind, new_kind == Kind.FSLOPE)
        if new_kind == Kind.FLAG:
            free[:, :, :flag_x] = False
        has_place, (turn, x, y) = _choose(free, chance)
        found_room &= has_place
        kind[rows, x, y] = new_kind
        yaw[rows, x, y] = turn
        if new_kind == Kind.FSLOPE:
            dx, dy = DIRECTIONS[turn[has_place]].T
            gear = rows[has_place], x[has_place] + dx, y[has_place] + dy
            kind[gear] = SECOND_PART[new_kind]
            yaw[gear] = turn[has_place]
    return found_room


def _place_cars(grids: Grid, chances: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Place all cars of each of B worlds in free cells of the floor; return (B,) where all found room.

    ``chances`` (B, 2 n), from 0 to below 1, decide: the cell and the yaw of each car.
    """
    rows = np.arange(len(grids))
    found_room = np.ones(len(grids), np.bool_)
    free = free_floor(grids.kind[..., 1], False)
    for car in range(grids.n_cars):
        has_place, (_, x, y) = _choose(free, chances[:, 2 * car])
        found_room &= has_place
        free[rows, 0, x, y] = False
        grids.cars[:, car, CarField.X] = x
        grids.cars[:, car, CarField.Y] = y
        grids.cars[:, car, CarField.YAW] = (chances[:, 2 * car + 1] * _YAWS).astype(np.int16)
    return found_room


def back_to_back(grids: Grid) -> NDArray[np.bool_]:
    """Return (B,): whether two folded slopes on the floor stand with their backs to each other."""
    yaw = np.where(grids.kind[..., 1] == Kind.FSLOPE, grids.yaw[..., 1], -1)
    along_x = (yaw[:, :-1] == 2) & (yaw[:, 1:] == 0)
    along_y = (yaw[:, :, :-1] == 3) & (yaw[:, :, 1:] == 1)
    return np.logical_or(along_x.any(axis=(1, 2)), along_y.any(axis=(1, 2)))


def _choose(
    free: NDArray[np.bool_], chance: NDArray[np.float64]
) -> tuple[NDArray[np.bool_], tuple[NDArray[np.intp], ...]]:
    """Return in which of B worlds there is a free place, and one of them, all as likely: its yaw, x and y.

    ``free`` is (B, yaws, L, W); where nothing is free the place is the first one.
    """
    places = free.reshape(len(free), -1)
    count = places.sum(axis=1)
    nth = np.minimum((chance * count).astype(np.int64), count - 1)
    place = (places.cumsum(axis=1) > nth[:, None]).argmax(axis=1)
    return count > 0, np.unravel_index(place, free.shape[1:])


def random_task(
    name: str,
    split: Split = "train",
    reward: str | Weights = "paper",
    n_cars: int | None = None,
    n_blocks: int | None = None,
    area: tuple[int, ...] | None = None,
    max_steps: int | None = None,
) -> Task:
    """Return one of the paper's six tasks with a random start in each episode.

    The design stays where it is, and its cells may hold things at the start. In ``breaking_barrier`` the row of blocks
    between flag and goal stays, too, and the flag starts somewhere behind it.

    Args:
        name: of the paper's task.
        split: ``train``, drawn as needed, or ``test``: the 1,000 held-out starts that are shipped, for each of which
            the planner has found a plan; with other numbers or another area held-out ones are drawn as needed, too, and
            some may have no solution, as some of ``train`` have none. No start is in both.
        reward: see :func:`make_task`.
        n_cars: other than the paper's number of cars.
        n_blocks: the same for blocks, not fewer than the design takes.
        area: (length, width) or (length, width, height) in cells, other than the paper's, not smaller than the design.
        max_steps: the step limit, unless given 1.5 times what 95 % of the planner's plans take.

    Raises InputError.

    Example:
        >>> import craftsim
        >>> task = craftsim.random_task("strip", n_cars=3, area=(5, 5))
        >>> task.layout.n_cars, task.starts[0].size
        (3, (5, 5, 3))
    """
    check_split(split)
    if max_steps is None:
        max_steps = STEP_LIMITS[name]
    paper_task = replace(make_task(name, reward), max_steps=max_steps)
    blueprint, flag_x = _blueprint(paper_task, n_cars, n_blocks, area)
    shown_targets = 0
    if paper_task.design is not None:
        shown_targets = len(paper_task.design.targets)
    task = replace(
        paper_task,
        name=split_name(RANDOM_PREFIX + name, split),
        starts=(blueprint,),
        split=split,
        shown_targets=shown_targets,
    )
    if split == "test" and (n_cars, n_blocks, area) == (None, None, None):
        return replace(task, sampler=read_split(RANDOM_PREFIX + name, "test")[0])
    return replace(task, sampler=RandomPlacement(task, flag_x))


def large_task(name: str, split: Split = "train") -> Task:
    """Return one of the large tasks, with a random start in each episode.

    The tower is three levels high, with four ramps; its reward is table 1 of the paper, as in complex two-story. Free
    building is rewarded by :func:`craftsim.tasks.potentials.structure`, has succeeded once three blocks stand on
    one another, and goes on until the step limit.

    Args:
        name: ``large_tower_4``, ``large_tower_8``, ``large_free_building_4`` or ``large_free_building_8``, by the
            number of cars.
        split: ``train`` or ``test``; both are drawn as needed, and no start is in both.

    Raises InputError.

    Example:
        >>> from craftsim.tasks import as_task
        >>> task = as_task("large_tower_8")
        >>> task.starts[0].size, task.layout.n_cars, task.layout.n_blocks, task.layout.n_slopes
        ((10, 10, 4), 8, 20, 4)
    """
    check_split(split)
    if name not in _LARGE:
        raise InputError(
            f"unknown large task '{name}'{suggestion(name, LARGE_NAMES)}; there are {', '.join(LARGE_NAMES)}"
        )
    n_cars, max_steps = _LARGE[name]
    design = None
    reward = Reward({"structure": 1.0})
    goal = "three_high"
    shown_targets = 0
    if "tower" in name:
        design = read_design(shipped_blueprint("large_tower_goal"))
        reward = Reward({"complex_building": 1.0})
        goal = "built"
        shown_targets = len(design.targets)
    task = Task(
        name=split_name(name, split),
        starts=(Blueprint(Path(name), (10, 10, 4), 20, 4, n_cars),),
        reward=reward,
        success=goal,
        design=design,
        max_steps=max_steps,
        ends_on_success=design is not None,
        split=split,
        shown_targets=shown_targets,
    )
    return replace(task, sampler=RandomPlacement(task, apart=True))


def _blueprint(
    task: Task, n_cars: int | None, n_blocks: int | None, area: tuple[int, ...] | None
) -> tuple[Blueprint, int]:
    """Return the numbers of all that there is, with what stays in its place, and the lowest x of the flag."""
    paper = task.starts[0]
    size = whole_size(area, paper.size)
    check_size(size, paper.n_cars)
    stays: list[Piece] = []
    flag_x = -1
    if task.design is None:
        smallest = (1, 1, 1)
    else:
        smallest = task.design.size
    if task.goal_cell is not None:
        flag_x = next(item.cell[0] for item in paper.objects if item.kind == Kind.FLAG)
        stays = [Piece(Kind.BLOCK, (flag_x - 1, y, 1)) for y in range(size[1])]
        smallest = flag_x + 1, task.goal_cell[1] + 1, 1
    if any(length < lowest for length, lowest in zip(size, smallest, strict=True)):
        raise InputError(
            f"task '{RANDOM_PREFIX}{task.name}': the area is {size}; allowed: at least {smallest}"
        )
    # A wider area takes a longer barrier.
    if task.design is None:
        n_needed = len(stays)
    else:
        n_needed = len(task.design.of_kind(Kind.BLOCK))
    if n_blocks is None:
        n_blocks = paper.n_blocks
        if stays:
            n_blocks += size[1] - paper.size[1]
    if n_blocks < n_needed:
        raise InputError(
            f"task '{RANDOM_PREFIX}{task.name}': {n_blocks} blocks; allowed: at least {n_needed}"
        )
    bare = replace(paper, size=size, objects=tuple(stays), cars={}, n_blocks=n_blocks)
    return bare.with_counts(n_cars), flag_x


def whole_size(area: tuple[int, ...] | None, usual: Cell) -> Cell:
    """Return length, width and height of an area, the usual ones unless given; raise InputError if invalid."""
    sides = () if area is None else area
    if len(sides) not in (0, 2, 3):
        raise InputError(
            f"the area is {sides}; allowed: length and width, perhaps height, in cells"
        )
    return cast(Cell, (*sides, *usual[len(sides) :]))
