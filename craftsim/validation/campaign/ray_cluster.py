"""Workers that are actors on an existing Ray cluster (the optional extra ``ray``)."""

from __future__ import annotations

import contextlib
import math
import sys
import time
from collections.abc import Sequence
from typing import Any, Final

from craftsim.envs.ray_connection import LOOK_S, check_reachable, connect, processors
from craftsim.errors import InputError
from craftsim.modules import REGISTERING, look_for_modules
from craftsim.validation.campaign.distribute import Worker, WorkerDiedError
from craftsim.validation.campaign.items import Answer, Item, Work, perform

_HINT: Final = "--resume goes on with what was finished"


def ray_workers(work: Work, n: int) -> list[Worker]:
    """Return workers of the cluster of RAY_ADDRESS, or else of one on this machine, at most as many as it can run.

    Raises:
        InputError: Ray is not installed, or there is no cluster, at the address that is given for instance.
    """
    ray, head = connect(_HINT)
    return [RayWorker(ray, work, head) for _ in range(max(1, min(n, processors(ray))))]


class _Actor:
    """A process of the cluster, which finds the modules that this process finds."""

    def __init__(self, path: list[str], registering: list[str]) -> None:
        """Look for modules along this path too, and import those that register something."""
        look_for_modules(path, registering)

    def ready(self) -> None:
        """Answer as soon as the process has started."""

    def perform(self, work: Work, jobs: list[Any]) -> list[Answer]:
        """Do several items."""
        return perform(work, jobs)


class RayWorker:
    """An actor with a processor of its own; made anew, on whatever node, when it dies."""

    def __init__(self, ray: Any, work: Work, head: str) -> None:
        """Prepare an actor for a picklable function; ``head`` is the address of the cluster's head."""
        self._ray, self._work, self._head = ray, work, head
        self._class = ray.remote(num_cpus=1, max_restarts=0, scheduling_strategy="SPREAD")(_Actor)
        self._actor: Any = None

    def run(self, items: Sequence[Item], timeout_s: float) -> list[Answer]:
        """Do several items, see :class:`~craftsim.validation.campaign.distribute.Worker`.

        The time begins when the actor has started: a full cluster may let it wait.
        """
        errors = self._ray.exceptions
        try:
            if self._actor is None:
                check_reachable(self._head, _HINT)
                self._actor = self._class.remote(sys.path, REGISTERING)
            self._wait(self._actor.ready.remote(), math.inf)
            answers: list[Answer] = self._wait(
                self._actor.perform.remote(self._work, [item.job for item in items]), timeout_s
            )
            return answers
        except errors.GetTimeoutError:
            self._end()
            raise TimeoutError from None
        except (errors.RayActorError, errors.ObjectLostError) as error:
            self._end()
            raise WorkerDiedError from error
        except errors.RayError as error:
            raise InputError(
                f"the Ray cluster cannot do the work: {str(error).splitlines()[0]}; what was finished is kept: "
                "--resume goes on, with a cluster or without --engine ray"
            ) from error

    def close(self) -> None:
        """End the actor at once."""
        self._end()

    def _wait(self, reference: Any, timeout_s: float) -> Any:
        """Return a result; raise InputError when the head is gone: Ray would wait, and then end this process."""
        end = time.monotonic() + timeout_s
        while True:
            try:
                return self._ray.get(reference, timeout=max(0.0, min(LOOK_S, end - time.monotonic())))
            except self._ray.exceptions.GetTimeoutError:
                if time.monotonic() >= end:
                    raise
                check_reachable(self._head, _HINT)

    def _end(self) -> None:
        """End the actor; the next work gets another one."""
        actor, self._actor = self._actor, None
        # Of a cluster that is gone nothing is left to be ended.
        with contextlib.suppress(self._ray.exceptions.RayError, InputError):
            if actor is not None:
                check_reachable(self._head, _HINT)
                self._ray.kill(actor)
