"""Which corrections of ``physical`` learned rules contain: a yardstick, of which learning itself knows nothing."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Final

import numpy as np

from craftsim.audit.examples import Example, WorldAction, is_single_action, placed_action
from craftsim.audit.plan import audit_plan
from craftsim.audit.queries import options_of_play
from craftsim.discrete.grid import Grid
from craftsim.discrete.kinds import Action, Correction, RuleSetName
from craftsim.discrete.rules import RULE_SETS, Rules

FOUND_AGAIN: Final = 0.8
"""Share of a correction's failures that learned rules have to forbid."""
_MOST_EACH: Final = 60
_WORLDS: Final = 1500
"""Worlds of play on the grid; some corrections matter in one of 700."""
_MOST_ASKED: Final = 30


@dataclass(frozen=True)
class CorrectionFound:
    """How much of one correction learned rules have, by situations that learning never tried."""

    tried: int
    """Situations whose action this correction alone forbids, or changes the effect of."""
    failures: int
    """Those in which the action did not go as predicted."""
    forbidden: int
    """Those of the failures that learned rules forbid."""
    rules: tuple[str, ...]
    """Names of the rules that forbid most of these."""

    @property
    def is_found(self) -> bool:
        """Whether learned rules forbid enough of the failures, and there are any."""
        return self.failures > 0 and self.forbidden >= FOUND_AGAIN * self.failures


class KnownCorrections:
    """The corrections that a rule set lacks, each alone added to it."""

    def __init__(self, base: RuleSetName) -> None:
        self.base: RuleSetName = base
        self._plain = Rules(base)
        self._physical = Rules("physical")
        self._corrected: dict[str, Rules] = {}
        for name, flag in Correction.__members__.items():
            if flag not in RULE_SETS[base]:
                self._corrected[name] = Rules(base, RULE_SETS[base] | flag)

    def of(self, grid: Grid, car: int, action: Action) -> list[str]:
        """Return those that, each alone, forbid an action that the rule set allows, or change its effect."""
        expected = self._plain.apply(grid, car, action)
        names = []
        for name, rules in self._corrected.items():
            if _differs(rules, grid, car, action, expected):
                names.append(name)
        return names

    def most_like(self, failures: Iterable[Example]) -> str:
        """Return the correction that alone forbids, or changes, most of some failures; empty for none."""
        counts: Counter[str] = Counter()
        for example in list(failures)[:_MOST_ASKED]:
            if example.situation is not None:
                situation = example.situation
                counts.update(self.of(situation.grid, situation.car, situation.action))
        if not counts:
            return ""
        return counts.most_common(1)[0][0]

    def situations(
        self, rng: np.random.Generator, tried: Collection[WorldAction]
    ) -> dict[str, list[WorldAction]]:
        """Return situations that one correction alone forbids or changes, by its name, without those tried before.

        They are of random play on the grid; of corrections that play hardly meets also of the rows of an audit.
        """
        listed: dict[str, list[WorldAction]] = {name: [] for name in self._corrected}
        for name, situation in chain(self._of_play(rng), self._of_audit()):
            if len(listed[name]) < _MOST_EACH and situation not in tried:
                listed[name].append(situation)
        return listed

    def _of_play(self, rng: np.random.Generator) -> Iterator[tuple[str, WorldAction]]:
        """Yield the situations of random play on the grid, each with its correction."""
        for option in options_of_play(self.base, rng, _WORLDS):
            name = self._only(option.grid, option.car, option.action)
            if name:
                yield name, option.situation

    def _of_audit(self) -> Iterator[tuple[str, WorldAction]]:
        """Yield the same of the rows of an audit that the rules allow."""
        for row in audit_plan(self.base):
            if not row.legal or row.no_prediction:
                continue
            for situation in filter(is_single_action, row.members):
                name = self._only(situation.grid, 0, situation.acts[0])
                if name:
                    yield name, placed_action(situation)

    def _only(self, grid: Grid, car: int, action: Action) -> str:
        """Return the correction that alone forbids or changes an action; empty for none, or several."""
        expected = self._plain.apply(grid, car, action)
        if not _differs(self._physical, grid, car, action, expected):
            return ""
        names = self.of(grid, car, action)
        if len(names) != 1:
            return ""
        return names[0]


def _differs(rules: Rules, grid: Grid, car: int, action: Action, expected: Grid) -> bool:
    """Return whether rules forbid an action, or have another effect of it than expected."""
    if not rules.legal(grid, car, action):
        return True
    return not rules.apply(grid, car, action).same_visible(expected)


def correction_found(
    examples: Sequence[Example], forbidding: Mapping[str, Sequence[Example]]
) -> CorrectionFound:
    """Return how much of a correction is found again.

    ``examples`` are trials of its situations, ``forbidding`` the failures among them that each learned rule forbids.
    """
    counts = Counter({name: len(failures) for name, failures in forbidding.items() if failures})
    forbidden: set[WorldAction | None] = set()
    for failures in forbidding.values():
        forbidden.update(example.situation for example in failures)
    failed = [example for example in examples if not example.worked]
    n_forbidden = sum(example.situation in forbidden for example in failed)
    names = tuple(name for name, _ in counts.most_common(3))
    return CorrectionFound(len(examples), len(failed), n_forbidden, names)
