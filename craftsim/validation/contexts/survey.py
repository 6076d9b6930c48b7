"""Every situation in which an action is legal: the contexts, found by walking the product of what can differ.

Nothing is listed by hand. Each combination is drawn as a small world (:mod:`craftsim.validation.contexts.worlds`); what
cannot be drawn cannot exist, and what a rule set forbids there is kept apart.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from itertools import product
from typing import Final

import numpy as np

from craftsim.discrete.actions import verbs as all_verbs
from craftsim.discrete.grid import KINDS_WITH_YAW, Cell, Grid, Kind
from craftsim.discrete.rules import Rules, RuleSet
from craftsim.errors import CraftsimError
from craftsim.validation.contexts.context import FORWARD, NOTHING, Context, Ground, Thing, Verb
from craftsim.validation.contexts.worlds import (
    Drawing,
    ImpossibleError,
    check_car,
    draw,
    fillable,
)

LEVELS: Final = (1, 2, 3)


@dataclass(frozen=True)
class Survey:
    """What a world can show."""

    contexts: tuple[Context, ...]
    illegal: tuple[Context, ...]
    """Those in which the rules forbid the action; all with room."""


def _things(kinds: tuple[Kind, ...], below: bool = False) -> list[Thing]:
    return [Thing(k, yaw, below) for k in kinds for yaw in (range(4) if k in KINDS_WITH_YAW else (0,))]


_OWN: Final = _things((Kind.AIR, Kind.BLOCK, Kind.FLAG, Kind.FSLOPE, Kind.BODY, Kind.GEAR, Kind.FOOT))
_NEXT: Final = [
    *_things((Kind.AIR, Kind.BLOCK, Kind.FLAG, Kind.FSLOPE, Kind.BODY, Kind.GEAR, Kind.FOOT, Kind.WALL)),
    *_things((Kind.BODY,), below=True),
]
_OVER: Final = _things((Kind.AIR, Kind.BLOCK, Kind.FLAG, Kind.GEAR))
_LOADS: Final = (Kind.AIR, Kind.BLOCK, Kind.FLAG, Kind.FSLOPE)


def _inner(verb: Verb) -> list[tuple[int | None, Thing | None, int, Thing, bool]]:
    """Return the combinations of direction, next, level, over and beyond that a verb depends on, in a fixed order."""
    spec = verb.spec
    ways: list[tuple[int | None, Thing | None]] = [*product(spec.ahead, _NEXT)] or [(None, None)]
    found = []
    for (direction, thing), level in product(ways, LEVELS):
        ramp = thing is not None and thing.kind in (Kind.FOOT, Kind.BODY)
        overs = _OVER if ramp or spec.over else [NOTHING]
        beyonds = (False,) if spec.beyond is None else (False, True)
        found += [(direction, thing, level, over, beyond) for over, beyond in product(overs, beyonds)]
    return found


def survey(rule_set: RuleSet = "physical", verbs: tuple[str, ...] = ()) -> Survey:
    """Try every combination of these verbs, or of all, and return the contexts of a rule set."""
    return _survey(rule_set, tuple(verb for verb in all_verbs() if not verbs or verb in verbs))


@cache
def _survey(rule_set: RuleSet, verbs: tuple[str, ...]) -> Survey:
    rules = Rules(rule_set)
    found: list[Context] = []
    illegal: list[Context] = []
    for verb in map(Verb, verbs):
        inner = _inner(verb)
        for ground, own, load in product(Ground, _OWN, _LOADS):
            try:
                check_car(ground, own, load)
            except ImpossibleError:
                continue
            for direction, thing, level, over, beyond in inner:
                context = Context(verb, direction, level, ground, own, load, thing, over, beyond)
                try:
                    drawing = draw(context)
                except ImpossibleError:
                    continue
                if not _legal(rules, context, drawing):
                    illegal.append(context)
                    continue
                found.append(context)
                tight = replace(context, tight=True)
                if _tighten(rules, tight, drawing):
                    found.append(tight)
    return Survey(tuple(found), tuple(illegal))


def _legal(rules: Rules, context: Context, drawing: Drawing) -> bool:
    grid = drawing.grid(context)
    return rules.legal(grid, 0, context.action(FORWARD))


def _tighten(rules: Rules, context: Context, drawing: Drawing) -> list[Cell]:
    """Fill the neighbour cells one after the other with blocks while the action stays legal; return the filled ones."""
    filled: list[Cell] = []
    for column in fillable(context, drawing):
        before = dict(drawing.cells)
        drawing.cells.update((cell, (Kind.BLOCK, 0)) for cell in column)
        if _legal(rules, context, drawing):
            filled.append(column[-1])
        else:
            drawing.cells = before
    return filled


def make_world(
    context: Context, rng: np.random.Generator, rule_set: RuleSet = "physical", forbidden: bool = False
) -> Grid:
    """Return a world in which the context holds for car 0.

    What does not matter is drawn from ``rng``: the map direction that the car heads in, and its place on the map.

    Args:
        context: what the world is to show.
        rng: draws the rest.
        rule_set: by which the action is legal there.
        forbidden: make the world of an action that is not legal, too.

    Raises:
        CraftsimError: there is no such world.
    """
    rules = Rules(rule_set)
    try:
        drawing = draw(context)
    except ImpossibleError as reason:
        raise CraftsimError(f"there is no world for {context.id}: {reason}") from reason
    if context.tight and not _tighten(rules, context, drawing):
        raise CraftsimError(f"there is no world for {context.id}: no neighbour cell can be filled")
    turn, before_x, before_y, room = (int(v) for v in rng.integers((0, 1, 1, 1), (4, 4, 4, 4)))
    grid = drawing.grid(context, turn, (before_x, before_y), room)
    if not forbidden and not rules.legal(grid, 0, context.action(turn)):
        raise CraftsimError(f"there is no world for {context.id}: the rules forbid it")
    return grid
