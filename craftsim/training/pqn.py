"""PQN-VDN: Q-learning on many worlds side by side, without replay and target networks.

After Gallici et al., "Simplifying deep temporal difference learning", ICLR 2025: lambda returns of fresh rollouts, and
layer normalisation, take the place of both. The team's value is the sum of the cars' (VDN).
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn.functional import mse_loss

from craftsim.training.features import Seen, joined
from craftsim.training.learner import Learner, of_actions
from craftsim.training.networks import CarNet
from craftsim.training.q_learning import epsilon_greedy
from craftsim.training.rollouts import Rollout, distinct, lambda_returns
from craftsim.training.settings import PQNSettings
from craftsim.training.shape import Shape


class PQNLearner(Learner):
    """Learns the value of each action of a car, such that the sum over the cars is the team's."""

    def __init__(self, shape: Shape, ticks: int, settings: PQNSettings) -> None:
        self.settings: PQNSettings = settings
        self.ticks = ticks
        self.net = CarNet(shape)
        self.modules: nn.Module = self.net
        self.optimizer = torch.optim.RAdam(self.net.parameters(), settings.learning_rate)

    def act(self, seen: Seen) -> Tensor:
        """Choose each car's best action, and now and then any."""
        return epsilon_greedy(self.net(seen), seen, self.settings.epsilon(self.learnt))

    def update(self, rollout: Rollout) -> None:
        """Learn from each tick as many times as there are epochs."""
        settings = self.settings
        n, actions = len(rollout), rollout.actions.flatten(0, 1)
        once, inverse = distinct(joined([rollout.now.flat(), rollout.after.flat()]))
        with torch.no_grad():
            best = self.net(once).amax(-1).sum(-1)
        after = best[inverse[n:]].view_as(rollout.rewards)
        target = lambda_returns(rollout, after, settings.gamma, settings.td_lambda).flatten()
        for _ in range(settings.epochs):
            for some in torch.randperm(n).chunk(settings.minibatches):
                met, places = torch.unique(inverse[some], return_inverse=True)
                values = self.net(once[met]).index_select(0, places)
                self.minimize(mse_loss(of_actions(values, actions[some]).sum(-1), target[some]))
