"""The distinct ones among what was observed: a network need only look at these.

Episodes that begin alike meet the same worlds again and again, and what a network says of one holds for all its copies.
"""

from __future__ import annotations

from typing import Final

import torch
from torch import Tensor

_HASH_SEED: Final = 2


class Distinct:
    """The distinct rows among N rows of integers, by a hash of 64 bits: two of a million rows share one by chance in
    one of ten million cases.
    """

    def __init__(self, *columns: Tensor) -> None:
        """Compare rows; each column is (N, ...)."""
        generator = torch.Generator().manual_seed(_HASH_SEED)
        hashes = torch.zeros(len(columns[0]), dtype=torch.int64)
        for column in columns:
            rows = column.flatten(1).long()
            hashes += (rows * torch.randint(-(2**62), 2**62, rows.shape[1:], generator=generator)).sum(-1)
        found, self.inverse = torch.unique(hashes, return_inverse=True)
        """(N,): which of the distinct rows each row is."""
        self.first = torch.full_like(found, len(hashes)).scatter_reduce_(
            0, self.inverse, torch.arange(len(hashes)), "amin"
        )
        """(U,): where each distinct row is found first."""
