"""The largest level of an imperfection that an action stands, from trials that each have a level at which they fail.

Trial number i has the same draws at every level (common random numbers), so it stands low levels and, from its own
*critical level* on, fails. Critical levels of independent trials are independent, and their order statistics bound the
quantiles of their distribution, whatever that is (S. S. Wilks, "Determination of sample sizes for setting tolerance
limits", 1941):

- the smallest of n is stood by at least 95 % of all worlds, with confidence 1 - 0.95**n, which is 95 % for n = 59;
- from the k-th smallest of m on more than 5 % fail, with 95 % confidence, where k or more of m would fail with a
  probability of 5 % at most if 5 % failed: the third smallest of 16.

That a trial which fails at a level fails at all higher ones is used to search, not to conclude: at the margin itself
every trial is run.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

SHARE: Final = 0.95
"""Of all worlds that stand a margin."""
TRIALS: Final = 59
"""So many trials must all stand a level for 95 % confidence that 95 % of all worlds do."""
RANKS: Final = ((16, 3), (7, 2), (1, 1))
"""Of the first so many trials the critical level of this rank is the upper end; the first that there are trials for."""

BASE: Final = 0
"""Number of the level at which the imperfection is that of the base."""

Stands = Callable[[int, int], bool]
"""Whether a trial stands a level, both by their numbers."""


@dataclass(frozen=True)
class Found:
    """The result of a search; levels by number, from :data:`BASE` to the largest."""

    margin: int | None
    """The largest level that all trials stand; None where the base itself is not stood."""
    upper: int | None
    """The level from which on more than 5 % of all worlds fail; None where too few trials fail at the largest."""
    edge: tuple[int, int] | None
    """A trial that fails at the level next to the margin, and that level; None where all stand the largest."""


def confidence(trials: int) -> float:
    """Return how sure it is that 95 % of all worlds stand what so many trials stand."""
    return 1.0 - SHARE**trials


def search(stands: Stands, levels: int, trials: int) -> Found:
    """Return the margin among levels 0 (the base) to ``levels``, of so many trials."""
    return _Search(stands, levels, trials).run()


class _BaseFailsError(Exception):
    """A trial fails at the base."""


class _Search:
    def __init__(self, stands: Stands, levels: int, trials: int) -> None:
        self._stands, self._levels, self._trials = stands, levels, trials
        self._known: dict[tuple[int, int], bool] = {}

    def run(self) -> Found:
        first, rank = next(pair for pair in RANKS if pair[0] <= self._trials)
        try:
            critical: list[int] = []
            for trial in range(first):
                most = sorted(critical)[rank - 1] if len(critical) >= rank else self._levels
                critical.append(self._critical(trial, most))
            lowest = min(critical)
            for trial in range(first, self._trials):
                lowest = self._critical(trial, lowest)
            while not all(self._try(trial, lowest) for trial in range(self._trials)):
                failed = next(trial for trial in range(self._trials) if not self._try(trial, lowest))
                lowest = self._critical(failed, lowest)
        except _BaseFailsError:
            failed = next(
                trial for (trial, level), stood in self._known.items() if level == BASE and not stood
            )
            return Found(None, None, (failed, BASE))
        upper = sorted(critical)[rank - 1] + 1
        edge = None
        if lowest < self._levels:
            failing = [
                trial for (trial, level), stood in self._known.items() if level == lowest + 1 and not stood
            ]
            edge = min(failing), lowest + 1
        return Found(lowest, upper if upper <= self._levels else None, edge)

    def _try(self, trial: int, level: int) -> bool:
        if (trial, level) not in self._known:
            self._known[trial, level] = self._stands(trial, level)
        return self._known[trial, level]

    def _critical(self, trial: int, most: int) -> int:
        """Return the largest level that a trial stands, or ``most`` if it stands that."""
        if self._try(trial, most):
            return most
        fails, step = most, 1
        while not self._try(trial, level := max(fails - step, BASE)):
            if level == BASE:
                raise _BaseFailsError
            fails, step = level, 2 * step
        while fails - level > 1:
            middle = (level + fails) // 2
            if self._try(trial, middle):
                level = middle
            else:
                fails = middle
        return level
