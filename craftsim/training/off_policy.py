"""Independent Q-learning, VDN and QMIX: TorchRL's losses and mixers on a replay buffer."""

from __future__ import annotations

from typing import Any, Final

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import nn
from torchrl.data import Categorical, LazyTensorStorage, TensorDictReplayBuffer
from torchrl.modules import EGreedyModule, QValueModule
from torchrl.modules.models.multiagent import VDNMixer
from torchrl.objectives import DQNLoss, SoftUpdate
from torchrl.objectives.multiagent import QMixerLoss

from craftsim.discrete.rules.legality import N_ACTIONS
from craftsim.training.config import AlgoName
from craftsim.training.features import Shape
from craftsim.training.learner import Learner
from craftsim.training.networks import ACTION, MASK, OBSERVATION, CarNet, StateQMixer

GAMMA: Final = 0.99
LEARNING_RATE: Final = 5e-4
MAX_GRADIENT: Final = 10.0
BUFFER: Final = 50_000
"""Ticks that are remembered."""
BATCH: Final = 512
LEARNS_EVERY: Final = 128
"""Ticks played for each batch learnt from."""
TARGET_RATE: Final = 0.01
EPSILON: Final = (1.0, 0.03)
EPSILON_TICKS: Final = 300_000
"""After how many ticks the part of random actions has come down from the first to the last EPSILON."""

VALUE: Final = ("agents", "action_value")
CHOSEN: Final = ("agents", "chosen_action_value")


class QLearner(Learner):
    """Learns the value of each action of a car: alone (iql), or such that the cars' values mix to the team's."""

    def __init__(self, shape: Shape, ticks: int, algo: AlgoName) -> None:
        self.ticks = ticks
        self.of_team = algo != "iql"
        self.net = CarNet(shape, N_ACTIONS)
        values = TensorDictSequential(
            TensorDictModule(self.net, in_keys=[OBSERVATION, MASK], out_keys=[VALUE]),
            QValueModule(
                action_value_key=VALUE,
                action_mask_key=MASK,
                out_keys=[ACTION, VALUE, CHOSEN],
                action_space="categorical",
            ),
        )
        if self.of_team:
            mixer = StateQMixer(shape) if algo == "qmix" else VDNMixer(shape.n_cars, "cpu")
            sees = [CHOSEN, OBSERVATION, MASK] if algo == "qmix" else [CHOSEN]
            mix = TensorDictModule(mixer, in_keys=sees, out_keys=["chosen_action_value"])
            self.loss = QMixerLoss(values, mix, action_space="categorical", delay_value=True)
        else:
            self.loss = DQNLoss(values, action_space="categorical", delay_value=True)
            of_cars = {key: ("agents", key) for key in ("reward", "done", "terminated")}
            self.loss.set_keys(action=ACTION, action_value=VALUE, value=CHOSEN, **of_cars)
        self.loss.make_value_estimator(gamma=GAMMA)
        self.modules = self.loss
        self.targets = SoftUpdate(self.loss, tau=TARGET_RATE)
        self.explores = EGreedyModule(
            Categorical(
                N_ACTIONS, (shape.n_cars,), mask=torch.ones(shape.n_cars, N_ACTIONS, dtype=torch.bool)
            ),
            *EPSILON,
            annealing_num_steps=EPSILON_TICKS,
            action_key=ACTION,
            action_mask_key=MASK,
        )
        self.plays = TensorDictSequential(values, self.explores)
        self.optimizer = torch.optim.Adam(self.loss.parameters(), LEARNING_RATE)
        self.buffer = TensorDictReplayBuffer(storage=LazyTensorStorage(BUFFER), batch_size=BATCH)

    def update(self, rollout: TensorDictBase) -> None:
        """Remember what was played and learn from batches of what is remembered."""
        n_cars = rollout[ACTION].shape[-1]
        played = rollout.select(
            OBSERVATION,
            MASK,
            ACTION,
            *(("next", key) for key in (OBSERVATION, MASK, "reward", "done", "terminated")),
        ).reshape(-1)
        if not self.of_team:
            for key in ("reward", "done", "terminated"):
                of_team = played["next", key].unsqueeze(-2)
                played["next", "agents", key] = of_team.expand(-1, n_cars, 1).contiguous()
        self.buffer.extend(played)
        self.explores.step(len(played))
        for _ in range(-(-len(played) // LEARNS_EVERY)):
            loss = self.loss(self.buffer.sample())["loss"]
            self.optimizer.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(self.loss.parameters(), MAX_GRADIENT)
            self.optimizer.step()
            self.targets.step()

    def state(self) -> dict[str, Any]:
        """Return weights, the optimiser's averages, the part of random actions, and what is remembered."""
        return {
            "modules": self.loss.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "epsilon": self.explores.state_dict(),
            "buffer": self.buffer.state_dict(),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Take them over."""
        self.loss.load_state_dict(state["modules"])
        self.optimizer.load_state_dict(state["optimizer"])
        self.explores.load_state_dict(state["epsilon"])
        self.buffer.load_state_dict(state["buffer"])
