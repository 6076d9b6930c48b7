"""The key of robots on a network: one file, which they and who drives them have.

It holds a private key and its certificate. Both sides show by TLS 1.3 that they have it: each signs what was said in
this connection, random numbers of both included, so that nothing recorded can be shown again; the key itself is never
sent, nor compared. What follows is encrypted.
"""

from __future__ import annotations

import os
import ssl
from contextlib import suppress
from pathlib import Path
from typing import Final

from craftsim.errors import InputError
from craftsim.storage.limits import KEY
from craftsim.storage.paths import unreadable
from craftsim.storage.reading import open_file

MAKE: Final = (
    "openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes -days 3650 "
    "-subj /CN=robots -keyout robots.pem -out robots.pem"
)
"""The command that makes a key."""
_OF_OTHERS: Final = 0o077
"""Permissions of group and others."""
_CERTIFICATE: Final = "-----BEGIN CERTIFICATE-----"


def tls_of(key: Path, listens: bool) -> ssl.SSLContext:
    """Return TLS of who listens, or of who calls, in which both show that they have a key.

    Raises InputError for a file that others may read or write, and for what is no key.
    """
    text = _read(key)
    if text.count(_CERTIFICATE) != 1:
        raise _no_key(key, "it should hold one certificate and its private key")
    try:
        callee = _context(ssl.PROTOCOL_TLS_SERVER, key, text)
        caller = _context(ssl.PROTOCOL_TLS_CLIENT, key, text)
        callee.num_tickets = 0
        _try(callee, caller)
    except OSError as error:
        problem = getattr(error, "verify_message", "") or getattr(error, "reason", "")
        raise _no_key(key, problem or "no private key without a password is in it") from None
    if listens:
        return callee
    return caller


def _no_key(key: Path, problem: str) -> InputError:
    return InputError(f"{key}: no key of robots: {problem}; make one with: {MAKE}")


def _read(key: Path) -> str:
    try:
        with open_file(key, KEY) as file:
            mode = os.fstat(file.fileno()).st_mode
            data = file.read(KEY.file_bytes)
    except OSError as error:
        raise unreadable(key, error) from error
    if mode & _OF_OTHERS:
        raise InputError(
            f"{key}: others may read or change this key (mode {mode & 0o777:o}); allowed: 600 or less, by "
            f"chmod 600 {key}"
        )
    return data.decode("ascii", errors="replace")


def _context(protocol: int, key: Path, text: str) -> ssl.SSLContext:
    context = ssl.SSLContext(protocol)
    context.minimum_version = ssl.TLSVersion.TLSv1_3
    # The certificate itself is what is known, not a name in it.
    context.check_hostname = False
    context.verify_mode = ssl.CERT_REQUIRED
    # A key with a password is refused; without one here the terminal would be asked for it.
    context.load_cert_chain(key, password="")
    context.load_verify_locations(cadata=text)
    return context


def _try(callee: ssl.SSLContext, caller: ssl.SSLContext) -> None:
    """Connect both in memory, so that a key that cannot work is an error at once."""
    to_callee = ssl.MemoryBIO()
    to_caller = ssl.MemoryBIO()
    calling = caller.wrap_bio(to_caller, to_callee)
    called = callee.wrap_bio(to_callee, to_caller, server_side=True)
    for side in (calling, called, calling, called):
        with suppress(ssl.SSLWantReadError):
            side.do_handshake()
