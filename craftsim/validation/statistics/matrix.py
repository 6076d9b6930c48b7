"""What the rules say against what physics does: the matrix of legality and result."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TypeAlias

from craftsim.checking.attempt import Verdict
from craftsim.validation.statistics.proportions import Proportion
from craftsim.validation.statistics.records import RESULTS, AttemptRecord

Results: TypeAlias = Counter[Verdict]
"""How many attempts had each result."""


@dataclass(frozen=True)
class MatrixRow:
    """How many attempts of one kind had each result."""

    trials: int
    as_predicted: int
    failed: int
    side_effect: int
    unsafe: int
    numerics: int
    success: Proportion
    """Share that did as predicted."""

    @classmethod
    def of(cls, attempts: Iterable[AttemptRecord]) -> MatrixRow:
        """Count the results of some attempts."""
        return cls.counted(Counter(Verdict(attempt["result"]) for attempt in attempts))

    @classmethod
    def counted(cls, found: Results) -> MatrixRow:
        """Return the row of attempts whose results were counted."""
        good, failed, side_effect, unsafe, numerics = (found[result] for result in RESULTS)
        trials = found.total()
        return cls(trials, good, failed, side_effect, unsafe, numerics, Proportion.of(good, trials))


@dataclass(frozen=True)
class LegalityMatrix:
    """Results of what the rules allow, and of what they forbid and was tried on purpose."""

    legal: MatrixRow
    forbidden: MatrixRow


def legality_matrix(attempts: Iterable[AttemptRecord]) -> LegalityMatrix:
    """Return the matrix of legality and result of some attempts."""
    legal: Results = Counter()
    forbidden: Results = Counter()
    for attempt in attempts:
        if attempt["legal"] or attempt["performed"]:
            (legal if attempt["legal"] else forbidden)[Verdict(attempt["result"])] += 1
    return LegalityMatrix(MatrixRow.counted(legal), MatrixRow.counted(forbidden))
