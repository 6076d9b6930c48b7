"""Independent and multi-agent PPO: TorchRL's clipped loss and advantages on whole episodes of many worlds."""

from __future__ import annotations

from typing import Any, Final

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.objectives import ClipPPOLoss, ValueEstimators

from craftsim.discrete.rules.legality import N_ACTIONS
from craftsim.training.learner import Learner
from craftsim.training.networks import ACTION, MASK, OBSERVATION, CarNet, TeamNet
from craftsim.training.restoring import adam_state, module_state
from craftsim.training.shape import Shape
from craftsim.training.team_networks import masked_actor

GAMMA: Final = 0.99
LAMBDA: Final = 0.95
CLIP: Final = 0.2
ENTROPY: Final = 0.01
CRITIC: Final = 0.5
LEARNING_RATE: Final = 1e-3
EPOCHS: Final = 4
MINIBATCHES: Final = 4
MAX_GRADIENT: Final = 1.0
MIN_ADVANTAGE_STD: Final = 0.1
"""Advantages of a smaller standard deviation are not scaled up to 1: they are noise of the critic."""

VALUE: Final = ("agents", "state_value")


class PPOLearner(Learner):
    """IPPO, whose critic sees what one car observes, or MAPPO, whose critic sees what all cars observe."""

    def __init__(self, shape: Shape, ticks: int, sees_team: bool) -> None:
        self.ticks = ticks
        self.net = CarNet(shape, N_ACTIONS)
        self.plays = masked_actor(self.net)
        critic = TensorDictModule(
            TeamNet(shape) if sees_team else CarNet(shape, 1), in_keys=[OBSERVATION, MASK], out_keys=[VALUE]
        )
        self.modules = self.loss = ClipPPOLoss(
            self.plays, critic, clip_epsilon=CLIP, entropy_coeff=ENTROPY, critic_coeff=CRITIC
        )
        of_cars = {key: ("agents", key) for key in ("reward", "done", "terminated")}
        self.loss.set_keys(action=ACTION, value=VALUE, **of_cars)
        self.loss.make_value_estimator(ValueEstimators.GAE, gamma=GAMMA, lmbda=LAMBDA, deactivate_vmap=True)
        self.optimizer = torch.optim.Adam(self.loss.parameters(), LEARNING_RATE)

    def update(self, rollout: TensorDictBase) -> None:
        """Learn from each tick EPOCHS times."""
        n_cars = rollout[ACTION].shape[-1]
        for key in ("reward", "done", "terminated"):
            of_team = rollout["next", key].unsqueeze(-2)
            rollout["next", "agents", key] = of_team.expand(*rollout.shape, n_cars, 1).contiguous()
        with torch.no_grad():
            self.loss.value_estimator(rollout)
        advantage = rollout["advantage"]
        rollout["advantage"] = (advantage - advantage.mean()) / advantage.std().clamp(min=MIN_ADVANTAGE_STD)
        played = rollout.reshape(-1)
        for _ in range(EPOCHS):
            for some in torch.randperm(len(played)).chunk(MINIBATCHES):
                losses = self.loss(played[some])
                self.optimizer.zero_grad()
                (losses["loss_objective"] + losses["loss_critic"] + losses["loss_entropy"]).backward()
                nn.utils.clip_grad_norm_(self.loss.parameters(), MAX_GRADIENT)
                self.optimizer.step()

    def state(self) -> dict[str, Any]:
        """Return weights and the optimiser's averages."""
        return {"modules": self.loss.state_dict(), "optimizer": self.optimizer.state_dict()}

    def restore(self, state: dict[str, Any]) -> None:
        """Take them over, once all of them are checked."""
        modules = module_state(state, "modules", self.loss)
        optimizer = adam_state(state, self.optimizer)
        self.loss.load_state_dict(modules)
        self.optimizer.load_state_dict(optimizer)
