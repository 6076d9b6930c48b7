"""The Gymnasium form for batches in physics: many worlds in worker processes, in step or each at its own pace."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any, Final, get_args

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from craftsim.discrete.kernel.tasks import ROW
from craftsim.discrete.own_actions import as_own
from craftsim.discrete.tasks import Task
from craftsim.discrete.tasks.observation import car_vectors
from craftsim.envs.actions import checked
from craftsim.envs.central import CentralConstruction
from craftsim.envs.options import Options
from craftsim.envs.vector import Bools, Observation, TaskVectorEnv
from craftsim.envs.worlds import (
    Acted,
    ActRequest,
    Answer,
    Rendered,
    RenderRequest,
    Request,
    ResetRequest,
    Seen,
    Worlds,
)
from craftsim.errors import CraftsimError, InputError
from craftsim.storage.limits import WORKERS
from craftsim.workers.pool import Engine

Batch = tuple[Observation, NDArray[np.float64], Bools, Bools, dict[str, Any]]

_OF_WORLD: Final = ("success", "duration_s", "problems")
"""Infos that a world has one of; of the others it has one a car."""


class PhysicsVectorEnv(TaskVectorEnv):
    """B worlds of one task in contact physics, spread over worker processes; one agent acts for all cars of a world.

    Spaces, rewards, ends and resets are those of :class:`craftsim.envs.vector.GridVectorEnv`, so that a learner takes
    either. World i of a batch that was reset with seed s is, bit for bit, the environment
    :class:`~craftsim.envs.central.CentralConstruction` that was reset with s + i, whatever the number of workers.

    Joint steps take their time: with :meth:`step` all worlds wait for the slowest worker, with :meth:`send` and
    :meth:`recv` none waits for another.

    Make it where ``__name__ == "__main__"``, and close it.
    """

    def __init__(
        self,
        task: Task | str,
        num_envs: int = 1,
        *,
        workers: int | None = None,
        engine: Engine = "local",
        **options: Any,
    ) -> None:
        """Prepare ``num_envs`` worlds; the processes go on starting while this returns.

        Args:
            task: as in :func:`craftsim.envs.parallel_env`.
            num_envs: how many worlds, 1 or more.
            workers: how many processes share them, at most one a world; one for each processor unless given.
            engine: processes of this machine, or actors of an existing Ray cluster, of which each takes a processor.
            options: the fields of :class:`craftsim.envs.options.Options`, ``backend`` and ``observe`` aside.

        Raises:
            InputError: there is no such task, option or option value, or no Ray cluster.
        """
        chosen = Options.named(**options)
        if chosen.actions:
            options["actions"] = (
                chosen.actions
            )  # by themselves: a name alone does not say where it is registered
        super().__init__(task, num_envs, chosen.images, as_own(chosen.actions))
        if workers is not None and not isinstance(workers, int):
            raise InputError(f"workers is {workers!r}; allowed: None, or {WORKERS}")
        if workers is not None:
            WORKERS.check("workers", workers)
        if engine not in get_args(Engine):
            raise InputError(f"engine is {engine!r}; allowed: {', '.join(get_args(Engine))}")
        make = partial(CentralConstruction, self.task, backend="physics", **options)
        one = make()  # so that what is wrong is said here, and not in a process
        self.metadata = one.metadata | {"autoreset_mode": AutoresetMode.SAME_STEP}
        self.render_mode = one.render_mode
        one.close()
        self._worlds = Worlds(make, num_envs, workers, engine)
        self.workers = self._worlds.workers
        self._ids = frozenset(range(num_envs))
        self._acting = np.zeros(num_envs, np.bool_)
        self._begun = False
        self._rows = np.zeros((num_envs, self.task.layout.n_observed, ROW), np.int32)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin all episodes anew.

        Args:
            seed: of world 0, and those that follow it of the others, or one seed a world; without, generators go on.
            options: of every world's reset, see :meth:`craftsim.envs.core.Core.reset`.

        Raises InputError for seeds that are none, a start that does not fit the task, and while a world is acting.
        """
        self._require_rest("reset")
        seeds = self._seeds(seed)
        answers = self._ask_all({i: ResetRequest(one, options) for i, one in enumerate(seeds)})
        self._begun = True
        return self._observe(list(answers.values())), {}

    def _seeds(self, seed: int | Sequence[int | None] | None) -> list[int | None]:
        if seed is None or isinstance(seed, int | np.integer):
            seeds = [None if seed is None else int(seed) + i for i in range(self.num_envs)]
        else:
            seeds = list(seed) if isinstance(seed, Sequence | np.ndarray) else []
        whole = all(one is None or (isinstance(one, int | np.integer) and one >= 0) for one in seeds)
        if len(seeds) != self.num_envs or not whole:
            raise InputError(
                f"the seed is {seed!r}; allowed: None, a whole number from 0, or {self.num_envs} of them"
            )
        return seeds

    def step(self, actions: NDArray[np.integer]) -> Batch:
        """Let all cars of all worlds act once; ``actions`` (B, n).

        Infos, each an array with a leading dimension B: ``success``, ``duration_s``, ``illegal`` (B, n), ``problems``;
        the other infos of the cars (docs/reference/environments.md), each (B, n); and where ``_final_obs`` is true
        ``final_obs``, a
        world's last observation before it was reset. Raises InputError before the first reset, for actions of another
        shape or that are no numbers from 0 to 14, and while a world is acting; CraftsimError when a process has died.
        """
        self._require_rest("step")
        self.send(actions)
        return self._batch(self._gather(self.num_envs))

    def send(
        self, actions: NDArray[np.integer], ids: Sequence[int] | NDArray[np.integer] | None = None
    ) -> None:
        """Let all cars of some worlds, or of all, act once, and do not wait for it.

        Args:
            actions: (k, n), one row a world.
            ids: (k,) numbers of the worlds; none twice, and none that is acting.

        Raises InputError as :meth:`step` does, and for numbers that are none; CraftsimError when a process has died.
        """
        if not self._begun:
            raise InputError("call reset() before anything else")
        chosen = np.arange(self.num_envs) if ids is None else self._checked_ids(ids)
        rows = checked(actions, (len(chosen), self.task.layout.n_cars), self.n_actions)
        if self._acting[chosen].any():
            acting = chosen[self._acting[chosen]].tolist()
            raise InputError(f"worlds {acting} are acting; recv() what they come to first")
        self._ask({int(i): ActRequest(row) for i, row in zip(chosen, rows, strict=True)})
        self._acting[chosen] = True

    def _checked_ids(self, ids: Sequence[int] | NDArray[np.integer]) -> NDArray[np.int64]:
        chosen = np.asarray(ids)
        known = chosen.ndim == 1 and chosen.dtype.kind in "iu" and set(chosen.tolist()) <= self._ids
        if not known or len(set(chosen.tolist())) != len(chosen):
            raise InputError(
                f"ids are {ids!r}; allowed: different whole numbers from 0 to {self.num_envs - 1}"
            )
        return chosen.astype(np.int64)

    def recv(self, at_least: int = 1) -> Batch:
        """Wait until so many of the acting worlds have come to an end, or all; return what all that have come to.

        Returns what :meth:`step` does, of k worlds, and their numbers in rising order as ``infos["env_id"]``. Which of
        them are the first depends on the machine; what each comes to does not.

        Raises InputError where no world is acting, CraftsimError when a process has died.
        """
        acting = int(self._acting.sum())
        if not acting:
            raise InputError("no world is acting; send() actions first")
        if not isinstance(at_least, int) or at_least < 1:
            raise InputError(f"at_least is {at_least!r}; allowed: 1 and more")
        answers = self._gather(min(at_least, acting))
        observation, reward, terminated, truncated, infos = self._batch(answers)
        return observation, reward, terminated, truncated, infos | {"env_id": np.array(list(answers))}

    @property
    def pids(self) -> list[int]:
        """Numbers of the worker processes, where they are those of this machine."""
        return self._worlds.pids

    def car_vectors(self) -> NDArray[np.int32]:
        """Return (B, n, length): what each car of each world observed last, its own row first."""
        return car_vectors(self._rows, self.task.layout.n_cars)

    def render(self) -> tuple[Any, ...]:
        """Return what every world renders, see :class:`craftsim.envs.options.Options`."""
        self._require_rest("render")
        answers = self._ask_all({i: RenderRequest() for i in range(self.num_envs)})
        return tuple(answer.picture for answer in answers.values() if isinstance(answer, Rendered))

    def close_extras(self, **_: Any) -> None:
        """End all processes."""
        self._worlds.close()
        self._acting[:] = False

    def _require_rest(self, what: str) -> None:
        if self._acting.any():
            acting = np.flatnonzero(self._acting).tolist()
            raise InputError(f"worlds {acting} are acting; recv() what they come to before a {what}()")

    def _ask(self, requests: dict[int, Request]) -> None:
        if self.closed:
            raise InputError("the environment is closed; make it anew")
        self._worlds.ask(requests)

    def _ask_all(self, requests: dict[int, Request]) -> dict[int, Answer]:
        self._ask(requests)
        return self._gather(len(requests))

    def _gather(self, at_least: int) -> dict[int, Answer]:
        try:
            answers = self._worlds.gather(at_least)
        except CraftsimError:
            self.close()
            raise
        self._acting[list(answers)] = False
        for world, answer in answers.items():
            if isinstance(answer, InputError):
                raise answer
            if isinstance(answer, CraftsimError):
                self.close()
                raise answer
            if isinstance(answer, Seen):
                self._masks[world] = answer.observation["action_mask"]
                self._rows[world] = answer.observation["observation"].reshape(self._rows.shape[1:])
        return answers

    def _observe(self, answers: Sequence[Answer]) -> Observation:
        seen = [answer.observation for answer in answers if isinstance(answer, Seen)]
        return {key: np.stack([one[key] for one in seen]) for key in seen[0]}

    def _batch(self, answers: dict[int, Answer]) -> Batch:
        acted = [answer for answer in answers.values() if isinstance(answer, Acted)]
        infos = {key: _column(key, [one.info[key] for one in acted]) for key in acted[0].info}
        ended = np.array([one.final is not None for one in acted])
        if ended.any():
            last = np.full(len(acted), None, object)
            last[:] = [one.final for one in acted]
            infos |= {"final_obs": last, "_final_obs": ended}
        return (
            self._observe(acted),
            np.array([one.reward for one in acted], np.float64),
            np.array([one.terminated for one in acted], np.bool_),
            np.array([one.truncated for one in acted], np.bool_),
            infos,
        )


def _column(key: str, values: Sequence[Any]) -> NDArray[Any]:
    """Return an info of some worlds as an array (k,), or (k, n) where it is the cars'; texts are objects in it."""
    by_car = key not in _OF_WORLD
    first = values[0][0] if by_car else values[0]
    if isinstance(first, bool | np.bool_ | float | int):
        return np.array(values)
    column = np.empty((len(values), len(values[0])) if by_car else len(values), object)
    for place in np.ndindex(column.shape):
        column[place] = values[place[0]][place[1]] if by_car else values[place[0]]
    return column
