"""Searching gains by ask and tell: CMA-ES within bounds, from a generator that is given."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from craftsim.extras import need

FIRST_STEP: Final = 0.25
"""Standard deviation of the first candidates, in positions of knobs: a factor of 1.7."""
NEXT_STEP: Final = 0.12
"""The same of a search that begins where another one ended."""


def need_cma() -> None:
    """Raise InputError with the command that installs what is missing."""
    need("tune", "tuning needs", "cma")


def population(n: int) -> int:
    """Return how many candidates of n knobs a generation has, by Hansen's rule."""
    return 4 + int(3 * np.log(n))


class Search:
    """Covariance matrix adaptation (Hansen, arXiv 1604.00772; the package cma): fit for tens of knobs and a noisy cost
    of which only the order counts."""

    def __init__(
        self,
        bounds: Sequence[tuple[float, float]],
        begin: Sequence[float],
        step: float,
        rng: np.random.Generator,
    ) -> None:
        """Begin at a position within bounds, (n,) each."""
        from cma import CMAEvolutionStrategy

        n = len(bounds)
        low, high = np.array(bounds).T
        options = {
            "bounds": [low.tolist(), high.tolist()],
            "popsize": population(n),
            # The usual one draws from NumPy's global generator.
            "randn": lambda *shape: rng.standard_normal(shape),
            "seed": np.nan,
            "verbose": -9,
        }
        self._strategy: Any = CMAEvolutionStrategy(np.clip(begin, low, high).tolist(), step, options)
        self._low, self._high = low, high

    def ask(self) -> list[NDArray[np.float64]]:
        """Return the positions of the next candidates."""
        return list(self._strategy.ask())

    def tell(self, positions: Sequence[NDArray[np.float64]], costs: Sequence[float]) -> None:
        """Say what they cost."""
        self._strategy.tell(list(positions), list(costs))

    @property
    def favourite(self) -> NDArray[np.float64]:
        """The centre of the distribution, which noise deceives less than the best candidate."""
        found: NDArray[np.float64] = np.clip(self._strategy.result.xfavorite, self._low, self._high)
        return found
