"""Situations of the audit, margins and tuning: small worlds, their properties and actions."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from importlib.resources import files
from itertools import product
from typing import Any, Final, NamedTuple

import numpy as np
import yaml

from craftsim.checking.recipe import Step
from craftsim.discrete.actions import ACTIONS
from craftsim.discrete.grid import (
    KINDS_WITH_YAW,
    CarField,
    CarRow,
    Cell,
    Grid,
    Kind,
    Piece,
    beside,
    grid_of,
    turn_cell,
)
from craftsim.discrete.kinds import MOVE_DIRECTION, STANDING, Action
from craftsim.discrete.readback import HEADING_NAMES
from craftsim.discrete.rules import Rules
from craftsim.discrete.schedule import Concurrency

_SHARED: Final = "two things would share a cell"


class ImpossibleError(Exception):
    """A world or an effect that cannot exist; the message is the reason."""


@dataclass
class Builder:
    """A world under construction. Columns may have any coordinates, also negative ones; levels begin at 1."""

    cells: dict[Cell, tuple[Kind, int]] = field(default_factory=dict)
    """Kind and yaw by occupied cell. AIR reserves a free cell; a gear occupies a cell only if it was claimed."""
    cars: list[CarRow] = field(default_factory=list)

    @classmethod
    def of(cls, grid: Grid) -> Builder:
        """Return a builder with the pieces and cars of a grid."""
        builder = cls(cars=[tuple(row) for row in grid.cars.tolist()])
        for piece in grid.pieces(*STANDING):
            builder.put(piece)
        return builder

    def copy(self) -> Builder:
        """Return an independent copy."""
        return Builder(dict(self.cells), list(self.cars))

    def put(self, piece: Piece) -> None:
        """Add a piece; a gear occupies no cell. Raises ImpossibleError if a cell is occupied."""
        cells = {cell: (kind, piece.yaw) for cell, kind in self._taken(piece) if kind != Kind.GEAR}
        if cells.keys() & self.cells:
            raise ImpossibleError(_SHARED)
        self.cells |= cells

    def claim(self, piece: Piece) -> None:
        """Add a piece unless it is there already; a gear occupies a cell, and AIR reserves one.

        Raises ImpossibleError if something else is there.
        """
        for cell, kind in self._taken(piece):
            if self.cells.setdefault(cell, (kind, piece.yaw)) != (kind, piece.yaw):
                raise ImpossibleError(_SHARED)

    @staticmethod
    def _taken(piece: Piece) -> list[tuple[Cell, Kind]]:
        if piece.cell[2] < 1:
            raise ImpossibleError("something would be in the ground")
        return list(zip(piece.cells, piece.kinds, strict=True))

    def support(self, cell: Cell) -> None:
        """Fill the cells below with blocks, down to the ground."""
        x, y, z = cell
        if z < 1:
            raise ImpossibleError("something would be in the ground")
        for level in range(1, z):
            below = (x, y, level)
            free = below not in self.cells and any(row[:3] == below for row in self.cars)
            if free:
                kind = Kind.AIR
                _ = 0
            else:
                kind, _ = self.cells.setdefault(below, (Kind.BLOCK, 0))
            if kind != Kind.BLOCK:
                ground = "nothing"
                if kind != Kind.AIR:
                    ground = f"a {kind.name.lower()}"
                raise ImpossibleError(f"something would stand on {ground}")

    def turned(self, quarters: int) -> Builder:
        """Return a copy turned counterclockwise about the column (0, 0)."""
        cells = {}
        for cell, (kind, yaw) in self.cells.items():
            turned_yaw = 0
            if kind in KINDS_WITH_YAW:
                turned_yaw = (yaw + quarters) % 4
            cells[turn_cell(cell, quarters)] = (kind, turned_yaw)
        cars: list[CarRow] = []
        for x, y, z, yaw, load, load_yaw, slope in self.cars:
            gear = 0
            if load == Kind.FSLOPE:
                gear = (load_yaw + quarters) % 4
            cars.append((*turn_cell((x, y, z), quarters), (yaw + quarters) % 4, load, gear, slope))
        return Builder(cells, cars)

    def grid(self, low: tuple[int, int], size: Cell) -> Grid:
        """Return the grid of this size whose first column is ``low``."""
        lx, ly = low
        pieces = []
        for (x, y, z), (kind, yaw) in self.cells.items():
            if kind in STANDING:
                pieces.append(Piece(kind, (x - lx, y - ly, z), yaw))
        return grid_of(pieces, [(x - lx, y - ly, *row) for x, y, *row in self.cars], size)


FORWARD, LEFT, BACK, RIGHT = range(4)
"""Directions and yaws relative to the car's heading."""
DIRECTION_NAMES: Final = ("forward", "left", "back", "right")


class Row(NamedTuple):
    """The properties of a situation as short texts, empty if irrelevant.

    The text of a row is for people and for patterns, and is never parsed.
    """

    action: str
    """The verb, for a move with its direction relative to the heading, such as ``MOVE-left``; several with ``+``."""
    level: str = ""
    ground: str = ""
    """Ground below the car: flat, or the lower or upper half of a slope that leads up or down ahead."""
    own: str = ""
    load: str = ""
    next: str = ""
    """Content of a move's target cell; with ``above-`` the target is free, and this is in the cell below it."""
    over: str = ""
    """Content of the cell above the car (lift, fold, unfold) or above the target; for a move onto a ramp, of the cell
    above the landing, the body or the foot that comes next."""
    beyond: str = ""
    """Content of the cell after the next one."""
    room: str = ""
    """``tight`` if blocks fill the neighbour cells of the path, as far as the action stays legal."""
    near: str = ""
    column: str = ""
    """The neighbour's column relative to the car."""
    above: str = ""
    """The neighbour's level relative to the lower one of the car."""
    scene: str = ""
    order: str = ""
    """Execution order of several cars."""
    kind: str = ""
    """Common property of situations that are counted together."""
    then: tuple[str, ...] = ()
    """Further actions after the first; the last one is judged."""

    def __str__(self) -> str:
        """Return a text such as ``MOVE-forward/level=1/ground=flat/own=block/load=none/next=air/room=free``."""
        at = ""
        if self.column:
            at = f"@({self.column},{self.above})"
        properties = self._replace(
            near=self.near + at, column="", above="", kind="", then=()
        )._asdict()
        parts = [f"{name}={word}" for name, word in properties.items() if word and name != "action"]
        text = "/".join([self.action, *parts, *filter(None, [self.kind])])
        return " then ".join([text, *self.then])


@dataclass(frozen=True)
class Situation:
    """A world with one or several consecutive actions of car 0, or with one tick of several cars."""

    row: Row
    grid: Grid = field(compare=False, repr=False)
    acts: tuple[Action, ...]
    """Consecutive actions of car 0; with an order, the actions of the first cars in one tick."""
    order: Concurrency | None = None
    """Execution order of the actions of a tick."""
    anywhere: bool = False
    """Whether heading and place on the map are drawn; the grid then has a margin of one column."""
    clearance_mm: float | None = None
    """Geometric clearance of the neighbour, negative for an overlap; None out of reach or without a neighbour."""

    @property
    def id(self) -> str:
        """The properties as text."""
        return str(self.row)

    @cached_property
    def digest(self) -> int:
        """Hash of the properties, a seed of the trials."""
        properties = {name: word for name, word in self.row._asdict().items() if word}
        return int.from_bytes(hashlib.sha256(json.dumps(properties).encode()).digest()[:8])

    def placed(self, rng: np.random.Generator) -> Situation:
        """Return the situation with a drawn heading and place on the map, if these do not matter."""
        if not self.anywhere:
            return self
        turn, before_x, before_y, room = (int(v) for v in rng.integers((0, 1, 1, 1), (4, 4, 4, 4)))
        length, width, height = self.grid.size
        x0, y0, _ = turn_cell((1, 1, 0), turn)
        x1, y1, _ = turn_cell((length - 2, width - 2, 0), turn)
        low = min(x0, x1) - before_x, min(y0, y1) - before_y
        size = max(x0, x1) + 1 + room - low[0], max(y0, y1) + 1 + room - low[1], height
        grid = Builder.of(self.grid).turned(turn).grid(low, size)
        acts = []
        for act in self.acts:
            if act in MOVE_DIRECTION:
                act = _MOVES[(MOVE_DIRECTION[act] + turn) % 4]
            acts.append(act)
        return Situation(self.row, grid, tuple(acts), self.order)

    def legal(self, rules: Rules) -> bool:
        """Return whether the rules allow the first action, or all actions of the tick in sequence."""
        if self.order is None:
            return rules.legal(self.grid, 0, self.acts[0])
        _, applied = rules.tick(self.grid, list(enumerate(self.acts)))
        return bool(applied.all())

    @cached_property
    def why_nothing(self) -> str:
        """The reason why a forbidden action has no intended effect; empty if it has one."""
        if self.order is not None:
            return "several cars are to act"
        try:
            intended(self.grid, 0, self.acts[0])
        except ImpossibleError as reason:
            return str(reason)
        return ""

    def steps(self, legal: bool = True) -> tuple[Step, ...]:
        """Return the steps of the trial; a forbidden action has its intended world as goal."""
        if self.order is not None:
            return (Step.of_ticks(0, list(enumerate(self.acts)), order=self.order),)
        goal = None
        if not legal:
            goal = intended(self.grid, 0, self.acts[0])
        return tuple(Step.single(tick, 0, act, goal) for tick, act in enumerate(self.acts))


_MOVES: Final = {direction: action for action, direction in MOVE_DIRECTION.items()}

# The intended effect of a forbidden action.
_LEVEL: Final = (Kind.GROUND, Kind.BLOCK, Kind.FLAG, Kind.FSLOPE)
"""Kinds with a flat top at the height of the next level."""
_ROOMY: Final = (Kind.AIR, Kind.GEAR, Kind.FOOT)
"""Kinds that leave room for a load in their cell."""


def intended(grid: Grid, car: int, action: Action) -> Grid:
    """Return the grid after an action by the effects of the physical rules, legal or not.

    Raises ImpossibleError if the action has no effect, or the grid after it cannot exist.
    """
    nothing = ACTIONS[action].nothing_to_try(grid, car)
    if nothing:
        raise ImpossibleError(nothing)
    after = Rules("physical").enforce(grid, car, action)
    if action in MOVE_DIRECTION:
        ax, ay, az = (int(v) for v in after.cars[car, : CarField.Z + 1])
        _check_target(grid, (ax, ay, az), Kind(grid.cars[car, CarField.LOAD]))
    after.derive_marks()
    _check_state(after, car)
    return after


def _check_target(grid: Grid, cell: Cell, load: Kind) -> None:
    """Raise ImpossibleError if the target cell has no room for the car and its load."""
    kind = _kind_at(grid, cell)
    if kind == Kind.WALL:
        raise ImpossibleError("a wall is there")
    if load != Kind.AIR and kind not in _ROOMY:
        raise ImpossibleError(_SHARED)
    if (grid.cars[:, : CarField.Z + 1] == cell).all(axis=1).any():
        raise ImpossibleError("a car is there")


def _check_state(grid: Grid, car: int) -> None:
    """Raise ImpossibleError for a state of a car that the rules do not have."""
    x, y, z, yaw, load, load_yaw, slope = (int(v) for v in grid.cars[car])
    kind = _kind_at(grid, (x, y, z))
    below = _kind_at(grid, (x, y, z - 1))
    off_slope = (slope == 1) != (kind == Kind.FOOT) or (slope == 2) != (below == Kind.BODY)
    if off_slope or (slope == 0 and below not in _LEVEL):
        raise ImpossibleError("there is no ground to stand on")
    if slope:
        level = z - 1
        if slope == 1:
            level = z
        if (yaw - int(grid.yaw[x, y, level])) % 2:
            raise ImpossibleError("a car across a slope is no state of the rules")
    if load == Kind.FSLOPE:
        gear = _kind_at(grid, beside((x, y, z), load_yaw))
        if not slope and gear not in _ROOMY:
            raise ImpossibleError(_SHARED)


def _kind_at(grid: Grid, cell: Cell) -> Kind:
    """Return the kind in a cell, AIR above the map. Raises ImpossibleError for a cell beside the map."""
    x, y, z = cell
    length, width, height = grid.kind.shape
    if not (0 <= x < length and 0 <= y < width):
        raise ImpossibleError("the map ends there")
    if z < height:
        return Kind(grid.kind[cell])
    return Kind.AIR


_SIZE: Final = (8, 7, 4)
_CAR: Final = re.compile(r"(\d+,\d+,\d+) (..)(?: (block|flag|fslope)([+-][xy])?)?(?: (low|high))?")


def shipped(name: str) -> Any:
    """Return the content of a YAML file of ``craftsim/data``."""
    return yaml.safe_load(files("craftsim.data").joinpath(name).read_text(encoding="utf-8"))


@cache
def scenes() -> tuple[Situation, ...]:
    """Return the scenes of ``craftsim/data/scenes.yaml``: each is for a suspected rule, with several cars, or
    with properties outside the survey."""
    situations = []
    for group in shipped("scenes.yaml"):
        for shared, (name, scene) in product(group.get("each", [{}]), group["scenes"].items()):
            levels = (group, shared, scene)
            entry = group | shared | scene
            acts = tuple(Action[action] for action in entry["action"].split("+"))
            order = entry.get("order")
            verbs = "+".join(ACTIONS[action].verb for action in acts)
            pieces = [_piece(text) for text in _listed(levels, "things")]
            cars = [_car(text) for text in _listed(levels, "cars")]
            grid = grid_of(pieces, cars, _SIZE)
            situations.append(
                Situation(Row(verbs, scene=name, order=order or ""), grid, acts, order)
            )
    return tuple(situations)


def _listed(levels: Sequence[Mapping[str, str]], key: str) -> list[str]:
    texts = []
    for entry in levels:
        if key in entry:
            for text in entry[key].split("; "):
                texts.append(text)
    return texts


def _cell(text: str) -> Cell:
    x, y, z = map(int, text.split(","))
    return x, y, z


def _piece(text: str) -> Piece:
    """Return the piece of a text such as ``block 5,3,1`` or ``body 2,3,1 +x``."""
    kind, cell, *heading = text.split()
    yaw = 0
    if heading:
        yaw = HEADING_NAMES.index(heading[0])
    return Piece(Kind[kind.upper()], _cell(cell), yaw)


def _car(text: str) -> CarRow:
    """Return the car that :func:`~craftsim.discrete.readback.describe_car` describes so."""
    match = _CAR.fullmatch(text)
    if match is None:
        raise RuntimeError(f"craftsim/data/scenes.yaml: '{text}' describes no car")
    cell, heading, load, side, half = match.groups()
    if load:
        carried = Kind[load.upper()]
    else:
        carried = Kind.AIR
    load_yaw = 0
    if side:
        load_yaw = HEADING_NAMES.index(side)
    slope = {None: 0, "low": 1, "high": 2}[half]
    return *_cell(cell), HEADING_NAMES.index(heading), carried, load_yaw, slope
