"""Vocabulary of grid worlds: kinds, fields of cells and cars, the 15 actions, corrections of the rules."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import EnumType, IntEnum, IntFlag, auto
from numbers import Integral
from typing import Any, Final, Literal

from craftsim.workers.modules import import_registering

RuleSetName = Literal["published", "physical"]
"""CraftEnv's own rules, or the corrected ones."""
Execution = Literal["synchronous", "asynchronous"]
"""A step lasts until the slowest car has finished, or each car decides when its own action has finished."""


class Kind(IntEnum):
    """The content of a cell, or the load of a car.

    Example:
        >>> import craftsim
        >>> craftsim.Kind.BLOCK.name, int(craftsim.Kind.BLOCK)
        ('BLOCK', 3)
    """

    AIR = 0
    GROUND = 1
    WALL = 2
    BLOCK = 3
    FLAG = 4
    FSLOPE = 5
    GEAR = 6
    BODY = 7
    FOOT = 8


@dataclass(frozen=True)
class KindSpec:
    """A kind beyond its rules and its machine; see the table :data:`KINDS`."""

    words: str
    """Its name in messages, with the article."""
    sign: str
    """Its sign in text; that of a kind with a yaw is followed by its arrow."""
    style: str
    """Style of the sign, as rich has it."""
    colour: tuple[float, float, float]
    """Red, green and blue, each 0..1, in pictures; machines as their MJCF colours them."""
    plural: str = ""
    """Name of several, of a kind that cars carry."""
    letter: str = ""
    """Its sign in text as a car's load; empty for a kind that no car carries."""
    stands: bool = False
    """It is a thing of its own that stands on something."""


KINDS: Final = {
    Kind.AIR: KindSpec("nothing", " .", "dim", (1.0, 1.0, 1.0)),
    Kind.GROUND: KindSpec("the ground", "__", "dim", (0.93, 0.93, 0.92)),
    Kind.WALL: KindSpec("a wall", "##", "white on grey37", (0.42, 0.44, 0.47), stands=True),
    Kind.BLOCK: KindSpec("a block", "[]", "yellow", (0.93, 0.72, 0.35), "blocks", "b", True),
    Kind.FLAG: KindSpec("a flag", "|>", "bold red", (0.80, 0.16, 0.20), "flags", "f", True),
    Kind.FSLOPE: KindSpec("a folded slope", "S", "cyan", (0.36, 0.56, 0.76), "slopes", "s", True),
    Kind.GEAR: KindSpec("the gear of a folded slope", "g", "cyan", (0.25, 0.27, 0.30)),
    Kind.BODY: KindSpec("the body of a slope", "B", "bold cyan", (0.36, 0.56, 0.76), stands=True),
    Kind.FOOT: KindSpec("the foot of a slope", "f", "bold cyan", (0.52, 0.70, 0.86)),
}
"""The table of kinds, in the order of their numbers. docs/how-to/extend.md says what else a new one takes."""

NAMES: Final = {kind: spec.words for kind, spec in KINDS.items()}
"""Names of the kinds in messages."""
CARRIED: Final = tuple(kind for kind, spec in KINDS.items() if spec.letter)
"""Kinds that cars carry."""
STANDING: Final = tuple(kind for kind, spec in KINDS.items() if spec.stands)
"""Kinds that are things of their own; gears and feet come with their slopes."""

if list(KINDS) != list(Kind):
    raise RuntimeError(
        f"{next(kind for kind in Kind if kind not in KINDS).name} has no row in the table of kinds"
    )


class CellField(IntEnum):
    """Fields of a cell, the last axis of :attr:`Grid.cells`."""

    KIND = 0
    """A :class:`Kind`."""
    YAW = 1
    """0..3 for kinds that have a yaw, else 0."""
    OCCUPANT = 2
    """The mark "what is on me": -1 nothing, -2 an object, k >= 0 car k."""
    LANDING = 3
    """The mark "I am the landing of a ramp": 0 or 1; only ever 1 for blocks."""


class CarField(IntEnum):
    """Columns of :attr:`Grid.cars`."""

    X = 0
    Y = 1
    Z = 2
    YAW = 3
    LOAD = 4
    """A Kind; AIR is no load."""
    LOAD_YAW = 5
    """Yaw of a carried folded slope, else 0."""
    SLOPE = 6
    """0 off slopes, 1 in a foot's cell, 2 in the cell above a body."""


_REGISTERED_ACTIONS: Final[dict[str | int, Any]] = {}
"""Registered actions by name and by number."""
_REGISTERED_BY: Final[dict[str, str]] = {}
"""The module that registers each, by its name."""


class _ActionType(EnumType):
    """Looks an action up by its name, a registered one too."""

    def __getitem__(cls, name: str) -> Any:
        registered = _REGISTERED_ACTIONS.get(name)
        if registered is None:
            return super().__getitem__(name)
        return registered


class Action(IntEnum, metaclass=_ActionType):
    """A primitive action; the numbers are CraftEnv's. Moves are map directions, whatever the car's yaw.

    Iterating gives these 15. ``Action["NAME"]`` and ``Action(number)`` also give a registered one
    (:func:`craftsim.register_action`); the numbers of those begin at 15 and hold in one process.

    Example:
        >>> import craftsim
        >>> craftsim.Action.LIFT, craftsim.Action["MOVE_RIGHT"].value
        (<Action.LIFT: 0>, 9)
    """

    LIFT = 0
    DROP = 1
    FOLD = 2
    UNFOLD = 3
    ROTATE_LEFT = 4
    ROTATE_RIGHT = 5
    MOVE_FORWARD = 6
    MOVE_BACK = 7
    MOVE_LEFT = 8
    MOVE_RIGHT = 9
    STOP = 10
    MOVE_FORWARD_LEFT = 11
    MOVE_FORWARD_RIGHT = 12
    MOVE_BACK_LEFT = 13
    MOVE_BACK_RIGHT = 14

    @classmethod
    def _missing_(cls, value: object) -> Action | None:
        if isinstance(value, Integral):
            return _REGISTERED_ACTIONS.get(int(value))
        return None

    def __reduce_ex__(self, protocol: Any) -> Any:
        # By its name: a process that loads it may have registered others before.
        module = _REGISTERED_BY.get(self.name)
        if module is None:
            return super().__reduce_ex__(protocol)
        return _load_action, (self.name, module)


TeamAction = Sequence[tuple[int, Action]]
"""Actions of several cars at a time: (car, action) in acting order; a car that is not listed does nothing."""
PlanTick = tuple[tuple[int, Action], ...]
"""The :data:`TeamAction` of one tick of a plan, empty where nothing begins. Unlike others it cannot change, because
plans are compared and shared."""


def add_action(name: str, module: str) -> Action:
    """Return a new action, numbered after all others, which ``module`` registers; its name must be a new one."""
    number = len(Action) + len(_REGISTERED_ACTIONS) // 2
    action = int.__new__(Action, number)
    action._name_ = name
    action._value_ = number
    _REGISTERED_ACTIONS[name] = _REGISTERED_ACTIONS[number] = action
    _REGISTERED_BY[name] = module
    return action


def _load_action(name: str, module: str) -> Action:
    """Return the action of a pickle; the module that registers it is imported if need be."""
    if name not in _REGISTERED_ACTIONS:
        import_registering(module)
    return Action[name]


MOVE_DIRECTION: Final[dict[Action, int]] = {
    Action.MOVE_RIGHT: 0,
    Action.MOVE_FORWARD: 1,
    Action.MOVE_LEFT: 2,
    Action.MOVE_BACK: 3,
}
"""Grid yaw (0..3: +x, +y, -x, -y) in which each of the four moves goes. The diagonal moves are never legal."""


class Correction(IntFlag):
    """The differences between the rule sets, each read in one place of the rules; none is as published."""

    derived_marks = auto()
    """Marks follow from what is there instead of from past events."""
    swinging_flap = auto()
    """FOLD and UNFOLD need room for the flap on its way (docs/rules.md#flap)."""
    turning_load = auto()
    """A load turns only where no car stands beside it and no load leans in beside it (docs/rules.md#turning-load)."""
    leaning_load = auto()
    """A load needs room on a ramp, below it and beside one that leans there (docs/rules.md#leaning-load)."""
    own_ramp = auto()
    """On a ramp a car goes on along that ramp alone, and over no crest (docs/rules.md#own-ramp)."""
    second_ramp = auto()
    """Who drives from a ramp's top onto the foot of a second ramp is then on that (docs/rules.md#second-ramp)."""
    ramp_below_gear = auto()
    """A ramp below a gear is driven down in its own direction only (docs/rules.md#through-a-gear)."""
    run_out = auto()
    """Who comes down a ramp does not drive under a block or flag right behind its foot (docs/rules.md#run-out)."""
    reaching_load = auto()
    """Loads and flaps keep clear of loads that reach in from another level (docs/rules.md#reaching-load)."""
    overhead_wall = auto()
    """A wall overhead keeps loads, flaps and climbing cars away (docs/rules.md#overhead-wall)."""
    crossing_gear = auto()
    """A slope is lifted and set down only where its gear crosses nothing (docs/rules.md#crossing-gear)."""
    lasting_gears = auto()
    """A gear gives way to what stands, and lasts as long as its slope (docs/rules.md#lift-erases-gear-cell)."""
