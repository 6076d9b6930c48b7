"""Worlds in actors of an existing Ray cluster (the optional extra ``ray``)."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Mapping, Sequence
from typing import Any, Final

from gymnasium.vector.utils import CloudpickleWrapper

from craftsim.envs.ray_connection import LOOK_S, check_reachable, connect, processors
from craftsim.envs.world_requests import Answer, Make, Request, perform
from craftsim.errors import CraftsimError, InputError
from craftsim.modules import REGISTERING, look_for_modules

_HINT: Final = "Then make the environment anew"


class _WorldsActor:
    """A process of the cluster that holds some worlds, and finds the modules that this process finds."""

    def __init__(self, path: list[str], registering: list[str]) -> None:
        """Look for modules along this path too, and import those that register something."""
        look_for_modules(path, registering)

    def hold(self, make: Make, worlds: Sequence[int]) -> None:
        """Make these worlds."""
        self._envs = {world: make() for world in worlds}

    def perform(self, world: int, request: Request) -> Answer:
        """Return a world's answer."""
        return perform(self._envs[world], request)


class RayWorlds:
    """Worlds in actors; see :class:`~craftsim.envs.world_requests.WorldHolder`."""

    def __init__(self, make: Make, n_worlds: int, workers: int | None) -> None:
        """Start the actors; they go on starting while this returns.

        Args:
            make: makes a world; anything that cloudpickle takes.
            n_worlds: how many worlds there are.
            workers: how many actors share them, at most one a world and one a processor of the cluster, and so many
                unless given.

        Raises InputError where Ray or a cluster is missing.
        """
        self._ray, self._head = connect(_HINT)
        self.workers = min(n_worlds, workers or n_worlds, processors(self._ray))
        kind = self._ray.remote(num_cpus=1, max_restarts=0, scheduling_strategy="SPREAD")(_WorldsActor)
        self._actors = [kind.remote(sys.path, REGISTERING) for _ in range(self.workers)]
        sent = CloudpickleWrapper(make)
        for number, actor in enumerate(self._actors):
            actor.hold.remote(sent, range(number, n_worlds, self.workers))
        self._due: dict[Any, int] = {}

    def ask(self, requests: Mapping[int, Request]) -> None:
        """Ask worlds for something each."""
        for world, request in requests.items():
            self._due[self._actors[world % self.workers].perform.remote(world, request)] = world

    def gather(self, at_least: int) -> dict[int, Answer]:
        """Return the answers that are there, and wait for so many."""
        at_least = min(at_least, len(self._due))
        answers: dict[int, Answer] = {}
        try:
            while len(answers) < at_least:
                self._take(answers, at_least - len(answers), LOOK_S)
                if len(answers) < at_least:
                    # Where the head is gone Ray would wait, and then end this process.
                    check_reachable(self._head, _HINT)
            if self._due:
                self._take(answers, len(self._due), 0.0)
        except self._ray.exceptions.RayError as error:
            first = str(error).strip().splitlines()[0]
            raise CraftsimError(
                f"the Ray cluster has lost worlds of this environment ({first}); make it anew"
            ) from error
        return dict(sorted(answers.items()))

    def _take(self, answers: dict[int, Answer], number: int, timeout_s: float) -> None:
        ready, _ = self._ray.wait(list(self._due), num_returns=number, timeout=timeout_s)
        for reference, answer in zip(ready, self._ray.get(ready), strict=True):
            answers[self._due.pop(reference)] = answer

    def close(self) -> None:
        """End all actors."""
        # Of a cluster that is gone nothing is left to be ended.
        with contextlib.suppress(self._ray.exceptions.RayError, InputError):
            check_reachable(self._head, _HINT)
            for actor in self._actors:
                self._ray.kill(actor)
