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
from collections.abc import Iterable, Iterator, Sequence
from heapq import heapify, heapreplace
from itertools import combinations
from typing import Final

from craftsim.audit.plan import PlanRow
from craftsim.audit.situation import Row, Situation
from craftsim.discrete.actions import ACTIONS
from craftsim.discrete.rules import Rules, RuleSet

MOST_ROWS: Final = 800
"""Rows of a quick look at most: one takes about 0.4 s of one core, planning and reports included."""

_FREE: Final = Row("", over="air", beyond="free")
"""What is there where a row does not say."""
_VARYING: Final = re.compile(r"( in)? \(-?\d+, -?\d+, -?\d+\)|: .*|\d+(\.\d+)?")
"""What differs between reasons of one kind: cells, what is there, and numbers."""


def quick_rows(plan: Sequence[PlanRow], rule_set: RuleSet) -> list[PlanRow]:
    """Return the rows of a quick look in the order of the plan, each with one of its situations."""
    rows = [row for row in plan if not row.no_prediction]
    allowed = [row for row in rows if row.legal]
    chosen = {(row.row, True) for row in allowed if row.row.scene}
    for forbidden, near in _boundary(rows, rule_set):
        chosen |= {(forbidden.row, False)} | ({(near.row, True)} if near else set())
    known = [row.row for row in allowed if (row.row, True) in chosen]
    left = MOST_ROWS - len(chosen)
    chosen |= {(row, True) for row in covering([row.row for row in allowed], known, left)}
    return [row._replace(members=row.members[:1]) for row in rows if (row.row, row.legal) in chosen]


def covering(rows: Sequence[Row], known: Iterable[Row], most: int, strength: int = 4) -> list[Row]:
    """Return rows that cover, with those known, the combinations of up to ``strength`` properties of each action.

    Args:
        rows: those to choose from.
        known: those that are tried anyway.
        most: how many, at most.
        strength: how many properties, beside the action, are combined.
    """
    chosen: list[Row] = []
    known = list(known)
    for t in range(1, strength + 1):
        open_ = {row: set(_combinations(row, t)) for row in rows}
        covered = {c for row in (*known, *chosen) for c in _combinations(row, t)}
        # What a row adds only gets less: one that still adds most after a second look is the one that does.
        heap = [(-len(combos - covered), str(row), row) for row, combos in open_.items()]
        heapify(heap)
        while heap and heap[0][0] < 0 and len(chosen) < most:
            _, name, row = heap[0]
            gain = -len(open_[row] - covered)
            heapreplace(heap, (gain, name, row))
            if gain and heap[0] == (gain, name, row):
                covered |= open_[row]
                chosen.append(row)
    return chosen


def _combinations(row: Row, t: int) -> Iterator[tuple[object, ...]]:
    """Yield the combinations of t properties of a row, each with its action; what a row does not say is free."""
    words = zip(Row._fields[1:], row[1:], _FREE[1:], strict=True)
    found = [(name, word or free) for name, word, free in words if word or free]
    for some in combinations(found, t):
        yield (row.action, *some)


def _boundary(rows: Sequence[PlanRow], rule_set: RuleSet) -> Iterator[tuple[PlanRow, PlanRow | None]]:
    """Yield for each reason the forbidden row next to an allowed one, and that one; None where none is comparable."""
    allowed = [row for row in rows if row.legal]
    nearest: dict[str, tuple[int, str, PlanRow, PlanRow | None]] = {}
    for row in (row for row in rows if not row.legal):
        near = min(
            ((_differing(row.row, other.row), other.name, other) for other in allowed),
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


def _differing(one: Row, other: Row) -> int:
    """Return in how many properties two rows of one action differ."""
    if one.action != other.action or one.scene or other.scene:
        return _FAR
    return sum(word != another for word, another in zip(one, other, strict=True))


def _reason(situation: Situation, rule_set: RuleSet) -> str:
    """Return why an action is forbidden: its verb and the correction, or the words without what varies."""
    said = Rules(rule_set).explain(situation.grid, 0, situation.acts[0])
    verb = "+".join(ACTIONS[act].verb for act in situation.acts)
    return f"{verb}: {said.correction.name if said.correction else _VARYING.sub('', said.reason)}"
