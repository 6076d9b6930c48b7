"""COMA: each car is judged by what the team would have got had it acted otherwise.

After Foerster et al., "Counterfactual multi-agent policy gradients", AAAI 2018.
"""

from __future__ import annotations

from copy import deepcopy

import torch
from torch import Tensor, nn
from torch.nn.functional import mse_loss

from craftsim.training.features import Seen
from craftsim.training.learner import Learner, drawn, of_actions
from craftsim.training.networks import CarNet, OthersNet
from craftsim.training.q_learning import follow
from craftsim.training.rollouts import Rollout
from craftsim.training.settings import COMASettings
from craftsim.training.shape import Shape


class COMALearner(Learner):
    """Passes over each rollout, whose actions are those of the policy that learns from them."""

    def __init__(self, shape: Shape, ticks: int, settings: COMASettings) -> None:
        self.settings: COMASettings = settings
        self.ticks = ticks
        self.net = CarNet(shape)
        self.critic = OthersNet(shape)
        self.target = deepcopy(self.critic).requires_grad_(False)
        self.modules = nn.ModuleDict({"net": self.net, "critic": self.critic, "target": self.target})
        weights = [*self.net.parameters(), *self.critic.parameters()]
        self.optimizer = torch.optim.Adam(weights, settings.learning_rate, fused=True)

    def act(self, seen: Seen) -> Tensor:
        """Draw each car's action by the policy."""
        return drawn(self.net(seen))

    def update(self, rollout: Rollout) -> None:
        """Learn from each tick once."""
        returns = self._returns(rollout).flatten(0, 1)
        seen, actions = rollout.now.flat(), rollout.actions.flatten(0, 1)
        for some in torch.randperm(len(rollout)).chunk(self.settings.minibatches):
            logits = self.net(seen[some])
            values = self.critic(seen[some], actions[some])
            gain, entropy = counterfactual(logits, values.detach(), actions[some])
            taken = of_actions(values, actions[some])
            self.minimize(
                mse_loss(taken, returns[some]) - gain.mean() - self.settings.entropy * entropy.mean()
            )
            follow(self.target, self.critic, self.settings.target_rate)

    @torch.no_grad()
    def _returns(self, rollout: Rollout) -> Tensor:
        """Return (T, B, n): TD(lambda) of the target critic; an episode that ran out of time is over, too."""
        gamma, decay = self.settings.gamma, self.settings.td_lambda
        values = self.target(rollout.now, rollout.actions)
        taken = of_actions(values, rollout.actions)
        reward, same = rollout.rewards.unsqueeze(-1), ~rollout.done.unsqueeze(-1)
        found, ahead, follows = torch.empty_like(taken), taken[-1], taken[-1]
        for t in range(len(taken) - 1, -1, -1):
            found[t] = ahead = reward[t] + gamma * same[t] * ((1 - decay) * follows + decay * ahead)
            follows = taken[t]
        return found


def counterfactual(logits: Tensor, values: Tensor, actions: Tensor) -> tuple[Tensor, Tensor]:
    """Return (..., n) twice: what the policy's gradient ascends, and its entropy.

    The baseline of a car's advantage is the value that its policy expects, all others acting as they did.
    """
    log_probs = logits.log_softmax(-1)
    probs = log_probs.exp()
    advantage = of_actions(values, actions) - (probs.detach() * values).sum(-1)
    entropy = -(probs * log_probs.clamp(min=-1e4)).sum(-1)
    return of_actions(log_probs, actions) * advantage, entropy
