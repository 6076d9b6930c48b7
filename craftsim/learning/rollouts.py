"""Rollouts, and what is computed of them: lambda returns, and which observations are distinct."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import torch
from torch import Tensor

from craftsim.learning.features import Features

_HASH_SEED: Final = 2


@dataclass(frozen=True)
class Rollout:
    """T ticks of B worlds with n cars."""

    before: Features  # (T, B): before each tick
    after: Features  # (T, B): after each tick; at the end of an episode its last observation
    actions: Tensor  # (T, B, n) int64
    rewards: Tensor  # (T, B) float32: team rewards
    terminated: Tensor  # (T, B) bool: the episode ended, and nothing follows
    done: Tensor  # (T, B) bool: the episode ended, by success or its time limit
    decides: Tensor | None = (
        None  # (T, B, n) bool: which cars chose, while others were acting; None: all
    )
    elapsed: Tensor | None = (
        None  # (T, B) float32: time of each step in usual ticks; None: one each
    )

    def __len__(self) -> int:
        """Return the number of ticks over all worlds."""
        return self.rewards.numel()


def lambda_returns(rollout: Rollout, after: Tensor, gamma: float, decay: float) -> Tensor:
    """Return (T, B) or (T, B, n): lambda returns from the values, of the same shape, after each tick.

    A truncated episode is bootstrapped with the value after its last tick, a completed one is not.
    """
    shape = *rollout.done.shape, *(1,) * (after.ndim - 2)
    rewards = rollout.rewards.reshape(shape)
    terminated = rollout.terminated.reshape(shape)
    done = rollout.done.reshape(shape)
    if decay == 0:
        return rewards + gamma * ~terminated * after
    returns = torch.empty_like(after)
    later = after[-1]
    for t in range(len(after) - 1, -1, -1):
        mixed = torch.where(done[t], after[t], (1 - decay) * after[t] + decay * later)
        returns[t] = later = rewards[t] + gamma * ~terminated[t] * mixed
    return returns


def distinct_features(features: Features) -> tuple[Features, Tensor]:
    """Return the distinct ones of N observations, and (N,) the index of each among them.

    A network then evaluates each once: episodes with equal starts visit the same worlds often. A
    hash of 64 bits distinguishes them; among a million rows the probability of a collision is 1e-7.
    """
    generator = torch.Generator("cpu").manual_seed(_HASH_SEED)  # the same numbers on any device
    hashes = torch.zeros(len(features.places), dtype=torch.int64)
    for column in (features.places, features.offers):
        rows = column.flatten(1).long()
        factors = torch.randint(-(2**62), 2**62, rows.shape[1:], generator=generator, device="cpu")
        hashes += (rows * factors.to(rows.device)).sum(-1)
    unique_hashes, inverse = torch.unique(hashes, return_inverse=True)
    numbers = torch.arange(len(hashes))
    first = torch.full_like(unique_hashes, len(hashes)).scatter_reduce_(0, inverse, numbers, "amin")
    return features[first], inverse
