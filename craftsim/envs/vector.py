"""The Gymnasium form for batches, and batches of grid worlds, which are advanced in one array call."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from craftsim.discrete.kinds import Action
from craftsim.discrete.schedule import car_durations
from craftsim.envs.actions import checked_actions, illegal
from craftsim.envs.observations import Observation
from craftsim.envs.options import BATCH_OPTIONS, BatchOptions, Options
from craftsim.envs.spaces import central_space, joint_action_space, observed
from craftsim.errors import InputError
from craftsim.tasks import Task, as_task
from craftsim.tasks.asynchronous import BLOCKED, ILLEGAL, WAITS, AsynchronousEpisodes, make_episodes
from craftsim.tasks.episodes import Steps
from craftsim.workers.copying import Copyable

_Bools = NDArray[np.bool_]
Batch = tuple[Observation, NDArray[np.float64], _Bools, _Bools, dict[str, Any]]


class TaskVectorEnv(VectorEnv[Observation, NDArray[np.integer], NDArray[Any]]):
    """B worlds of one task: the spaces, and how episodes follow each other.

    One agent sees a world's global state and chooses an action for each of its cars. A world whose episode ends is
    reset in the same step: the observation returned is the new episode's first, and the old one's last is in
    ``infos["final_obs"]``, with its infos in ``infos["final_info"]``, as :func:`final_infos` says.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 (as Gymnasium declares it)
        "autoreset_mode": AutoresetMode.SAME_STEP,
        "render_modes": [],
    }

    def __init__(self, task: Task | str, num_envs: int, options: Options) -> None:
        """Make the spaces; raises InputError for a task that there is not."""
        self.task = as_task(task)
        self.num_envs = num_envs
        self.form = options.action_form(self.task)
        self._radius = options.local_view
        layout = self.task.layout
        n_actions = self.form.n_actions
        self.single_observation_space = central_space(self.task, options, self.form)
        self.single_action_space = joint_action_space(self.task, n_actions)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._masks = np.zeros((num_envs, layout.n_cars, n_actions), np.int8)
        self._begun = False

    def action_masks(self) -> _Bools:
        """Return the offered actions, (B, n * actions), as :meth:`CentralConstruction.action_masks` does of a world."""
        return self._masks.astype(np.bool_).reshape(self.num_envs, -1)

    def _checked(self, actions: Any, n_worlds: int) -> NDArray[np.int64]:
        if not self._begun:
            raise InputError("call reset() before anything else")
        return checked_actions(actions, (n_worlds, self.task.layout.n_cars), self.form.n_actions)


def final_infos(
    ended: _Bools, observations: Sequence[Observation], columns: Mapping[str, NDArray[Any]]
) -> dict[str, Any]:
    """Return what a batch says of the episodes that have ended, in the form of Gymnasium's ``SyncVectorEnv``.

    Args:
        ended: (B,) in which worlds.
        observations: their last observations, k of them.
        columns: their last infos by key, each (k, ...).

    Returns ``final_obs`` (B,), the observations, None elsewhere; ``final_info``, the infos by key, each (B, ...), zero
    or None elsewhere; and ``_final_obs``, ``_final_info`` and in ``final_info`` ``_KEY`` for each key, which are
    ``ended``.
    """
    last = np.full(len(ended), None, object)
    last[ended] = observations
    infos: dict[str, Any] = {}
    for key, column in columns.items():
        shape = (len(ended), *column.shape[1:])
        if column.dtype == object:
            filled = np.full(shape, None)
        else:
            filled = np.zeros(shape, column.dtype)
        filled[ended] = column
        infos[key] = filled
        infos[f"_{key}"] = ended.copy()
    return {
        "final_obs": last,
        "_final_obs": ended.copy(),
        "final_info": infos,
        "_final_info": ended.copy(),
    }


class GridVectorEnv(Copyable, TaskVectorEnv):
    """B grid worlds of one task; :meth:`car_vectors` is what the single cars observe."""

    def __init__(self, task: Task | str, num_envs: int = 1, **options: Any) -> None:
        """Prepare worlds, arguments as of :func:`craftsim.envs.vector_env`. Raises InputError for what there is not."""
        chosen = Options(**({"backend": "grid"} | options))
        for name in options:
            if name not in (*BATCH_OPTIONS, "backend"):
                raise InputError(f"a batch of grid worlds knows no '{name}'; leave it out")
        super().__init__(task, BatchOptions(num_envs).num_envs, chosen)
        self.time_weight = chosen.time_weight
        setting = chosen.rule_set, chosen.helper_depth, None, self.form.own
        self.episodes = make_episodes(
            self.task, np.random.default_rng(), num_envs, *setting, timing=chosen.timing
        )

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin all episodes anew; without a seed the generator goes on. Options are ignored."""
        super().reset(seed=seed)
        if seed is not None:
            self.episodes.rng = np.random.default_rng(seed)
        self.episodes.reset()
        self._begun = True
        return self._look({})

    def step(self, actions: NDArray[np.integer]) -> Batch:
        """Let all cars of all worlds act once; ``actions`` (B, n). In asynchronous execution the cars that decide
        begin theirs, what is given for others is ignored, and each world advances to its own next event.

        Infos, each an array with a leading dimension B: ``success``, ``duration_s``, ``illegal`` (B, n); and where an
        episode has ended those of :func:`final_infos`. In asynchronous execution
        also ``decides`` (B, n), who decides next, which reset() says, too; of each car whose decision has ended, and
        of all at the end of an episode, ``elapsed_s`` and ``earned`` (B, n), the time since that decision and the sum
        of the rewards of that time; ``blocked`` and ``failed`` (B, n), and ``deadlock`` (B,). Raises InputError before
        the first reset, and for actions of another shape or that are no numbers from 0 to 14.
        """
        chosen = self._checked(actions, self.num_envs)
        episodes = self.episodes
        if isinstance(episodes, AsynchronousEpisodes):
            steps, infos = self._next_event(episodes, chosen)
        else:
            steps, infos = self._tick(chosen)
        terminated = steps.success & self.task.ends_on_success
        over = steps.done.copy()
        if "deadlock" in infos:
            infos["deadlock"] &= ~over
            over |= infos["deadlock"]
        ended = np.flatnonzero(over)
        if len(ended):
            observations = observed(episodes.some(ended), self.form, self._radius)
            last = []
            for place in range(len(ended)):
                last.append({key: array[place] for key, array in observations.items()})
            columns = {key: column[ended] for key, column in infos.items()}
            columns["action_mask"] = observations["action_mask"]
            if isinstance(episodes, AsynchronousEpisodes):
                columns["decides"] = episodes.decides[ended]
            infos |= final_infos(over, last, columns)
            episodes.reset(ended)
        observation, _ = self._look(infos)
        return observation, steps.reward, terminated, over & ~terminated, infos

    def _tick(self, chosen: NDArray[np.int64]) -> tuple[Steps, dict[str, Any]]:
        episodes = self.episodes
        offered = self._masks
        numbers, queued = self.form.begin(episodes, chosen)
        before = episodes.grids.cars.copy()
        steps = episodes.step(numbers)
        # Cars act at once; that they may have to wait for each other is not counted.
        duration = car_durations(before, episodes.grids.cars, numbers, steps.applied).max(
            -1, initial=0.0
        )
        wrong = illegal(chosen, steps.applied, offered, queued)
        infos = {"success": steps.success, "duration_s": duration, "illegal": wrong}
        return replace(steps, reward=steps.reward - self.time_weight * duration), infos

    def _next_event(
        self, episodes: AsynchronousEpisodes, chosen: NDArray[np.int64]
    ) -> tuple[Steps, dict[str, Any]]:
        """Let the cars that decide begin, and advance each world to its next event."""
        actions = np.where(episodes.decides, chosen, int(Action.STOP))
        numbers, queued = self.form.begin(episodes, actions)
        event = episodes.step(numbers, offered=self._masks, time_weight=self.time_weight)
        wrong = event.outcome == ILLEGAL
        if queued is not None:
            # A choice of an object to which there is no way is a STOP that was not asked for.
            wrong |= (event.outcome == WAITS) & ~queued
        return event, {
            "success": event.success,
            "duration_s": event.duration_s,
            "illegal": wrong & (actions != Action.STOP),
            "blocked": event.outcome == BLOCKED,
            "failed": event.failed,
            "elapsed_s": event.elapsed_s,
            "earned": event.earned,
            "deadlock": event.deadlock,
        }

    def _look(self, infos: dict[str, Any]) -> tuple[Observation, dict[str, Any]]:
        """Return what is observed of all worlds, and infos that say who decides next."""
        observations = observed(self.episodes, self.form, self._radius)
        self._masks = observations["action_mask"].copy()  # by which the next step is judged
        if isinstance(self.episodes, AsynchronousEpisodes):
            infos["decides"] = self.episodes.decides
        return observations, infos

    def car_vectors(self) -> NDArray[np.int32]:
        """Return (B, n, length): what each car of each world observes, its own row first."""
        return self.episodes.vectors()
