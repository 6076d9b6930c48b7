"""Situations that take more than one car, or more than the contexts vary: drawn by hand, each for a suspect rule."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from craftsim.discrete.actions import Action
from craftsim.discrete.grid import KINDS_WITH_YAW, SECOND_PART, Cell, Grid, Kind, beside
from craftsim.discrete.rules import Rules
from craftsim.discrete.schedule import Order
from craftsim.validation.attempts.attempt import verb_of
from craftsim.validation.audit.intended import NoPredictionError, intended
from craftsim.validation.replays.recipe import Step

_SIZE: Final = (8, 7, 4)
_BLOCK, _FLAG, _WALL, _FOLDED, _OPEN = Kind.BLOCK, Kind.FLAG, Kind.WALL, Kind.FSLOPE, Kind.BODY
_LIFT, _DROP, _FOLD, _UNFOLD = Action.LIFT, Action.DROP, Action.FOLD, Action.UNFOLD
_LEFT, _RIGHT, _UP, _DOWN = Action.MOVE_LEFT, Action.MOVE_RIGHT, Action.MOVE_FORWARD, Action.MOVE_BACK
_TURN: Final = Action.ROTATE_LEFT

Thing = tuple[Kind, Cell] | tuple[Kind, Cell, int]
"""An object with its cell and, of a slope, its yaw; the second part comes with it."""
CarRow = tuple[int, int, int, int, Kind, int, int]


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
        verbs = "+".join(verb_of(action) for action in self.actions)
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
            return Step.joint(0, list(enumerate(self.actions)), self.order)
        goal = None if legal else intended(self.world(), 0, self.actions[0])
        return Step.single(0, 0, self.actions[0], goal)


def _put(grid: Grid, kind: Kind, cell: Cell, yaw: int) -> None:
    """Put something into a cell; a gear gives way, and of two gears the one with the smaller yaw is shown."""
    there = grid.kind[cell]
    if kind == Kind.GEAR and there != Kind.AIR and not (there == kind and yaw < grid.yaw[cell]):
        return
    grid.kind[cell] = kind
    grid.yaw[cell] = yaw if kind in KINDS_WITH_YAW else 0


def _car(x: int, y: int, z: int = 1, yaw: int = 0, load: Kind = Kind.AIR, slope: int = 0) -> CarRow:
    return x, y, z, yaw, load, (yaw + 2) % 4 if load == Kind.FSLOPE else 0, slope


def _stack(x: int, y: int, height: int = 1) -> tuple[Thing, ...]:
    return tuple((_BLOCK, (x, y, z)) for z in range(1, height + 1))


_RAMP: Final[tuple[Thing, ...]] = (*_stack(1, 3), (_OPEN, (2, 3, 1), 0))
"""It falls in +x from the block at (1, 3) to its foot at (3, 3)."""
_CLIMBER, _FALLER = _car(3, 3, yaw=2, load=_BLOCK, slope=1), _car(2, 3, 2, yaw=0, load=_BLOCK, slope=2)


def _flaps() -> list[Scene]:
    """Return scenes of a slope at (4, 3) whose foot is at (3, 3): beyond that is (2, 3)."""
    docked = _car(4, 3)
    around: dict[str, tuple[tuple[Thing, ...], tuple[CarRow, ...]]] = {
        "car beyond": ((), (_car(2, 3),)),
        "loaded car beyond": ((), (_car(2, 3, load=_BLOCK),)),
        "wall beyond": (((_WALL, (2, 3, 1)),), ()),
        "folded slope beyond": (((_FOLDED, (2, 3, 1), 2),), ()),
        "ramp's high side beyond": (((_OPEN, (2, 3, 1), 2),), ()),
        "facing foot beyond": (((_OPEN, (1, 3, 1), 0),), ()),
        "car on facing foot beyond": (((_OPEN, (1, 3, 1), 0),), (_car(2, 3, yaw=2, slope=1),)),
        "foot across beyond": (((_OPEN, (2, 4, 1), 3),), ()),
        "gear from the side beyond": (((_FOLDED, (2, 4, 1), 3),), ()),
        "gear from ahead beyond": (((_FOLDED, (1, 3, 1), 0),), ()),
        "carried gear from the side beyond": ((), (_car(2, 4, yaw=1, load=_FOLDED),)),
        "load leans in beyond": (((_OPEN, (2, 5, 1), 3),), (_car(2, 4, yaw=1, load=_BLOCK, slope=1),)),
        "load leans in straight beyond": (
            ((_OPEN, (0, 3, 1), 0),),
            (_car(1, 3, yaw=2, load=_BLOCK, slope=1),),
        ),
        "gear above the foot": ((*_stack(3, 4), (_FOLDED, (3, 4, 2), 3)), ()),
        "carried gear above the foot": (_stack(3, 4), (_car(3, 4, 2, yaw=1, load=_FOLDED),)),
        "carried gear above the body": (_stack(4, 4), (_car(4, 4, 2, yaw=1, load=_FOLDED),)),
        "car on the landing": (_stack(5, 3), (_car(5, 3, 2),)),
        "load on the landing": (_stack(5, 3), (_car(5, 3, 2, load=_BLOCK),)),
        "carried gear from the landing": (_stack(5, 3), (_car(5, 3, 2, load=_FOLDED),)),
        "cars beside": ((), (_car(4, 4), _car(3, 4), _car(3, 2), _car(4, 2))),
        "loads beside": ((), (_car(4, 4, load=_BLOCK), _car(3, 2, load=_BLOCK))),
        "loads beside on the next level": (
            (*_stack(3, 4), *_stack(4, 2)),
            (_car(3, 4, 2, load=_BLOCK), _car(4, 2, 2, load=_BLOCK)),
        ),
        "ramps beside": (((_OPEN, (4, 4, 1), 2), (_OPEN, (4, 2, 1), 2)), ()),
    }
    scenes = [
        Scene(name, ((kind, (4, 3, 1), 2), *things), (docked, *cars), (action,))
        for kind, action in ((_OPEN, _FOLD), (_FOLDED, _UNFOLD))
        for name, (things, cars) in around.items()
    ]
    slope: Thing = (_FOLDED, (4, 3, 1), 2)
    return [
        *scenes,
        Scene("car in the foot's cell", (slope,), (docked, _car(3, 3)), (_UNFOLD,)),
        Scene("loaded car in the foot's cell", (slope,), (docked, _car(3, 3, load=_BLOCK)), (_UNFOLD,)),
        Scene(
            "gear from the side in the foot's cell", (slope, (_FOLDED, (3, 4, 1), 3)), (docked,), (_UNFOLD,)
        ),
        Scene(
            "carried gear in the foot's cell", (slope,), (docked, _car(3, 4, yaw=1, load=_FOLDED)), (_UNFOLD,)
        ),
    ]


def _turns() -> list[Scene]:
    scenes = [
        Scene(
            f"{word} beside, {load.name.lower()} turns",
            (),
            (_car(3, 3, load=load), _car(x, y, load=other)),
            (_TURN,),
        )
        for load in (_BLOCK, _FOLDED)
        for other, word in ((Kind.AIR, "car"), (_BLOCK, "loaded car"))
        for x, y in ((4, 3),)
    ]
    scenes += [
        Scene(
            f"cars at all corners, {load.name.lower()} turns", (), (_car(3, 3, load=load), *corners), (_TURN,)
        )
        for load in (_BLOCK, _FOLDED)
        for corners in [tuple(_car(x, y, yaw=1) for x in (2, 4) for y in (2, 4))]
    ]
    return [
        *scenes,
        Scene(
            "loaded cars at all corners",
            (),
            (_car(3, 3, load=_BLOCK), *(_car(x, y, load=_BLOCK) for x in (2, 4) for y in (2, 4))),
            (_TURN,),
        ),
        Scene("load leans in beside", _RAMP, (_car(4, 4, load=_BLOCK), _CLIMBER), (_TURN,)),
        Scene("load leans straight towards", _RAMP, (_car(5, 3, load=_BLOCK), _CLIMBER), (_TURN,)),
        Scene("at the border of the map", (), (_car(0, 3, load=_BLOCK),), (_TURN,)),
    ]


def _ramps() -> list[Scene]:
    """Return scenes of moves on and beside the ramp."""
    gear_over_body: tuple[Thing, ...] = (*_RAMP, *_stack(2, 4), (_FOLDED, (2, 4, 2), 3))
    gear_over_foot: tuple[Thing, ...] = (*_RAMP, *_stack(3, 4), (_FOLDED, (3, 4, 2), 3))
    unloaded_down, unloaded_up = _car(2, 3, 2, slope=2), _car(3, 3, yaw=2, slope=1)
    stairs: tuple[Thing, ...] = (
        (_OPEN, (4, 3, 1), 0),
        *_stack(3, 3),
        *_stack(2, 3),
        *_stack(1, 3, 2),
        (_OPEN, (2, 3, 2), 0),
    )
    return [
        Scene("behind a load that leans", _RAMP, (_car(5, 3, yaw=2, load=_BLOCK), _CLIMBER), (_LEFT,)),
        Scene("behind a load that leans, unloaded", _RAMP, (_car(5, 3, yaw=2), _CLIMBER), (_LEFT,)),
        Scene(
            "behind a load that leans, sideways", _RAMP, (_car(4, 4, yaw=2, load=_BLOCK), _CLIMBER), (_DOWN,)
        ),
        Scene(
            "gear to where a load leans, across", _RAMP, (_car(4, 5, yaw=1, load=_FOLDED), _CLIMBER), (_DOWN,)
        ),
        Scene("gear to where a load leans, straight", _RAMP, (_car(6, 3, load=_FOLDED), _CLIMBER), (_LEFT,)),
        Scene("down towards a loaded car", _RAMP, (_FALLER, _car(4, 3, yaw=2, load=_BLOCK)), (_RIGHT,)),
        Scene("down towards a car", _RAMP, (_FALLER, _car(4, 3, yaw=2)), (_RIGHT,)),
        Scene("down towards a block", (*_RAMP, *_stack(4, 3)), (_FALLER,), (_RIGHT,)),
        Scene("down towards a block, unloaded", (*_RAMP, *_stack(4, 3)), (unloaded_down,), (_RIGHT,)),
        Scene("down towards a wall", (*_RAMP, (_WALL, (4, 3, 1))), (_FALLER,), (_RIGHT,)),
        Scene("down towards a gear from the side", (*_RAMP, (_FOLDED, (4, 4, 1), 3)), (_FALLER,), (_RIGHT,)),
        Scene("down towards a gear from ahead", (*_RAMP, (_FOLDED, (5, 3, 1), 2)), (_FALLER,), (_RIGHT,)),
        Scene(
            "off a ramp towards a carried gear",
            _RAMP,
            (_car(3, 3, load=_BLOCK, slope=1), _car(5, 3, load=_FOLDED)),
            (_RIGHT,),
        ),
        Scene(
            "up below a carried gear",
            (*_RAMP, *_stack(2, 4)),
            (_CLIMBER, _car(2, 4, 2, yaw=1, load=_FOLDED)),
            (_LEFT,),
        ),
        Scene("up below a gear over the foot", gear_over_foot, (_CLIMBER,), (_LEFT,)),
        Scene("down below a gear over the foot", gear_over_foot, (_car(1, 3, 2, load=_BLOCK),), (_RIGHT,)),
        Scene("onto the foot below a gear", gear_over_foot, (_car(4, 3, yaw=2, load=_BLOCK),), (_LEFT,)),
        Scene("onto a top through a gear", gear_over_body, (_car(1, 3, 2),), (_RIGHT,)),
        Scene(
            "onto a top through a gear, sideways", (*gear_over_body, *_stack(2, 2)), (_car(2, 2, 2),), (_UP,)
        ),
        Scene(
            "over a crest",
            ((_OPEN, (3, 3, 1), 0), (_OPEN, (2, 3, 1), 2)),
            (_car(3, 3, 2, yaw=2, slope=2),),
            (_LEFT,),
        ),
        Scene("onto a second ramp", stairs, (_car(4, 3, 2, yaw=2, slope=2),), (_LEFT,)),
        Scene(
            "against another slope's body",
            (*_RAMP, *_stack(5, 3), (_OPEN, (4, 3, 1), 0)),
            (_car(3, 3, slope=1),),
            (_RIGHT,),
        ),
        Scene(
            "over the edge to a foot across",
            ((_OPEN, (3, 3, 1), 0), (_OPEN, (2, 4, 1), 3)),
            (_car(3, 3, 2, yaw=2, slope=2),),
            (_LEFT,),
        ),
        Scene("into a car on the same ramp", _RAMP, (unloaded_up, _car(2, 3, 2, yaw=2, slope=2)), (_LEFT,)),
        Scene("in below a body with a car on top", _RAMP[1:], (_car(1, 3, yaw=2), unloaded_down), (_RIGHT,)),
        Scene(
            "on a top with a car below", _RAMP[1:], (_car(3, 3, yaw=2, slope=1), _car(2, 3, yaw=2)), (_LEFT,)
        ),
        Scene("off a top with a car below", _RAMP, (_FALLER, _car(2, 3, yaw=2)), (_RIGHT,)),
    ]


def _others() -> list[Scene]:
    facing: tuple[Thing, ...] = ((_FOLDED, (2, 3, 1), 0), (_FOLDED, (4, 3, 1), 2))
    return [
        Scene("gears in one cell", facing, (_car(4, 3),), (_LIFT,)),
        Scene("gears in one cell", facing[:1], (_car(4, 3, load=_FOLDED),), (_DROP,)),
        Scene("gear over the foot of a ramp", _RAMP, (_car(4, 3, load=_FOLDED),), (_DROP,)),
        Scene(
            "car on the block beside", (*_stack(3, 3), *_stack(4, 3)), (_car(3, 3), _car(4, 3, 2)), (_LIFT,)
        ),
        Scene(
            "loaded cars all round",
            _stack(3, 3),
            (_car(3, 3), *(_car(x, y, load=_BLOCK) for x, y in ((2, 3), (4, 3), (3, 2), (3, 4)))),
            (_LIFT,),
        ),
        Scene(
            "loaded cars all round",
            (),
            (
                _car(3, 3, load=_BLOCK),
                *(_car(x, y, load=_BLOCK) for x, y in ((2, 3), (4, 3), (3, 2), (3, 4))),
            ),
            (_DROP,),
        ),
        Scene("load leans in beside", _RAMP, (_car(4, 4, load=_BLOCK), _CLIMBER), (_DROP,)),
        Scene("onto a folded slope", (*_stack(2, 3), (_FOLDED, (3, 3, 1), 0)), (_car(2, 3, 2),), (_RIGHT,)),
        Scene(
            "onto a folded slope, loaded",
            (*_stack(2, 3), (_FOLDED, (3, 3, 1), 0)),
            (_car(2, 3, 2, load=_BLOCK),),
            (_RIGHT,),
        ),
        Scene("onto a flag", (*_stack(2, 3), (_FLAG, (3, 3, 1))), (_car(2, 3, 2),), (_RIGHT,)),
    ]


def _ticks() -> list[Scene]:
    """Return ticks of several cars, as the rules let them follow each other, by the schedule and all at once."""
    ticks: dict[str, tuple[tuple[Thing, ...], tuple[CarRow, ...], tuple[Action, ...]]] = {
        "into a cell that is left at a right angle": (
            (),
            (_car(3, 3, load=_BLOCK), _car(2, 3, load=_BLOCK)),
            (_UP, _RIGHT),
        ),
        "into a cell that is left straight ahead": (
            (),
            (_car(3, 3, load=_BLOCK), _car(2, 3, load=_BLOCK)),
            (_RIGHT, _RIGHT),
        ),
        "side by side": ((), (_car(3, 3, load=_BLOCK), _car(3, 4, load=_BLOCK)), (_RIGHT, _RIGHT)),
        "past each other": ((), (_car(3, 3, load=_BLOCK), _car(4, 4, load=_BLOCK)), (_RIGHT, _LEFT)),
        "set down beside one that passes": (
            (),
            (_car(3, 3, load=_BLOCK), _car(3, 4, load=_BLOCK)),
            (_DROP, _RIGHT),
        ),
        "unloaded at a right angle": ((), (_car(3, 3), _car(2, 3)), (_UP, _RIGHT)),
    }
    orders: tuple[Order, ...] = ("sequential", "concurrent", "at-once")
    return [Scene(name, *tick, order) for name, tick in ticks.items() for order in orders]


SCENES: Final[tuple[Scene, ...]] = (*_flaps(), *_turns(), *_ramps(), *_others(), *_ticks())
