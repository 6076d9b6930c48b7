"""Which corrections concern a row: flags of the rules that, each alone, forbid its action or change its effect."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from typing import Final

import numpy as np

from craftsim.discrete.grid import Grid
from craftsim.discrete.kinds import Action, Correction
from craftsim.discrete.rules import RULE_SETS, Rules, RuleSet
from craftsim.validation.audit.rows import Row, Situation, action_in, world_of
from craftsim.validation.audit.scenes import Scene

FLAG_NAMES: Final = tuple(Correction.__members__)


def corrections(rows: Iterable[Row], rule_set: RuleSet) -> dict[str, tuple[str, ...]]:
    """Return, by the name of each allowed row, the flags that a rule set has off and that would each correct it."""
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
    grid, actions = start_of(situation, rule_set)
    joint = [(car, int(action)) for car, action in enumerate(actions)]
    before, after = (
        rules.tick(grid, joint)
        for rules in (Rules(rule_set), Rules(rule_set, RULE_SETS[rule_set] | Correction[flag]))
    )
    return not (np.array_equal(before[1], after[1]) and before[0].same_visible(after[0]))


@cache
def start_of(situation: Situation, rule_set: RuleSet) -> tuple[Grid, tuple[Action, ...]]:
    """Return the world of a situation, and what its first cars do in it."""
    if isinstance(situation, Scene):
        return situation.world(), situation.actions
    grid = world_of(situation, np.random.default_rng(0), rule_set)
    return grid, (action_in(situation, grid),)
