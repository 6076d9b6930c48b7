"""Actors on an existing Ray cluster (the optional extra ``ray``)."""

from __future__ import annotations

import contextlib
import logging
import os
import socket
import sys
import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any, Final
from urllib.parse import urlsplit

from craftsim.errors import InputError
from craftsim.storage.extras import need
from craftsim.workers.actor import RequestHandler, WorkerDiedError
from craftsim.workers.copying import OfOneProcess
from craftsim.workers.modules import REGISTERING, look_for_modules

_REACH_S: Final = 5.0
"""Time limit of a connection to a cluster."""
LOOK_S: Final = 2.0
"""Interval of checks that the head is reachable; without it Ray waits, and then ends this process."""
_HINT: Final = (
    "Afterwards --resume goes on with what was finished; of worlds make the environment anew"
)


class _Server:
    """The process on the cluster, with the module path of this process."""

    def __init__(self, path: list[str], registering: list[str]) -> None:
        look_for_modules(path, registering)

    def begin(self, make: Callable[[], RequestHandler]) -> None:
        self._handler = make()

    def answer(self, request: Any) -> tuple[bool, Any]:
        try:
            return True, self._handler(request)
        except Exception as error:
            return False, error


class RayActor(OfOneProcess):
    """An actor like :class:`craftsim.workers.actor.Actor` on a processor of a Ray cluster."""

    _instead = "start another one"

    def __init__(self, make: Callable[[], RequestHandler]) -> None:
        """Start it on any node without waiting for it. Raises InputError without a cluster."""
        self._ray, self._head = _connect()
        _check_reachable(self._head)
        server = self._ray.remote(num_cpus=1, max_restarts=0, scheduling_strategy="SPREAD")(_Server)
        self._server = server.remote(sys.path, REGISTERING)
        self._server.begin.remote(make)
        self._answers: deque[Any] = deque()

    @property
    def due(self) -> int:
        """Number of unanswered requests."""
        return len(self._answers)

    def send(self, request: Any) -> None:
        """Send a request without waiting. Raises CraftsimError in a forked process, in which Ray is not connected."""
        self.check_process()
        self._answers.append(self._server.answer.remote(request))

    def recv(self) -> Any:
        """Wait for the next answer and return it; raises WorkerDiedError, InputError, and the handler's exceptions."""
        self.wait([self], None)
        errors = self._ray.exceptions
        try:
            good, value = self._ray.get(self._answers.popleft())
        except (errors.RayActorError, errors.ObjectLostError) as error:
            raise WorkerDiedError(f"is lost to the Ray cluster ({_first_line(error)})") from error
        except errors.RayError as error:
            raise InputError(
                f"the Ray cluster cannot do the work: {_first_line(error)}. {_HINT}"
            ) from error
        if not good:
            raise value
        return value

    def kill(self) -> None:
        """Kill the process; in a forked process only forget it."""
        if self.is_forked:
            return
        # Nothing remains of a cluster that is gone.
        with contextlib.suppress(self._ray.exceptions.RayError, InputError):
            _check_reachable(self._head)
            self._ray.kill(self._server)

    @staticmethod
    def wait(actors: Sequence[RayActor], timeout_s: float | None) -> list[RayActor]:
        """Return an actor with an answer, as soon as there is one, or none after the timeout.

        Raises InputError if the head of the cluster is not reachable.
        """
        if not actors:
            return []
        by_answer = {actor._answers[0]: actor for actor in actors}
        if timeout_s is None:
            end_s = float("inf")
        else:
            end_s = time.monotonic() + timeout_s
        while True:
            left_s = max(0.0, end_s - time.monotonic())
            ready, _ = actors[0]._ray.wait(list(by_answer), timeout=min(LOOK_S, left_s))
            if ready or left_s <= LOOK_S:
                return [by_answer[answer] for answer in ready]
            _check_reachable(actors[0]._head)


def _connect() -> tuple[Any, str]:
    """Return Ray, connected to the cluster of RAY_ADDRESS or of this machine, and the address of its head.

    Raises InputError if Ray is not installed or there is no cluster.
    """
    need("ray", "the engine 'ray' needs", "ray")
    import ray

    if not ray.is_initialized():
        try:
            _check_reachable(_address())
            _initialise(ray, "auto", logging_level=logging.WARNING)
        except (ConnectionError, ray.exceptions.RayError) as error:
            raise InputError(
                f"no Ray cluster ({_first_line(error)}); start one with 'ray start --head', or give the address of one "
                "in RAY_ADDRESS"
            ) from error
    head = _address()
    if not head.startswith("ray://"):
        head = ray.get_runtime_context().gcs_address
    return ray, head


def _initialise(ray: Any, address: str, **options: Any) -> None:
    """Connect Ray to a cluster, or start one; its processes import no modules from the working folder."""
    # They look for modules first in the folder in which Ray is initialised.
    with contextlib.chdir("/"):
        ray.init(address, log_to_driver=False, **options)


def processors() -> int:
    """Return the number of processors of the cluster, at least 1. Raises InputError without a cluster."""
    ray, _ = _connect()
    return max(1, int(ray.cluster_resources().get("CPU", 1)))


def _address() -> str:
    """Return RAY_ADDRESS, or the address of another cluster. Raises ConnectionError if there is none."""
    address = os.environ.get("RAY_ADDRESS", "auto")
    if address != "auto":
        return address
    # Ray has no public function for "auto": the last 'ray start' of this machine, which may be gone.
    from ray._private.services import canonicalize_bootstrap_address

    return str(canonicalize_bootstrap_address("auto"))


def _check_reachable(address: str) -> None:
    """Raise InputError if an address is not reachable, since Ray would try for over a minute.

    The address is ``host:port`` or ``ray://host:port``; one without a port is not checked.
    """
    try:
        url = address if "://" in address else f"//{address}"
        host = urlsplit(url).hostname
        port = urlsplit(url).port
    except ValueError as error:
        raise InputError(
            f"'{address}' is no address of a Ray cluster ({error}); RAY_ADDRESS is HOST:PORT"
        ) from None
    if not host or not port:
        return
    try:
        socket.create_connection((host, port), _REACH_S).close()
    except OSError as error:
        raise InputError(
            f"no Ray cluster answers at {address} ({error}); start one with 'ray start --head', or give the address of "
            f"one in RAY_ADDRESS; 'ray stop' forgets one of this machine that is gone. {_HINT}"
        ) from error


def _first_line(error: Exception) -> str:
    return str(getattr(error, "cause", None) or error).strip().splitlines()[0]
