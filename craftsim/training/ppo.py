"""Independent and multi-agent PPO: the clipped objective and generalised advantages on whole episodes of many worlds.

After Schulman et al. (2017) and Yu et al., "The surprising effectiveness of PPO in cooperative multi-agent games"
(NeurIPS 2022).
"""

from __future__ import annotations

from typing import Final

import torch
from torch import Tensor, nn
from torch.nn.functional import smooth_l1_loss

from craftsim.training.learner import Learner, drawn
from craftsim.training.networks import CarNet, Critic
from craftsim.training.rollouts import Rollout, Seen, UniqueObservations, joined
from craftsim.training.settings import PPOSettings
from craftsim.training.shape import Shape

MIN_ADVANTAGE_STD: Final = 0.1
"""Advantages of a smaller standard deviation are not scaled up to 1: they are noise of the critic."""


class PPOLearner(Learner):
    """IPPO, whose critic sees what one car observes, or MAPPO, whose critic sees what all cars observe.

    Actor and critic share the encoder. A world that a batch meets many times is looked at once.
    """

    def __init__(self, shape: Shape, ticks: int, sees_team: bool, settings: PPOSettings) -> None:
        self.settings: PPOSettings = settings
        self.ticks = ticks
        self.net = CarNet(shape)
        self.critic = Critic(shape, sees_team)
        self.modules = nn.ModuleDict({"net": self.net, "critic": self.critic})
        self.optimizer = torch.optim.Adam(self.modules.parameters(), settings.learning_rate, fused=True)

    def act(self, seen: Seen) -> Tensor:
        """Draw each car's action by the policy."""
        return drawn(self.net(seen))

    def update(self, rollout: Rollout) -> None:
        """Learn from each tick as many times as there are epochs."""
        settings = self.settings
        n, actions = len(rollout), rollout.actions.flatten(0, 1)
        # Of now, then of the tick after: where an episode ends these are not the next of the rollout.
        distinct = UniqueObservations(joined([rollout.now.flat(), rollout.after.flat()]))
        with torch.no_grad():
            encoded = self.net.encode(distinct.seen)
            now, after = self.critic(encoded)[distinct.inverse].view(2, *rollout.actions.shape)
            before = self.net.masked(encoded, distinct.seen).log_softmax(-1)
            before = _of(before[distinct.inverse[:n]], actions)
        advantage = advantages(rollout, now, after, settings.gamma, settings.gae_lambda).flatten(0, 1)
        target = advantage + now.flatten(0, 1)
        chose = None if rollout.decides is None else rollout.decides.flatten(0, 1)
        met = advantage if chose is None else advantage[chose]
        advantage = (advantage - met.mean()) / met.std().clamp(min=MIN_ADVANTAGE_STD)
        for _ in range(settings.epochs):
            for some in torch.randperm(n).chunk(settings.minibatches):
                met, inverse = torch.unique(distinct.inverse[some], return_inverse=True)
                seen = distinct.seen[met]
                encoded = self.net.encode(seen)
                log_probs = self.net.masked(encoded, seen).log_softmax(-1)
                ratio = (_of(log_probs.index_select(0, inverse), actions[some]) - before[some]).exp()
                gain = ratio * advantage[some]
                clipped = ratio.clamp(1 - settings.clip, 1 + settings.clip) * advantage[some]
                value = self.critic(encoded).index_select(0, inverse)
                entropy = -(log_probs.exp() * log_probs.clamp(min=-1e4)).sum(-1).index_select(0, inverse)
                loss = settings.critic * smooth_l1_loss(value, target[some], reduction="none")
                loss = loss - torch.minimum(gain, clipped) - settings.entropy * entropy
                self.minimize((loss if chose is None else loss[chose[some]]).mean())


def _of(log_probs: Tensor, actions: Tensor) -> Tensor:
    """Return (..., n): those of the actions that were done."""
    return log_probs.gather(-1, actions.unsqueeze(-1)).squeeze(-1)


def advantages(rollout: Rollout, now: Tensor, after: Tensor, gamma: float, decay: float) -> Tensor:
    """Return (T, B, n): generalised advantages (Schulman et al., 2016) from the values before and after each tick.

    Where cars decide one by one, an action lasts from a car's decision to its next one, and earns what the team is
    rewarded with meanwhile, discounted by the time that has passed (a semi-Markov decision process); what stands where
    a car decides nothing means nothing.
    """
    goes_on, same = (~flag.unsqueeze(-1) for flag in (rollout.terminated, rollout.done))
    rewards = rollout.rewards.unsqueeze(-1)
    if rollout.decides is None or rollout.elapsed is None:
        errors = rewards + gamma * goes_on * after - now
        found, ahead = torch.empty_like(errors), torch.zeros_like(errors[0])
        for t in range(len(errors) - 1, -1, -1):
            found[t] = ahead = errors[t] + gamma * decay * same[t] * ahead
        return found
    discount = gamma ** rollout.elapsed.unsqueeze(-1)
    found = torch.empty_like(now)
    # Of each car: what follows until its next decision, with the value then, and the advantage of that decision.
    follows, ahead = after[-1], torch.zeros_like(after[-1])
    for t in range(len(now) - 1, -1, -1):
        earned = rewards[t] + discount[t] * goes_on[t] * torch.where(same[t], follows, after[t])
        ahead = discount[t] * same[t] * ahead
        found[t] = earned - now[t] + decay * ahead
        follows = torch.where(rollout.decides[t], now[t], earned)
        ahead = torch.where(rollout.decides[t], found[t], ahead)
    return found
