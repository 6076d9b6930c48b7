"""The environments' physics with every action checked: what policies are validated on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from craftsim.checking.checked_run import ActionRecord
from craftsim.checking.recipe import Recipe, Step, do, prepare
from craftsim.discrete.actions import Action
from craftsim.discrete.grid import Cell, Grid
from craftsim.discrete.tasks.worlds import Worlds
from craftsim.envs.backend import Tick


class CheckedBackend:
    """A backend that keeps the recipe of its one episode and the records of all actions."""

    def __init__(self, start: Recipe) -> None:
        """Prepare the world of a recipe without steps."""
        self.recipe = start
        """How the episode starts, and all its steps so far."""
        self.records: list[tuple[ActionRecord, ...]] = []
        """Of each step."""
        self._checked = prepare(start)

    def start(self, grid: Grid, rng: np.random.Generator) -> Grid:
        """Begin the episode; what there is to draw was drawn for the recipe, from the same seed as ``grid``."""
        assert grid.same_visible(self.recipe.grid())
        return self.grid

    def perform(self, step: Step) -> tuple[ActionRecord, ...]:
        """Do one step and keep its records."""
        self.recipe = replace(self.recipe, steps=(*self.recipe.steps, step))
        self.records.append(do(self._checked, step))
        return self.records[-1]

    @property
    def grid(self) -> Grid:
        """The world as it was read last."""
        return self._checked.reading.grid

    @property
    def problems(self) -> tuple[str, ...]:
        """Why the world cannot be read as a grid any more; empty when it can."""
        broken = ("the simulation broke down",) if self._checked.site.diverged else ()
        return (*broken, *self._checked.reading.problems)

    def tick(self, worlds: Worlds, actions: NDArray[np.int64], order: NDArray[np.int64]) -> Tick:
        """Let all cars act at once, and judge each."""
        began_s = self._checked.site.time_s
        joint = [(int(car), Action(actions[car])) for car in order]
        records = self.perform(Step.joint(len(self.records), joint))
        worlds.put(0, self.grid)
        legal = np.zeros(len(actions), np.bool_)
        legal[[record.car for record in records]] = [record.legal for record in records]
        return Tick(legal, self._checked.site.time_s - began_s, self.problems)

    def picture(self, grid: Grid, goal: Cell | None) -> NDArray[np.uint8]:
        """Show nothing: films are made from bundles."""
        raise NotImplementedError

    def pictures(self, grid: Grid, goal: Cell | None) -> list[NDArray[np.uint8]]:
        """Show nothing."""
        raise NotImplementedError

    def show(self, grid: Grid, goal: Cell | None) -> None:
        """Show nothing."""
        raise NotImplementedError

    def close(self) -> None:
        """Hold nothing."""
