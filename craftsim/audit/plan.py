"""The plan of an audit: its rows, each of situations that count as one, and the corrections that concern a row.

What the rules forbid and nothing is intended for is one row for each action and reason.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cache
from typing import Final, NamedTuple

import numpy as np

from craftsim.audit.neighbours import nearby
from craftsim.audit.situation import SCENES, Row, Situation
from craftsim.audit.survey import counted_row, survey
from craftsim.discrete.actions import ACTIONS, verbs
from craftsim.discrete.kinds import Correction
from craftsim.discrete.rules import RULE_SETS, Rules, RuleSet

FLAG_NAMES: Final = tuple(Correction.__members__)


class PlanRow(NamedTuple):
    """Situations that count together."""

    row: Row
    legal: bool
    members: tuple[Situation, ...]
    no_prediction: str = ""
    """Why there is nothing to try; empty where there is."""

    @property
    def name(self) -> str:
        """Its properties as text."""
        return str(self.row)

    @property
    def clearance_mm(self) -> float | None:
        """How close geometry expects a neighbour to come, the least of its members; None out of reach, or for none."""
        near = [member.clearance_mm for member in self.members if member.clearance_mm is not None]
        return min(near, default=None)


def audit_plan(rule_set: RuleSet, of: tuple[str, ...] = ()) -> tuple[PlanRow, ...]:
    """Return the rows of these verbs, or all: what a rule set allows, what it forbids, the scenes, and the
    neighbourhoods, by name."""
    return _plan(rule_set, tuple(verb for verb in verbs() if not of or verb in of))


@cache
def _plan(rule_set: RuleSet, of: tuple[str, ...]) -> tuple[PlanRow, ...]:
    rules = Rules(rule_set)
    scenes = [one for one in SCENES if {ACTIONS[act].verb for act in one.acts} & set(of)]
    found = [(one, legal, counted_row(one.row, legal)) for one, legal in survey(rule_set, of)]
    found += [(one, one.legal(rules), one.row) for one in scenes]
    found += nearby(rule_set, of)
    members: dict[tuple[Row, bool, str], list[Situation]] = {}
    for one, legal, row in found:
        reason = "" if legal else one.why_nothing
        if reason and not row.scene:
            row = Row(row.action, kind=f"nothing intended: {reason}")
        members.setdefault((row, legal, reason), []).append(one)
    rows = [
        PlanRow(row, legal, tuple(together), reason) for (row, legal, reason), together in members.items()
    ]
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
    """Return, by the name of each allowed row, the flags that a rule set has off and that would each correct it: those
    that, alone, forbid its action or change its effect."""
    off = [flag for flag in FLAG_NAMES if Correction[flag] not in RULE_SETS[rule_set]]
    return {
        row.name: tuple(s for s in off if any(_differs(member, rule_set, s) for member in row.members))
        for row in rows
    }


def rows_by_flag(found: Mapping[str, Sequence[str]]) -> dict[str, int]:
    """Return how many rows each flag corrects, in the order of the flags; ``found`` has the flags by row."""
    counts = {flag: sum(flag in flags for flags in found.values()) for flag in FLAG_NAMES}
    return {flag: count for flag, count in counts.items() if count}


def _differs(situation: Situation, rule_set: RuleSet, flag: str) -> bool:
    """Return whether one correction changes what is allowed, or its effect."""
    joint = [(car, int(action)) for car, action in enumerate(situation.acts)]
    before, after = (
        rules.tick(situation.grid, joint)
        for rules in (Rules(rule_set), Rules(rule_set, RULE_SETS[rule_set] | Correction[flag]))
    )
    return not (np.array_equal(before[1], after[1]) and before[0].same_visible(after[0]))
