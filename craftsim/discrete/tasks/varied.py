"""Tasks whose episodes differ: in where things and cars are at the start, and perhaps in what is to be built."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Final, cast

import numpy as np

from craftsim.discrete.files.design import Design
from craftsim.discrete.grid import Cell, Grid
from craftsim.discrete.tasks.batches import Starts, StartSource
from craftsim.discrete.tasks.measures import Finished, target_array
from craftsim.discrete.tasks.observation import Layout
from craftsim.discrete.tasks.splits import Split, Stored
from craftsim.discrete.tasks.starts import StoredStarts
from craftsim.discrete.tasks.task import Task
from craftsim.errors import InputError

DESIGNS: Final = "designs"
"""The name of the task in which each episode has a random design."""


def whole_size(area: tuple[int, ...] | None, usual: Cell) -> Cell:
    """Return length, width and height of an area that is given without some of them; InputError for what is none."""
    given = () if area is None else area
    if len(given) not in (0, 2, 3):
        raise InputError(f"the area is {given}; allowed: length and width, perhaps height, in cells")
    return cast(Cell, (*given, *usual[len(given) :]))


@dataclass(frozen=True)
class DrawnEpisode(StoredStarts):
    """The task of one episode of a varied task: its start and its design, which observations go on to show."""

    shown: int = 0
    """How many rows say what is to be built, of which the design may need fewer."""

    @property
    def n_targets(self) -> int:
        """How many rows say what is to be built."""
        return self.shown

    @property
    def layout(self) -> Layout:
        """Layout of the task's observations, which show what is to be built."""
        return Layout.of(self.starts[0], self.shows_flag, self.shown)

    def draw_starts(self, rng: np.random.Generator, n: int) -> Starts:
        """Return n times the start, and what is to be built."""
        rows = target_array(self.design)
        return Starts.of(
            [self.draw(rng) for _ in range(n)], np.pad(rows, ((0, self.shown - len(rows)), (0, 0)))
        )


@dataclass(frozen=True)
class VariedTask(Task):
    """A task whose episodes start as a source says; without a design of its own each episode has one."""

    source: StartSource = field(kw_only=True)
    split: Split = "train"

    def draw_starts(self, rng: np.random.Generator, n: int) -> Starts:
        """Return the starts of n new episodes, and what is to be built in each."""
        return self.source.draw(rng, n)

    def draw(self, rng: np.random.Generator) -> Grid:
        """Return the world of a new episode."""
        return self.draw_starts(rng, 1).grid(0)

    @property
    def listed_starts(self) -> Starts | None:
        """The starts of all episodes where they are a list, such as held-out ones."""
        return self.source.starts if isinstance(self.source, Stored) and self.split == "test" else None

    @property
    def always_starts_the_same(self) -> bool:
        """Whether every episode starts with the same world."""
        return False

    @property
    def draws_designs(self) -> bool:
        """Whether each episode has a design of its own."""
        return self.design is None and isinstance(self.success, Finished)

    @property
    def n_targets(self) -> int:
        """How many rows say what is to be built: as many as a design can have at most."""
        first = self.starts[0]
        return first.n_blocks + 2 * first.n_slopes if self.draws_designs else super().n_targets

    @property
    def layout(self) -> Layout:
        """Layout of the task's observations, which show what is to be built."""
        return Layout.of(self.starts[0], self.shows_flag, self.n_targets)

    @property
    def digest(self) -> str:
        """SHA-256 of what its starts are drawn from."""
        return f"{super().digest}-{self.split}"

    def for_episode(self, rng: np.random.Generator) -> Task:
        """Return the task of a new episode: itself, or where each has a design of its own, that one from its start."""
        if not self.draws_designs:
            return self
        starts = self.draw_starts(rng, 1)
        return self.starting_at(starts.grid(0), starts.design(0, self.name))

    def starting_at(self, start: Grid, design: Design | None = None) -> Task:
        """Return the task of an episode with a given start, and the design that it needs where each has its own."""
        if not self.draws_designs:
            return super().starting_at(start, design)
        if not isinstance(design, Design):
            raise InputError(
                f"in task '{self.name}' each episode has a design of its own; with a start give the option 'design', "
                f"a Design, not {design!r}"
            )
        if len(design.targets) > self.n_targets:
            raise InputError(
                f"{design.path}: {len(design.targets)} cells; allowed in task '{self.name}': at most {self.n_targets}"
            )
        reward, success = self.reward.for_design(design), Finished(design)
        known = replace(self, design=design, reward=reward, success=success).parts
        return DrawnEpisode(**known, grids=(start,), shown=self.n_targets)
