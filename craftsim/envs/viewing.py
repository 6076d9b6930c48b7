"""Viewing an environment in the browser while it runs."""

from __future__ import annotations

from typing import Any

from craftsim.envs.core import Core
from craftsim.envs.physics_backend import PhysicsBackend
from craftsim.errors import InputError
from craftsim.rendering.viewer.extra import LOOPBACK, PORT
from craftsim.rendering.viewer.live import LiveView
from craftsim.rendering.viewer.page import AS_IT_GOES


def view(env: Any, host: str = LOOPBACK, port: int = PORT, speed: str = AS_IT_GOES) -> LiveView:
    """Show a running environment in the browser: PettingZoo's, Gymnasium's, or what wraps one, in physics.

    Args:
        env: the environment, before or after its reset.
        host: address to listen on, of this machine alone unless another is given.
        port: of that address; 0 takes one that is free.
        speed: the page's choice of the speed at first: ``as it goes``, ``1 x`` and so on.

    Raises InputError for what is no environment of craftsim in physics, where viser is missing, and for an address or
    a port that cannot be had.

    Example:
        >>> import craftsim
        >>> env = craftsim.parallel_env("strip")
        >>> with craftsim.view(env, port=0) as page:
        ...     observations, infos = env.reset(seed=0)
        >>> page.address.startswith("http://127.0.0.1:")
        True
    """
    inner = env
    while inner is not None and not isinstance(getattr(inner, "core", None), Core):
        inner = getattr(inner, "env", None)
    if inner is None or not isinstance(inner.core.backend, PhysicsBackend):
        raise InputError(
            f"{env!r} cannot be viewed; allowed: an environment of craftsim with backend='physics', a single one"
        )
    opened = LiveView(host, port, speed)
    inner.core.backend.follow(opened)
    return opened
