"""An exploration bonus for buildings that were seldom seen: count-based exploration by hashing.

After Tang et al., "#Exploration", NeurIPS 2017. The bonus fades as counts grow, and evaluations never see it.
"""

from __future__ import annotations

from typing import Final

import torch
from tensordict import TensorDictBase

from craftsim.discrete.kernel.tasks import ROW
from craftsim.training.networks import OBSERVATION
from craftsim.training.shape import Shape

BUCKETS: Final = 1 << 20
_HASH_SEED: Final = 1


class Novelty:
    """Counts how often each arrangement of things, wherever the cars are, was seen."""

    def __init__(self, weight: float, shape: Shape) -> None:
        self.weight = weight
        self.counts = torch.zeros(BUCKETS if weight else 0, dtype=torch.int32)
        self._skip = ROW * (1 + shape.n_cars)
        n = shape.vector_length - self._skip
        generator = torch.Generator().manual_seed(_HASH_SEED)
        self._factors = torch.randint(-(2**62), 2**62, (n,), generator=generator)

    def add_to(self, rollout: TensorDictBase) -> None:
        """Add the bonus to the rewards of a rollout, batch size (B, ticks)."""
        if not self.weight:
            return
        things = rollout["next", *OBSERVATION][:, :, 0, self._skip :].long()
        bucket = ((things * self._factors).sum(-1) >> 20) % BUCKETS
        self.counts.index_add_(0, bucket.flatten(), torch.ones(bucket.numel(), dtype=torch.int32))
        rollout["next", "reward"] += self.weight / self.counts[bucket].sqrt().unsqueeze(-1)
