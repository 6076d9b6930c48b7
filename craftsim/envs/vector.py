"""The Gymnasium form for batches: many grid worlds of one task, all advanced in one array call."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from craftsim.discrete.kinds import Action
from craftsim.discrete.own_actions import as_own
from craftsim.discrete.rules import RuleSet
from craftsim.discrete.schedule import tick_durations
from craftsim.discrete.tasks import Task, as_task
from craftsim.discrete.tasks.episodes import Episodes
from craftsim.discrete.tasks.observation import car_vectors
from craftsim.envs.actions import checked, illegal, numbers_of
from craftsim.envs.images import Images
from craftsim.envs.options import Options
from craftsim.envs.spaces import central_space, joint_action_space
from craftsim.errors import InputError

Observation = dict[str, NDArray[Any]]
Bools = NDArray[np.bool_]


class TaskVectorEnv(VectorEnv[Observation, NDArray[np.integer], NDArray[Any]]):
    """B worlds of one task, in whatever they are simulated: the spaces, and how episodes follow each other.

    One who sees a world's global state chooses an action for each of its cars. A world whose episode ends is reset in
    the same step: the observation returned is the new episode's first, and the old one's last is in
    ``infos["final_obs"]``.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 (as Gymnasium declares it)
        "autoreset_mode": AutoresetMode.SAME_STEP,
        "render_modes": [],
    }

    def __init__(
        self, task: Task | str, num_envs: int, images: Images | None = None, own: Sequence[Action] = ()
    ) -> None:
        """Make the spaces; raises InputError for a task that there is not and for a number that is none."""
        if not isinstance(num_envs, int) or num_envs < 1:
            raise InputError(f"num_envs is {num_envs}; allowed: 1 or more")
        self.task = as_task(task)
        self.num_envs = num_envs
        self.own, self.n_actions = tuple(own), len(Action) + len(own)
        """The registered actions that are offered, and how many there are with the 15."""
        self.single_observation_space = central_space(self.task, images, self.n_actions)
        self.single_action_space = joint_action_space(self.task, self.n_actions)
        self._masks = np.zeros((num_envs, self.task.layout.n_cars, self.n_actions), np.int8)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)

    def action_masks(self) -> NDArray[np.bool_]:
        """Return what is offered now, (B, n * actions), as :meth:`CentralConstruction.action_masks` does of a world."""
        return self._masks.astype(np.bool_).reshape(self.num_envs, -1)


class GridVectorEnv(TaskVectorEnv):
    """B grid worlds of one task; :meth:`car_vectors` is what the single cars observe."""

    def __init__(
        self,
        task: Task | str,
        num_envs: int = 1,
        *,
        rule_set: RuleSet = "physical",
        helper_depth: int | None = None,
        time_weight: float = 0.0,
        actions: Sequence[Action | str] = (),
    ) -> None:
        """Prepare ``num_envs`` worlds; the options are as in :class:`craftsim.envs.options.Options`.

        Raises InputError for a task or an option value that there is not.
        """
        options = Options("grid", rule_set, helper_depth, time_weight, actions=tuple(actions))
        super().__init__(task, num_envs, own=as_own(options.actions))
        self.time_weight = options.time_weight
        self.episodes = Episodes(
            self.task, np.random.default_rng(), num_envs, rule_set, helper_depth, actions=self.own
        )
        self._begun = False

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin all episodes anew; without a seed the generator goes on. Options are ignored."""
        super().reset(seed=seed)
        if seed is not None:
            self.episodes.rng = np.random.default_rng(seed)
        self.episodes.reset()
        self._begun = True
        self._look()
        return self._observe(), {}

    def step(
        self, actions: NDArray[np.integer]
    ) -> tuple[Observation, NDArray[np.float64], Bools, Bools, dict[str, Any]]:
        """Let all cars of all worlds act once; ``actions`` (B, n).

        Infos, each an array with a leading dimension B: ``success``, ``duration_s``, ``illegal`` (B, n); and where
        ``_final_obs`` is true ``final_obs``, a world's last observation before it was reset. Raises InputError before
        the first reset, and for actions of another shape or that are no numbers from 0 to 14.
        """
        if not self._begun:
            raise InputError("call reset() before anything else")
        episodes = self.episodes
        chosen = checked(actions, (self.num_envs, self.task.layout.n_cars), self.n_actions)
        offered = self._masks
        queued = None if episodes.depth is None else episodes.queue[:, :, 0] >= 0
        before = episodes.grids.cars.copy()
        numbers = numbers_of(chosen, self.own, queued)
        steps = episodes.step(numbers)
        duration = tick_durations(before, episodes.grids.cars, numbers, steps.applied)
        terminated = steps.success & self.task.ends_on_success
        truncated = steps.done & ~terminated
        infos: dict[str, Any] = {
            "success": steps.success,
            "duration_s": duration,
            "illegal": illegal(chosen, steps.applied, offered, queued),
        }
        self._look()
        ended = np.flatnonzero(steps.done)
        if len(ended):
            infos |= self._final(ended)
            episodes.reset(ended)
            self._look()
        reward = steps.reward - self.time_weight * duration
        return self._observe(), reward, terminated, truncated, infos

    def _look(self) -> None:
        self._masks = self.episodes.offered().view(np.int8)
        self._rows = self.episodes.entity_rows()

    def _observe(self) -> Observation:
        # Copies, for the next step is judged by these masks, and car_vectors() reads these rows.
        rows = self._rows.reshape(self.num_envs, -1).copy()
        return {"observation": rows, "action_mask": self._masks.copy()}

    def _final(self, ended: NDArray[np.int64]) -> dict[str, Any]:
        last = np.full(self.num_envs, None, object)
        for i in ended:
            last[i] = {"observation": self._rows[i].ravel(), "action_mask": self._masks[i]}
        return {"final_obs": last, "_final_obs": np.isin(np.arange(self.num_envs), ended)}

    def car_vectors(self) -> NDArray[np.int32]:
        """Return (B, n, length): what each car of each world observes now, its own row first."""
        return car_vectors(self._rows, self.episodes.n_cars)
