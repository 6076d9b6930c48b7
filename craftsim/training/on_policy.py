"""Independent and multi-agent PPO: TorchRL's clipped loss and advantages on whole episodes of many worlds."""

from __future__ import annotations

from typing import Any, Final

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value.functional import vec_generalized_advantage_estimate

from craftsim.training.distinct import Distinct
from craftsim.training.learner import Learner
from craftsim.training.networks import ACTION, MASK, OBSERVATION, CarNet, Critic
from craftsim.training.restoring import restore_adam, restore_module
from craftsim.training.settings import PPOSettings
from craftsim.training.shape import Shape
from craftsim.training.team_networks import LOGITS, masked_actor

MIN_ADVANTAGE_STD: Final = 0.1
"""Advantages of a smaller standard deviation are not scaled up to 1: they are noise of the critic."""

VALUE: Final = ("agents", "state_value")
LOG_PROB: Final = ("agents", "action_log_prob")


class PPOLearner(Learner):
    """IPPO, whose critic sees what one car observes, or MAPPO, whose critic sees what all cars observe.

    Actor and critic share the encoder. A world that a batch meets many times is looked at once.
    """

    def __init__(self, shape: Shape, ticks: int, sees_team: bool, settings: PPOSettings) -> None:
        self.settings = settings
        self.ticks = ticks
        self.net = CarNet(shape)
        self.critic = Critic(shape, sees_team)
        self.plays = masked_actor(self.net)
        # The loss is told what the networks say: it need not know that they say it once for all copies of a world.
        self.loss = ClipPPOLoss(
            masked_actor(nn.Identity(), [LOGITS]),
            TensorDictModule(nn.Identity(), in_keys=[VALUE], out_keys=[VALUE]),
            clip_epsilon=settings.clip,
            entropy_coeff=settings.entropy,
            critic_coeff=settings.critic,
        )
        self.loss.set_keys(action=ACTION, value=VALUE)
        self.modules = nn.ModuleDict({"net": self.net, "critic": self.critic})
        self.optimizer = torch.optim.Adam(self.modules.parameters(), settings.learning_rate, fused=True)

    def update(self, rollout: TensorDictBase) -> None:
        """Learn from each tick as many times as there are epochs."""
        settings = self.settings
        n, n_cars = rollout.numel(), rollout[ACTION].shape[-1]
        # Of now, then of the tick after: where an episode ends these are not the next of the rollout.
        observed, masks = (
            torch.cat([rollout[key].flatten(0, 1), rollout["next", *key].flatten(0, 1)])
            for key in (OBSERVATION, MASK)
        )
        distinct = Distinct(observed, masks)
        places, offers = self.net.encoder.places(observed[distinct.first]), masks[distinct.first]
        with torch.no_grad():
            values = self.critic(self.net.encoder.of_places(places, offers)).squeeze(-1)
        now, after = values[distinct.inverse].view(2, *rollout.shape, n_cars)
        reward, done, terminated = (
            rollout["next", key].expand_as(now) for key in ("reward", "done", "terminated")
        )
        advantage, target = vec_generalized_advantage_estimate(
            *(settings.gamma, settings.gae_lambda, now, after),
            *(column.contiguous() for column in (reward, done, terminated)),
        )
        advantage = (advantage - advantage.mean()) / advantage.std().clamp(min=MIN_ADVANTAGE_STD)
        played = rollout.select(ACTION, MASK, LOG_PROB).reshape(-1)
        played["advantage"], played["value_target"] = (
            column.reshape(n, n_cars, 1) for column in (advantage, target)
        )
        for _ in range(settings.epochs):
            for some in torch.randperm(n).chunk(settings.minibatches):
                batch = played[some]
                met, inverse = torch.unique(distinct.inverse[some], return_inverse=True)
                encoded = self.net.encoder.of_places(places[met], offers[met])
                batch[LOGITS] = self.net.on_places(encoded, places[met]).index_select(0, inverse)
                batch[VALUE] = self.critic(encoded).index_select(0, inverse)
                losses = self.loss(batch)
                self.optimizer.zero_grad()
                (losses["loss_objective"] + losses["loss_critic"] + losses["loss_entropy"]).backward()
                nn.utils.clip_grad_norm_(self.modules.parameters(), settings.max_gradient)
                self._step()

    def _step(self) -> None:
        (group,) = self.optimizer.param_groups
        group["lr"] = self.settings.rate(self.learnt)
        self.optimizer.step()
        group["lr"] = self.settings.learning_rate  # what a checkpoint is checked against

    def state(self) -> dict[str, Any]:
        """Return weights and the optimiser's averages."""
        return {"modules": self.modules.state_dict(), "optimizer": self.optimizer.state_dict()}

    def restore(self, state: dict[str, Any]) -> None:
        """Take them over."""
        restore_module(self.modules, state["modules"])
        restore_adam(self.optimizer, state["optimizer"])
