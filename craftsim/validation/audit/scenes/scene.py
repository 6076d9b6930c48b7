"""A scene: a world drawn by hand, and what is done in it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from craftsim.checking.recipe import Step
from craftsim.discrete.actions import Action
from craftsim.discrete.grid import KINDS_WITH_YAW, SECOND_PART, Cell, Grid, Kind, beside
from craftsim.discrete.rules import Rules
from craftsim.discrete.rules.table import ACTIONS
from craftsim.discrete.schedule import Order
from craftsim.validation.audit.intended import NoPredictionError, intended

_SIZE: Final = (8, 7, 4)

Thing = tuple[Kind, Cell] | tuple[Kind, Cell, int]
"""An object with its cell and, of a slope, its yaw; the second part comes with it."""
CarRow = tuple[int, int, int, int, Kind, int, int]
"""A row of ``Grid.cars``."""


@dataclass(frozen=True)
class Scene:
    """A world on the map, and one action in it, or one tick of several cars."""

    name: str
    things: tuple[Thing, ...]
    cars: tuple[CarRow, ...]
    """Rows of ``Grid.cars``; the first car acts, or the first ones."""
    actions: tuple[Action, ...]
    order: Order | None = None
    """How the actions of a tick follow each other; None for a single action."""

    @property
    def id(self) -> str:
        """Name of its row: the action, and the scene."""
        verbs = "+".join(ACTIONS[action].verb for action in self.actions)
        return f"{verbs}/scene={self.name}" + (f"/order={self.order}" if self.order else "")

    def world(self) -> Grid:
        """Return its world."""
        grid = Grid.empty(_SIZE, len(self.cars))
        for row, values in zip(grid.cars, self.cars, strict=True):
            row[:] = values
        for kind, cell, *yaw in self.things:
            turn = yaw[0] if yaw else 0
            _put(grid, kind, cell, turn)
            if kind in SECOND_PART:
                _put(grid, SECOND_PART[kind], beside(cell, turn), turn)
        grid.derive_marks()
        return grid

    def legal(self, rules: Rules) -> bool:
        """Return whether the rules allow all of it, one action after the other."""
        _, applied = rules.tick(self.world(), [(car, int(a)) for car, a in enumerate(self.actions)])
        return bool(applied.all())

    def why_nothing(self) -> str:
        """Return why nothing is intended where the rules forbid it; empty where something is."""
        if self.order is not None:
            return "several cars are to act"
        try:
            intended(self.world(), 0, self.actions[0])
        except NoPredictionError as reason:
            return str(reason)
        return ""

    def step(self, legal: bool) -> Step:
        """Return what is to be done; a forbidden action goes with its intended world."""
        if self.order is not None:
            return Step.joint(0, list(enumerate(self.actions)), order=self.order)
        goal = None if legal else intended(self.world(), 0, self.actions[0])
        return Step.single(0, 0, self.actions[0], goal)


def _put(grid: Grid, kind: Kind, cell: Cell, yaw: int) -> None:
    """Put something into a cell; a gear gives way, and of two gears the one with the smaller yaw is shown."""
    there = grid.kind[cell]
    if kind == Kind.GEAR and there != Kind.AIR and not (there == kind and yaw < grid.yaw[cell]):
        return
    grid.kind[cell] = kind
    grid.yaw[cell] = yaw if kind in KINDS_WITH_YAW else 0
