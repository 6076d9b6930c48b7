"""An exploration bonus for buildings that were seldom seen: count-based exploration by hashing.

After Tang et al., "#Exploration", NeurIPS 2017. The bonus fades as counts grow, and evaluations never see it.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.kernel.tasks import ROW
from craftsim.training.rollouts import BatchStep, WorldBatch
from craftsim.training.shape import Shape

BUCKETS: Final = 1 << 20
_HASH_SEED: Final = 1


class NoveltyWorlds:
    """WorldBatch whose rewards rise by a weight divided by the root of how often their arrangement of things was seen.

    Where the cars are plays no part. ``counts`` (BUCKETS,) may be shared by several.
    """

    def __init__(self, worlds: WorldBatch, weight: float, shape: Shape, counts: NDArray[np.int32]) -> None:
        self.worlds, self.weight, self.counts = worlds, weight, counts
        self._skip = ROW * (1 + shape.n_cars)
        n = shape.vector_length - self._skip
        self._factors = np.random.default_rng(_HASH_SEED).integers(-(2**62), 2**62, n)
        self.reset, self.observe = worlds.reset, worlds.observe
        self.restart, self.close = worlds.restart, worlds.close

    @property
    def decides(self) -> NDArray[np.bool_] | None:
        """Which cars choose what they do next."""
        return self.worlds.decides

    def step(self, actions: NDArray[np.int64]) -> BatchStep:
        """Let all cars act; the bonus is part of the reward."""
        outcome = self.worlds.step(actions)
        things = self.observe()[0][:, 0, self._skip :].astype(np.int64)
        with np.errstate(over="ignore"):
            buckets = ((things * self._factors).sum(-1) >> 20) % BUCKETS
        np.add.at(self.counts, buckets, 1)
        return outcome._replace(reward=outcome.reward + self.weight / np.sqrt(self.counts[buckets]))
