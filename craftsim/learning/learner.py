"""The interface of the training algorithms: acting during training, and updates from rollouts."""

from __future__ import annotations

from abc import ABC, abstractmethod
from pkgutil import resolve_name

import torch
from torch import Tensor, nn

from craftsim.learning.algorithms import ALGORITHMS, AlgoName
from craftsim.learning.features import Features
from craftsim.learning.networks import Bounds, CarNet
from craftsim.learning.rollouts import Rollout
from craftsim.learning.settings import Settings
from craftsim.learning.shape import Shape
from craftsim.storage.limits import LARGEST_WEIGHT


class Learner(ABC):
    """An algorithm with its networks and optimiser."""

    modules: nn.Module  # all modules with weights, including target networks
    optimizer: torch.optim.Optimizer
    settings: Settings

    def __init__(self, shape: Shape, ticks: int, settings: Settings) -> None:
        """Make the policy; subclasses make what else is learned."""
        self.settings = settings
        self.ticks = ticks  # length of a rollout: ticks of each world between updates
        self.learnt = 0  # ticks so far over all worlds, counted by the trainer
        self.net = CarNet(
            shape
        )  # from a car's observation to one number per action, higher is better

    def to(self, device: torch.device) -> None:
        """Move all that it has learnt to a device."""
        self.modules.to(device)

    def begin(self, worlds: Tensor) -> None:  # noqa: B027
        """Take note of the worlds (B,) in which an episode begins, as a mask."""

    def act(self, features: Features) -> Tensor:
        """Return actions (B, n) with exploration, by torch's default generator: sampled from the policy."""
        return drawn(self.net(features))

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

    def tensors(self) -> tuple[dict[str, Tensor], dict[str, Bounds]]:
        """Return all that it has learnt and remembers, by name, for a checkpoint, and bounds of what is no weight.

        They are the learner's own: to change them is to change it.
        """
        tensors = self.modules.state_dict(prefix="modules.")
        bounds = dict[str, Bounds]()
        (group,) = self.optimizer.param_groups
        for number, weight in enumerate(group["params"]):
            averages = self.optimizer.state[weight]
            if not averages:
                # As the optimiser begins with the first gradient.
                fused = bool(group.get("fused"))
                averages |= {"step": torch.zeros((), device=weight.device if fused else "cpu")}
                names = ["exp_avg", "exp_avg_sq"]
                if isinstance(self.optimizer, torch.optim.RMSprop):
                    names = ["square_avg"]
                averages |= {name: torch.zeros_like(weight) for name in names}
            name = f"optimizer.{number}."
            tensors |= {f"{name}{key}": average for key, average in averages.items()}
            bounds |= {f"{name}step": (0, 2**31), f"{name}exp_avg_sq": (0, LARGEST_WEIGHT)}
            bounds |= {f"{name}square_avg": (0, LARGEST_WEIGHT)}
        return tensors, bounds


def learner_class(algo: AlgoName) -> type[Learner]:
    """Return what learns by an algorithm."""
    kind: type[Learner] = resolve_name(ALGORITHMS[algo].learner)
    return kind


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
