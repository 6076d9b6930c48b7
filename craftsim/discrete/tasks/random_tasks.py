"""The paper's six tasks with random starts: the same design, but things and cars anywhere, turned anyhow."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.files.blueprint import Blueprint
from craftsim.discrete.files.listing import ListedObject
from craftsim.discrete.grid import CarField, Kind
from craftsim.discrete.grid_checks import check_size
from craftsim.discrete.tasks.batches import Starts, StartSource
from craftsim.discrete.tasks.measures import OnePlatform, target_array
from craftsim.discrete.tasks.placing import place_all
from craftsim.discrete.tasks.splits import Split, Stored, belongs, check_split
from craftsim.discrete.tasks.task import TASK_NAMES, RewardName, Task, make_task
from craftsim.discrete.tasks.varied import VariedTask, whole_size
from craftsim.errors import InputError

RANDOM: Final = "random_"
RANDOM_NAMES: Final = tuple(f"{RANDOM}{name}" for name in TASK_NAMES)
MAX_STEPS: Final = {
    "strip": 30,
    "block": 29,
    "simple_two_story": 51,
    "complex_two_story": 104,
    "free_building": 51,
    "breaking_barrier": 36,
}
"""Step limits: about 1.5 times what 95 % of the planner's plans for random starts take (docs/tasks.md)."""
_TRIES: Final = 1000


@dataclass(frozen=True)
class RandomPlacement:
    """Random starts of a split, drawn as they are needed: what a blueprint lists stands, all else is placed at random.

    A start at which the work is done already is none.
    """

    blueprint: Blueprint
    task: Task
    split: Split
    flag_x: int = -1
    """The lowest x at which a flag is placed; -1 for none."""

    def draw(self, rng: np.random.Generator, n: int) -> Starts:
        """Return n starts; raises InputError where things find no room."""
        starts, missing = self._place(rng, n)
        for _ in range(_TRIES):
            if not len(missing):
                return starts
            again, wrong = self._place(rng, len(missing))
            starts.put(missing, again)
            missing = missing[wrong]
        plan = self.blueprint
        raise InputError(
            f"task '{self.task.name}': no room for {plan.n_cars} cars, {plan.n_slopes} slopes and {plan.n_blocks} "
            f"blocks in an area of {plan.size[:2]} cells; try a larger one, or fewer of them"
        )

    @cached_property
    def _bare(self) -> Starts:
        """The world before anything is placed."""
        plan = self.blueprint
        bare = replace(plan, n_cars=0, n_blocks=plan.listed(Kind.BLOCK), n_slopes=0)
        grid = bare.grid(np.random.default_rng(0))
        grid.cars = np.zeros((plan.n_cars, len(CarField)), np.int16)
        grid.cars[:, CarField.Z] = 1
        return Starts.of([grid], target_array(self.task.design))

    def _place(self, rng: np.random.Generator, n: int) -> tuple[Starts, NDArray[np.int64]]:
        """Return n starts, and which of them will not do."""
        plan = self.blueprint
        starts, blocks = self._bare.take(np.zeros(n, np.int64)), plan.n_blocks - plan.listed(Kind.BLOCK)
        n_things = (self.flag_x >= 0) + plan.n_slopes + blocks
        found_room = np.zeros(n, np.bool_)
        place_all(
            *(starts.grids.world(), plan.n_slopes, blocks, self.flag_x),
            *(rng.random((n, n_things + 2 * plan.n_cars)), found_room),
        )
        done = self.task.success_measure.of_episodes(starts.grids.world(), starts.designs) != 0
        return starts, np.flatnonzero(~found_room | done | ~belongs(starts.digests(), self.split))


def random_task(
    name: str,
    split: Split = "train",
    reward: RewardName = "paper",
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
    own = make_task(name, reward, MAX_STEPS.get(name, 0) if max_steps is None else max_steps)
    blueprint, flag_x = _blueprint(own, n_cars, n_blocks, area)
    known = own.parts | {
        "name": RANDOM + name + (f"@{split}" if split == "test" else ""),
        "starts": (blueprint,),
    }
    if own.design is None and own.goal_cell is None:
        known["success"] = OnePlatform(blueprint.n_blocks)
    source: StartSource = RandomPlacement(blueprint, Task(**known), split, flag_x)
    if split == "test" and (n_cars, n_blocks, area) == (None, None, None):
        source = Stored(RANDOM + name, "test")
    return VariedTask(**known, source=source, split=split)


def _blueprint(
    task: Task, n_cars: int | None, n_blocks: int | None, area: tuple[int, ...] | None
) -> tuple[Blueprint, int]:
    """Return the numbers of all that there is, with what stays in its place, and the lowest x of the flag."""
    paper = task.starts[0]
    size = whole_size(area, paper.size)
    check_size(size, paper.n_cars)
    stays: list[ListedObject] = []
    flag_x = -1
    least = (1, 1, 1) if task.design is None else task.design.size
    if task.goal_cell is not None:
        flag_x = next(item.cell[0] for item in paper.objects if item.kind == Kind.FLAG)
        stays = [ListedObject(Kind.BLOCK, (flag_x - 1, y, 1), 0, 0) for y in range(size[1])]
        least = flag_x + 1, task.goal_cell[1] + 1, 1
    if any(found < needed for found, needed in zip(size, least, strict=True)):
        raise InputError(f"task '{RANDOM}{task.name}': the area is {size}; allowed: at least {least}")
    # A wider area takes a longer barrier.
    needed = len(stays) if task.design is None else len(task.design.of_kind(Kind.BLOCK))
    blocks = paper.n_blocks + (size[1] - paper.size[1] if stays else 0) if n_blocks is None else n_blocks
    if blocks < needed:
        raise InputError(f"task '{RANDOM}{task.name}': {blocks} blocks; allowed: at least {needed}")
    bare = replace(paper, size=size, objects=tuple(stays), cars=(), n_blocks=blocks)
    return bare.with_counts(n_cars), flag_x
