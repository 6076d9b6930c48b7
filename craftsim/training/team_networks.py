"""Networks that see what the whole team observes and does: critics of COMA and QTRAN, used in training alone."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import torch
from tensordict.nn import InteractionType, TensorDictModule
from torch import Tensor, nn
from torchrl.modules import MaskedCategorical, ProbabilisticActor

from craftsim.discrete.kernel.codes import N_ACTIONS
from craftsim.training.features import make_encoder
from craftsim.training.networks import ACTION, MASK, OBSERVATION, head
from craftsim.training.shape import Shape

VALUE: Final = ("agents", "action_value")
"""Of each action of each car (..., n, 15)."""
LOGITS: Final = ("agents", "logits")
JOINT: Final = "joint_value"
"""Of what the team does (..., 1)."""
REST: Final = "state_value"
"""What the cars' values leave out of it (..., 1)."""


class OthersNet(nn.Module):
    """Gives each car the team's value of every action of its own, all others acting as they did: COMA's critic."""

    def __init__(self, shape: Shape) -> None:
        super().__init__()
        self.encoder = make_encoder(shape)
        self.actions = nn.Parameter(torch.zeros(shape.n_cars, N_ACTIONS, shape.width))
        self.head = head(shape.width, N_ACTIONS)

    def forward(self, observation: Tensor, mask: Tensor, action: Tensor) -> Tensor:
        """Return (..., n, 15) from observations, masks and actions (..., n)."""
        did = _looked_up(self.actions, action)
        others = did.sum(-2, keepdim=True) - did
        places = self.encoder.places(observation)
        encoded = self.encoder.of_places(places, mask)
        return self.encoder.on_map(self.head(encoded + others), places)


class JointNet(nn.Module):
    """Gives the team the value of its joint action, and of the state alone: QTRAN's."""

    def __init__(self, shape: Shape) -> None:
        super().__init__()
        self.encoder = make_encoder(shape)
        self.actions = nn.Parameter(torch.zeros(shape.n_cars, N_ACTIONS, shape.width))
        self.joint, self.rest = head(shape.width, 1), head(shape.width, 1)

    def forward(self, observation: Tensor, mask: Tensor, action: Tensor) -> tuple[Tensor, Tensor]:
        """Return (..., 1) twice from observations, masks and actions (..., n)."""
        state = self.encoder(observation, mask).mean(-2)
        return self.joint(state + _looked_up(self.actions, action).sum(-2)), self.rest(state)


def _looked_up(table: Tensor, action: Tensor) -> Tensor:
    """Return (..., n, width): the row of each car's action in its own table, (n, 15, width)."""
    return table[torch.arange(len(table)), action]


def masked_actor(
    net: nn.Module, in_keys: Sequence[tuple[str, str]] = (OBSERVATION, MASK)
) -> ProbabilisticActor:
    """Return what draws each car's action among those offered, by the logits that a module gives them."""
    return ProbabilisticActor(
        TensorDictModule(net, in_keys=[*in_keys], out_keys=[LOGITS]),
        in_keys={"logits": LOGITS, "mask": MASK},
        out_keys=[ACTION],
        distribution_class=MaskedCategorical,
        default_interaction_type=InteractionType.RANDOM,
        return_log_prob=True,
    )
