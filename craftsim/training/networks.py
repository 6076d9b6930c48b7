"""The networks: one for all cars, those that look at the whole team, used in training alone, and weights from files."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import torch
from torch import Tensor, nn

from craftsim.discrete.kernel.codes import N_ACTIONS
from craftsim.errors import InputError
from craftsim.storage.limits import LARGEST_WEIGHT
from craftsim.training.features import Seen, make_encoder
from craftsim.training.shape import Shape

if TYPE_CHECKING:
    from craftsim.training.rollouts import Rollout

_MIXING_WIDTH: Final = 32


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
        self.width, self.recurrent = shape.width, shape.recurrent
        self.encoder = make_encoder(shape)
        self.head = head(shape.width, N_ACTIONS, shape.layer_norm)
        if shape.recurrent:
            self.last = nn.Embedding(N_ACTIONS + 1, shape.width)
            self.cell = nn.GRUCell(shape.width, shape.width)

    def memory(self, *cars: int) -> RecurrentState | None:
        """Return what cars (..., n) remember as their episodes begin; None for a policy that remembers nothing."""
        if not self.recurrent:
            return None
        return RecurrentState(torch.zeros(*cars, self.width), torch.full(cars, N_ACTIONS))

    def forward(self, seen: Seen, memory: RecurrentState | None = None) -> Tensor:
        """Return (..., n, 15), those of actions that are not offered -inf; a memory's state is updated."""
        encoded = self.encoder(seen)
        if memory is not None:
            encoded = self._remembered(encoded, *memory)
            memory.hidden.copy_(encoded)
        return self.masked(encoded, seen)

    def of_rollouts(self, rollout: Rollout) -> tuple[Tensor, Tensor]:
        """Return the values (T, B, n, 15) before and, without gradients, after each tick.

        Rollouts of a recurrent policy begin with an episode.
        """
        if not self.recurrent:
            return self(rollout.now), self.of_ends(rollout)
        encoded, begun = self.encoder(rollout.now), self.memory(*rollout.actions.shape[1:])
        assert begun is not None
        (hidden, last), states = begun, []
        for t, actions in enumerate(rollout.actions):
            states.append(self._remembered(encoded[t], hidden, last))
            over = rollout.done[t].unsqueeze(-1)
            hidden, last = states[-1] * ~over.unsqueeze(-1), actions.masked_fill(over, N_ACTIONS)
        state = torch.stack(states)
        with torch.no_grad():
            after = self._remembered(self.encoder(rollout.after), state, rollout.actions)
            after = self.masked(after, rollout.after)
        return self.masked(state, rollout.now), after

    @torch.no_grad()
    def of_ends(self, rollout: Rollout) -> Tensor:
        """Return the values (T, B, n, 15) after each tick."""
        return self.of_rollouts(rollout)[1] if self.recurrent else self(rollout.after)

    def _remembered(self, encoded: Tensor, hidden: Tensor, last: Tensor) -> Tensor:
        """Return the next state (..., n, width) of the GRU."""
        seen = (encoded + self.last(last)).relu()
        state: Tensor = self.cell(seen.flatten(0, -2), hidden.flatten(0, -2))
        return state.view_as(encoded)

    def masked(self, encoded: Tensor, seen: Seen) -> Tensor:
        """Return (..., n, 15) from the encoder's vectors, -inf for what is not offered."""
        return self.encoder.on_map(self.head(encoded), seen.places).masked_fill(~seen.offers, -torch.inf)


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
        seen = encoded.mean(-2, keepdim=True) if self.sees_team else encoded
        value: Tensor = self.head(seen)[..., 0]
        return value.expand(encoded.shape[:-1])


class QMixer(nn.Module):
    """QMIX's mixer (Rashid et al., ICML 2018), with what all cars observe as the state.

    The team's value rises with each car's: weights that a state gives are taken without their signs.
    """

    def __init__(self, shape: Shape) -> None:
        super().__init__()
        self.n_cars = shape.n_cars
        self.encoder = make_encoder(shape)
        # The table begins as a linear layer on a drawing of all places does. With a policy's table the team's value
        # changes by 7 to 22 with a car's, and the cars' values are lost; in the published mixer by 0.2 to 0.7, here by
        # 0.1 to 0.5, however many things there are.
        largest = shape.places**-0.5
        nn.init.uniform_(self.encoder.table.weight, -largest, largest)
        self.first_weight = nn.Linear(shape.width, shape.n_cars * _MIXING_WIDTH)
        self.first_bias = nn.Linear(shape.width, _MIXING_WIDTH)
        self.last_weight = nn.Linear(shape.width, _MIXING_WIDTH)
        self.last_bias = nn.Sequential(
            nn.Linear(shape.width, _MIXING_WIDTH), nn.ReLU(), nn.Linear(_MIXING_WIDTH, 1)
        )

    def forward(self, chosen: Tensor, seen: Seen) -> Tensor:
        """Return the team's value (...) from the values (..., n) of the cars' chosen actions."""
        return self.mix(chosen, self.encoder(seen).mean(-2).relu())

    def mix(self, chosen: Tensor, state: Tensor) -> Tensor:
        """Return the same from a state (..., width)."""
        weight = self.first_weight(state).abs().unflatten(-1, (self.n_cars, _MIXING_WIDTH))
        hidden = (chosen.unsqueeze(-2) @ weight).squeeze(-2) + self.first_bias(state)
        last = self.last_weight(state).abs()
        value: Tensor = (nn.functional.elu(hidden) * last).sum(-1) + self.last_bias(state).squeeze(-1)
        return value


class OthersNet(nn.Module):
    """Gives each car the team's value of every action of its own, all others acting as they did: COMA's critic."""

    def __init__(self, shape: Shape) -> None:
        super().__init__()
        self.encoder = make_encoder(shape)
        self.actions = nn.Parameter(torch.zeros(shape.n_cars, N_ACTIONS, shape.width))
        self.head = head(shape.width, N_ACTIONS)

    def forward(self, seen: Seen, actions: Tensor) -> Tensor:
        """Return (..., n, 15) from what is seen and actions (..., n)."""
        did = _looked_up(self.actions, actions)
        others = did.sum(-2, keepdim=True) - did
        return self.encoder.on_map(self.head(self.encoder(seen) + others), seen.places)


class JointNet(nn.Module):
    """Gives the team the value of its joint action, and of the state alone: QTRAN's."""

    def __init__(self, shape: Shape) -> None:
        super().__init__()
        self.encoder = make_encoder(shape)
        self.actions = nn.Parameter(torch.zeros(shape.n_cars, N_ACTIONS, shape.width))
        self.joint, self.rest = head(shape.width, 1), head(shape.width, 1)

    def state(self, seen: Seen) -> Tensor:
        """Return a vector (..., width) of what all cars see."""
        state: Tensor = self.encoder(seen).mean(-2)
        return state

    def forward(self, state: Tensor, actions: Tensor) -> tuple[Tensor, Tensor]:
        """Return (...) twice from states (..., width) and actions (..., n)."""
        joint = self.joint(state + _looked_up(self.actions, actions).sum(-2))
        return joint[..., 0], self.rest(state)[..., 0]


def _looked_up(table: Tensor, actions: Tensor) -> Tensor:
    """Return (..., n, width): the row of each car's action in its own table, (n, 15, width)."""
    return table[torch.arange(len(table)), actions]


def head(width: int, n_out: int, layer_norm: bool = False) -> nn.Module:
    """Return the last two layers, from an encoder's vector to numbers that are close to zero at first."""
    first, last = nn.Linear(width, width), nn.Linear(width, n_out)
    # Small first outputs: the first policy is close to uniform, the first values close to zero.
    nn.init.orthogonal_(last.weight, 0.01)
    nn.init.zeros_(last.bias)
    if layer_norm:
        return nn.Sequential(nn.LayerNorm(width), nn.ReLU(), first, nn.LayerNorm(width), nn.ReLU(), last)
    return nn.Sequential(nn.ReLU(), nn.Sequential(first, nn.ReLU(), last))


@torch.no_grad()
def follow(target: nn.Module, online: nn.Module, rate: float) -> None:
    """Let the weights of a target network follow those of another by this part of their difference."""
    torch._foreach_lerp_([*target.parameters()], [*online.parameters()], rate)


def numbers(
    saved: Any, name: str, like: Tensor, low: float = -LARGEST_WEIGHT, high: float = LARGEST_WEIGHT
) -> Tensor:
    """Return a tensor of the shape and type of ``like``; raise InputError for what is none.

    Its numbers must be within bounds, and so be finite.
    """
    if type(saved) is not Tensor or (saved.shape, saved.dtype, saved.layout) != (
        like.shape,
        like.dtype,
        torch.strided,
    ):
        found = f"{saved.dtype} {tuple(saved.shape)}" if isinstance(saved, Tensor) else type(saved).__name__
        raise InputError(f"'{name}' is {found}; allowed: {like.dtype} {tuple(like.shape)}")
    if saved.numel() and not (low <= float(saved.min()) and float(saved.max()) <= high):
        raise InputError(f"'{name}' has numbers that are not finite, or not from {low:g} to {high:g}")
    return saved


def restore_module(module: nn.Module, saved: Mapping[str, Any]) -> None:
    """Take over weights; settings among its tensors, single numbers, stay as they are. Raises InputError."""
    state = module.state_dict()
    if odd := sorted(set(saved) ^ set(state), key=str):
        raise InputError(f"'{str(odd[0])[:80]}' is missing or unknown among its weights")
    for key, own in state.items():
        if own.ndim and own.is_floating_point():
            state[key] = numbers(saved[key], key, own)
    module.load_state_dict(state)


def restore_adam(optimizer: torch.optim.Optimizer, saved: Mapping[str, Any]) -> None:
    """Take over the averages of Adam or RAdam; its settings stay as they are. Raises InputError."""
    own = optimizer.state_dict()
    parameters = dict(
        enumerate(parameter for group in optimizer.param_groups for parameter in group["params"])
    )
    state = {number: _averages(parameters[number], **found) for number, found in saved["state"].items()}
    optimizer.load_state_dict(own | {"state": state})


def _averages(like: Tensor, step: Any, exp_avg: Any, exp_avg_sq: Any) -> dict[str, Tensor]:
    return {
        "step": numbers(step, "step", torch.zeros(()), 0, 2**31),
        "exp_avg": numbers(exp_avg, "exp_avg", like),
        "exp_avg_sq": numbers(exp_avg_sq, "exp_avg_sq", like, 0),
    }
