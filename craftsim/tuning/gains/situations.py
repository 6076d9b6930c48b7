"""The situations in which gains are tried: single actions, each where another gain matters.

They are contexts of the audit, chosen by hand: on the flat and on stacks, with and without a load, in the open and
between neighbours, onto slopes and off them.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from craftsim.discrete.grid import Kind
from craftsim.tuning.gains.knobs import SUBJECTS, Subject
from craftsim.validation.contexts.context import BACK, FORWARD, LEFT, RIGHT, Context, Ground, Thing, Verb

_AIR: Final = Thing()
_MOVE: Final = Verb("MOVE")
_FOOT: Final = Thing(Kind.FOOT, BACK)


def _move(
    direction: int,
    level: int = 1,
    load: Kind = Kind.AIR,
    ground: Ground = Ground.FLAT,
    own: Thing = _AIR,
    ahead: Thing = _AIR,
    tight: bool = False,
) -> Context:
    return Context(_MOVE, direction, level, ground, own, load, ahead, tight=tight)


def _on_the_spot(
    verb: str, level: int = 1, own: Thing = _AIR, load: Kind = Kind.AIR, tight: bool = False
) -> Context:
    return Context(Verb(verb), None, level, Ground.FLAT, own, load, None, tight=tight)


def _ramp(load: Kind) -> tuple[Context, ...]:
    """Return the three moves of a climb and the three of a descent."""
    return (
        _move(FORWARD, 1, load, ahead=_FOOT),
        _move(FORWARD, 1, load, Ground.LOW_UP, _FOOT, Thing(Kind.BODY, BACK)),
        _move(FORWARD, 2, load, Ground.HIGH_UP),
        _move(FORWARD, 2, load, ahead=Thing(Kind.BODY, FORWARD, below=True)),
        _move(FORWARD, 2, load, Ground.HIGH_DOWN),
        _move(FORWARD, 1, load, Ground.LOW_DOWN, Thing(Kind.FOOT, FORWARD)),
    )


_SECTIONS: Final[Mapping[str, tuple[Context, ...]]] = {
    "drive": (
        _move(FORWARD),
        _move(LEFT),
        _move(FORWARD, tight=True),
        _move(RIGHT, tight=True),
        _move(FORWARD, load=Kind.BLOCK),
        _move(RIGHT, load=Kind.FSLOPE),
        _move(BACK, level=2, tight=True),
        _move(LEFT, level=3),
        _move(FORWARD, level=3, load=Kind.BLOCK),
        _on_the_spot("ROTATE_LEFT"),
        _on_the_spot("ROTATE_RIGHT", load=Kind.BLOCK),
        _on_the_spot("ROTATE_LEFT", level=3, tight=True),
        *_ramp(Kind.AIR),
        *_ramp(Kind.BLOCK),
    ),
    "board": (
        _on_the_spot("LIFT", own=Thing(Kind.BLOCK)),
        _on_the_spot("LIFT", own=Thing(Kind.FLAG), tight=True),
        _on_the_spot("LIFT", own=Thing(Kind.FSLOPE, BACK)),
        _on_the_spot("LIFT", level=3, own=Thing(Kind.BLOCK)),
        _on_the_spot("DROP", load=Kind.BLOCK),
        _on_the_spot("DROP", load=Kind.FLAG, tight=True),
        _on_the_spot("DROP", load=Kind.FSLOPE),
        _on_the_spot("DROP", level=3, load=Kind.BLOCK),
    ),
    "hinge": (
        _on_the_spot("UNFOLD", own=Thing(Kind.FSLOPE, BACK)),
        _on_the_spot("UNFOLD", own=Thing(Kind.FSLOPE, BACK), tight=True),
        _on_the_spot("UNFOLD", level=3, own=Thing(Kind.FSLOPE, BACK)),
        _on_the_spot("FOLD", own=Thing(Kind.BODY, BACK)),
        _on_the_spot("FOLD", own=Thing(Kind.BODY, BACK), tight=True),
        _on_the_spot("FOLD", level=3, own=Thing(Kind.BODY, BACK)),
    ),
}


def situations(subject: Subject) -> tuple[Context, ...]:
    """Return the situations in which the gains of a subject are tried."""
    return tuple(context for section in SUBJECTS[subject] for context in _SECTIONS[section])
