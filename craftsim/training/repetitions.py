"""What differs among episodes: their starts, and what happened in them from tick to tick."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

_FACTOR: Final = np.int64(6364136223846793005)
"""Of Knuth's linear congruential generator; numbers are taken modulo 2**64."""


class Repetitions:
    """Digests of n episodes: of how each began, and of all that its cars saw and did."""

    def __init__(self, designs: NDArray[np.integer]) -> None:
        """Begin; ``designs`` (n, T, 5) is what is to be built in each."""
        self._designs = _digests(designs.reshape(len(designs), -1))
        self.starts = self._designs.copy()
        self.trajectories = self._designs.copy()
        self._begun = np.zeros(len(designs), np.bool_)

    def add(
        self, which: NDArray[np.integer], seen: NDArray[np.integer], actions: NDArray[np.integer]
    ) -> None:
        """Add a tick of some episodes: what was seen, (k, ...), and then done, (k, n)."""
        with np.errstate(over="ignore"):
            world = _digests(seen.reshape(len(which), -1))
            new = which[~self._begun[which]]
            self.starts[new] = self.starts[new] * _FACTOR + world[~self._begun[which]]
            self._begun[new] = True
            done = _digests(actions.reshape(len(which), -1))
            self.trajectories[which] = (self.trajectories[which] * _FACTOR + world) * _FACTOR + done

    def solved(self, won: NDArray[np.generic]) -> tuple[int, int]:
        """Return of how many starts each episode succeeded, and how many starts there are."""
        _, start = np.unique(self.starts, return_inverse=True)
        failures = np.bincount(start, weights=won == 0)
        return int((failures == 0).sum()), len(failures)


def _digests(rows: NDArray[np.integer]) -> NDArray[np.int64]:
    factors = np.random.default_rng(1).integers(-(2**62), 2**62, rows.shape[1])
    with np.errstate(over="ignore"):
        sums: NDArray[np.int64] = (rows.astype(np.int64) * factors).sum(axis=1)
    return sums
