"""Text for people, whoever wrote it: nothing steers their terminal, and no letter that it lacks stops a command."""

from __future__ import annotations

import codecs
import io
import ipaddress
import os
import select
import socket
import sys
from typing import Final

from craftsim.reports.text import escape

_ASCII: Final = {"←": "<", "→": ">", "↑": "^", "↓": "v", "…": "."}
"""What stands for a sign that a terminal lacks, where it is not a question mark."""
_ERRORS: Final = "craftsim.plain"


def print_safe(text: object) -> None:
    """Print a text, cleaned, on standard output."""
    print(escape(text))


def print_error(text: object) -> None:
    """Print a text, cleaned, on standard error, as coming from this program."""
    print(f"craftsim: {escape(text)}", file=sys.stderr)


def replace_unencodable() -> None:
    """Let standard output and error put other signs in place of those that their encoding lacks."""
    codecs.register_error(_ERRORS, _other_signs)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors=_ERRORS)


def _other_signs(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return "".join(_ASCII.get(sign, "?") for sign in error.object[error.start : error.end]), error.end


def output_closed() -> bool:
    """Return whether standard output or error is a pipe that nobody reads from any more."""
    poll = select.poll()
    for number in (1, 2):
        poll.register(number, 0)
    return any(event & select.POLLERR for _, event in poll.poll(0))


def discard_output() -> None:
    """Drop what standard output still holds, and all that comes, so that the end of the process does not fail on it."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.close(nowhere)


def warn_if_exposed(host: str, what: str) -> None:
    """Say on standard error what people on other machines can do, unless only this machine reaches an address.

    Example:
        >>> warn_of_strangers("127.0.0.1", "drive these robots")
    """
    try:
        places = {place[4][0] for place in socket.getaddrinfo(host, None)}
    except (OSError, ValueError):
        places = {host}
    if not all(map(_is_loopback, places)):
        print_error(
            f"warning: from other machines, too, anybody who reaches {host} can {what}; there is no password. "
            "Without --host only this machine can, and others by ssh -L"
        )


def _is_loopback(place: str | int) -> bool:
    try:
        return ipaddress.ip_address(str(place).partition("%")[0]).is_loopback
    except ValueError:
        return False
