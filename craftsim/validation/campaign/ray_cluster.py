"""Workers that are actors on an existing Ray cluster (the optional extra ``ray``)."""

from __future__ import annotations

import contextlib
import logging
import math
import os
import socket
import sys
import time
from collections.abc import Sequence
from typing import Any, Final
from urllib.parse import urlsplit

from craftsim.errors import InputError
from craftsim.validation.campaign.distribute import Worker, WorkerDiedError
from craftsim.validation.campaign.items import Answer, Item, Work, perform

REACH_S: Final = 5.0
"""How long a cluster may take to answer at its address."""
LOOK_S: Final = 2.0
"""How often one looks whether its head is still there."""


def ray_workers(work: Work, n: int) -> list[Worker]:
    """Return workers of the cluster of RAY_ADDRESS, or else of one on this machine, at most as many as it can run.

    Raises:
        InputError: Ray is not installed, or there is no cluster, at the address that is given for instance.
    """
    try:
        import ray
    except ImportError:
        raise InputError("--engine ray needs Ray: pip install '.[ray]' in a checkout of craftsim") from None
    if not ray.is_initialized():
        try:
            _check_reachable(_address())
            ray.init(address="auto", log_to_driver=False, logging_level=logging.WARNING)
        except (ConnectionError, ray.exceptions.RayError) as error:
            raise InputError(
                f"no Ray cluster ({str(error).splitlines()[0]}); start one with 'ray start --head', or give the "
                "address of one in RAY_ADDRESS"
            ) from error
    head = _address()
    if not head.startswith("ray://"):
        head = ray.get_runtime_context().gcs_address
    return [
        RayWorker(ray, work, head) for _ in range(max(1, min(n, int(ray.cluster_resources().get("CPU", 1)))))
    ]


def _address() -> str:
    """Return RAY_ADDRESS, or where else Ray finds a cluster; raise ConnectionError where it finds none."""
    given = os.environ.get("RAY_ADDRESS", "auto")
    if given != "auto":
        return given
    # Ray has no public name for where "auto" leads: the last 'ray start' of this machine, though it may be gone.
    from ray._private.services import canonicalize_bootstrap_address

    return str(canonicalize_bootstrap_address("auto"))


def _check_reachable(address: str) -> None:
    """Raise InputError where nobody listens at an address: Ray would try for over a minute.

    The address is of the form ``host:port`` or ``ray://host:port``; one without a port is left to Ray.
    """
    try:
        parts = urlsplit(address if "://" in address else f"//{address}")
        host, port = parts.hostname, parts.port
    except ValueError as error:
        raise InputError(
            f"'{address}' is no address of a Ray cluster ({error}); RAY_ADDRESS is HOST:PORT"
        ) from None
    if not host or not port:
        return
    try:
        socket.create_connection((host, port), REACH_S).close()
    except OSError as error:
        raise InputError(
            f"no Ray cluster answers at {address} ({error}); start one with 'ray start --head', or give the address of "
            "one in RAY_ADDRESS; 'ray stop' forgets one of this machine that is gone. --resume goes on with what was "
            "finished"
        ) from error


class _Actor:
    """A process of the cluster, which finds the modules that this process finds."""

    def __init__(self, path: list[str]) -> None:
        """Look for modules along this path too."""
        sys.path += [place for place in path if place not in sys.path]

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
                _check_reachable(self._head)
                self._actor = self._class.remote(sys.path)
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
                _check_reachable(self._head)

    def _end(self) -> None:
        """End the actor; the next work gets another one."""
        actor, self._actor = self._actor, None
        # Of a cluster that is gone nothing is left to be ended.
        with contextlib.suppress(self._ray.exceptions.RayError, InputError):
            if actor is not None:
                _check_reachable(self._head)
                self._ray.kill(actor)
