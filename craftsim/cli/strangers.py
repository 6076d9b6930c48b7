"""Saying that other machines reach what a command opens."""

from __future__ import annotations

import ipaddress
import socket

from craftsim.cli.text import complain


def warn_of_strangers(host: str, what: str) -> None:
    """Say on standard error what people on other machines can do, unless only this machine reaches an address.

    Example:
        >>> warn_of_strangers("127.0.0.1", "drive these robots")
    """
    try:
        places = {place[4][0] for place in socket.getaddrinfo(host, None)}
    except (OSError, ValueError):
        places = {host}
    if not all(map(_is_loopback, places)):
        complain(
            f"warning: from other machines, too, anybody who reaches {host} can {what}; there is no password. "
            "Without --host only this machine can, and others by ssh -L"
        )


def _is_loopback(place: str | int) -> bool:
    try:
        return ipaddress.ip_address(str(place).partition("%")[0]).is_loopback
    except ValueError:
        return False
