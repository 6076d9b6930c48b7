"""QTRAN-base, after Son et al., "QTRAN: Learning to factorize with transformation", ICML 2019.

TorchRL has no such loss; this one takes the parts that its others take.
"""

from __future__ import annotations

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase, TensorDictParams
from torch.nn.functional import mse_loss
from torchrl.objectives import LossModule

from craftsim.training.networks import ACTION
from craftsim.training.team_networks import JOINT, REST, VALUE


class QTRANLoss(LossModule):
    """Learns the team's value of joint actions, and cars' values whose sum is highest where the team's is.

    That holds of any team's value, whereas VDN and QMIX find it only where the team's rises with each car's.

    Args:
        values: from what is observed to ``VALUE`` (..., n, n_actions), and the best action of each car as ``ACTION``.
        team: from what is observed and ``ACTION`` to the team's value ``JOINT`` (..., 1), and to ``REST`` (..., 1), by
            which the sum of the cars' values falls short of it.
        gamma: the discount.
    """

    values: TensorDictModuleBase
    values_params: TensorDictParams
    target_values_params: TensorDictParams
    team: TensorDictModuleBase
    team_params: TensorDictParams
    target_team_params: TensorDictParams

    def __init__(self, values: TensorDictModuleBase, team: TensorDictModuleBase, gamma: float) -> None:
        super().__init__()
        self.gamma = gamma
        self.convert_to_functional(values, "values", create_target_params=True)
        self.convert_to_functional(team, "team", create_target_params=True)

    def forward(self, tensordict: TensorDictBase) -> TensorDict:
        """Return ``loss``, the sum of the paper's three, of ticks (B,)."""
        seen = tensordict.clone(False)
        with self.values_params.to_module(self.values):
            greedy = self.values(tensordict.clone(False))
        own = greedy[VALUE].gather(-1, tensordict[ACTION].unsqueeze(-1)).sum(-2)
        best = greedy[VALUE].gather(-1, greedy[ACTION].unsqueeze(-1)).sum(-2)
        with self.team_params.to_module(self.team):
            played = self.team(seen)
            with torch.no_grad():
                joint_best = self.team(greedy.select(*self.team.in_keys))[JOINT]
        short = played[REST] - played[JOINT].detach()
        optimal = (best + played[REST] - joint_best).square().mean()
        other = (own + short).clamp(max=0.0).square().mean()
        return TensorDict({"loss": mse_loss(played[JOINT], self._target(tensordict)) + optimal + other})

    @torch.no_grad()
    def _target(self, tensordict: TensorDictBase) -> torch.Tensor:
        after = tensordict["next"].clone(False)
        with self.target_values_params.to_module(self.values):
            after = self.values(after)
        with self.target_team_params.to_module(self.team):
            follows: torch.Tensor = self.team(after)[JOINT]
        goes_on = (~tensordict["next", "terminated"]).to(follows.dtype)
        reward: torch.Tensor = tensordict["next", "reward"]
        return reward + self.gamma * goes_on * follows
