"""What a training algorithm is: how it acts while it learns, and how it learns from a rollout."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import torch
from torch import Tensor, nn

from craftsim.training.networks import CarNet
from craftsim.training.restoring import numbers, restore_adam, restore_module
from craftsim.training.rollouts import Rollout, Seen
from craftsim.training.settings import Settings


class Learner(ABC):
    """One of the algorithms, with its networks and its optimiser."""

    net: CarNet
    """The policy: from what a car sees to one number an action, higher for better."""
    modules: nn.Module
    """All that has weights, target networks among them."""
    optimizer: torch.optim.Optimizer
    settings: Settings
    ticks: int
    """Length of a rollout: ticks of each world between two updates."""
    learnt: int = 0
    """Ticks learnt from so far, all worlds together, which its trainer counts."""

    @abstractmethod
    def act(self, seen: Seen) -> Tensor:
        """Return the actions (B, n) of a rollout, some of them for exploration, drawn by torch's default generator."""

    @abstractmethod
    def update(self, rollout: Rollout) -> None:
        """Learn from a rollout."""

    def minimize(self, loss: Tensor) -> None:
        """Do one step of the optimiser."""
        (group,) = self.optimizer.param_groups
        group["lr"] = self.settings.rate(self.learnt)
        self.optimizer.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(group["params"], self.settings.max_gradient)
        self.optimizer.step()

    def memory(self) -> dict[str, tuple[Tensor, float, float]]:
        """Return what it remembers beside weights: by name a tensor, and the bounds of its numbers."""
        return {}

    def remember(self, memory: dict[str, Tensor]) -> None:  # noqa: B027
        """Take over what :meth:`memory` returned once; names, types, shapes and bounds have been checked."""

    def state(self) -> dict[str, Any]:
        """Return all that a run needs to go on: tensors and plain values only."""
        memory = {name: tensor for name, (tensor, _, _) in self.memory().items()}
        return {
            "modules": self.modules.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "memory": memory,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from what :meth:`state` returned.

        Raises InputError, or what another content of a file leads to; then the learner is good for nothing.
        """
        restore_module(self.modules, state["modules"])
        restore_adam(self.optimizer, state["optimizer"])
        saved = state["memory"]
        self.remember(
            {
                name: numbers(saved[name], name, like, low, high)
                for name, (like, low, high) in self.memory().items()
            }
        )


def drawn(logits: Tensor) -> Tensor:
    """Return actions (...) drawn with the probabilities that masked logits (..., 15) give them (Gumbel-max)."""
    noise = torch.rand_like(logits).clamp_(min=1e-20).log_().neg_().log_().neg_()
    return (logits + noise).argmax(-1)


def drawn_offers(offers: Tensor) -> Tensor:
    """Return actions (...) drawn uniformly from those that are offered (..., 15)."""
    return (torch.rand(offers.shape) * offers).argmax(-1)
