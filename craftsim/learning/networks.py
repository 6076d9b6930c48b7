"""The networks: one for all cars, those that look at the whole team, used in training alone, and weights from files."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import Any, Final, NamedTuple

import torch
from torch import Tensor, nn

from craftsim.discrete.kernel.codes import N_ACTIONS
from craftsim.errors import InputError
from craftsim.learning.features import Features, LinearEncoder, joined, make_encoder
from craftsim.learning.rollouts import Rollout
from craftsim.learning.shape import Shape
from craftsim.storage.limits import LARGEST_WEIGHT
from craftsim.tasks.kernel import ROW

_MIXING_WIDTH: Final = 32
Bounds = tuple[float, float]
"""The least and the largest number that a tensor may have."""


class RecurrentState(NamedTuple):
    """What a recurrent policy remembers of episodes, changed in place."""

    hidden: Tensor  # (..., n, width): the state of the GRU
    last: Tensor  # (..., n) int64: actions of the tick before; 15 at first

    def forget(self, which: Tensor) -> None:
        """Forget the episodes of a mask."""
        self.hidden[which] = 0.0
        self.last[which] = N_ACTIONS


class CarNet(nn.Module):
    """Gives every car a number for each action from what it observes, and may remember; all cars share it."""

    def __init__(self, shape: Shape) -> None:
        super().__init__()
        self.width = shape.width
        self.recurrent = shape.recurrent
        self.encoder = make_encoder(shape)
        self.head = head(shape.width, N_ACTIONS, shape.layer_norm)
        self.last = None
        if shape.recurrent:
            if shape.last_action:
                self.last = nn.Embedding(N_ACTIONS + 1, shape.width)
            self.cell = nn.GRUCell(shape.width, shape.width)
        if shape.recurrent and isinstance(self.encoder, LinearEncoder):
            self.head = nn.Linear(shape.width, N_ACTIONS)
            if self.last is not None:
                self.encoder.begin(self.last.weight)

    def memory(self, *cars: int) -> RecurrentState | None:
        """Return what cars (..., n) remember as their episodes begin; None for a policy that remembers nothing."""
        if not self.recurrent:
            return None
        return RecurrentState(torch.zeros(*cars, self.width), torch.full(cars, N_ACTIONS))

    def forward(self, features: Features, memory: RecurrentState | None = None) -> Tensor:
        """Return (..., n, 15), those of actions that are not offered -inf; a memory's state is updated."""
        encoded = self.encoder(features)
        if memory is not None:
            encoded = self._remembered(encoded, *memory)
            memory.hidden.copy_(encoded)
        return self.masked(encoded, features)

    def of_rollouts(self, rollout: Rollout) -> tuple[Tensor, Tensor]:
        """Return the values (T, B, n, 15) before and, without gradients, after each tick.

        What is seen after a tick is what is seen before the next one, and is looked at once, unless an episode ends
        there. Rollouts of a recurrent policy begin with an episode.
        """
        observed = joined([rollout.before, rollout.after[-1:]])
        encoded = self.encoder(observed)
        ends = rollout.done[:-1]
        if self.recurrent:
            encoded = self._states(encoded, rollout.actions, ends)
        values = self.masked(encoded, observed)
        after = values.detach()[1:]
        if ends.any():
            after = after.clone()
            with torch.no_grad():
                last = rollout.after[:-1][ends]
                encoded_last = self.encoder(last)
                if self.recurrent:
                    states = encoded[:-2][ends]
                    encoded_last = self._remembered(
                        encoded_last, states, rollout.actions[:-1][ends]
                    )
                after[:-1][ends] = self.masked(encoded_last, last)
        return values[:-1], after

    @torch.no_grad()
    def of_ends(self, rollout: Rollout) -> Tensor:
        """Return the values (T, B, n, 15) after each tick."""
        return self.of_rollouts(rollout)[1]

    def _states(self, encoded: Tensor, actions: Tensor, ends: Tensor) -> Tensor:
        """Return (T + 1, B, n, width): what cars remember at each tick and after the last one.

        ``actions`` are (T, B, n), and ``ends`` (T - 1, B) says which episodes end with a tick.
        """
        over = ends.unsqueeze(-1)
        first = torch.full_like(actions[:1], N_ACTIONS)
        last = torch.cat([first, actions[:-1].masked_fill(over, N_ACTIONS), actions[-1:]])
        inputs = self._inputs(encoded, last).flatten(1, 2)
        hidden = torch.zeros_like(inputs[:1])
        states = []
        # From one tick at which some episode begins to the next such tick all go on.
        begins = [0, *(ends.any(1).nonzero()[:, 0] + 1).tolist(), len(inputs)]
        for begin, end in pairwise(begins):
            if begin:
                begun = over[begin - 1].expand(encoded.shape[1:3]).flatten().unsqueeze(-1)
                hidden = hidden.masked_fill(begun, 0.0)
            states.append(self._unrolled(inputs[begin:end], hidden))
            hidden = states[-1][-1:]
        return torch.cat(states).view_as(encoded)

    def _unrolled(self, inputs: Tensor, hidden: Tensor) -> Tensor:
        """Return the states (T, rows, width) of the GRU after each input, from one before, (1, rows, width)."""
        cell = self.cell
        weights = [cell.weight_ih, cell.weight_hh, cell.bias_ih, cell.bias_hh]
        states: Tensor = torch.gru(inputs, hidden, weights, True, 1, 0.0, False, False, False)[0]
        return states

    def _remembered(self, encoded: Tensor, hidden: Tensor, last: Tensor) -> Tensor:
        """Return the next state (..., n, width) of the GRU."""
        inputs = self._inputs(encoded, last)
        state: Tensor = self.cell(inputs.flatten(0, -2), hidden.flatten(0, -2))
        return state.view_as(encoded)

    def _inputs(self, encoded: Tensor, last: Tensor) -> Tensor:
        """Return the inputs (..., n, width) of the GRU from vectors of what is seen, and what was done last."""
        if self.last is not None:
            encoded = encoded + self.last(last)
        return encoded.relu()

    def masked(self, encoded: Tensor, features: Features) -> Tensor:
        """Return (..., n, 15) from the encoder's vectors, -inf for what is not offered."""
        return self.encoder.on_map(self.head(encoded), features.places).masked_fill(
            ~features.offers, -torch.inf
        )


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
        """Return (..., n) from vectors (..., n, width)."""
        inputs = encoded
        if self.sees_team:
            inputs = encoded.mean(-2, keepdim=True)
        value: Tensor = self.head(inputs)[..., 0]
        return value.expand(encoded.shape[:-1])


class QMixer(nn.Module):
    """QMIX's mixer (Rashid et al., ICML 2018), with what all cars observe as the state.

    The team's value rises with each car's: weights that a state gives are taken without their signs.
    """

    first_weight: nn.Module
    last_weight: nn.Module

    def __init__(self, shape: Shape) -> None:
        super().__init__()
        self.n_cars = shape.n_cars
        self.is_linear = shape.network == "linear"
        if self.is_linear:
            n_in = shape.vector_length - ROW
            self.first_weight = _two_layers(n_in, shape.width, shape.n_cars * _MIXING_WIDTH)
            self.first_bias = nn.Linear(n_in, _MIXING_WIDTH)
            self.last_weight = _two_layers(n_in, shape.width, _MIXING_WIDTH)
            self.last_bias = _two_layers(n_in, _MIXING_WIDTH, 1)
            return
        self.encoder = make_encoder(shape)
        # The table begins as a linear layer on a drawing of all places does. With a policy's table the team's value
        # changes by 7 to 22 with a car's, and the cars' values are lost; in the published mixer by 0.2 to 0.7, here by
        # 0.1 to 0.5, however many things there are.
        largest = shape.places**-0.5
        nn.init.uniform_(self.encoder.table.weight, -largest, largest)
        self.first_weight = nn.Linear(shape.width, shape.n_cars * _MIXING_WIDTH)
        self.first_bias = nn.Linear(shape.width, _MIXING_WIDTH)
        self.last_weight = nn.Linear(shape.width, _MIXING_WIDTH)
        self.last_bias = _two_layers(shape.width, _MIXING_WIDTH, 1)

    def forward(self, chosen: Tensor, features: Features) -> Tensor:
        """Return the team's value (...) from the values (..., n) of the cars' chosen actions."""
        if self.is_linear:
            # What the first car observes of all others and of all things.
            state = features.places[..., 0, ROW:].to(self.first_bias.weight.dtype)
        else:
            state = self.encoder(features).mean(-2).relu()
        return self.mix(chosen, state)

    def mix(self, chosen: Tensor, state: Tensor) -> Tensor:
        """Return the same from a state (..., width), or (..., vector_length - 13) of a linear network."""
        weight = self.first_weight(state).abs().unflatten(-1, (self.n_cars, _MIXING_WIDTH))
        hidden = (chosen.unsqueeze(-1) * weight).sum(-2) + self.first_bias(state)
        last = self.last_weight(state).abs()
        value: Tensor = (nn.functional.elu(hidden) * last).sum(-1) + self.last_bias(state).squeeze(
            -1
        )
        return value


def _two_layers(n_in: int, width: int, n_out: int) -> nn.Module:
    return nn.Sequential(nn.Linear(n_in, width), nn.ReLU(), nn.Linear(width, n_out))


class OthersNet(nn.Module):
    """Gives each car the team's value of every action of its own, all others acting as they did: COMA's critic."""

    def __init__(self, shape: Shape) -> None:
        super().__init__()
        self.encoder = make_encoder(shape)
        self.actions = nn.Parameter(torch.zeros(shape.n_cars, N_ACTIONS, shape.width))
        self.head = head(shape.width, N_ACTIONS)

    def forward(self, features: Features, actions: Tensor) -> Tensor:
        """Return (..., n, 15) from what is seen and actions (..., n)."""
        action_vectors = _looked_up(self.actions, actions)
        others_actions = action_vectors.sum(-2, keepdim=True) - action_vectors
        return self.encoder.on_map(
            self.head(self.encoder(features) + others_actions), features.places
        )


class JointNet(nn.Module):
    """Gives the team the value of its joint action, and of the state alone: QTRAN's.

    As in the paper, what each car sees is joined with what that car does, before the cars' vectors are added up.
    """

    def __init__(self, shape: Shape) -> None:
        super().__init__()
        self.encoder = make_encoder(shape)
        self.actions = nn.Parameter(0.5 * torch.randn(shape.n_cars, N_ACTIONS, shape.width))
        self.pair = nn.Linear(shape.width, shape.width)
        self.joint = head(shape.width, 1)
        self.rest = head(shape.width, 1)

    def state(self, features: Features) -> Tensor:
        """Return vectors (..., n, width) of what each car sees."""
        state: Tensor = self.encoder(features)
        return state

    def forward(self, state: Tensor, actions: Tensor) -> tuple[Tensor, Tensor]:
        """Return (...) twice from states (..., n, width) and actions (..., n)."""
        pairs = self.pair((state + _looked_up(self.actions, actions)).relu())
        return self.joint(pairs.sum(-2))[..., 0], self.rest(state.mean(-2))[..., 0]


def _looked_up(table: Tensor, actions: Tensor) -> Tensor:
    """Return (..., n, width): the row of each car's action in its own table, (n, 15, width)."""
    return table[torch.arange(len(table)), actions]


def head(width: int, n_out: int, layer_norm: bool = False) -> nn.Module:
    """Return the last two layers, from an encoder's vector to numbers that are close to zero at first."""
    first = nn.Linear(width, width)
    last = nn.Linear(width, n_out)
    # Small first outputs: the first policy is close to uniform, the first values close to zero.
    nn.init.orthogonal_(last.weight, 0.01)
    nn.init.zeros_(last.bias)
    if layer_norm:
        return nn.Sequential(
            nn.LayerNorm(width), nn.ReLU(), first, nn.LayerNorm(width), nn.ReLU(), last
        )
    return nn.Sequential(nn.ReLU(), nn.Sequential(first, nn.ReLU(), last))


@torch.no_grad()
def follow(target: nn.Module, online: nn.Module, rate: float) -> None:
    """Let the weights of a target network follow those of another by this part of their difference."""
    torch._foreach_lerp_([*target.parameters()], [*online.parameters()], rate)


@torch.no_grad()
def restore(
    tensors: Mapping[str, Tensor], saved: Mapping[str, Any], bounds: Mapping[str, Bounds]
) -> None:
    """Give tensors the numbers of saved arrays of the same names. Raises InputError for arrays that do not fit.

    Numbers must be within the bounds of the tensor's name, and so be finite; weights are within LARGEST_WEIGHT.
    """
    odd = sorted(set(saved) ^ set(tensors))
    if odd:
        raise InputError(f"'{odd[0][:80]}' is missing or unknown among its weights")
    for name, tensor in tensors.items():
        array = torch.from_numpy(saved[name])
        if (array.shape, array.dtype) != (tensor.shape, tensor.dtype):
            is_of = f"{array.dtype} {tuple(array.shape)}"
            allowed = f"{tensor.dtype} {tuple(tensor.shape)}"
            raise InputError(f"'{name}' is {is_of}; allowed: {allowed}")
        low, high = bounds.get(name, (-LARGEST_WEIGHT, LARGEST_WEIGHT))
        if array.numel() and not (low <= float(array.min()) and float(array.max()) <= high):
            raise InputError(
                f"'{name}' has numbers that are not finite, or not from {low:g} to {high:g}"
            )
        tensor.copy_(array)
