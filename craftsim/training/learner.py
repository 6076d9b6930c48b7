"""What a training algorithm is: how it explores, and how it learns from a rollout."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import nn

from craftsim.training.networks import CarNet


class Learner(ABC):
    """One of the algorithms, with its networks and its optimiser."""

    net: CarNet
    """The policy: from observation and mask to one number an action, higher for better."""
    plays: TensorDictModuleBase
    """Chooses the actions of rollouts."""
    modules: nn.Module
    """All that has weights."""
    ticks: int
    """Length of a rollout: ticks of each world between two updates."""
    learnt: int = 0
    """Ticks learnt from so far, all worlds together, which its trainer counts."""

    @abstractmethod
    def update(self, rollout: TensorDictBase) -> None:
        """Learn from a rollout, batch size (B, ticks)."""

    @abstractmethod
    def state(self) -> dict[str, Any]:
        """Return all that a run needs to go on: tensors and plain values only."""

    @abstractmethod
    def restore(self, state: dict[str, Any]) -> None:
        """Go on from what :meth:`state` returned.

        Raises InputError, or what another content of a file leads to; then the learner is good for nothing.
        """
