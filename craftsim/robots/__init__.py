"""Robots: what a machine must offer so that the skills drive it, and how it is reached over a network."""

from __future__ import annotations

from typing import Final

from craftsim.extras import need

LOOPBACK: Final = "127.0.0.1"
"""The address that only this machine reaches."""
PORT: Final = 5555
"""Where robots are reached unless another address is given."""


def need_network() -> None:
    """Raise InputError with the command that installs what a network needs, where that is missing."""
    need("robots", "robots on a network need", "msgpack")
