"""The Gymnasium form: one agent chooses the actions of all cars."""

from __future__ import annotations

from itertools import chain
from typing import Any, Final

import gymnasium
import numpy as np
from numpy.typing import NDArray

from craftsim.envs.observations import Observation
from craftsim.envs.options import Options
from craftsim.envs.single_world import SingleWorld
from craftsim.envs.spaces import central_space, joint_action_space
from craftsim.errors import InputError
from craftsim.tasks import Task

OF_WORLD: Final = ("success", "duration_s", "problems", "deadlock")
"""Infos that a world has one of; of the others it has one per car."""


class CentralConstruction(SingleWorld, gymnasium.Env[Any, NDArray[np.int64]]):
    """A task for one agent that sees the global state and chooses an action for every car."""

    def __init__(self, task: Task | str, render_mode: Any = None, **options: Any) -> None:
        """Prepare a task; ``options`` are the fields of :class:`craftsim.envs.options.Options`, ``observe`` aside.

        Raises InputError for a task, an option or an option value that there is not.
        """
        chosen = Options(render_mode=render_mode, **options)
        if chosen.observe is not None:
            raise InputError(
                "'observe' is what single cars observe, in the PettingZoo forms; "
                "here wrap the environment in gymnasium.wrappers.TransformObservation"
            )
        super().__init__(task, chosen)
        self.observation_space = central_space(self.core.task, chosen, self.core.form)
        self.action_space = joint_action_space(self.core.task, self.core.form.n_actions)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode; see :meth:`craftsim.envs.core.Core.reset` for the options."""
        infos = self.core.reset(seed, options)
        super().reset(seed=seed)
        return self._observe(), self._info(infos)

    def step(
        self, action: NDArray[np.int64]
    ) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Let all cars act once; ``action`` (n,) by car. Infos are those of the cars, each a tuple by car.

        Raises InputError where no episode runs, and for actions of another shape or that are no numbers from 0 to 14.
        """
        reward, terminated, truncated, infos = self.core.step(action)
        return self._observe(), reward, terminated, truncated, self._info(infos)

    def _info(self, infos: list[dict[str, Any]]) -> dict[str, Any]:
        """Return the infos of the cars as one: each a tuple by car, masks as an array, those of the world once."""
        # In asynchronous execution a car has some keys only after its first action.
        keys = dict.fromkeys(chain.from_iterable(infos))
        info: dict[str, Any] = {}
        for key in keys:
            info[key] = tuple(of_car.get(key) for of_car in infos)
        info["action_mask"] = self.core.masks.copy()
        for key in keys.keys() & set(OF_WORLD):
            info[key] = info[key][0]
        return info

    def action_masks(self) -> NDArray[np.bool_]:
        """Return the offered actions, shape (n * actions,): the masks of the cars one after the other, as MaskablePPO
        of sb3-contrib asks for them."""
        return self.core.masks.astype(np.bool_).ravel()

    def _observe(self) -> Observation:
        observation = {key: array.copy() for key, array in self.core.seen.items()}
        images = self.core.options.images
        if images is None:
            return observation
        return observation | images.of_all(self.core.images)
