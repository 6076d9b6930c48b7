"""Situations that take more than one car, or more than the contexts vary: drawn by hand, each for a suspect rule."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from itertools import product
from typing import Final

import yaml

from craftsim.checking.episode import Step
from craftsim.discrete.actions import ACTIONS
from craftsim.discrete.grid import SECOND_PART, Cell, Grid, Kind, Piece
from craftsim.discrete.kinds import Action
from craftsim.discrete.readback import HEADINGS
from craftsim.discrete.rules import Rules
from craftsim.discrete.schedule import Concurrency
from craftsim.validation.audit.intended import NoPredictionError, intended

_SIZE: Final = (8, 7, 4)
_CAR: Final = re.compile(r"(\d+,\d+,\d+) (..)(?: (block|flag|fslope)([+-][xy])?)?(?: (low|high))?")

Thing = tuple[Kind, Cell, int]
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
    order: Concurrency | None = None
    """How the actions of a tick follow each other; None for a single action."""
    size: Cell = _SIZE
    """Of the world."""

    @property
    def id(self) -> str:
        """Name of its row: the action, and the scene."""
        verbs = "+".join(ACTIONS[action].verb for action in self.actions)
        return f"{verbs}/scene={self.name}" + (f"/order={self.order}" if self.order else "")

    def world(self) -> Grid:
        """Return its world."""
        grid = Grid.empty(self.size, len(self.cars))
        for row, values in zip(grid.cars, self.cars, strict=True):
            row[:] = values
        # Of two gears in a cell the one with the smaller yaw is shown.
        for kind, cell, yaw in sorted(self.things, key=lambda thing: -thing[2]):
            grid.put(Piece(kind, cell, yaw if kind in SECOND_PART else 0))
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


def _scenes() -> Iterator[Scene]:
    """Yield what ``craftsim/data/scenes.yaml`` describes."""
    text = files("craftsim.data").joinpath("scenes.yaml").read_text(encoding="utf-8")
    for group in yaml.safe_load(text):
        for shared, (name, own) in product(group.get("each", [{}]), group["scenes"].items()):
            said = (group, shared, own)
            one = group | shared | own
            yield Scene(
                name,
                tuple(map(_thing, _listed(said, "things"))),
                tuple(map(_car, _listed(said, "cars"))),
                tuple(Action[action] for action in one["action"].split("+")),
                one.get("order"),
            )


def _listed(said: Sequence[Mapping[str, str]], key: str) -> list[str]:
    return [text for part in said if key in part for text in part[key].split("; ")]


def _cell(text: str) -> Cell:
    x, y, z = map(int, text.split(","))
    return x, y, z


def _thing(text: str) -> Thing:
    """Return the thing of a text such as ``block 5,3,1`` or ``body 2,3,1 +x``."""
    kind, cell, *heading = text.split()
    return Kind[kind.upper()], _cell(cell), HEADINGS.index(heading[0]) if heading else 0


def _car(text: str) -> CarRow:
    """Return the car that :func:`~craftsim.discrete.readback.describe_car` describes so."""
    found = _CAR.fullmatch(text)
    if found is None:
        raise RuntimeError(f"craftsim/data/scenes.yaml: '{text}' describes no car")
    cell, heading, load, side, half = found.groups()
    carried = Kind[load.upper()] if load else Kind.AIR
    load_yaw = HEADINGS.index(side) if side else 0
    slope = {None: 0, "low": 1, "high": 2}[half]
    return *_cell(cell), HEADINGS.index(heading), carried, load_yaw, slope


SCENES: Final = tuple(_scenes())
