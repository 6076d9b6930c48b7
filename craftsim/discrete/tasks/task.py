"""Tasks: where a world starts, its reward, when it is done. The six of the paper and one's own."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Final, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.files.blueprint import NO_CELL, Blueprint, read_blueprint
from craftsim.discrete.files.design import Design, read_design
from craftsim.discrete.files.placement import Placement
from craftsim.discrete.files.shipped import shipped_blueprint
from craftsim.discrete.grid import Cell, Grid
from craftsim.discrete.tasks.batches import Starts
from craftsim.discrete.tasks.measures import (
    CodeBuilding,
    CodePlatform,
    Complexity,
    Custom,
    Finished,
    FlagAtGoal,
    FlagNearness,
    Measure,
    OnePlatform,
    PaperBuilding,
    PaperPlatform,
    target_array,
)
from craftsim.discrete.tasks.observation import Layout
from craftsim.discrete.tasks.rewards import CodeBarrier, CodeReward, PaperBarrier, Reward
from craftsim.errors import BlueprintError, InputError, suggestion

TaskName = Literal[
    "strip", "block", "simple_two_story", "complex_two_story", "free_building", "breaking_barrier"
]
TASK_NAMES: Final[tuple[str, ...]] = get_args(TaskName)

RewardName = Literal["paper", "published_code", "complexity"]
"""The reward: as the paper states it, as CraftEnv's code computes it, or how elaborate a building is."""

DEFAULT_MAX_STEPS: Final = 18
"""The published step limit; an episode has two ticks more (docs/rules.md#episode-length)."""

UPPER_BLOCK: Final = {"simple_two_story": 1.0, "complex_two_story": 3.0}
"""Potential of a block above the floor by the paper's table 1, in simple and in complex buildings."""


@dataclass(frozen=True)
class Task:
    """Everything that makes a world an episode.

    Example:
        >>> import craftsim
        >>> task = craftsim.make_task("simple_two_story")
        >>> task.layout.n_cars, task.max_steps, task.has_goal
        (2, 18, True)
    """

    name: str
    starts: tuple[Blueprint, ...]
    """One of them is drawn for every episode; all announce the same numbers of cars, slopes and blocks."""
    reward: Reward
    success: Measure | Callable[[Grid], float | bool]
    """Whether the work is done: not zero when it is."""
    design: Design | None = None
    max_steps: int = DEFAULT_MAX_STEPS
    ends_on_success: bool = True
    shows_flag: bool = False
    """Whether observations have the flag's place; else that row repeats the goal."""
    placement: Placement = "sane"

    def __post_init__(self) -> None:
        if not self.starts:
            raise InputError(f"task '{self.name}' needs at least one start file")
        if self.max_steps < 0:
            raise InputError(f"task '{self.name}': max_steps is {self.max_steps}, allowed: 0 or more")
        first = self.starts[0]
        for start in self.starts[1:]:
            counts = [(b.n_cars, b.n_slopes, b.n_blocks, b.size) for b in (first, start)]
            if counts[0] != counts[1]:
                raise BlueprintError(
                    f"{start.path}: cars, slopes, blocks and area are {counts[1]}, but {counts[0]} in "
                    f"{first.path}; the start files of one task must agree"
                )
        if self.design is not None:
            self.design.check_fits(first.size)

    @property
    def layout(self) -> Layout:
        """Layout of the task's observations."""
        return Layout.of(self.starts[0], self.shows_flag)

    @property
    def digest(self) -> str:
        """SHA-256 of its starts and its design, whatever their files are called."""
        parts = [replace(start, path=Path()) for start in self.starts], self.design and self.design.targets
        return hashlib.sha256(repr(parts).encode()).hexdigest()

    @property
    def has_goal(self) -> bool:
        """Whether there is something to reach; without it success is never reported."""
        return self.success is not _no_goal

    @property
    def goal_cell(self) -> Cell | None:
        """The cell that the flag is to reach, if there is a flag."""
        return self.starts[0].goal if self.shows_flag else None

    @property
    def goal_cells(self) -> list[Cell]:
        """Cells of the floor to mark for people: the building's plan, or where the flag goes."""
        if self.design is not None:
            return self.design.floor
        goal = self.starts[0].goal
        return [] if goal is None or goal[2] != 1 else [goal]

    @property
    def success_measure(self) -> Measure:
        """The success predicate as a measure."""
        return self.success if isinstance(self.success, Measure) else Custom(self.success)

    @cached_property
    def _fixed(self) -> list[Grid | None]:
        """The worlds of the start files that leave nothing to chance."""
        rng = np.random.default_rng(0)
        return [start.grid(rng, self.placement) if start.is_fixed else None for start in self.starts]

    def draw(self, rng: np.random.Generator) -> Grid:
        """Return a new world from one of the start files."""
        start = int(rng.integers(len(self.starts))) if len(self.starts) > 1 else 0
        fixed = self._fixed[start]
        return self.starts[start].grid(rng, self.placement) if fixed is None else fixed.copy()

    @cached_property
    def _only(self) -> Starts:
        """The start of all episodes."""
        return Starts.of([self.draw(np.random.default_rng(0))], target_array(self.design))

    @property
    def always_starts_the_same(self) -> bool:
        """Whether every episode starts with the same world."""
        return len(self.starts) == 1 and self.starts[0].is_fixed

    def draw_starts(self, rng: np.random.Generator, n: int) -> Starts:
        """Return the starts of n new episodes, one or more, and what is to be built in each."""
        if self.always_starts_the_same:
            return self._only.take(np.zeros(n, np.int64))
        return Starts.of([self.draw(rng) for _ in range(n)], target_array(self.design))

    @property
    def n_targets(self) -> int:
        """How many rows say what is to be built."""
        return 0 if self.design is None else len(self.design.targets)

    @property
    def listed_starts(self) -> Starts | None:
        """The starts of all episodes where they are a list, such as held-out ones."""
        return None

    @property
    def draws_designs(self) -> bool:
        """Whether each episode has a design of its own."""
        return False

    def for_episode(self, rng: np.random.Generator) -> Task:
        """Return the task of a new episode: itself, or where each has a design of its own, that one from its start."""
        return self

    def starting_at(self, start: Grid, design: Design | None = None) -> Task:
        """Return the task of an episode with a given start: itself, as it has a design of its own, or needs none.

        Raises InputError for a design that is given nevertheless.
        """
        if design is not None:
            raise InputError(f"task '{self.name}' has its own goal; leave the option 'design' out")
        return self

    @property
    def parts(self) -> dict[str, Any]:
        """What makes it a task, by name: that of which another kind of task can be made."""
        return {field.name: getattr(self, field.name) for field in fields(Task)}

    def over(self, t: NDArray[np.int64], success: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return whether episodes are over after tick t (from 0), elementwise."""
        too_long: NDArray[np.bool_] = t > self.max_steps
        return too_long | success if self.ends_on_success else too_long

    def succeeded(self, grid: Grid) -> bool:
        """Return whether the work is done."""
        return bool(self.success_measure.of(grid))


def _no_goal(grid: Grid) -> bool:
    return False


def free_play(name: str, starts: tuple[Blueprint, ...], max_steps: int = DEFAULT_MAX_STEPS) -> Task:
    """Return a task without a goal around start files: the reward is how elaborate a building is."""
    reward = Reward(Complexity())
    return Task(name, starts, reward, _no_goal, max_steps=max_steps, ends_on_success=False)


def make_task(
    name: TaskName | str,
    reward: RewardName = "paper",
    max_steps: int = DEFAULT_MAX_STEPS,
    n_cars: int | None = None,
    n_blocks: int | None = None,
) -> Task:
    """Return one of the paper's six tasks.

    With ``reward="published_code"`` an episode ends by its length alone, random placement is as published,
    and the flag's row is shown in the barrier task only; otherwise it also ends with success.
    ``n_cars`` and ``n_blocks`` are other numbers than the published ones: what the start file does not list is drawn at
    random, so there cannot be fewer than it lists. Raises InputError.

    Example:
        >>> import craftsim
        >>> craftsim.make_task("strip", max_steps=40).max_steps
        40
    """
    if name not in TASK_NAMES:
        raise InputError(
            f"unknown task '{name}'{suggestion(name, TASK_NAMES)}; there are {', '.join(TASK_NAMES)}"
        )
    start = read_blueprint(shipped_blueprint(name)).with_counts(n_cars, n_blocks)
    goal, design = None, None
    if name == "breaking_barrier":
        goal = start.goal or NO_CELL
    elif name != "free_building":
        design = read_design(shipped_blueprint(f"{name}_goal"))
    return build_task(name, (start,), design, goal, reward, max_steps, UPPER_BLOCK.get(name, 1.0))


def build_task(
    name: str,
    starts: tuple[Blueprint, ...],
    design: Design | None,
    goal: Cell | None,
    reward: RewardName,
    max_steps: int,
    upper_block: float = 1.0,
) -> Task:
    """Return a task whose goal is a building, a flag at a cell or, with neither, one platform of all blocks.

    Args:
        name: of the task.
        starts: one of them is drawn for every episode.
        design: the building.
        goal: the cell that the flag is to reach; not both.
        reward: see :func:`make_task`.
        max_steps: the step limit.
        upper_block: potential of a block above the floor.
    """
    if reward not in get_args(RewardName):
        known = get_args(RewardName)
        raise InputError(
            f"unknown reward '{reward}'{suggestion(reward, known)}; there are {', '.join(known)}"
        )
    code = reward == "published_code"
    success: Measure
    rewards: Reward
    if design is not None:
        rewards = CodeReward(CodeBuilding(design)) if code else Reward(PaperBuilding(design, upper_block))
        success = Finished(design)
    elif goal is not None:
        rewards = (CodeBarrier if code else PaperBarrier)(FlagNearness(goal))
        success = FlagAtGoal(goal)
    else:
        rewards = CodeReward(CodePlatform()) if code else Reward(PaperPlatform())
        success = OnePlatform(starts[0].n_blocks)
    return Task(
        name=name,
        starts=starts,
        reward=Reward(Complexity()) if reward == "complexity" else rewards,
        success=success,
        design=design,
        max_steps=max_steps,
        ends_on_success=not code,
        shows_flag=goal is not None,
        placement="published" if code else "sane",
    )
