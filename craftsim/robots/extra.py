"""The library that only the network needs, and where robots are reached unless told otherwise."""

from __future__ import annotations

from typing import Final

from craftsim.extras import need

LOOPBACK: Final = "127.0.0.1"
"""The address that only this machine reaches."""
PORT: Final = 5555


def need_network() -> None:
    """Raise InputError with the command that installs what is missing."""
    need("robots", "robots on a network need", "msgpack")
