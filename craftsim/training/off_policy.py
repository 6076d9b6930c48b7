"""Independent Q-learning, VDN, QMIX and QTRAN on a replay buffer: TorchRL's losses and mixers, and QTRAN's own."""

from __future__ import annotations

from typing import Any, Final

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import nn
from torchrl.data import Categorical, LazyTensorStorage, TensorDictReplayBuffer
from torchrl.modules import EGreedyModule, QValueModule
from torchrl.modules.models.multiagent import VDNMixer
from torchrl.objectives import DQNLoss, LossModule, SoftUpdate
from torchrl.objectives.multiagent import QMixerLoss

from craftsim.discrete.kernel.codes import N_ACTIONS
from craftsim.errors import InputError
from craftsim.training.config import AlgoName
from craftsim.training.learner import Learner
from craftsim.training.networks import ACTION, MASK, OBSERVATION, CarNet, StateQMixer
from craftsim.training.qtran import QTRANLoss
from craftsim.training.restoring import numbers, restore_adam, restore_module
from craftsim.training.settings import QSettings
from craftsim.training.shape import Shape
from craftsim.training.team_networks import JOINT, REST, VALUE, JointNet

BUFFER: Final = 50_000
"""Ticks that are remembered."""

CHOSEN: Final = ("agents", "chosen_action_value")

_Columns = dict[str, tuple[tuple[int, ...], torch.dtype]]


class QLearner(Learner):
    """Learns the value of each action of a car: alone (iql), or such that the cars' values mix to the team's."""

    def __init__(self, shape: Shape, ticks: int, algo: AlgoName, settings: QSettings) -> None:
        self.settings = settings
        self.ticks = ticks
        self.shape = shape
        self.of_team = algo != "iql"
        self.net = CarNet(shape)
        values = TensorDictSequential(
            TensorDictModule(self.net, in_keys=[OBSERVATION, MASK], out_keys=[VALUE]),
            QValueModule(
                action_value_key=VALUE,
                action_mask_key=MASK,
                out_keys=[ACTION, VALUE, CHOSEN],
                action_space="categorical",
            ),
        )
        self.loss: LossModule
        if algo == "qtran":
            sees = [OBSERVATION, MASK, ACTION]
            team = TensorDictModule(JointNet(shape), in_keys=sees, out_keys=[JOINT, REST])
            self.loss = QTRANLoss(values, team, settings.gamma)
        elif self.of_team:
            mixer = StateQMixer(shape) if algo == "qmix" else VDNMixer(shape.n_cars, "cpu")
            sees = [CHOSEN, OBSERVATION, MASK] if algo == "qmix" else [CHOSEN]
            mix = TensorDictModule(mixer, in_keys=sees, out_keys=["chosen_action_value"])
            self.loss = QMixerLoss(values, mix, action_space="categorical", delay_value=True)
        else:
            self.loss = DQNLoss(values, action_space="categorical", delay_value=True)
            of_cars = {key: ("agents", key) for key in ("reward", "done", "terminated")}
            self.loss.set_keys(action=ACTION, action_value=VALUE, value=CHOSEN, **of_cars)
        if algo != "qtran":
            self.loss.make_value_estimator(gamma=settings.gamma)
        self.modules = self.loss
        self.targets = SoftUpdate(self.loss, tau=settings.target_rate)
        self.explores = EGreedyModule(
            Categorical(
                N_ACTIONS, (shape.n_cars,), mask=torch.ones(shape.n_cars, N_ACTIONS, dtype=torch.bool)
            ),
            settings.epsilon_start,
            settings.epsilon_end,
            annealing_num_steps=settings.epsilon_ticks,
            action_key=ACTION,
            action_mask_key=MASK,
        )
        self.plays = TensorDictSequential(values, self.explores)
        self.optimizer = torch.optim.Adam(self.loss.parameters(), settings.learning_rate)
        self.buffer = TensorDictReplayBuffer(storage=LazyTensorStorage(BUFFER), batch_size=settings.batch)

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
        for _ in range(-(-len(played) // self.settings.learns_every)):
            loss = self.loss(self.buffer.sample())["loss"]
            self.optimizer.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(self.loss.parameters(), self.settings.max_gradient)
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
        restore_module(self.loss, state["modules"])
        restore_adam(self.optimizer, state["optimizer"])
        epsilon = self.explores.state_dict()
        low, high = float(epsilon["eps_end"]), float(epsilon["eps_init"])
        epsilon["eps"] = numbers(state["epsilon"]["eps"], "eps", epsilon["eps"], low, high)
        self.explores.load_state_dict(epsilon)
        remembered, cursors = self._remembered(state["buffer"])
        if remembered is not None:
            self.buffer.extend(remembered)
        self.buffer.load_state_dict(self.buffer.state_dict() | {"_writer": cursors})

    def _remembered(self, saved: dict[str, Any]) -> tuple[TensorDict | None, dict[str, int]]:
        """Return what was played, each index and number in it within bounds, and where the next tick is written."""
        storage, writer = saved["_storage"], saved["_writer"]
        n, at, total = storage["_len"], writer["_cursor"], writer["_write_count"]
        if not (type(n) is type(at) is type(total) is int and 0 <= n <= BUFFER and 0 <= at < BUFFER):
            raise InputError(f"it remembers {str(n)[:40]} ticks; allowed: 0 to {BUFFER}")
        if not 0 <= total < 2**60 or (n < BUFFER and at != n):
            raise InputError(f"it remembers {n} ticks, but goes on at {at}")
        cursors = {"_cursor": at, "_write_count": total}
        if n == 0:
            return None, cursors
        rows: dict[str, torch.Tensor] = {}
        for key, (shape, dtype) in self._columns().items():
            like = torch.empty((n, *shape), dtype=dtype, device="meta")
            rows[key] = column = numbers(
                storage["_storage"][key][:n],
                key,
                like,
                *((0, N_ACTIONS - 1) if key.endswith("action") else ()),
            )
            places = (
                self.net.encoder.places(some) for some in column.split(1024) if key.endswith("observation")
            )
            if not all(int(p.min()) >= 0 and int(p.max()) <= self.net.encoder.absent for p in places):
                raise InputError(f"'{key}' of what it remembers holds what no tick has")
        return _nested(rows, "", n, self.shape.n_cars), cursors

    def _columns(self) -> _Columns:
        """Return shape and type of what is remembered of a tick."""
        n, length = self.shape.n_cars, self.shape.vector_length
        seen: _Columns = {
            "agents.observation": ((n, length), torch.int16),
            "agents.action_mask": ((n, N_ACTIONS), torch.bool),
        }
        told = {"reward": torch.float32, "done": torch.bool, "terminated": torch.bool}
        team: _Columns = {key: ((1,), dtype) for key, dtype in told.items()}
        cars: _Columns = {f"agents.{key}": ((n, 1), dtype) for key, dtype in told.items()}
        after = seen | team | ({} if self.of_team else cars)
        return (
            seen | {"agents.action": ((n,), torch.int64)} | {f"next.{key}": of for key, of in after.items()}
        )


def _nested(rows: dict[str, torch.Tensor], prefix: str, n: int, n_cars: int) -> TensorDict:
    """Return columns, named with dots, as they came from a rollout of n ticks."""
    here = {key.removeprefix(prefix): column for key, column in rows.items() if key.startswith(prefix)}
    inner = {key.partition(".")[0]: None for key in here if "." in key}
    content = {key: column for key, column in here.items() if "." not in key}
    parts = {key: _nested(here, f"{key}.", n, n_cars) for key in inner}
    return TensorDict(content | parts, (n, n_cars) if prefix == "agents." else (n,))
