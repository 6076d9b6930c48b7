"""COMA and QTRAN against known answers."""

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import nn
from torchrl.modules import ProbabilisticActor, QMixer, QValueModule
from torchrl.modules.models.multiagent import VDNMixer
from torchrl.objectives.multiagent import QMixerLoss

from craftsim.training.coma import RETURN, COMALoss
from craftsim.training.networks import ACTION, OBSERVATION
from craftsim.training.qtran import QTRANLoss
from craftsim.training.settings import COMASettings
from craftsim.training.team_networks import JOINT, REST, VALUE

PAYOFF = torch.tensor([[8.0, -12.0, -12.0], [-12.0, 0.0, 0.0], [-12.0, 0.0, 0.0]])
"""Son et al., table 1a: the best joint action is the first of both."""
CHOSEN = ("agents", "chosen_action_value")


class _Table(nn.Module):
    """Numbers that nothing observed changes."""

    def __init__(self, *shape):
        super().__init__()
        self.numbers = nn.Parameter(torch.zeros(shape))

    def forward(self, observation):
        return self.numbers.expand(len(observation), *self.numbers.shape)


class _Joint(nn.Module):
    def __init__(self):
        super().__init__()
        self.table, self.rest = nn.Parameter(torch.zeros(3, 3)), nn.Parameter(torch.zeros(1))

    def forward(self, observation, action):
        return self.table[action[:, 0], action[:, 1]].unsqueeze(-1), self.rest.expand(len(action), 1)


class _Mixed(nn.Module):
    """QMIX's mixer in the only state there is."""

    def __init__(self):
        super().__init__()
        self.mixer = QMixer((1,), 8, 2, "cpu")

    def forward(self, chosen):
        return self.mixer(chosen, torch.ones(len(chosen), 1))


def _every_joint_action():
    actions = torch.cartesian_prod(torch.arange(3), torch.arange(3))
    seen = TensorDict({"agents": {"observation": torch.zeros(9, 2, 1)}}, [9])
    after = seen.clone().update({"reward": PAYOFF[actions[:, 0], actions[:, 1]].unsqueeze(-1)})
    after.update({key: torch.ones(9, 1, dtype=torch.bool) for key in ("done", "terminated")})
    return seen.update({"next": after}).set(ACTION, actions)


def _greedy(algo):
    """Return the joint action that is best by the cars' values, all joint actions having been seen alike often."""
    torch.manual_seed(0)
    table = _Table(2, 3)
    outputs = {"out_keys": [ACTION, VALUE, CHOSEN], "action_space": "categorical"}
    values = TensorDictSequential(
        TensorDictModule(table, in_keys=[OBSERVATION], out_keys=[VALUE]),
        QValueModule(action_value_key=VALUE, **outputs),
    )
    if algo == "qtran":
        team = TensorDictModule(_Joint(), in_keys=[OBSERVATION, ACTION], out_keys=[JOINT, REST])
        loss = QTRANLoss(values, team, 0.99)
    else:
        mixer = _Mixed() if algo == "qmix" else VDNMixer(2, "cpu")
        mix = TensorDictModule(mixer, in_keys=[CHOSEN], out_keys=["chosen_action_value"])
        loss = QMixerLoss(values, mix, action_space="categorical", delay_value=True)
        loss.set_keys(action=ACTION, action_value=VALUE, local_value=CHOSEN)
        loss.make_value_estimator(gamma=0.99)
    optimizer = torch.optim.Adam(loss.parameters(), 0.1)
    played = _every_joint_action()
    for _ in range(300):
        optimizer.zero_grad()
        loss(played.clone())["loss"].backward()
        optimizer.step()
    parameters = loss.values_params if algo == "qtran" else loss.local_value_network_params
    return tuple(next(iter(parameters.values(True, True))).detach().argmax(-1).tolist())


@pytest.mark.parametrize(("algo", "finds"), [("vdn", False), ("qmix", False), ("qtran", True)])
def test_only_qtran_finds_the_best_joint_action_where_it_does_not_pay_alone(algo, finds):
    assert (_greedy(algo) == (0, 0)) is finds


def test_the_gradient_of_coma_is_that_of_its_formula():
    torch.manual_seed(1)
    n, n_actions, ticks = 2, 4, 5
    logits = _Table(n, n_actions)
    nn.init.normal_(logits.numbers)
    critic = _Table(n, n_actions)
    nn.init.normal_(critic.numbers)
    actor = ProbabilisticActor(
        TensorDictModule(logits, in_keys=[OBSERVATION], out_keys=[("agents", "logits")]),
        in_keys={"logits": ("agents", "logits")},
        out_keys=[ACTION],
        distribution_class=torch.distributions.Categorical,
    )
    loss = COMALoss(
        actor, TensorDictModule(critic, in_keys=[OBSERVATION], out_keys=[VALUE]), COMASettings(entropy=0.0)
    )
    action = torch.randint(n_actions, (ticks, n))
    played = TensorDict({"agents": {"observation": torch.zeros(ticks, n, 1)}}, [ticks])
    played.set(ACTION, action).set(RETURN, torch.zeros(ticks, n, 1))
    loss(played)["loss_objective"].backward()
    found = next(iter(loss.actor_params.values(True, True))).grad

    policy, values = logits.numbers.detach().softmax(-1), critic.numbers.detach()
    expected = torch.zeros(n, n_actions)
    for did in action:
        for car, own in enumerate(did):
            advantage = values[car, own] - policy[car] @ values[car]
            score = nn.functional.one_hot(own, n_actions) - policy[car]  # the gradient of log pi
            expected[car] -= advantage * score / (ticks * n)
    assert torch.allclose(found, expected, atol=1e-6)
