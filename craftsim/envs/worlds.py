"""Worlds in workers: what they are asked for, what they answer, and what holds them."""

from __future__ import annotations

import os
import time
import traceback
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

import numpy as np
from gymnasium.vector.utils import CloudpickleWrapper
from numpy.typing import NDArray

from craftsim.envs.central import CentralConstruction
from craftsim.errors import CraftsimError, InputError
from craftsim.workers.actor import Actor, WorkerDiedError
from craftsim.workers.pool import Engine
from craftsim.workers.ray_actor import RayActor, processors

CLOSE_S: Final = 10.0
"""How long worlds may take to write what they record, and to close."""

Observation = dict[str, NDArray[Any]]
Make = Callable[[], CentralConstruction]


@dataclass(frozen=True, slots=True)
class ResetRequest:
    """Ask a world to begin an episode; see :meth:`craftsim.envs.core.Core.reset`."""

    seed: int | None
    options: dict[str, Any] | None


@dataclass(frozen=True, slots=True)
class ActRequest:
    """Ask a world to let its cars act once, and to begin the next episode where that ends one."""

    actions: NDArray[np.int64]
    """(n,) by car."""


@dataclass(frozen=True, slots=True)
class RenderRequest:
    """Ask a world for its picture."""


Request = ResetRequest | ActRequest | RenderRequest


@dataclass(frozen=True, slots=True)
class Seen:
    """A world after a reset."""

    observation: Observation


@dataclass(frozen=True, slots=True)
class Acted(Seen):
    """A world after its cars have acted; the observation is the next episode's first where one has ended."""

    reward: float
    terminated: bool
    truncated: bool
    info: dict[str, Any]
    final: Observation | None
    """The last observation of an episode that has ended."""


@dataclass(frozen=True, slots=True)
class Rendered:
    """What a world has rendered."""

    picture: Any


Answer = Seen | Acted | Rendered | CraftsimError


def perform(env: CentralConstruction, request: Request) -> Answer:
    """Return a world's answer to a request; what it raises is its answer, too."""
    try:
        match request:
            case ResetRequest(seed, options):
                return Seen(env.reset(seed=seed, options=options)[0])
            case RenderRequest():
                return Rendered(env.render())
            case ActRequest(actions):
                observation, reward, terminated, truncated, info = env.step(actions)
                del info["action_mask"]  # the observation has it
                final = None
                if terminated or truncated:
                    final, observation = observation, env.reset()[0]
                return Acted(observation, reward, terminated, truncated, info, final)
    except CraftsimError as error:
        return error
    except Exception:
        return CraftsimError(f"a world in physics broke down:\n{traceback.format_exc()}")


class Worlds:
    """Worlds numbered from 0, spread over workers; none of their numbers depends on how."""

    def __init__(self, make: Make, n_worlds: int, workers: int | None, engine: Engine) -> None:
        """Start the workers; they go on starting while this returns.

        Args:
            make: makes a world; anything that cloudpickle takes.
            n_worlds: how many worlds there are.
            workers: how many share them, at most one a world; without, one for each processor, on Ray one a world.
            engine: processes of this machine, or actors of a cluster, at most as many as it has processors.

        Raises InputError where Ray or a cluster is missing.
        """
        usual = n_worlds if engine == "ray" else len(os.sched_getaffinity(0))
        self.workers = min(n_worlds, workers or usual, processors() if engine == "ray" else n_worlds)
        self._n_worlds = n_worlds
        self._kind: Any = RayActor if engine == "ray" else Actor
        sent = CloudpickleWrapper(make)
        self._actors = [
            self._kind(partial(_Holder, sent, range(number, n_worlds, self.workers)))
            for number in range(self.workers)
        ]

    @property
    def pids(self) -> list[int]:
        """Numbers of the processes, where they are those of this machine."""
        return [actor.pid for actor in self._actors if isinstance(actor, Actor)]

    def ask(self, requests: Mapping[int, Request]) -> None:
        """Ask worlds, by number, for something each; none of them may have an answer due."""
        for world, request in requests.items():
            self._actors[world % self.workers].send((world, request))

    def gather(self, at_least: int) -> dict[int, Answer]:
        """Return the answers that are there, by world in rising order; wait for so many, or for all that are due.

        Raises CraftsimError where a worker has ended.
        """
        answers: dict[int, Answer] = {}
        while due := [actor for actor in self._actors if actor.due]:
            ready = self._kind.wait(due, None if len(answers) < at_least else 0.0)
            if not ready:
                break
            for actor in ready:
                try:
                    world, answer = actor.recv()
                except WorkerDiedError as error:
                    number = self._actors.index(actor)
                    held = [str(world) for world in range(number, self._n_worlds, self.workers)]
                    worlds = ", ".join(held[:8]) + (", ..." if len(held) > 8 else "")
                    raise CraftsimError(
                        f"the process that holds the worlds {worlds} {error}; make the environment anew"
                    ) from error
                answers[world] = answer
        return dict(sorted(answers.items()))

    def close(self) -> None:
        """Close all worlds and end all workers; one that has something left to do is killed.

        Raises CraftsimError where a world could not be closed, as it could not write what it has recorded.
        """
        idle = [actor for actor in self._actors if not actor.due]
        problems: list[CraftsimError | None] = []
        for actor in idle:
            actor.send(None)
        end_s = time.monotonic() + CLOSE_S
        # Of a cluster that is gone, and of workers that have died, nothing is left to be closed.
        with suppress(InputError):
            while idle and (ready := self._kind.wait(idle, max(0.0, end_s - time.monotonic()))):
                for actor in ready:
                    idle.remove(actor)
                    with suppress(WorkerDiedError):
                        problems.append(actor.recv())
        while self._actors:
            self._actors.pop().kill()
        for problem in filter(None, problems):
            raise problem


class _Holder:
    """In a worker: some of the worlds."""

    def __init__(self, make: Make, worlds: Iterable[int]) -> None:
        self._envs = {world: make() for world in worlds}

    def __call__(self, asked: tuple[int, Request] | None) -> tuple[int, Answer] | CraftsimError | None:
        if asked is None:
            try:
                for env in self._envs.values():
                    env.close()
            except CraftsimError as error:
                return error
            return None
        world, request = asked
        return world, perform(self._envs[world], request)
