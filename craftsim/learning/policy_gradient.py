"""Policy gradients: independent and multi-agent PPO, COMA, and imitation.

After Schulman et al. (2017); Yu et al., "The surprising effectiveness of PPO in cooperative multi-agent games" (NeurIPS
2022); and Foerster et al., "Counterfactual multi-agent policy gradients" (AAAI 2018).
"""

from __future__ import annotations

from copy import deepcopy
from typing import ClassVar, Final

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional
from torch.nn.functional import mse_loss, smooth_l1_loss

from craftsim.discrete.rules import RuleSet
from craftsim.learning.features import Features, joined, with_hidden
from craftsim.learning.learner import Learner, drawn, of_actions
from craftsim.learning.networks import Critic, OthersNet, follow
from craftsim.learning.rollouts import Rollout, distinct_features, lambda_returns
from craftsim.learning.settings import COMASettings, PPOSettings
from craftsim.learning.shape import Shape
from craftsim.learning.starts import NOT_SHOWN, Demonstrations
from craftsim.tasks import Task
from craftsim.tasks.episodes import Episodes

_MIN_ADVANTAGE_STD: Final = 0.1
"""Advantages with a smaller standard deviation are not normalised to 1, since they are noise of the critic."""
_EPOCHS: Final = 6
"""Of imitation, as are the next ones."""
LEAST: Final = 200
"""Steps of the optimiser, however little is shown."""
_BATCH: Final = 512
_LEARNING_RATE: Final = 1e-3
_LOOKED_AT: Final = 4096
"""Worlds that are put into observations at once."""


class PPOLearner(Learner):
    """IPPO: the critic sees what one car observes.

    Actor and critic share the encoder. Repeated observations in a batch are evaluated once.
    """

    sees_team: ClassVar[bool] = False
    """Whether the critic sees what all cars observe."""
    settings: PPOSettings

    def __init__(self, shape: Shape, ticks: int, settings: PPOSettings) -> None:
        super().__init__(shape, ticks, settings)
        self.critic = Critic(shape, sees_team=self.sees_team)
        self.modules = nn.ModuleDict({"net": self.net, "critic": self.critic})
        self.optimizer = torch.optim.Adam(
            self.modules.parameters(), settings.learning_rate, fused=True
        )

    def update(self, rollout: Rollout) -> None:
        """Run the epochs of minibatch updates on a rollout."""
        settings = self.settings
        n = len(rollout)
        actions = rollout.actions.flatten(0, 1)
        # Values now and after each tick; these differ at the end of an episode.
        once, inverse = distinct_features(joined([rollout.before.flat(), rollout.after.flat()]))
        with torch.no_grad():
            encoded = self.net.encoder(once)
            values, after = self.critic(encoded)[inverse].view(2, *rollout.actions.shape)
            before = self.net.masked(encoded, once).log_softmax(-1)
            before = of_actions(before[inverse[:n]], actions)
        advantage = advantages(rollout, values, after, settings.gamma, settings.gae_lambda).flatten(
            0, 1
        )
        target = advantage + values.flatten(0, 1)
        chose = None
        if rollout.decides is not None:
            chose = rollout.decides.flatten(0, 1)
        if chose is None:
            met = advantage
        else:
            met = advantage[chose]
        advantage = (advantage - met.mean()) / met.std().clamp(min=_MIN_ADVANTAGE_STD)
        for _ in range(settings.epochs):
            for batch in torch.randperm(n).chunk(settings.minibatches):
                met, places = torch.unique(inverse[batch], return_inverse=True)
                features = once[met]
                encoded = self.net.encoder(features)
                log_probs = self.net.masked(encoded, features).log_softmax(-1)
                ratio = (
                    of_actions(log_probs.index_select(0, places), actions[batch]) - before[batch]
                ).exp()
                gain = ratio * advantage[batch]
                clipped = ratio.clamp(1 - settings.clip, 1 + settings.clip) * advantage[batch]
                batch_value = self.critic(encoded).index_select(0, places)
                entropy = (
                    -(log_probs.exp() * log_probs.clamp(min=-1e4)).sum(-1).index_select(0, places)
                )
                loss = settings.critic * smooth_l1_loss(
                    batch_value, target[batch], reduction="none"
                )
                loss = loss - torch.minimum(gain, clipped) - settings.entropy * entropy
                self.minimize((loss if chose is None else loss[chose[batch]]).mean())


class MAPPOLearner(PPOLearner):
    """MAPPO: the critic sees what all cars observe."""

    sees_team = True


def advantages(
    rollout: Rollout, before: Tensor, after: Tensor, gamma: float, decay: float
) -> Tensor:
    """Return (T, B, n): generalised advantages (Schulman et al., 2016) from the values before and after each tick.

    In asynchronous execution an action lasts from a car's decision to its next one, and earns the team's rewards of
    that time, discounted by elapsed time (semi-Markov decision process). Entries of cars that do not decide are
    undefined.
    """
    goes_on = ~rollout.terminated.unsqueeze(-1)
    same = ~rollout.done.unsqueeze(-1)
    rewards = rollout.rewards.unsqueeze(-1)
    if rollout.decides is None or rollout.elapsed is None:
        errors = rewards + gamma * goes_on * after - before
        advantage = torch.empty_like(errors)
        later = torch.zeros_like(errors[0])
        for t in range(len(errors) - 1, -1, -1):
            advantage[t] = later = errors[t] + gamma * decay * same[t] * later
        return advantage
    discount = gamma ** rollout.elapsed.unsqueeze(-1)
    advantage = torch.empty_like(before)
    # By car: the return until its next decision, with the value then, and the advantage of that decision.
    next_value = after[-1]
    later = torch.zeros_like(after[-1])
    for t in range(len(before) - 1, -1, -1):
        earned = rewards[t] + discount[t] * goes_on[t] * torch.where(same[t], next_value, after[t])
        later = discount[t] * same[t] * later
        advantage[t] = earned - before[t] + decay * later
        next_value = torch.where(rollout.decides[t], before[t], earned)
        later = torch.where(rollout.decides[t], advantage[t], later)
    return advantage


class COMALearner(Learner):
    """COMA: each car is judged by what the team would have got had it acted otherwise.

    Passes over each rollout, whose actions are those of the policy that learns from them.
    """

    settings: COMASettings

    def __init__(self, shape: Shape, ticks: int, settings: COMASettings) -> None:
        super().__init__(shape, ticks, settings)
        self.critic = OthersNet(shape)
        self.target = deepcopy(self.critic).requires_grad_(False)
        self.modules = nn.ModuleDict(
            {"net": self.net, "critic": self.critic, "target": self.target}
        )
        weights = [*self.net.parameters(), *self.critic.parameters()]
        self.optimizer = torch.optim.Adam(weights, settings.learning_rate, fused=True)

    def update(self, rollout: Rollout) -> None:
        """Learn from each tick once."""
        returns = self.returns(rollout).flatten(0, 1)
        features = rollout.before.flat()
        actions = rollout.actions.flatten(0, 1)
        for batch in torch.randperm(len(rollout)).chunk(self.settings.minibatches):
            logits = self.net(features[batch])
            values = self.critic(features[batch], actions[batch])
            gain, entropy = counterfactual(logits, values.detach(), actions[batch])
            value_of_action = of_actions(values, actions[batch])
            self.minimize(
                mse_loss(value_of_action, returns[batch])
                - gain.mean()
                - self.settings.entropy * entropy.mean()
            )
            follow(self.target, self.critic, self.settings.target_rate)

    @torch.no_grad()
    def returns(self, rollout: Rollout) -> Tensor:
        """Return (T, B, n): TD(lambda) of the target critic.

        The value after a tick is that of what the cars do next. Where a rollout or an episode ends, that is an action
        of the policy in the last world, so that time which has run out is not taken for completed work.
        """
        settings = self.settings
        values = of_actions(self.target(rollout.before, rollout.actions), rollout.actions)
        ends = rollout.done.clone()
        ends[-1] = True
        last = rollout.after[ends]
        drawn_next = drawn(self.net(last))
        after = values.roll(-1, 0)
        after[ends] = of_actions(self.target(last, drawn_next), drawn_next)
        return lambda_returns(rollout, after, settings.gamma, settings.td_lambda)


def counterfactual(logits: Tensor, values: Tensor, actions: Tensor) -> tuple[Tensor, Tensor]:
    """Return (..., n) twice: what the policy's gradient ascends, and its entropy.

    The baseline of a car's advantage is the value that its policy expects, all others acting as they did.
    """
    log_probs = logits.log_softmax(-1)
    probs = log_probs.exp()
    advantage = of_actions(values, actions) - (probs.detach() * values).sum(-1)
    entropy = -(probs * log_probs.clamp(min=-1e4)).sum(-1)
    return of_actions(log_probs, actions) * advantage, entropy


def imitate(
    learner: PPOLearner,
    task: Task,
    demonstrations: Demonstrations,
    rules: RuleSet = "physical",
    helper_depth: int | None = None,
) -> None:
    """Fit what a learner would do to what was shown, and its values to the returns of that."""
    features = _features(
        learner,
        demonstrations,
        Episodes(task, np.random.default_rng(0), _LOOKED_AT, rules, helper_depth),
    )
    device = features.places.device
    actions = torch.from_numpy(demonstrations.actions).to(device)
    returns = torch.from_numpy(demonstrations.returns(learner.settings.gamma)).to(device)
    # What a car does later in a tick may be legal only after what another did: such actions are not imitated.
    taught = (actions != NOT_SHOWN) & of_actions(features.offers, actions.clamp(min=0))
    optimizer = torch.optim.Adam(learner.modules.parameters(), _LEARNING_RATE, fused=True)
    batches = -(-len(actions) // _BATCH)
    steps = max(LEAST, _EPOCHS * batches)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps)
    for step in range(steps):
        if step % batches == 0:
            order = torch.randperm(len(actions)).chunk(batches)
        batch = order[step % batches]
        encoded = learner.net.encoder(features[batch])
        logits = learner.net.masked(encoded, features[batch])
        values = learner.critic(encoded)
        doing = functional.cross_entropy(logits[taught[batch]], actions[batch][taught[batch]])
        valuing = functional.mse_loss(values, returns[batch, None].expand_as(values))
        optimizer.zero_grad()
        (doing + learner.settings.critic * valuing).backward()
        nn.utils.clip_grad_norm_(learner.modules.parameters(), learner.settings.max_gradient)
        optimizer.step()
        schedule.step()


def _features(learner: PPOLearner, demonstrations: Demonstrations, episodes: Episodes) -> Features:
    """Return what the cars saw, (N,)."""
    parts = []
    n = len(demonstrations.actions)
    rows_from_0 = np.arange(n)
    ticks = rows_from_0 - np.maximum.accumulate(np.where(demonstrations.first, rows_from_0, 0))
    for rows in np.split(np.arange(n), range(_LOOKED_AT, n, _LOOKED_AT)):
        episodes.begin(np.arange(len(rows)), demonstrations.worlds.take(rows))
        vectors = episodes.vectors()[: len(rows)]
        if learner.net.encoder.ticks:
            vectors = with_hidden(vectors, ticks[rows], episodes.busy[: len(rows)])
        offered = episodes.offered()[: len(rows)]
        parts.append(learner.net.encoder.look(vectors, offered))
    return joined(parts)
