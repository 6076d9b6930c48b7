"""A batch of worlds as a TorchRL environment: what all have in common, and those on the grid."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Categorical, Composite, Unbounded
from torchrl.envs import EnvBase

from craftsim.discrete.kernel.codes import N_ACTIONS
from craftsim.discrete.rules import RuleSet
from craftsim.discrete.tasks import Task
from craftsim.discrete.tasks.episodes import Episodes


class TeamEnv(EnvBase):
    """B worlds of one task; batch size (B,).

    Keys, with n cars: ``("agents", "observation")`` (B, n, vector_length), ``("agents", "action_mask")`` (B, n, 15)
    where a car without a legal action is offered STOP, ``("agents", "action")`` (B, n), and, one for the team,
    ``reward`` (B, 1), ``terminated`` (success), ``truncated`` (out of time) and ``done``.
    """

    batch_locked = True

    def __init__(self, task: Task, n_worlds: int) -> None:
        super().__init__(device="cpu", batch_size=[n_worlds])
        layout = task.layout
        one, cars = (n_worlds, 1), (n_worlds, layout.n_cars)
        self.observation_spec = Composite(
            agents=Composite(
                observation=Unbounded((*cars, layout.vector_length), dtype=torch.int16),
                action_mask=Binary(N_ACTIONS, (*cars, N_ACTIONS), dtype=torch.bool),
                shape=cars,
            ),
            shape=(n_worlds,),
        )
        self.action_spec = Composite(
            agents=Composite(action=Categorical(N_ACTIONS, cars), shape=cars), shape=(n_worlds,)
        )
        self.reward_spec = Unbounded(one)
        flags = {key: Binary(1, one, dtype=torch.bool) for key in ("done", "terminated", "truncated")}
        self.done_spec = Composite(**flags, shape=(n_worlds,))

    def _seen(self, vectors: NDArray[np.integer], masks: NDArray[np.bool_]) -> TensorDict:
        """Return what is seen; ``vectors`` (B, n, vector_length) and ``masks`` (B, n, 15)."""
        cars = TensorDict(
            {
                "observation": torch.from_numpy(vectors.astype(np.int16)),
                "action_mask": torch.from_numpy(masks),
            },
            masks.shape[:2],
        )
        return TensorDict({"agents": cars}, self.batch_size)

    @staticmethod
    def _with_outcome(
        seen: TensorDict,
        reward: NDArray[np.float64],
        terminated: NDArray[np.bool_],
        truncated: NDArray[np.bool_],
    ) -> TensorDict:
        columns = {
            "reward": reward.astype(np.float32),
            "done": terminated | truncated,
            "terminated": terminated,
            "truncated": truncated,
        }
        return seen.update({key: torch.from_numpy(value)[:, None] for key, value in columns.items()})


class GridEnv(TeamEnv):
    """Worlds on the grid, stepped in one array call."""

    def __init__(
        self, task: Task, n_worlds: int, rules: RuleSet = "physical", helper_depth: int | None = None
    ) -> None:
        super().__init__(task, n_worlds)
        self.episodes = Episodes(task, np.random.default_rng(), n_worlds, rules, helper_depth)

    def _now(self) -> TensorDict:
        return self._seen(self.episodes.vectors(), self.episodes.offered())

    def _reset(self, tensordict: TensorDictBase | None = None, **_: Any) -> TensorDict:
        which = None if tensordict is None else tensordict.get("_reset", None)
        self.episodes.reset(None if which is None else which.squeeze(-1).numpy().nonzero()[0])
        return self._now()

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        steps = self.episodes.step(tensordict["agents", "action"].numpy())
        # New arrays: one of the episodes must not change in what was collected.
        return self._with_outcome(
            self._now(), steps.reward, steps.success & steps.done, steps.done & ~steps.success
        )

    def _set_seed(self, seed: int | None) -> None:
        self.episodes.rng = np.random.default_rng(seed)
