"""The interface of the training algorithms: acting during training, and updates from rollouts."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import torch
from torch import Tensor, nn

from craftsim.training.features import Seen
from craftsim.training.networks import CarNet, restore_adam, restore_module
from craftsim.training.rollouts import Rollout
from craftsim.training.settings import Settings


class Learner(ABC):
    """An algorithm with its networks and optimiser."""

    net: CarNet  # the policy: from a car's observation to one number per action, higher is better
    modules: nn.Module  # all modules with weights, including target networks
    optimizer: torch.optim.Optimizer
    settings: Settings
    ticks: int  # length of a rollout: ticks of each world between updates
    learnt: int = 0  # ticks so far over all worlds, counted by the trainer

    def begin(self, worlds: Tensor) -> None:  # noqa: B027
        """Take note of the worlds (B,) in which an episode begins, as a mask."""

    @abstractmethod
    def act(self, seen: Seen) -> Tensor:
        """Return actions (B, n) with exploration, drawn from torch's default generator."""

    @abstractmethod
    def update(self, rollout: Rollout) -> None:
        """Update from a rollout."""

    def minimize(self, loss: Tensor) -> None:
        """Take one optimiser step."""
        (group,) = self.optimizer.param_groups
        group["lr"] = self.settings.rate(self.learnt)
        self.optimizer.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(group["params"], self.settings.max_gradient)
        self.optimizer.step()

    def state(self) -> dict[str, Any]:
        """Return the complete state for a checkpoint: tensors and plain values."""
        return {
            "modules": self.modules.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "memory": {},
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Restore what :meth:`state` returned.

        Raises InputError, or another error for invalid content; the learner is then unusable.
        """
        restore_module(self.modules, state["modules"])
        restore_adam(self.optimizer, state["optimizer"])


def drawn(logits: Tensor) -> Tensor:
    """Return actions (...) sampled from masked logits (..., 15) (Gumbel-max)."""
    noise = torch.rand_like(logits).clamp_(min=1e-20).log_().neg_().log_().neg_()
    return (logits + noise).argmax(-1)


def drawn_offers(offers: Tensor) -> Tensor:
    """Return actions (...) drawn uniformly from masks (..., 15)."""
    return (torch.rand(offers.shape) * offers).argmax(-1)


def of_actions(values: Tensor, actions: Tensor) -> Tensor:
    """Return (...): the values (..., 15) of these actions (...)."""
    return values.gather(-1, actions.unsqueeze(-1)).squeeze(-1)
