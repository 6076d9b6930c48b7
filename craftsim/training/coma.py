"""COMA: each car is judged by what the team would have got had it acted otherwise.

After Foerster et al., "Counterfactual multi-agent policy gradients", AAAI 2018. TorchRL has no such loss; this one
takes the parts that its others take.
"""

from __future__ import annotations

from typing import Any, Final

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictModuleBase, TensorDictParams
from torch import nn
from torch.nn.functional import mse_loss
from torchrl.modules import ProbabilisticActor
from torchrl.objectives import LossModule, SoftUpdate
from torchrl.objectives.value.functional import vec_td_lambda_return_estimate

from craftsim.training.learner import Learner
from craftsim.training.networks import ACTION, MASK, OBSERVATION, CarNet
from craftsim.training.restoring import restore_adam, restore_module
from craftsim.training.settings import COMASettings
from craftsim.training.shape import Shape
from craftsim.training.team_networks import VALUE, OthersNet, masked_actor

RETURN: Final = ("agents", "value_target")


class COMALoss(LossModule):
    """The policy gradient with counterfactual advantages, and the critic's error.

    Args:
        actor: from what is observed to a distribution of ``ACTION``.
        critic: from what is observed and ``ACTION`` to ``VALUE`` (..., n, n_actions): what the team gets for each
            action of a car, all others acting as they did.
        settings: discount, lambda and the weight of the policy's entropy.
    """

    actor: ProbabilisticActor
    actor_params: TensorDictParams
    target_actor_params: TensorDictParams
    critic: TensorDictModuleBase
    critic_params: TensorDictParams
    target_critic_params: TensorDictParams

    def __init__(
        self, actor: ProbabilisticActor, critic: TensorDictModuleBase, settings: COMASettings
    ) -> None:
        super().__init__()
        self.settings = settings
        self.convert_to_functional(actor, "actor", create_target_params=False)
        self.convert_to_functional(critic, "critic", create_target_params=True)

    def forward(self, tensordict: TensorDictBase) -> TensorDict:
        """Return ``loss_objective``, ``loss_critic`` and ``loss_entropy`` of ticks (B,) with ``RETURN`` (B, n, 1)."""
        with self.actor_params.to_module(self.actor):
            choice = self.actor.get_dist(tensordict.clone(False))
        with self.critic_params.to_module(self.critic):
            values = self.critic(tensordict.clone(False))[VALUE]
        action = tensordict[ACTION]
        taken = values.gather(-1, action.unsqueeze(-1))
        advantage = (taken - (choice.probs * values).sum(-1, keepdim=True)).detach().squeeze(-1)
        return TensorDict(
            {
                "loss_objective": -(choice.log_prob(action) * advantage).mean(),
                "loss_critic": mse_loss(taken, tensordict[RETURN]),
                "loss_entropy": -self.settings.entropy * choice.entropy().mean(),
            }
        )

    @torch.no_grad()
    def returns(self, rollout: TensorDictBase) -> torch.Tensor:
        """Return (B, ticks, n, 1): TD(lambda) of the target critic; an episode that ran out of time is over, too."""
        with self.target_critic_params.to_module(self.critic):
            values = self.critic(rollout.select(*self.critic.in_keys))[VALUE]
        taken = values.gather(-1, rollout[ACTION].unsqueeze(-1)).transpose(1, 2)
        follows = torch.cat([taken[:, :, 1:], taken[:, :, -1:]], 2)
        reward, done = (
            rollout["next", key].unsqueeze(1).expand_as(taken).contiguous() for key in ("reward", "done")
        )
        found: torch.Tensor = vec_td_lambda_return_estimate(
            *(self.settings.gamma, self.settings.td_lambda, follows, reward, done, done)
        )
        return found.transpose(1, 2)


class COMALearner(Learner):
    """One pass over each rollout, whose actions are those of the policy that learns from them."""

    def __init__(self, shape: Shape, ticks: int, settings: COMASettings) -> None:
        self.settings = settings
        self.ticks = ticks
        self.net = CarNet(shape)
        self.plays = masked_actor(self.net)
        critic = TensorDictModule(OthersNet(shape), in_keys=[OBSERVATION, MASK, ACTION], out_keys=[VALUE])
        self.modules = self.loss = COMALoss(self.plays, critic, settings)
        self.targets = SoftUpdate(self.loss, tau=settings.target_rate)
        self.optimizer = torch.optim.Adam(self.loss.parameters(), settings.learning_rate)

    def update(self, rollout: TensorDictBase) -> None:
        """Learn from each tick once."""
        rollout[RETURN] = self.loss.returns(rollout)
        played = rollout.reshape(-1)
        for some in torch.randperm(len(played)).chunk(self.settings.minibatches):
            losses = self.loss(played[some])
            self.optimizer.zero_grad()
            (losses["loss_objective"] + losses["loss_critic"] + losses["loss_entropy"]).backward()
            nn.utils.clip_grad_norm_(self.loss.parameters(), self.settings.max_gradient)
            self.optimizer.step()
            self.targets.step()

    def state(self) -> dict[str, Any]:
        """Return weights and the optimiser's averages."""
        return {"modules": self.loss.state_dict(), "optimizer": self.optimizer.state_dict()}

    def restore(self, state: dict[str, Any]) -> None:
        """Take them over."""
        restore_module(self.loss, state["modules"])
        restore_adam(self.optimizer, state["optimizer"])
