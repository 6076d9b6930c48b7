"""Reaching an existing Ray cluster (the optional extra ``ray``)."""

from __future__ import annotations

import logging
import os
import socket
from contextlib import chdir
from typing import Any, Final
from urllib.parse import urlsplit

from craftsim.errors import InputError
from craftsim.extras import need

REACH_S: Final = 5.0
"""How long a cluster may take to answer at its address."""
LOOK_S: Final = 2.0
"""How often one looks whether its head is still there."""


def connect(hint: str) -> tuple[Any, str]:
    """Return Ray, connected to the cluster of RAY_ADDRESS or else to one on this machine, and the address of its head.

    Args:
        hint: ends the message where no cluster answers.

    Raises:
        InputError: Ray is not installed, or there is no cluster, at the address that is given for instance.
    """
    need("ray", "the engine 'ray' needs", "ray")
    import ray

    if not ray.is_initialized():
        try:
            check_reachable(_address(), hint)
            initialise(ray, "auto", logging_level=logging.WARNING)
        except (ConnectionError, ray.exceptions.RayError) as error:
            raise InputError(
                f"no Ray cluster ({str(error).splitlines()[0]}); start one with 'ray start --head', or give the "
                "address of one in RAY_ADDRESS"
            ) from error
    head = _address()
    return ray, head if head.startswith("ray://") else ray.get_runtime_context().gcs_address


def initialise(ray: Any, address: str, **options: Any) -> None:
    """Have Ray connect to a cluster, or start one; its processes do not look for modules in the working folder."""
    # They would in the folder in which this happens, and first.
    with chdir("/"):
        ray.init(address, log_to_driver=False, **options)


def processors(ray: Any) -> int:
    """Return how many processors the cluster has, 1 at least."""
    return max(1, int(ray.cluster_resources().get("CPU", 1)))


def _address() -> str:
    """Return RAY_ADDRESS, or where else Ray finds a cluster; raise ConnectionError where it finds none."""
    given = os.environ.get("RAY_ADDRESS", "auto")
    if given != "auto":
        return given
    # Ray has no public name for where "auto" leads: the last 'ray start' of this machine, though it may be gone.
    from ray._private.services import canonicalize_bootstrap_address

    return str(canonicalize_bootstrap_address("auto"))


def check_reachable(address: str, hint: str) -> None:
    """Raise InputError, which ends with ``hint``, where nobody listens at an address: Ray would try for over a minute.

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
            f"one in RAY_ADDRESS; 'ray stop' forgets one of this machine that is gone. {hint}"
        ) from error
