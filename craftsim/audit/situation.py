"""One kind of situation for the audit, margins and tuning: its properties, its world, and what is done there."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from importlib.resources import files
from itertools import product
from typing import Any, Final, NamedTuple

import numpy as np
import yaml

from craftsim.audit.builder import Builder, CarRow, ImpossibleError, grid_of, turned
from craftsim.checking.episode import Step
from craftsim.discrete.actions import ACTIONS
from craftsim.discrete.grid import CarField, Cell, Grid, Kind, Piece, beside
from craftsim.discrete.kinds import MOVE_DIRECTION, Action
from craftsim.discrete.readback import HEADINGS
from craftsim.discrete.rules import Rules
from craftsim.discrete.schedule import Concurrency

FORWARD, LEFT, BACK, RIGHT = range(4)
"""Directions and yaws relative to the car's heading."""
DIRECTION_NAMES: Final = ("forward", "left", "back", "right")
"""Their names, by number."""


class Row(NamedTuple):
    """The properties of a situation, each in a word or two; those that do not matter there are empty.

    As text they are read by people and matched by patterns, and nothing takes them apart again.
    """

    action: str
    """The verbs, of a move with its direction relative to the heading, such as ``MOVE-left``."""
    level: str = ""
    """The car's level before the action."""
    ground: str = ""
    """What the car stands on: flat, or the lower or upper half of a slope that leads up or down ahead."""
    own: str = ""
    """In the car's cell."""
    load: str = ""
    next: str = ""
    """In the cell that a move goes to; ``above-`` says that it is the cell below that, which is free."""
    over: str = ""
    """In the cell above the own one (lift, fold, unfold) or above what the action is about; of a move onto a ramp, in
    the cell above the landing of the climb, above the body or above the foot that comes next."""
    beyond: str = ""
    """In the cell after the next, where that matters."""
    room: str = ""
    """``tight`` where blocks fill the neighbour cells of the way, as far as the rules let the action be."""
    near: str = ""
    """A neighbour."""
    column: str = ""
    """Where it is, relative to the car."""
    above: str = ""
    """Levels above the car's lower one."""
    scene: str = ""
    """Its name in ``craftsim/data/scenes.yaml``."""
    order: str = ""
    """Of several cars."""
    kind: str = ""
    """What situations that count together have in common."""
    then: tuple[str, ...] = ()
    """Actions that come after the first; the last one is judged."""

    def __str__(self) -> str:
        """Return such as ``MOVE-forward/level=1/ground=flat/own=block/load=none/next=air/room=free``."""
        at = f"@({self.column},{self.above})" if self.column else ""
        said = self._replace(near=self.near + at, column="", above="", kind="", then=())._asdict()
        parts = [f"{name}={word}" for name, word in said.items() if word and name != "action"]
        text = "/".join([self.action, *parts, *filter(None, [self.kind])])
        return " then ".join([text, *self.then])


@dataclass(frozen=True)
class Situation:
    """A world and what is done there: one action or, one after the other, several of car 0; or a tick of many cars."""

    row: Row
    """Its own properties, which no other situation of a plan has."""
    grid: Grid = field(compare=False, repr=False)
    acts: tuple[Action, ...]
    """Of car 0, one after the other; with an order those of the first cars, in one tick."""
    order: Concurrency | None = None
    """How the actions of a tick follow each other."""
    anywhere: bool = False
    """Whether the direction on the map and the place are drawn for each trial; the grid is one column wider then than
    what matters."""
    clearance_mm: float | None = None
    """How close geometry expects a neighbour to come: negative where it is in the way; None out of reach, and for no
    neighbour."""

    @property
    def id(self) -> str:
        """Its properties as text."""
        return str(self.row)

    @cached_property
    def digest(self) -> int:
        """A number made of its properties, from which trials draw."""
        said = {name: word for name, word in self.row._asdict().items() if word}
        return int.from_bytes(hashlib.sha256(json.dumps(said).encode()).digest()[:8])

    def placed(self, rng: np.random.Generator) -> Situation:
        """Return it in a direction and at a place on the map that a generator draws, where these do not matter."""
        if not self.anywhere:
            return self
        turn, before_x, before_y, room = (int(v) for v in rng.integers((0, 1, 1, 1), (4, 4, 4, 4)))
        length, width, height = self.grid.size
        (x0, y0, _), (x1, y1, _) = (turned(cell, turn) for cell in ((1, 1, 0), (length - 2, width - 2, 0)))
        low = min(x0, x1) - before_x, min(y0, y1) - before_y
        size = max(x0, x1) + 1 + room - low[0], max(y0, y1) + 1 + room - low[1], height
        grid = Builder.of(self.grid).turned(turn).grid(low, size)
        acts = tuple(
            _MOVES[(MOVE_DIRECTION[act] + turn) % 4] if act in MOVE_DIRECTION else act for act in self.acts
        )
        return Situation(self.row, grid, acts, self.order)

    def legal(self, rules: Rules) -> bool:
        """Return whether the rules allow what is done first; of a tick all of it, one action after the other."""
        if self.order is None:
            return rules.legal(self.grid, 0, self.acts[0])
        _, applied = rules.tick(self.grid, [(car, int(act)) for car, act in enumerate(self.acts)])
        return bool(applied.all())

    @cached_property
    def why_nothing(self) -> str:
        """Why nothing is intended where the rules forbid it; empty where something is."""
        if self.order is not None:
            return "several cars are to act"
        try:
            intended(self.grid, 0, self.acts[0])
        except ImpossibleError as reason:
            return str(reason)
        return ""

    def steps(self, legal: bool = True) -> tuple[Step, ...]:
        """Return what is to be done; a forbidden action goes with its intended world."""
        if self.order is not None:
            return (Step.joint(0, list(enumerate(self.acts)), order=self.order),)
        goal = None if legal else intended(self.grid, 0, self.acts[0])
        return tuple(Step.single(tick, 0, act, goal) for tick, act in enumerate(self.acts))


_MOVES: Final = {way: action for action, way in MOVE_DIRECTION.items()}

# What a forbidden action would have done, had the rules allowed it.
_LEVEL: Final = (Kind.GROUND, Kind.BLOCK, Kind.FLAG, Kind.FSLOPE)
"""What has a level top at the height of the next floor, whether the rules let anything stand on it or not."""
_ROOMY: Final = (Kind.AIR, Kind.GEAR, Kind.FOOT)
"""What leaves room for a carried thing in its cell, as far as cells can tell."""


def intended(grid: Grid, car: int, action: Action) -> Grid:
    """Return the world that an action leads to by the effects of the physical rules, whether it is legal or not.

    Raises ImpossibleError where there is nothing to do, no room for what would be there, or no such state.
    """
    if nothing := ACTIONS[action].nothing_to_try(grid, car):
        raise ImpossibleError(nothing)
    after = Rules("physical").enforce(grid, car, action)
    if action in MOVE_DIRECTION:
        ax, ay, az = (int(v) for v in after.cars[car, : CarField.Z + 1])
        _check_target(grid, (ax, ay, az), Kind(grid.cars[car, CarField.LOAD]))
    after.derive_marks()
    _check_state(after, car)
    return after


def _check_target(grid: Grid, cell: Cell, load: Kind) -> None:
    """Raise ImpossibleError where a move leads to no place for the car and its load."""
    there = _kind_at(grid, cell)
    if there == Kind.WALL:
        raise ImpossibleError("a wall is there")
    if load != Kind.AIR and there not in _ROOMY:
        raise ImpossibleError("two things would share a cell")
    if (grid.cars[:, : CarField.Z + 1] == cell).all(axis=1).any():
        raise ImpossibleError("a car is there")


def _check_state(grid: Grid, car: int) -> None:
    """Raise ImpossibleError where the rules have no such state of a car."""
    x, y, z, yaw, load, load_yaw, slope = (int(v) for v in grid.cars[car])
    here, below = _kind_at(grid, (x, y, z)), _kind_at(grid, (x, y, z - 1))
    off_slope = (slope == 1) != (here == Kind.FOOT) or (slope == 2) != (below == Kind.BODY)
    if off_slope or (slope == 0 and below not in _LEVEL):
        raise ImpossibleError("there is no ground to stand on")
    if slope and (yaw - int(grid.yaw[x, y, z if slope == 1 else z - 1])) % 2:
        raise ImpossibleError("a car across a slope is no state of the rules")
    if load == Kind.FSLOPE:
        gear = _kind_at(grid, beside((x, y, z), load_yaw))
        if not slope and gear not in _ROOMY:
            raise ImpossibleError("two things would share a cell")


def _kind_at(grid: Grid, cell: Cell) -> Kind:
    """Return what is in a cell, above the map nothing; raise ImpossibleError beside it."""
    (x, y, z), (length, width, height) = cell, grid.kind.shape
    if not (0 <= x < length and 0 <= y < width):
        raise ImpossibleError("the map ends there")
    return Kind(grid.kind[cell]) if z < height else Kind.AIR


_SIZE: Final = (8, 7, 4)
"""Of the map of a scene."""
_CAR: Final = re.compile(r"(\d+,\d+,\d+) (..)(?: (block|flag|fslope)([+-][xy])?)?(?: (low|high))?")


def shipped(name: str) -> Any:
    """Return what a YAML file of ``craftsim/data`` holds."""
    return yaml.safe_load(files("craftsim.data").joinpath(name).read_text(encoding="utf-8"))


def _scenes() -> Iterator[Situation]:
    """Yield what ``craftsim/data/scenes.yaml`` describes."""
    for group in shipped("scenes.yaml"):
        for shared, (name, own) in product(group.get("each", [{}]), group["scenes"].items()):
            said = (group, shared, own)
            one = group | shared | own
            acts, order = tuple(Action[action] for action in one["action"].split("+")), one.get("order")
            verbs = "+".join(ACTIONS[action].verb for action in acts)
            grid = grid_of(map(_piece, _listed(said, "things")), [*map(_car, _listed(said, "cars"))], _SIZE)
            yield Situation(Row(verbs, scene=name, order=order or ""), grid, acts, order)


def _listed(said: Sequence[Mapping[str, str]], key: str) -> list[str]:
    return [text for part in said if key in part for text in part[key].split("; ")]


def _cell(text: str) -> Cell:
    x, y, z = map(int, text.split(","))
    return x, y, z


def _piece(text: str) -> Piece:
    """Return the piece of a text such as ``block 5,3,1`` or ``body 2,3,1 +x``."""
    kind, cell, *heading = text.split()
    return Piece(Kind[kind.upper()], _cell(cell), HEADINGS.index(heading[0]) if heading else 0)


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
"""Situations that take more than one car, or more than varies for one: drawn by hand, each for a suspect rule."""
