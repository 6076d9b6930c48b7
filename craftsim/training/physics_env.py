"""A batch of worlds in contact physics as a TorchRL environment."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase

from craftsim.discrete.kernel.tasks import ROW
from craftsim.discrete.tasks import Task
from craftsim.discrete.tasks.observation import car_vectors
from craftsim.envs.vector import PhysicsVectorEnv
from craftsim.training.grid_env import TeamEnv


class PhysicsEnv(TeamEnv):
    """Worlds in physics, spread over worker processes; none of their numbers depends on how many there are."""

    def __init__(self, task: Task, n_worlds: int, **options: Any) -> None:
        """Prepare; options are those of :class:`craftsim.envs.vector.PhysicsVectorEnv`."""
        super().__init__(task, n_worlds)
        self.worlds = PhysicsVectorEnv(task, n_worlds, **options)
        self._next_seed: int | None = None
        self._masks: NDArray[np.bool_]

    def _now(self) -> TensorDict:
        return self._seen(self.worlds.car_vectors(), self._masks)

    def _reset(self, tensordict: TensorDictBase | None = None, **_: Any) -> TensorDict:
        # A world whose episode has ended stands at the start of the next one already.
        if tensordict is None or tensordict.get("_reset", None) is None:
            observation, _infos = self.worlds.reset(seed=self._next_seed)
            self._next_seed = None
            self._masks = observation["action_mask"] != 0
        return self._now()

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        observation, reward, terminated, truncated, infos = self.worlds.step(
            tensordict["agents", "action"].numpy()
        )
        self._masks = observation["action_mask"] != 0
        vectors, masks = self.worlds.car_vectors(), self._masks.copy()
        for world in np.flatnonzero(terminated | truncated):
            last = infos["final_obs"][world]
            rows = last["observation"].reshape(1, -1, ROW)
            vectors[world] = car_vectors(rows, masks.shape[1])[0]
            masks[world] = last["action_mask"] != 0
        return self._with_outcome(self._seen(vectors, masks), reward, terminated, truncated)

    def _set_seed(self, seed: int | None) -> None:
        self._next_seed = seed

    def close(self, *, raise_if_closed: bool = True) -> None:
        """End the processes."""
        self.worlds.close()
        super().close(raise_if_closed=raise_if_closed)
