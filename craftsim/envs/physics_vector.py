"""Batches of worlds in contact physics, spread over worker processes."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from itertools import chain
from typing import Any, Final

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from craftsim.envs.central import OF_WORLD, CentralConstruction
from craftsim.envs.observations import Observation
from craftsim.envs.options import BatchOptions
from craftsim.envs.vector import Batch, TaskVectorEnv, final_infos
from craftsim.errors import CraftsimError, InputError
from craftsim.tasks import Task
from craftsim.tasks.kernel import ROW
from craftsim.tasks.observation import car_vectors
from craftsim.workers.actor import Actor, WorkerDiedError
from craftsim.workers.copying import OfOneProcess
from craftsim.workers.pool import Engine, usable_processors
from craftsim.workers.ray_actor import RayActor, processors

_CLOSE_S: Final = 10.0
"""How long worlds may take to write their records, and to close."""


class PhysicsVectorEnv(OfOneProcess, TaskVectorEnv):
    """B worlds of one task in contact physics, spread over worker processes.

    Spaces, rewards, ends and resets are those of a batch of grid worlds. World i of a batch that was reset with seed s
    is, bit for bit, the environment :class:`CentralConstruction` that was reset with s + i, whatever the number of
    workers. With :meth:`step` all worlds wait for the slowest one, with :meth:`send` and :meth:`recv` none for another.

    Close it, so that they end.
    """

    _instead = "its worlds are in other processes: make another one, or copy single environments"

    def __init__(
        self,
        task: Task | str,
        num_envs: int = 1,
        *,
        workers: int | None = None,
        engine: Engine = "local",
        **options: Any,
    ) -> None:
        """Prepare worlds, arguments as of :func:`craftsim.envs.vector_env`; the processes go on starting meanwhile.

        Raises InputError where there is no such task, option or option value, or no Ray cluster.
        """
        batch = BatchOptions(num_envs, workers, engine)
        env = CentralConstruction(
            task, **options
        )  # so that what is wrong is said here, and not in a process
        chosen = env.core.options
        super().__init__(env.core.task, num_envs, chosen)
        self.metadata = env.metadata | {"autoreset_mode": AutoresetMode.SAME_STEP}
        self.render_mode = env.render_mode
        env.close()
        if chosen.actions:  # by themselves: a name alone does not say where it is registered
            options["actions"] = chosen.actions
        make = partial(CentralConstruction, self.task, **options)
        on_ray = batch.engine == "ray"
        if on_ray:
            usual = num_envs
        else:
            usual = usable_processors()
        self.workers = min(num_envs, batch.workers or usual, processors() if on_ray else num_envs)
        if on_ray:
            self._kind: Any = RayActor
        else:
            self._kind = Actor
        actors = []
        for number in range(self.workers):
            actors.append(self._kind(partial(_holder, make, range(number, num_envs, self.workers))))
        self._actors = actors
        self._acting = np.zeros(num_envs, np.bool_)
        self._asynchronous = chosen.execution == "asynchronous"
        self._rows = np.zeros((num_envs, self.task.layout.n_observed, ROW), np.int32)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin all episodes anew; ``options`` as of :meth:`craftsim.envs.core.Core.reset`.

        ``seed`` is of world 0, and those that follow it of the others, or one per world; without, generators go on.
        Raises InputError for seeds that are none, a start that does not fit the task, and while a world is acting.
        """
        self._require_rest("reset")
        observations = self._ask_all(
            _begin, [(world_seed, options) for world_seed in self._seeds(seed)]
        )
        self._begun = True
        infos = {}
        if self._asynchronous:
            infos["decides"] = np.ones(self._masks.shape[:2], np.bool_)
        return self._keep(range(self.num_envs), observations), infos

    def _seeds(self, seed: int | Sequence[int | None] | None) -> list[int | None]:
        if seed is None:
            return [None] * self.num_envs
        if isinstance(seed, int | np.integer):
            return [int(seed) + i for i in range(self.num_envs)]
        if not isinstance(seed, Sequence | np.ndarray) or len(seed) != self.num_envs:
            raise InputError(
                f"the seed is {seed!r}; allowed: None, a whole number from 0, or {self.num_envs} of them"
            )
        return list(seed)

    def step(self, actions: NDArray[np.integer]) -> Batch:
        """Let all cars of all worlds act once; ``actions`` (B, n).

        Infos (docs/reference/environments.md) are arrays, (B,) or (B, n) by car; ``final_obs`` and ``final_info`` are
        as on the grid.
        Raises InputError before the first reset, for actions that are none, and while a world is acting; CraftsimError
        when a process has died.
        """
        self._require_rest("step")
        self.send(actions)
        return self._batch(self._gather(self.num_envs))

    def send(
        self, actions: NDArray[np.integer], ids: Sequence[int] | NDArray[np.integer] | None = None
    ) -> None:
        """Let all cars of some worlds, or of all, act once, and do not wait for it.

        ``actions`` (k, n) has one row for each of the numbers ``ids`` (k,), none twice, and none that is acting. Raises
        InputError as :meth:`step` does, and for numbers that are none.
        """
        if ids is None:
            worlds = np.arange(self.num_envs)
        else:
            worlds = np.asarray(ids)
        is_number = worlds.ndim == 1 and worlds.dtype.kind in "iu"
        if not is_number or len({*worlds.tolist()} & {*range(self.num_envs)}) < len(worlds):
            raise InputError(
                f"ids are {ids!r}; allowed: different whole numbers from 0 to {self.num_envs - 1}"
            )
        rows = self._checked(actions, len(worlds))
        acting = worlds[self._acting[worlds]].tolist()
        if acting:
            raise InputError(f"worlds {acting} are acting; recv() what they come to first")
        self._ask({int(world): (_act, (row,)) for world, row in zip(worlds, rows, strict=True)})
        self._acting[worlds] = True

    def recv(self, at_least: int = 1) -> Batch:
        """Wait until so many of the acting worlds have finished their step, or all; return what :meth:`step` does.

        The numbers of these worlds are in rising order in ``infos["env_id"]``. Which are the first depends on the
        machine; the results do not. Raises InputError where no world is acting, CraftsimError when a process has died.
        """
        acting = int(self._acting.sum())
        if not acting:
            raise InputError("no world is acting; send() actions first")
        if not isinstance(at_least, int) or at_least < 1:
            raise InputError(f"at_least is {at_least!r}; allowed: 1 and more")
        answers = self._gather(min(at_least, acting))
        batch = self._batch(answers)
        batch[4]["env_id"] = np.array(list(answers))
        return batch

    def car_vectors(self) -> NDArray[np.int32]:
        """Return (B, n, length): what each car of each world observed last, its own row first."""
        return car_vectors(self._rows, self.task.layout.n_cars)

    @property
    def pids(self) -> list[int]:
        """Numbers of the worker processes, where they are those of this machine."""
        return [actor.pid for actor in self._actors if isinstance(actor, Actor)]

    def render(self) -> tuple[Any, ...]:
        """Return what every world renders, see :class:`craftsim.envs.options.Options`."""
        self._require_rest("render")
        return tuple(self._ask_all(CentralConstruction.render, [()] * self.num_envs))

    def close_extras(self, **_: Any) -> None:
        """Close all worlds and end all processes; one that is still busy is killed.

        Raises CraftsimError where a world could not be closed, as it could not write its records.
        """
        if self.is_forked:
            self._actors.clear()
            return
        self._acting[:] = False
        working = [actor for actor in self._actors if not actor.due]
        for actor in working:
            actor.send(None)
        problems: list[CraftsimError] = []
        end_s = time.monotonic() + _CLOSE_S
        # Of a cluster that is gone, and of workers that have died, nothing is left to be closed.
        with suppress(InputError):
            while working and (
                ready := self._kind.wait(working, max(0.0, end_s - time.monotonic()))
            ):
                for actor in ready:
                    working.remove(actor)
                    with suppress(WorkerDiedError):
                        problems += actor.recv()
        while self._actors:
            self._actors.pop().kill()
        for problem in problems:
            raise problem

    def _require_rest(self, call: str) -> None:
        acting = np.flatnonzero(self._acting).tolist()
        if acting:
            raise InputError(
                f"worlds {acting} are acting; recv() what they come to before a {call}()"
            )

    def _ask(self, calls: Mapping[int, _Call]) -> None:
        if self.closed:
            raise InputError("the environment is closed; make it anew")
        self.check_process()
        for world, call in calls.items():
            self._actors[world % self.workers].send((world, *call))

    def _ask_all(self, call: Callable[..., Any], arguments: Iterable[tuple[Any, ...]]) -> list[Any]:
        self._ask({world: (call, call_arguments) for world, call_arguments in enumerate(arguments)})
        return list(self._gather(self.num_envs).values())

    def _gather(self, at_least: int) -> dict[int, Any]:
        """Return the answers that are there, by world in rising order; wait for so many, or for all that are due.

        Raises what a world has raised, and CraftsimError where a worker has ended.
        """
        received: dict[int, Any] = {}
        try:
            while due := [actor for actor in self._actors if actor.due]:
                ready = self._kind.wait(due, None if len(received) < at_least else 0.0)
                if not ready:
                    break
                for actor in ready:
                    try:
                        world, received[world] = actor.recv()
                    except WorkerDiedError as death:
                        raise self._died(actor, death) from death
        except CraftsimError:
            self.close()
            raise
        answers = dict(sorted(received.items()))
        self._acting[list(answers)] = False
        for error in (answer for answer in answers.values() if isinstance(answer, CraftsimError)):
            if not isinstance(error, InputError):
                self.close()
            raise error
        return answers

    def _died(self, actor: Any, error: WorkerDiedError) -> CraftsimError:
        lost_worlds = [
            str(world) for world in range(self._actors.index(actor), self.num_envs, self.workers)
        ]
        worlds = ", ".join(lost_worlds[:8]) + (", ..." if len(lost_worlds) > 8 else "")
        return CraftsimError(
            f"the process that holds the worlds {worlds} {error}; make the environment anew"
        )

    def _batch(self, answers: Mapping[int, tuple[Any, ...]]) -> Batch:
        """Return the answers of :func:`_act` as those of a batch."""
        observations, rewards, terminated, truncated, reported, final = zip(
            *answers.values(), strict=True
        )
        infos: dict[str, Any] = self._columns(reported)
        ended = np.array([last is not None for last in final])
        if ended.any():
            lasts = [last for last in final if last is not None]
            infos |= final_infos(
                ended,
                [last_observation for last_observation, _ in lasts],
                self._columns([info for _, info in lasts]),
            )
        return (
            self._keep(answers, observations),
            np.array(rewards, np.float64),
            np.array(terminated, np.bool_),
            np.array(truncated, np.bool_),
            infos,
        )

    def _columns(self, infos: Sequence[dict[str, Any]]) -> dict[str, NDArray[Any]]:
        """Return the infos of k worlds by key, (k, ...). A key that a world lacks has None there."""
        columns = {}
        for key in dict.fromkeys(chain.from_iterable(infos)):
            missing = None
            if key not in OF_WORLD:
                missing = (None,) * self.task.layout.n_cars
            columns[key] = _column(key, [info.get(key, missing) for info in infos])
        return columns

    def _keep(self, worlds: Iterable[int], observations: Sequence[Observation]) -> Observation:
        """Return the observations of worlds as a batch, and keep them as the last ones."""
        for world, observation in zip(worlds, observations, strict=True):
            self._masks[world] = observation["action_mask"]
            self._rows[world] = observation["observation"].reshape(self._rows.shape[1:])
        return {
            key: np.stack([observation[key] for observation in observations])
            for key in observations[0]
        }


def _column(key: str, values: Sequence[Any]) -> NDArray[Any]:
    """Return an info of some worlds as an array (k,), or (k, n) where it is the cars'; texts are objects in it."""
    if key == "action_mask":
        return np.stack(values)
    by_car = key not in OF_WORLD
    entries = values
    if by_car:
        entries = []
        for of_cars in values:
            for entry in of_cars:
                entries.append(entry)
    if all(isinstance(entry, bool | np.bool_ | float | int) for entry in entries):
        return np.array(values)
    column = np.empty((len(values), len(values[0])) if by_car else len(values), object)
    for place in np.ndindex(column.shape):
        if by_car:
            column[place] = values[place[0]][place[1]]
        else:
            column[place] = values[place[0]]
    return column


_Call = tuple[Callable[..., Any], tuple[Any, ...]]
"""What is called with an environment in a worker, and further arguments."""


def _holder(make: Callable[[], CentralConstruction], worlds: Iterable[int]) -> Callable[[Any], Any]:
    """In a worker: hold some of the worlds; return what answers (number of a world, call, further arguments).

    Asked for nothing it closes all, and returns errors.
    """
    envs = {world: make() for world in worlds}

    def answer(world: int, call: Callable[..., Any], *arguments: Any) -> Any:
        """Return what a call comes to; what it raises is an answer, too."""
        try:
            return call(envs[world], *arguments)
        except CraftsimError as error:
            return error
        except Exception:
            return CraftsimError(f"a world in physics broke down:\n{traceback.format_exc()}")

    def handle(request: tuple[int, Callable[..., Any], tuple[Any, ...]] | None) -> Any:
        if request is None:
            closed = [answer(world, CentralConstruction.close) for world in envs]
            return [error for error in closed if isinstance(error, CraftsimError)]
        world, call, arguments = request
        return world, answer(world, call, *arguments)

    return handle


def _act(env: CentralConstruction, actions: NDArray[np.int64]) -> tuple[Any, ...]:
    """Return what a step does, and of an episode that has ended the last observation and info; the next one begins."""
    observation, reward, terminated, truncated, info = env.step(actions)
    if "deadlock" in info:
        info["deadlock"] = info["deadlock"] is not None
    final = None
    if terminated or truncated:
        final = observation, info.copy()
        observation = env.reset()[0]
        if "decides" in info:
            info["decides"] = (True,) * len(info["decides"])
    del info["action_mask"]  # the observation has it
    return observation, reward, terminated, truncated, info, final


def _begin(
    env: CentralConstruction, seed: int | None, options: dict[str, Any] | None
) -> Observation:
    return env.reset(seed=seed, options=options)[0]
