"""What a grid world is described with: kinds, fields of cells and cars, the 15 actions, corrections of the rules."""

from __future__ import annotations

from enum import EnumType, IntEnum, IntFlag, auto
from numbers import Integral
from typing import Any, Final

from craftsim.modules import import_registering


class Kind(IntEnum):
    """What a cell holds, or what a car carries.

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


NAMES: Final = {
    Kind.AIR: "nothing",
    Kind.GROUND: "the ground",
    Kind.WALL: "a wall",
    Kind.BLOCK: "a block",
    Kind.FLAG: "a flag",
    Kind.FSLOPE: "a folded slope",
    Kind.GEAR: "the gear of a folded slope",
    Kind.BODY: "the body of a slope",
    Kind.FOOT: "the foot of a slope",
}
"""What is in a cell, in words."""


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


_OWN_ACTIONS: Final[dict[str | int, Any]] = {}
"""Registered actions by name and by number."""
_REGISTERED_BY: Final[dict[str, str]] = {}
"""The module that registers each, by its name."""


class _ActionType(EnumType):
    """Looks an action up by its name, a registered one too."""

    def __getitem__(cls, name: str) -> Any:
        own = _OWN_ACTIONS.get(name)
        return super().__getitem__(name) if own is None else own


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
        return _OWN_ACTIONS.get(int(value)) if isinstance(value, Integral) else None

    def __reduce_ex__(self, protocol: Any) -> Any:
        # By its name: a process that loads it may have registered others before.
        module = _REGISTERED_BY.get(self.name)
        return super().__reduce_ex__(protocol) if module is None else (_load_action, (self.name, module))


def add_action(name: str, module: str) -> Action:
    """Return a new action, numbered after all others, which ``module`` registers; its name must be a new one."""
    number = len(Action) + len(_OWN_ACTIONS) // 2
    action = int.__new__(Action, number)
    action._name_, action._value_ = name, number
    _OWN_ACTIONS[name] = _OWN_ACTIONS[number] = action
    _REGISTERED_BY[name] = module
    return action


def _load_action(name: str, module: str) -> Action:
    """Return the action of a pickle; the module that registers it is imported if need be."""
    if name not in _OWN_ACTIONS:
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
