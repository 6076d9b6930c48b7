"""Independent Q-learning, VDN, QMIX and QTRAN, with replay and target networks.

Each car's values come from one network. What differs is how the cars' values make the team's: not at all (IQL), as
their sum (VDN, Sunehag et al., AAMAS 2018), by a mixer that rises with each of them (QMIX, Rashid et al., ICML 2018),
or by a network of the joint action with which their sum must agree where it matters (QTRAN, Son et al., ICML 2019).
"""

from __future__ import annotations

import math
from abc import abstractmethod
from copy import deepcopy
from dataclasses import replace
from functools import partial

import torch
from torch import Tensor, nn
from torch.nn.functional import mse_loss

from craftsim.discrete.kernel.codes import N_ACTIONS
from craftsim.learning.features import Encoder, Features, joined
from craftsim.learning.learner import Learner, drawn_offers, of_actions
from craftsim.learning.networks import Bounds, JointNet, QMixer, RecurrentState, follow
from craftsim.learning.rollouts import Rollout, distinct_features, lambda_returns
from craftsim.learning.settings import PQNSettings, QSettings
from craftsim.learning.shape import Shape


class ReplayMemory:
    """The last rollouts that were played, whose worlds are drawn one by one."""

    def __init__(self, encoder: Encoder, n: int, size: int, ticks: int) -> None:
        """Make room for so many rollouts of one world with n cars."""
        self.size = size
        self.bounds: dict[str, Bounds] = {
            "places": encoder.bounds,
            "actions": (0, N_ACTIONS - 1),
            "rewards": (-1e9, 1e9),
            "total": (0, 2**60),
        }
        self.columns = {
            "places": torch.zeros(size, ticks, 2, n, encoder.n_places, dtype=encoder.dtype),
            "offers": torch.zeros(size, ticks, 2, n, N_ACTIONS, dtype=torch.bool),
            "actions": torch.zeros(size, ticks, n, dtype=torch.int64),
            "rewards": torch.zeros(size, ticks),
            "terminated": torch.zeros(size, ticks, dtype=torch.bool),
            "done": torch.zeros(size, ticks, dtype=torch.bool),
        }
        self.total = torch.zeros((), dtype=torch.int64)
        """Rollouts of one world that were ever put here."""

    def __len__(self) -> int:
        """Return how many are remembered."""
        return min(int(self.total), self.size)

    def add(self, rollout: Rollout) -> None:
        """Remember what was played in each world, and forget the oldest."""
        features = joined([rollout.before, rollout.after], partial(torch.stack, dim=2))
        outcomes = rollout.actions, rollout.rewards, rollout.terminated, rollout.done
        n = rollout.rewards.shape[1]
        at = (self.total + torch.arange(n)) % self.size
        for column, played in zip(
            self.columns.values(), (features.places, features.offers, *outcomes), strict=True
        ):
            column[at] = played.transpose(0, 1)
        self.total += n

    def sample(self, n: int) -> Rollout:
        """Return what was played in n worlds, drawn with replacement."""
        numbers = torch.randint(len(self), (n,))
        sampled = {}
        for name, column in self.columns.items():
            sampled[name] = column[numbers].transpose(0, 1).contiguous()
        places = sampled.pop("places")
        offers = sampled.pop("offers")
        before = Features(places[:, :, 0], offers[:, :, 0])
        after = Features(places[:, :, 1], offers[:, :, 1])
        return Rollout(before, after, **sampled)


class QLearner(Learner):
    """Learns the value of each action of a car, from what is replayed; subclasses say with which loss."""

    settings: QSettings

    def __init__(self, shape: Shape, ticks: int, settings: QSettings) -> None:
        super().__init__(shape, ticks, settings)
        self.n_cars = shape.n_cars
        self.team = self.team_network(shape)
        self.online = nn.ModuleDict({"net": self.net, "team": self.team})
        self.target_net = deepcopy(self.net)
        self.target_team = deepcopy(self.team)
        self.target = nn.ModuleDict({"net": self.target_net, "team": self.target_team})
        self.modules = nn.ModuleDict(
            {"online": self.online, "target": self.target.requires_grad_(False)}
        )
        self.rewards = torch.zeros(3, dtype=torch.float64)
        """How many there were so far, their sum, and that of their squares."""
        weights = self.online.parameters()
        self.optimizer: torch.optim.Optimizer
        if settings.rmsprop:
            self.optimizer = torch.optim.RMSprop(
                weights, settings.learning_rate, eps=1e-5, foreach=True
            )
        else:
            self.optimizer = torch.optim.Adam(weights, settings.learning_rate, fused=True)
        self.replay = ReplayMemory(
            self.net.encoder, self.n_cars, max(1, settings.buffer // ticks), ticks
        )
        self.acting: RecurrentState | None = None

    def team_network(self, shape: Shape) -> nn.Module:
        """Return the network that makes the team's value; most need none."""
        return nn.Identity()

    def to(self, device: torch.device) -> None:
        """Move what is remembered, too."""
        super().to(device)
        self.rewards, self.replay.total = self.rewards.to(device), self.replay.total.to(device)
        self.replay.columns = {
            name: column.to(device) for name, column in self.replay.columns.items()
        }

    def begin(self, worlds: Tensor) -> None:
        """Forget the episodes that were in these worlds."""
        if worlds.all():
            self.acting = self.net.memory(len(worlds), self.n_cars)
        elif self.acting is not None:
            self.acting.forget(worlds)

    def act(self, features: Features) -> Tensor:
        """Choose each car's best action, and now and then any."""
        values = self.net(features, self.acting)
        actions = _epsilon_greedy(values, features, self.settings.epsilon(self.learnt))
        if self.acting is not None:
            self.acting.last.copy_(actions)
        return actions

    def update(self, rollout: Rollout) -> None:
        """Remember what was played and learn from batches of what is remembered."""
        self.replay.add(rollout)
        rewards = rollout.rewards.double()
        self.rewards += torch.stack(
            [rewards.new_tensor(rewards.numel()), rewards.sum(), rewards.square().sum()]
        )
        worlds = max(1, round(self.settings.batch / self.ticks))
        every = self.settings.target_ticks
        for _ in range(math.ceil(len(rollout) * self.settings.replays / (worlds * self.ticks))):
            self.minimize(self.loss(self.replay.sample(worlds)))
            if not every:
                follow(self.target, self.online, self.settings.target_rate)
        if every and (self.learnt + len(rollout)) // every > self.learnt // every:
            follow(self.target, self.online, self.settings.target_rate)

    def values(self, batch: Rollout) -> tuple[Tensor, Tensor, Tensor]:
        """Return values (T, B, n, 15), the best actions (T, B, n) after each tick, and the target network's values of
        these: what is best is chosen by one network and valued by the other (double Q-learning).
        """
        before, after = self.net.of_rollouts(batch)
        best = after.argmax(-1)
        return before, best, of_actions(self.target_net.of_ends(batch), best)

    @abstractmethod
    def loss(self, batch: Rollout) -> Tensor:
        """Return the loss of rollouts."""

    def target_returns(self, batch: Rollout, next_values: Tensor) -> Tensor:
        """Return lambda returns (T, B) or (T, B, n) of values after each tick."""
        if self.settings.standardize:
            n, total, squares = self.rewards
            deviation = (squares / n - (total / n) ** 2).clamp(min=1e-4).sqrt().float()
            batch = replace(batch, rewards=batch.rewards / deviation)
        if self.settings.limit_ends:
            batch = replace(batch, terminated=batch.done)
        return lambda_returns(batch, next_values, self.settings.gamma, self.settings.td_lambda)

    def tensors(self) -> tuple[dict[str, Tensor], dict[str, Bounds]]:
        """Return what every learner does, and the rollouts that are remembered."""
        tensors, bounds = super().tensors()
        memory = self.replay.columns | {"total": self.replay.total}
        tensors |= {f"memory.{name}": column for name, column in memory.items()} | {
            "rewards": self.rewards
        }
        bounds |= {f"memory.{name}": limits for name, limits in self.replay.bounds.items()}
        return tensors, bounds | {"rewards": (-1e18, 1e18)}


class MixedQLearner(QLearner):
    """Compares the team's value of what was done with its lambda returns."""

    @abstractmethod
    def team_value(self, team: nn.Module, values: Tensor, features: Features) -> Tensor:
        """Return the team's values (T, B) or (T, B, n) from those of the cars' actions (T, B, n)."""

    def loss(self, batch: Rollout) -> Tensor:
        """Return the mean squared error."""
        values, _, next_values = self.values(batch)
        with torch.no_grad():
            next_values = self.team_value(self.target_team, next_values, batch.after)
        team_values = self.team_value(self.team, of_actions(values, batch.actions), batch.before)
        return mse_loss(team_values, self.target_returns(batch, next_values))


class IQLLearner(MixedQLearner):
    """IQL: each car takes the team's reward for its own."""

    def team_value(self, team: nn.Module, values: Tensor, features: Features) -> Tensor:
        """Return each car's value."""
        return values


class VDNLearner(MixedQLearner):
    """VDN: the team's value is the sum of the cars'."""

    def team_value(self, team: nn.Module, values: Tensor, features: Features) -> Tensor:
        """Return the sum."""
        return values.sum(-1)


class QMIXLearner(MixedQLearner):
    """QMIX: a network makes the team's value, which rises with each car's."""

    def team_network(self, shape: Shape) -> nn.Module:
        """Return the mixer."""
        return QMixer(shape)

    def team_value(self, team: nn.Module, values: Tensor, features: Features) -> Tensor:
        """Return what the mixer makes of the values."""
        mixed: Tensor = team(values, features)
        return mixed


class QTRANLearner(QLearner):
    """QTRAN-base: the sum of the cars' values agrees with a joint value where it matters."""

    def team_network(self, shape: Shape) -> nn.Module:
        """Return the network of the joint value."""
        return JointNet(shape)

    def loss(self, batch: Rollout) -> Tensor:
        """Return the sum of the paper's three losses."""
        assert isinstance(self.team, JointNet)
        assert isinstance(self.target_team, JointNet)
        values, best_after, _ = self.values(batch)
        best = values.detach().argmax(-1)
        state = self.team.state(batch.before)
        joint, remainder = self.team(state, batch.actions)
        with torch.no_grad():
            joint_best, _ = self.team(state, best)
            next_values, _ = self.target_team(self.target_team.state(batch.after), best_after)
        optimal = of_actions(values, best).sum(-1) - joint_best + remainder
        excess = of_actions(values, batch.actions).sum(-1) - joint.detach() + remainder
        return (
            mse_loss(joint, self.target_returns(batch, next_values))
            + optimal.square().mean()
            + excess.clamp(max=0.0).square().mean()
        )


class PQNLearner(Learner):
    """PQN-VDN: the sum of the cars' values is the team's, learnt on many worlds side by side, without replay.

    After Gallici et al., "Simplifying deep temporal difference learning", ICLR 2025: lambda returns of fresh rollouts,
    and layer normalisation, take the place of replay and target networks.
    """

    settings: PQNSettings

    def __init__(self, shape: Shape, ticks: int, settings: PQNSettings) -> None:
        super().__init__(shape, ticks, settings)
        self.modules: nn.Module = self.net
        self.optimizer = torch.optim.RAdam(self.net.parameters(), settings.learning_rate)

    def act(self, features: Features) -> Tensor:
        """Choose each car's best action, and now and then any."""
        return _epsilon_greedy(self.net(features), features, self.settings.epsilon(self.learnt))

    def update(self, rollout: Rollout) -> None:
        """Learn from each tick as many times as there are epochs."""
        settings = self.settings
        n = len(rollout)
        actions = rollout.actions.flatten(0, 1)
        once, inverse = distinct_features(joined([rollout.before.flat(), rollout.after.flat()]))
        with torch.no_grad():
            best = self.net(once).amax(-1).sum(-1)
        after = best[inverse[n:]].view_as(rollout.rewards)
        target = lambda_returns(rollout, after, settings.gamma, settings.td_lambda).flatten()
        for _ in range(settings.epochs):
            for batch in torch.randperm(n).chunk(settings.minibatches):
                met, places = torch.unique(inverse[batch], return_inverse=True)
                values = self.net(once[met]).index_select(0, places)
                self.minimize(mse_loss(of_actions(values, actions[batch]).sum(-1), target[batch]))


def _epsilon_greedy(values: Tensor, features: Features, epsilon: float) -> Tensor:
    """Return actions (B, n): with this probability one drawn from those that are offered, or the best one."""
    best = values.argmax(-1)
    any_offered = drawn_offers(features.offers)
    return torch.where(torch.rand(best.shape) < epsilon, any_offered, best)
