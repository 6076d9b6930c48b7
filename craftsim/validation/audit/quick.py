"""A quick look: of all rows of an audit those that tell most about the rules, one trial each.

A rule that is wrong is wrong somewhere near its boundary, and for few combinations of properties. So a quick look
takes

- of what is forbidden, for each reason that the rules give, a row that differs from an allowed one in as few
  properties as can be, and that allowed row with it: both sides of each clause;
- of what is allowed, all scenes, which were drawn for suspicions, and then a covering array: rows such that every
  combination of three properties of an action that occurs in allowed rows occurs in one that is tried (Kuhn, Kacker
  and Lei, Introduction to Combinatorial Testing, 2013). It is chosen greedily, single properties first, then pairs,
  then triples, the row with most that is new before others; where there are more than can be tried in two minutes,
  the last ones are left out.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from heapq import heapify, heapreplace
from itertools import combinations
from typing import Final

from craftsim.discrete.rules import Rules, RuleSet
from craftsim.validation.audit.corrections import start_of
from craftsim.validation.audit.rows import Row, Situation
from craftsim.validation.statistics.audit_rows import kind_of

MOST_ROWS: Final = 800
"""Rows of a quick look at most: one takes about 0.4 s of one core, planning and reports included."""

_SCENE: Final = "/scene="
_CELLS: Final = re.compile(r"( in)? \(-?#, -?#, -?#\)|: .*")

Properties = Mapping[str, str]


def quick_rows(plan: Sequence[Row], rule_set: RuleSet) -> list[Row]:
    """Return the rows of a quick look in the order of the plan, each with one of its situations."""
    rows = [row for row in plan if not row.no_prediction]
    allowed = [row for row in rows if row.legal]
    chosen = {(row.name, True) for row in allowed if _SCENE in row.name}
    for forbidden, near in _boundary(rows, rule_set):
        chosen |= {(forbidden.name, False)} | ({(near.name, True)} if near else set())
    known = [row.name for row in allowed if (row.name, True) in chosen]
    left = MOST_ROWS - len(chosen)
    chosen |= {(name, True) for name in covering([row.name for row in allowed], known, left)}
    return [replace(row, members=row.members[:1]) for row in rows if (row.name, row.legal) in chosen]


def properties(name: str) -> dict[str, str]:
    """Return the properties that the name of a row says; the first part is the action, one without ``=`` a kind."""
    action, *parts = name.split("/")
    found = {"action": action}
    for part in parts:
        key, is_property, value = part.partition("=")
        what, _, where = value.partition("@")
        found |= {key: what} if is_property else {"kind": part}
        if where:  # a neighbour: its column and its level count apart
            column, _, level = where.strip("()").rpartition(",")
            found |= {"column": column, "above": level}
    return found


def covering(names: Sequence[str], known: Iterable[str], most: int, strength: int = 4) -> list[str]:
    """Return names that cover, with those known, the combinations of up to ``strength`` properties of each action.

    Args:
        names: of the rows to choose from.
        known: of those that are tried anyway.
        most: how many, at most.
        strength: how many properties, beside the action, are combined.
    """
    chosen: list[str] = []
    known = list(known)
    for t in range(1, strength + 1):
        open_ = {name: set(_combinations(name, t)) for name in names}
        covered = {c for name in (*known, *chosen) for c in _combinations(name, t)}
        # What a row adds only gets less: one that still adds most after a second look is the one that does.
        heap = [(-len(combos - covered), name) for name, combos in open_.items()]
        heapify(heap)
        while heap and heap[0][0] < 0 and len(chosen) < most:
            _, name = heap[0]
            gain = -len(open_[name] - covered)
            heapreplace(heap, (gain, name))
            if gain and heap[0] == (gain, name):
                covered |= open_[name]
                chosen.append(name)
    return chosen


def _combinations(name: str, t: int) -> Iterator[tuple[str, ...]]:
    """Yield the combinations of t properties of a row, each with its action; what a name leaves out is free."""
    found = {"over": "air", "beyond": "free", **properties(name)}
    action = found.pop("action")
    for some in combinations(sorted(found.items()), t):
        yield (action, *(f"{key}={value}" for key, value in some))


def _boundary(rows: Sequence[Row], rule_set: RuleSet) -> Iterator[tuple[Row, Row | None]]:
    """Yield for each reason the forbidden row next to an allowed one, and that one; None where none is comparable."""
    allowed = [(row, properties(row.name)) for row in rows if row.legal]
    nearest: dict[str, tuple[int, str, Row, Row | None]] = {}
    for row in (row for row in rows if not row.legal):
        mine = properties(row.name)
        near = min(
            ((_differing(mine, theirs), other.name, other) for other, theirs in allowed),
            key=lambda found: found[:2],
            default=(_FAR, "", None),
        )
        found = (near[0], row.name, row, near[2] if near[0] < _FAR else None)
        reason = _reason(row.members[0], rule_set)
        if reason not in nearest or found[:2] < nearest[reason][:2]:
            nearest[reason] = found
    for _, _, row, partner in nearest.values():
        yield row, partner


_FAR: Final = 99
"""How many properties differ between rows that are not comparable."""


def _differing(one: Properties, other: Properties) -> int:
    """Return in how many properties two rows of one action differ."""
    if one["action"] != other["action"] or "scene" in one or "scene" in other:
        return _FAR
    return sum(one.get(key) != other.get(key) for key in one.keys() | other.keys())


def _reason(situation: Situation, rule_set: RuleSet) -> str:
    """Return why an action is forbidden: its verb and the correction, or the words without cells and what is there."""
    grid, actions = start_of(situation, rule_set)
    said = Rules(rule_set).explain(grid, 0, actions[0])
    verb = properties(situation.id)["action"].partition("-")[0]
    return f"{verb}: {said.correction.name if said.correction else _CELLS.sub('', kind_of(said.reason))}"
