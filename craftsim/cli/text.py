"""Printing of untrusted text: control characters are escaped, and unencodable characters never stop a command."""

from __future__ import annotations

import codecs
import io
import os
import select
import sys
from typing import Final

from craftsim.reports.text import escape

_ASCII: Final = {"←": "<", "→": ">", "↑": "^", "↓": "v", "…": "."}
"""Replacements of unencodable characters; the default is a question mark."""
_ERRORS: Final = "craftsim.plain"


def print_safe(text: object) -> None:
    """Print an escaped text on standard output."""
    print(escape(text))


def print_error(text: object) -> None:
    """Print an escaped text on standard error, with the name of the program."""
    print(f"craftsim: {escape(text)}", file=sys.stderr)


def replace_unencodable() -> None:
    """Let standard output and error replace characters that their encoding lacks."""

    def other_signs(error: UnicodeError) -> tuple[str, int]:
        if not isinstance(error, UnicodeEncodeError):
            raise error
        return "".join(
            _ASCII.get(sign, "?") for sign in error.object[error.start : error.end]
        ), error.end

    codecs.register_error(_ERRORS, other_signs)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors=_ERRORS)


def output_closed() -> bool:
    """Return whether standard output or error is a pipe without a reader."""
    poll = select.poll()
    for number in (1, 2):
        poll.register(number, 0)
    return any(event & select.POLLERR for _, event in poll.poll(0))


def discard_output() -> None:
    """Discard buffered and further output, so that the process can exit without an error."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.close(nowhere)


def warn_if_exposed(host: str, action: str) -> None:
    """Warn on standard error if an address can be reached from other machines.

    Example:
        >>> warn_if_exposed("127.0.0.1", "look on")
    """
    from craftsim.robots.sockets import is_loopback

    try:
        local = is_loopback(host)
    except (OSError, ValueError):
        local = False
    if not local:
        print_error(
            f"warning: from other machines, too, anybody who reaches {host} can {action}; there is no password. "
            "Without --host only this machine can, and others by ssh -L"
        )
