"""Tasks: where a world starts, its reward, when it is done. The six of the paper and one's own."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.files.blueprint import Blueprint, read_blueprint
from craftsim.discrete.files.design import Design, read_design
from craftsim.discrete.files.placement import Placement
from craftsim.discrete.files.shipped import shipped_blueprint
from craftsim.discrete.grid import CarField, Cell, Grid, Kind, check_grid
from craftsim.errors import BlueprintError, InputError, suggestion
from craftsim.tasks.observation import Layout
from craftsim.tasks.potentials import GOALS
from craftsim.tasks.rewards import Reward, Weights, check_name, make_reward
from craftsim.tasks.starts import Split, Starts, StartSampler, Targets, targets_of

TaskName = Literal[
    "strip", "block", "simple_two_story", "complex_two_story", "free_building", "breaking_barrier"
]
TASK_NAMES: Final[tuple[str, ...]] = get_args(TaskName)

WITHOUT_GOAL: Final = "complexity"
"""The reward of a task without a goal."""
DEFAULT_MAX_STEPS: Final = 18
"""The published step limit; an episode has two ticks more (docs/rules.md#episode-length)."""


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
    """A weighted sum of terms."""
    success: str | Callable[[Grid], float | bool] | None
    """The condition of success: a name in :data:`craftsim.tasks.potentials.GOALS`, or any function of a Grid that is
    not zero then; None where there is nothing to reach."""
    design: Design | None = None
    """The design to be built in every episode; None where nothing is, or each has a design of its own."""
    max_steps: int = DEFAULT_MAX_STEPS
    ends_on_success: bool = True
    shows_flag: bool = False
    """Observations have the flag's place; else that row repeats the goal."""
    placement: Placement = "sane"
    sampler: StartSampler | None = None
    """Source of starts, where not the start files; they have the numbers that those announce."""
    split: Split | None = None
    """The split of the starts of a task that varies."""
    shown_targets: int = 0
    """Rows of an observation that show what is to be built; 0 for none."""

    def __post_init__(self) -> None:
        if not self.starts:
            raise InputError(f"task '{self.name}' needs at least one start file")
        if not isinstance(self.reward, Reward):
            raise InputError(
                f"task '{self.name}': reward must be a Reward, such as Reward({{function: 1.0}}), not {self.reward!r}"
            )
        if self.max_steps < 0:
            raise InputError(
                f"task '{self.name}': max_steps is {self.max_steps}, allowed: 0 or more"
            )
        first = self.starts[0]
        counts = [
            (start.n_cars, start.n_slopes, start.n_blocks, start.size) for start in self.starts
        ]
        for start, count in zip(self.starts, counts, strict=True):
            if count != counts[0]:
                raise BlueprintError(
                    f"{start.path}: cars, slopes, blocks and area are {count}, but {counts[0]} in {first.path}; "
                    "the start files of one task must agree"
                )
        if self.design is not None:
            self.design.check_fits(first.size)
        if self.success is not None:
            check_name("goal", self.success, GOALS)

    @cached_property
    def layout(self) -> Layout:
        """Layout of the task's observations."""
        first = self.starts[0]
        n_shown = 0
        if self.shown_targets:
            n_shown = len(self._targets)
        counts = first.n_cars, first.n_slopes, first.n_blocks
        return Layout(*counts, first.goal, self.shows_flag, n_targets=n_shown)

    @property
    def digest(self) -> str:
        """SHA-256 of its start files and its design, whatever these are called, and the split of its starts."""
        parts = [start.content for start in self.starts], self.design and self.design.content
        digest = hashlib.sha256(json.dumps(parts).encode()).hexdigest()
        if self.split is None:
            return digest
        return f"{digest}-{self.split}"

    @property
    def has_goal(self) -> bool:
        """Whether there is something to reach; without it success is never reported."""
        return self.success is not None

    @property
    def goal_cell(self) -> Cell | None:
        """The cell that the flag is to reach, if there is a flag."""
        if self.shows_flag:
            return self.starts[0].goal
        return None

    @property
    def goal_cells(self) -> list[Cell]:
        """Cells of the floor to mark for people: the building's plan, or where the flag goes."""
        if self.design is not None:
            return self.design.floor
        goal = self.starts[0].goal
        if goal is None or goal[2] != 1:
            return []
        return [goal]

    @cached_property
    def always_starts_the_same(self) -> bool:
        """Whether every episode starts with the same world."""
        return self.sampler is None and len(self.starts) == 1 and self.starts[0].is_fixed

    @property
    def draws_designs(self) -> bool:
        """Whether each episode has a design of its own."""
        return self.design is None and self.shown_targets > 0

    @cached_property
    def _targets(self) -> Targets:
        """(T, 5): the rows of its design, of which there are as many as are shown."""
        rows = targets_of(self.design)
        return np.pad(rows, ((0, max(0, self.shown_targets - len(rows))), (0, 0)))

    @cached_property
    def _fixed(self) -> list[Grid | None]:
        """The worlds of the start files without random parts."""
        rng = np.random.default_rng(0)
        grids: list[Grid | None] = []
        for start in self.starts:
            if start.is_fixed:
                grids.append(start.grid(rng, self.placement))
            else:
                grids.append(None)
        return grids

    def draw(self, rng: np.random.Generator) -> Grid:
        """Return the world of a new episode."""
        return self.draw_starts(rng, 1).grid(0)

    def draw_starts(self, rng: np.random.Generator, n: int) -> Starts:
        """Return the starts of n new episodes, one or more, and what is to be built in each."""
        if self.sampler is not None:
            starts = self.sampler.draw(rng, n)
            if self.draws_designs:
                return starts
            grids = starts.grids
        else:
            worlds = []
            for _ in range(n):
                i = 0
                if len(self.starts) > 1:
                    i = int(rng.integers(len(self.starts)))
                worlds.append(self._fixed[i] or self.starts[i].grid(rng, self.placement))
            grids = Grid.stack(worlds)
        return Starts(grids, np.repeat(self._targets[None], n, axis=0))

    def starting_from(self, grids: Sequence[Grid], design: Design | None = None) -> Task:
        """Return the task whose episodes start with one of these worlds, each as likely.

        Where each episode has a design of its own, the one that is given is built in all of them.

        Raises InputError for worlds that do not fit the task, for none at all, for a design where the task has a goal
        of its own, and for none, or one of too many cells, where it needs one.
        """
        if not grids:
            raise InputError(f"task '{self.name}' needs at least one stored start")
        # One world may stand in the list many times.
        for grid in {id(grid): grid for grid in grids}.values():
            self.check_start(grid)
        if not self.draws_designs:
            if design is not None:
                raise InputError(
                    f"task '{self.name}' has its own goal; leave the option 'design' out"
                )
            return replace(self, sampler=Starts.of(grids, self._targets))
        if not isinstance(design, Design):
            raise InputError(
                f"in task '{self.name}' each episode has a design of its own; with a start give the option 'design', "
                f"a Design, not {design!r}"
            )
        if len(design.targets) > self.shown_targets:
            raise InputError(
                f"{design.path}: {len(design.targets)} cells; allowed in task '{self.name}': at most "
                f"{self.shown_targets}"
            )
        return replace(
            self, design=design, split=None, sampler=Starts.of(grids, targets_of(design))
        )

    def for_episode(self, rng: np.random.Generator) -> Task:
        """Return the task of a new episode: itself, or where each has a design of its own, that one from its start."""
        if not self.draws_designs:
            return self
        starts = self.draw_starts(rng, 1)
        return self.starting_from([starts.grid(0)], starts.design(0, self.name))

    def check_start(self, grid: Grid) -> None:
        """Raise InputError for a world that cannot be a start: another size, other things than the task observes."""
        check_grid(grid)
        first = self.starts[0]
        layout = self.layout
        if (grid.size, grid.n_cars) != (first.size, first.n_cars):
            raise InputError(
                f"the start has size {grid.size} and {grid.n_cars} cars; task '{self.name}' has {first.size} and "
                f"{first.n_cars}"
            )
        kinds = [*grid.kind.ravel().tolist(), *grid.cars[:, CarField.LOAD].tolist()]
        feet = {(body.cells[1], body.yaw) for body in grid.pieces(Kind.BODY)}
        # A foot whose slope has no body takes a row of observations as a whole slope does.
        lone_feet = sum((foot.cell, foot.yaw) not in feet for foot in grid.pieces(Kind.FOOT))
        slopes = kinds.count(Kind.FSLOPE) + kinds.count(Kind.BODY) + lone_feet
        for noun, count, n_observed in (
            ("blocks", kinds.count(Kind.BLOCK), layout.n_blocks),
            ("slopes", slopes, layout.n_slopes),
        ):
            if count > n_observed:
                raise InputError(
                    f"the start has {count} {noun}; task '{self.name}' observes at most {n_observed}"
                )

    def potential(self, grids: Grid, designs: Targets) -> NDArray[np.float64]:
        """Return (B,): the potential of each of B worlds, in which ``designs`` (B, T, 5) are to be built."""
        return self.reward.potential(
            self.reward.potentials(grids, designs, self.layout), len(designs)
        )

    def reached(self, grids: Grid, designs: Targets) -> NDArray[np.bool_]:
        """Return (B,): whether the work is done in each of B worlds, in which ``designs`` (B, T, 5) are to be built."""
        success = self.success
        if isinstance(success, str):
            return GOALS[success](grids, designs, self.layout)
        if success is None:
            return np.zeros(len(grids), np.bool_)
        return np.array([bool(success(grids[i])) for i in range(len(grids))])

    def succeeded(self, grid: Grid) -> bool:
        """Return whether the work is done; InputError where each episode has a design of its own."""
        if self.draws_designs:
            raise InputError(
                "this task has a design of its own in each episode; task.for_episode(rng) is the task of one"
            )
        return bool(self.reached(grid[None], self._targets[None])[0])

    def over(self, t: NDArray[np.int64], success: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return whether episodes are over after tick t (from 0), elementwise."""
        too_long: NDArray[np.bool_] = t > self.max_steps
        if self.ends_on_success:
            return too_long | success
        return too_long


def free_play(
    name: str,
    starts: tuple[Blueprint, ...],
    max_steps: int = DEFAULT_MAX_STEPS,
    reward: str | Weights = WITHOUT_GOAL,
) -> Task:
    """Return a task without a goal around start files: the reward is how elaborate a building is, or other terms."""
    return Task(name, starts, make_reward(reward), None, max_steps=max_steps, ends_on_success=False)


def make_task(
    name: TaskName | str,
    reward: str | Weights = "paper",
    max_steps: int = DEFAULT_MAX_STEPS,
    n_cars: int | None = None,
    n_blocks: int | None = None,
) -> Task:
    """Return one of the paper's six tasks.

    ``reward`` is the name of a reward or of a term (:mod:`craftsim.tasks.rewards`), or weights of such names:
    ``{"paper": 1.0, "illegal_actions": -0.1}``. With ``published_code`` an episode ends by its length alone, random
    placement is as published, and the flag's row is shown in the barrier task only; otherwise it also ends with
    success.
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
    starts = (read_blueprint(shipped_blueprint(name)).with_counts(n_cars, n_blocks),)
    if name in ("free_building", "breaking_barrier"):
        if name == "free_building":
            goal = "one_platform"
        else:
            goal = "flag_at_goal"
        return build_task(name, starts, goal, reward, max_steps)
    design = read_design(shipped_blueprint(f"{name}_goal"))
    return build_task(name, starts, "built", reward, max_steps, design, scored_as=name)


def build_task(
    name: str,
    starts: tuple[Blueprint, ...],
    goal: str,
    reward: str | Weights,
    max_steps: int,
    design: Design | None = None,
    scored_as: str = "",
) -> Task:
    """Return a task with one of the goals ``built``, ``flag_at_goal`` and ``one_platform``; rewards as in make_task.

    ``scored_as`` names a task whose rewards differ from those of the goal.
    """
    published = reward == "published_code" or (
        isinstance(reward, Mapping) and "published_code" in reward
    )
    return Task(
        name=name,
        starts=starts,
        reward=make_reward(reward, scored_as, goal),
        success=goal,
        design=design,
        max_steps=max_steps,
        ends_on_success=not published,
        shows_flag=goal == "flag_at_goal",
        placement="published" if published else "sane",
    )
