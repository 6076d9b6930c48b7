"""The networks: one for all cars, and what looks at the whole team."""

from __future__ import annotations

from typing import Final

import torch
from torch import Tensor, nn

from craftsim.discrete.kernel.codes import N_ACTIONS
from craftsim.training.features import make_encoder
from craftsim.training.shape import Shape

OBSERVATION: Final = ("agents", "observation")
MASK: Final = ("agents", "action_mask")
ACTION: Final = ("agents", "action")
_MIXING_WIDTH: Final = 32


class CarNet(nn.Module):
    """Gives every car a number for each action from what it observes; all cars share it."""

    def __init__(self, shape: Shape) -> None:
        super().__init__()
        self.encoder = make_encoder(shape)
        self.head = head(shape.width, N_ACTIONS)

    def forward(self, observation: Tensor, mask: Tensor) -> Tensor:
        """Return (..., n, 15) from observations (..., n, vector_length) and masks (..., n, 15)."""
        places = self.encoder.places(observation)
        return self.on_places(self.encoder.of_places(places, mask), places)

    def on_places(self, encoded: Tensor, places: Tensor) -> Tensor:
        """Return the same from the encoder's vectors and the places in its table that they were made of."""
        return self.encoder.on_map(self.head(encoded), places)


def first_net(shape: Shape, seed: int) -> CarNet:
    """Return the policy that a run of a seed begins with."""
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        return CarNet(shape)


class Critic(nn.Module):
    """Gives every car a value from the vectors of the policy's encoder: its own, or those of the whole team."""

    def __init__(self, shape: Shape, sees_team: bool) -> None:
        super().__init__()
        self.sees_team = sees_team
        self.head = head(shape.width, 1)

    def forward(self, encoded: Tensor) -> Tensor:
        """Return (..., n, 1) from vectors (..., n, width)."""
        seen = encoded.mean(-2, keepdim=True) if self.sees_team else encoded
        value: Tensor = self.head(seen)
        return value.expand(*encoded.shape[:-1], 1)


class StateQMixer(nn.Module):
    """QMIX's mixer, with what all cars observe as the state."""

    def __init__(self, shape: Shape) -> None:
        # Policies play without this library, which takes 200 MB.
        from torchrl.modules.models.multiagent import QMixer

        super().__init__()
        self.encoder = make_encoder(shape)
        # The table is the first layer of what makes the mixing weights, and begins as a linear layer on a drawing of
        # all places does. With a policy's table the team's value changes by 7 to 22 with a car's, and otherwise in
        # every state: the cars' values are lost in it. The published mixer begins with 0.2 to 0.7, this one with 0.1
        # to 0.5, however many things there are.
        largest = shape.places**-0.5
        nn.init.uniform_(self.encoder.table.weight, -largest, largest)
        self.mixer = QMixer((shape.width,), _MIXING_WIDTH, shape.n_cars, "cpu")

    def forward(self, chosen: Tensor, observation: Tensor, mask: Tensor) -> Tensor:
        """Return the team's value (..., 1) from the values (..., n, 1) of the cars' chosen actions."""
        state = self.encoder(observation, mask).mean(-2)
        value: Tensor = self.mixer(chosen, state.relu())
        return value


def head(width: int, n_out: int) -> nn.Module:
    """Return the last two layers, from an encoder's vector to numbers that are close to zero at first."""
    first, last = nn.Linear(width, width), nn.Linear(width, n_out)
    # Small first outputs: the first policy is close to uniform, the first values close to zero.
    nn.init.orthogonal_(last.weight, 0.01)
    nn.init.zeros_(last.bias)
    return nn.Sequential(nn.ReLU(), nn.Sequential(first, nn.ReLU(), last))
