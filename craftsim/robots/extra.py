"""The libraries that only the network needs, and where robots are reached unless told otherwise."""

from __future__ import annotations

from importlib.util import find_spec
from typing import Final

from craftsim.errors import InputError

LOOPBACK: Final = "127.0.0.1"
"""The address that only this machine reaches."""
PORT: Final = 5555


def need_network() -> None:
    """Raise InputError with the command that installs what is missing."""
    missing = [
        name for name, module in (("pyzmq", "zmq"), ("msgpack", "msgpack")) if find_spec(module) is None
    ]
    if missing:
        raise InputError(
            f"robots on a network need {' and '.join(missing)}, not installed here; in a checkout of craftsim try: "
            "pip install '.[robots]'"
        )
