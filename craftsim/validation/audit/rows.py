"""The rows of the audit: contexts that physics cannot tell apart count as one.

Merged are: mirror images, for the machines are alike left and right; levels 2 and 3, which both stand on blocks; a flag
with a block, which have one shape and mass; and from which side a gear hangs in the car's own cell, where it does not
reach the car. Where an action is forbidden, it counts as one, too, from which side a gear hangs overhead, and for a
move that is not forward what is overhead at all, since it does not get there. The map direction and the place are
drawn for each context. What the rules forbid and nothing is intended for is one row for each action and reason.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from typing import Final

import numpy as np

from craftsim.discrete.actions import verbs as all_verbs
from craftsim.discrete.grid import KINDS_WITH_YAW, CarField, Grid, Kind
from craftsim.discrete.kinds import Action
from craftsim.discrete.rules import Rules, RuleSet
from craftsim.validation.audit.intended import NoPredictionError, intended
from craftsim.validation.audit.nearby import Nearby, nearby
from craftsim.validation.audit.scenes import SCENES, Scene
from craftsim.validation.contexts.context import FORWARD, NOTHING, Context, Thing, Verb
from craftsim.validation.contexts.survey import make_world, survey

Situation = Context | Scene

_TURNS: Final = (Verb("ROTATE_LEFT"), Verb("ROTATE_RIGHT"))
_MIRRORED: Final = dict(zip(_TURNS, reversed(_TURNS), strict=True))


@dataclass(frozen=True)
class Row:
    """One action in situations that count together."""

    name: str
    """The action, a slash, and the context."""
    legal: bool
    members: tuple[Situation, ...]
    no_prediction: str = ""
    """Why there is nothing to try; empty where there is."""

    @property
    def clearance_mm(self) -> float | None:
        """How close geometry expects a neighbour to come, the least of its members; None out of reach, or for none."""
        near = [m.clearance_mm for m in self.members if isinstance(m, Nearby)]
        return min((mm for mm in near if mm is not None), default=None)


def audit_plan(rule_set: RuleSet, verbs: tuple[str, ...] = ()) -> tuple[Row, ...]:
    """Return the rows of these verbs, or all: what a rule set allows, what it forbids, the scenes, and the
    neighbourhoods, by name."""
    return _plan(rule_set, tuple(verb for verb in all_verbs() if not verbs or verb in verbs))


@cache
def _plan(rule_set: RuleSet, verbs: tuple[str, ...]) -> tuple[Row, ...]:
    found = survey(rule_set, verbs)
    members: dict[tuple[str, bool, str], list[Situation]] = {}
    for context in found.contexts:
        members.setdefault((row_name(context, True), True, ""), []).append(context)
    for context in found.illegal:
        reason = why_nothing(context, rule_set)
        name = row_name(context, False)
        if reason:
            name = f"{name.split('/', 1)[0]}/nothing intended: {reason}"
        members.setdefault((name, False, reason), []).append(context)
    for scene in SCENES:
        if not set(scene.id.split("/")[0].split("+")) & set(verbs):
            continue
        legal = scene.legal(Rules(rule_set))
        members.setdefault((scene.id, legal, "" if legal else scene.why_nothing()), []).append(scene)
    for near, legal in nearby(rule_set, verbs):
        reason = "" if legal else near.why_nothing()
        name = f"{near.id.split('/', 1)[0]}/nothing intended: {reason}" if reason else near.row(legal)
        members.setdefault((name, legal, reason), []).append(near)
    return tuple(Row(name, legal, tuple(of), reason) for (name, legal, reason), of in sorted(members.items()))


def why_nothing(context: Context, rule_set: RuleSet) -> str:
    """Return why a forbidden action has no intended effect in a context; empty where it has one."""
    grid = world_of(context, np.random.default_rng(0), rule_set)
    try:
        intended(grid, 0, action_in(context, grid))
    except NoPredictionError as reason:
        return str(reason)
    return ""


def world_of(context: Context, rng: np.random.Generator, rule_set: RuleSet) -> Grid:
    """Return a world of a context, whether the action is legal in it or not."""
    return make_world(context, rng, rule_set, forbidden=True)


def action_in(context: Context, grid: Grid) -> Action:
    """Return the primitive action of a context in its world."""
    return context.action(int(grid.cars[0, CarField.YAW]))


def row_name(context: Context, legal: bool) -> str:
    """Return the name of the row of a context: that of the first of those it is merged with."""
    return min(_merged_id(c, legal) for c in (context, _mirrored(context)))


def _merged_id(context: Context, legal: bool) -> str:
    merged = replace(context, level=min(context.level, 2), own=_any_side(context.own))
    if not legal:
        forward = context.direction in (None, FORWARD)
        merged = replace(merged, over=_any_side(context.over) if forward else NOTHING)
    name = (
        merged.id.replace("level=2", "level=2+")
        .replace("=flag", "=block")
        .replace("own=gear-forward", "own=gear")
    )
    return name if legal else name.replace("over=gear-forward", "over=gear")


def _any_side(thing: Thing) -> Thing:
    return replace(thing, yaw=FORWARD) if thing.kind == Kind.GEAR else thing


def _mirrored(context: Context) -> Context:
    return replace(
        context,
        verb=_MIRRORED.get(context.verb, context.verb),
        direction=None if context.direction is None else -context.direction % 4,
        own=_turned_over(context.own),
        next=None if context.next is None else _turned_over(context.next),
        over=_turned_over(context.over),
    )


def _turned_over(thing: Thing) -> Thing:
    return replace(thing, yaw=(FORWARD - thing.yaw) % 4) if thing.kind in KINDS_WITH_YAW else thing


def distribute_trials(row: Row, trials: int) -> Iterator[tuple[Situation, int]]:
    """Yield the situation and the number of each trial of a row, those of one situation together.

    There are at least ``trials`` of them and at least one of each situation, distributed evenly.
    """
    total = max(trials, len(row.members))
    for i, situation in enumerate(row.members):
        for number in range(len(range(i, total, len(row.members)))):
            yield situation, number
