"""The plan of an audit: rows of equivalent situations, the corrections for each row, and the rows of a quick audit.

Forbidden situations in which the action has no intended effect are one row for each action and reason.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cache
from heapq import heapify, heapreplace
from itertools import combinations
from operator import ne
from typing import Final, NamedTuple

import numpy as np

from craftsim.audit.neighbours import nearby
from craftsim.audit.situation import Row, Situation, scenes
from craftsim.audit.survey import counted_row, survey
from craftsim.discrete.actions import ACTIONS, verbs
from craftsim.discrete.kinds import Correction
from craftsim.discrete.rules import Rules, RuleSet

FLAG_NAMES: Final = tuple(Correction.__members__)


class PlanRow(NamedTuple):
    """Equivalent situations, whose trials are counted together."""

    row: Row
    legal: bool
    members: tuple[Situation, ...]
    no_prediction: str = ""
    """The reason why nothing can be tried; empty if something can."""

    @property
    def name(self) -> str:
        """Its properties as text."""
        return str(self.row)

    @property
    def clearance_mm(self) -> float | None:
        """Least geometric clearance of a neighbour over all members; None out of reach or without a neighbour."""
        clearances_mm = [
            member.clearance_mm for member in self.members if member.clearance_mm is not None
        ]
        return min(clearances_mm, default=None)


def audit_plan(rule_set: RuleSet, of: tuple[str, ...] = ()) -> tuple[PlanRow, ...]:
    """Return the rows of these verbs, or of all, by name: allowed and forbidden situations, scenes, neighbourhoods."""
    return _plan(rule_set, tuple(verb for verb in verbs() if not of or verb in of))


@cache
def _plan(rule_set: RuleSet, of: tuple[str, ...]) -> tuple[PlanRow, ...]:
    rules = Rules(rule_set)
    counted = []
    for situation, legal in survey(rule_set, of):
        counted.append((situation, legal, counted_row(situation.row, legal)))
    for scene in scenes():
        if {ACTIONS[act].verb for act in scene.acts} & set(of):
            counted.append((scene, scene.legal(rules), scene.row))
    counted += nearby(rule_set, of)
    members: dict[tuple[Row, bool, str], list[Situation]] = {}
    for situation, legal, row in counted:
        reason = ""
        if not legal:
            reason = situation.why_nothing
        if reason and not row.scene:
            row = Row(row.action, kind=f"nothing intended: {reason}")
        members.setdefault((row, legal, reason), []).append(situation)
    rows = []
    for (row, legal, reason), situations in members.items():
        rows.append(PlanRow(row, legal, tuple(situations), reason))
    return tuple(sorted(rows, key=lambda row: (row.name, row.legal, row.no_prediction)))


def distribute_trials(row: PlanRow, trials: int) -> Iterator[tuple[Situation, int]]:
    """Yield the situation and the number of each trial of a row, those of one situation together.

    There are at least ``trials`` of them and at least one of each situation, distributed evenly.
    """
    total = max(trials, len(row.members))
    for i, situation in enumerate(row.members):
        for number in range(len(range(i, total, len(row.members)))):
            yield situation, number


def corrections(rows: Iterable[PlanRow], rule_set: RuleSet) -> dict[str, tuple[str, ...]]:
    """Return the corrections of each allowed row by its name.

    These are the flags that the rule set lacks and that, each alone, forbid the action or change its effect.
    """
    rules = Rules(rule_set)
    flags_of_set = rules.corrections
    corrected = {}
    for flag in FLAG_NAMES:
        if Correction[flag] not in flags_of_set:
            corrected[flag] = Rules(rule_set, flags_of_set | Correction[flag])

    def differs(situation: Situation, with_flag: Rules) -> bool:
        team_action = list(enumerate(situation.acts))
        after, applied = rules.tick(situation.grid, team_action)
        after_corrected, applied_corrected = with_flag.tick(situation.grid, team_action)
        return not (
            np.array_equal(applied, applied_corrected) and after.same_visible(after_corrected)
        )

    flags_by_row = {}
    for row in rows:
        flags = []
        for flag, with_flag in corrected.items():
            if any(differs(situation, with_flag) for situation in row.members):
                flags.append(flag)
        flags_by_row[row.name] = tuple(flags)
    return flags_by_row


def rows_by_flag(flags_by_row: Mapping[str, Sequence[str]]) -> dict[str, int]:
    """Return the number of rows that each flag corrects; ``flags_by_row`` has the flags by row."""
    counts = {}
    for flag in FLAG_NAMES:
        counts[flag] = sum(flag in flags for flags in flags_by_row.values())
    return {flag: count for flag, count in counts.items() if count}


MOST_ROWS: Final = 800
"""Maximum number of rows of a quick audit; each takes about 0.4 s of one core, planning and report included."""

_FREE: Final = Row("", over="air", beyond="free")
_VARYING: Final = re.compile(r"( in)? \(-?\d+, -?\d+, -?\d+\)|: .*|\d+(\.\d+)?")
"""What varies between reasons of one kind: cells, their contents, and numbers."""


def quick_rows(plan: Sequence[PlanRow], rule_set: RuleSet) -> list[PlanRow]:
    """Return the rows of a quick audit in the order of the plan, each with one of its situations.

    A wrong rule is wrong near its boundary, and for few combinations of properties. Of what is forbidden, there is for
    each reason of the rules the row that differs from an allowed one in the fewest properties, and that allowed row:
    both sides of each clause. Of what is allowed, there are all scenes, and then a covering array: every combination of
    three properties of an action that occurs in allowed rows occurs in a row that is tried (Kuhn, Kacker and Lei,
    Introduction to Combinatorial Testing, 2013). It is chosen greedily, single properties before pairs and triples.
    Rows above :data:`MOST_ROWS` are left out.
    """
    rows = [row for row in plan if not row.no_prediction]
    allowed = [row for row in rows if row.legal]
    chosen = {(row.row, True) for row in allowed if row.row.scene}
    for forbidden, partner in _boundary(rows, rule_set):
        chosen.add((forbidden.row, False))
        if partner is not None:
            chosen.add((partner.row, True))
    known_rows = [row.row for row in allowed if (row.row, True) in chosen]
    n_remaining = MOST_ROWS - len(chosen)
    chosen |= {
        (row, True) for row in covering([row.row for row in allowed], known_rows, n_remaining)
    }
    return [row._replace(members=row.members[:1]) for row in rows if (row.row, row.legal) in chosen]


def covering(
    rows: Sequence[Row], known_rows: Iterable[Row], max_rows: int, strength: int = 4
) -> list[Row]:
    """Return at most so many rows that, with the known ones, cover all combinations of ``strength`` properties of each
    action."""
    chosen: list[Row] = []
    known_rows = list(known_rows)
    for t in range(1, strength + 1):
        open_ = {row: set(_combinations(row, t)) for row in rows}
        covered = set[tuple[object, ...]]()
        for row in (*known_rows, *chosen):
            covered.update(_combinations(row, t))
        # A row's gain never grows, so a row that is still first after an update has the largest gain.
        heap = [(-len(combos - covered), str(row), row) for row, combos in open_.items()]
        heapify(heap)
        while heap and heap[0][0] < 0 and len(chosen) < max_rows:
            _, name, row = heap[0]
            gain = -len(open_[row] - covered)
            heapreplace(heap, (gain, name, row))
            if gain and heap[0] == (gain, name, row):
                covered |= open_[row]
                chosen.append(row)
    return chosen


def _combinations(row: Row, t: int) -> Iterator[tuple[object, ...]]:
    """Yield the combinations of t properties of a row, each with its action; empty properties count as free."""
    words = zip(Row._fields[1:], row[1:], _FREE[1:], strict=True)
    properties = [(name, word or free) for name, word, free in words if word or free]
    for combination in combinations(properties, t):
        yield (row.action, *combination)


def _boundary(
    rows: Sequence[PlanRow], rule_set: RuleSet
) -> Iterator[tuple[PlanRow, PlanRow | None]]:
    """Yield for each reason the forbidden row nearest to an allowed one, and that row; None if none is comparable."""
    allowed: dict[str, list[PlanRow]] = {}
    for row in sorted(rows, key=lambda row: row.name):
        if row.legal and not row.row.scene:
            allowed.setdefault(row.row.action, []).append(row)
    nearest: dict[str, tuple[float, str, PlanRow, PlanRow | None]] = {}
    for row in rows:
        if row.legal:
            continue
        differing = math.inf
        partner = None
        if not row.row.scene:
            # They are sorted by name, so that of equally near ones the first by name counts.
            for candidate in allowed.get(row.row.action, ()):
                n_differing = sum(map(ne, row.row, candidate.row))
                if n_differing < differing:
                    differing = n_differing
                    partner = candidate
        reason = _reason(row.members[0], rule_set)
        if reason not in nearest or (differing, row.name) < nearest[reason][:2]:
            nearest[reason] = differing, row.name, row, partner
    for _, _, row, partner in nearest.values():
        yield row, partner


def _reason(situation: Situation, rule_set: RuleSet) -> str:
    """Return the kind of reason why an action is forbidden: its verb, and the correction or the masked reason."""
    explanation = Rules(rule_set).explain(situation.grid, 0, situation.acts[0])
    verb = "+".join(ACTIONS[act].verb for act in situation.acts)
    if explanation.correction:
        return f"{verb}: {explanation.correction.name}"
    return f"{verb}: {_VARYING.sub('', explanation.reason)}"
