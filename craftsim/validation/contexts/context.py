"""A context: one situation of one action, seen from its car."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, StrEnum
from typing import Final

from craftsim.discrete.actions import ACTIONS, ActionSpec, verbs
from craftsim.discrete.grid import KINDS_WITH_YAW, Kind
from craftsim.discrete.kinds import Action
from craftsim.errors import InputError

FORWARD, LEFT, BACK, RIGHT = range(4)
"""Directions and yaws relative to the car's heading."""
DIRECTION_NAMES: Final = ("forward", "left", "back", "right")
"""Their names, by number."""


class Verb(StrEnum):
    """An action whatever the map direction: the verbs of the table of actions."""

    _ignore_ = "verb"
    for verb in verbs():
        vars()[verb] = verb

    @classmethod
    def _missing_(cls, value: object) -> Verb | None:
        """Return the verb of an action that was registered later."""
        if value not in verbs():
            return None
        own = str.__new__(cls, value)
        own._name_ = own._value_ = str(value)
        return own

    @property
    def spec(self) -> ActionSpec:
        """Its row in the table of actions, of a move any: what its contexts vary is the same."""
        return next(spec for spec in ACTIONS.values() if spec.verb == self.value and spec.performed)


class Ground(Enum):
    """What the car stands on: its half of a slope (0 none, 1 lower, 2 upper), and where downhill is."""

    FLAT = ("flat", 0, FORWARD)
    LOW_UP = ("low-up", 1, BACK)
    HIGH_UP = ("high-up", 2, BACK)
    LOW_DOWN = ("low-down", 1, FORWARD)
    HIGH_DOWN = ("high-down", 2, FORWARD)

    def __init__(self, label: str, half: int, downhill: int) -> None:
        self.label, self.half, self.downhill = label, half, downhill


@dataclass(frozen=True)
class Thing:
    """What is in a cell, its yaw relative to the car's heading."""

    kind: Kind = Kind.AIR
    yaw: int = 0
    below: bool = False
    """The thing is in the cell below, and this one is free: the body of a slope to drive down."""

    def __str__(self) -> str:
        name = self.kind.name.lower() + (
            f"-{DIRECTION_NAMES[self.yaw]}" if self.kind in KINDS_WITH_YAW else ""
        )
        return f"above-{name}" if self.below else name

    @classmethod
    def of(cls, name: str) -> Thing:
        """Return the thing of such a name."""
        kind, _, way = name.removeprefix("above-").partition("-")
        return cls(Kind[kind.upper()], DIRECTION_NAMES.index(way) if way else 0, name.startswith("above-"))


NOTHING: Final = Thing()
_NAME: Final = "MOVE-forward/level=1/ground=flat/own=block/load=none/next=air/room=free"


@dataclass(frozen=True)
class Context:
    """One situation of one action; directions and yaws are relative to the car's heading."""

    verb: Verb
    direction: int | None
    """Of a move, else None."""
    level: int
    """The car's level before the action."""
    ground: Ground
    own: Thing
    load: Kind
    next: Thing | None
    """In the cell that a move goes to."""
    over: Thing = NOTHING
    """In the cell above the own one (lift, fold, unfold) or above what the action is about; of a move onto a ramp, in
    the cell above the landing of the climb, above the body or above the foot that comes next."""
    beyond_taken: bool = False
    """Whether a block stands in the cell after the next, where that matters: beyond the foot of a slope that is folded
    or unfolded."""
    tight: bool = False
    """Whether blocks fill the neighbour cells of the way, as far as the rules let the action be."""

    @property
    def id(self) -> str:
        """Stable name, such as ``MOVE-forward/level=1/ground=flat/own=block/load=none/next=air/room=free``; :meth:`of`
        reads it."""
        verb = self.verb if self.direction is None else f"{self.verb}-{DIRECTION_NAMES[self.direction]}"
        load = "none" if self.load == Kind.AIR else self.load.name.lower()
        parts = [
            verb,
            f"level={self.level}",
            f"ground={self.ground.label}",
            f"own={self.own}",
            f"load={load}",
        ]
        parts += [f"next={self.next}"] if self.next is not None else []
        parts += [f"over={self.over}"] if self.over != NOTHING else []
        parts += ["beyond=taken"] if self.beyond_taken else []
        return "/".join([*parts, f"room={'tight' if self.tight else 'free'}"])

    @classmethod
    def of(cls, name: str) -> Context:
        """Return the context of an :attr:`id`; raise InputError for a name that is none."""
        try:
            act, *parts = name.split("/")
            said = dict(part.split("=") for part in parts)
            found = cls(
                *verb_of(act),
                int(said["level"]),
                next(ground for ground in Ground if ground.label == said["ground"]),
                Thing.of(said["own"]),
                Kind.AIR if said["load"] == "none" else Kind[said["load"].upper()],
                Thing.of(said["next"]) if "next" in said else None,
                Thing.of(said.get("over", "air")),
                "beyond" in said,
                said["room"] == "tight",
            )
        except (KeyError, ValueError, StopIteration):
            found = None
        if found is None or found.id != name:
            raise InputError(f"there is no context '{name}'; the name of one is such as '{_NAME}'")
        return found

    def action(self, heading: int) -> Action:
        """Return the primitive action for a car of this grid yaw."""
        return action_of(self.verb, self.direction, heading)


def verb_of(act: str) -> tuple[Verb, int | None]:
    """Return the verb and the direction of an act such as ``MOVE-forward``; raise ValueError for one that is none."""
    verb, _, way = act.partition("-")
    return Verb(verb), DIRECTION_NAMES.index(way) if way else None


def action_of(verb: Verb, direction: int | None, heading: int) -> Action:
    """Return the primitive action for a car of a grid yaw; the direction is relative to it."""
    way = None if direction is None else (heading + direction) % 4
    performed = [(action, spec.direction) for action, spec in ACTIONS.items() if spec.verb == verb.value]
    return next(action for action, goes in performed if goes in (way, None) and ACTIONS[action].performed)
