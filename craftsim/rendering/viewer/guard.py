"""Who may talk to the viewer's web server: browsers that were given its address, and none of their other pages.

A page of another site cannot read what a server on this machine answers, but it may open a websocket to it; what it
cannot do is to hide its own Origin. One that gives its own name this machine's address afterwards (DNS rebinding) is of
the same origin as the viewer then, and betrayed by that name in Host.
"""

from __future__ import annotations

import asyncio
import contextlib
import http
import ipaddress
import logging
import socket
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from typing import Any, Final
from urllib.parse import urlsplit

import msgspec
import viser
import websockets.asyncio.server
from websockets.asyncio.server import ServerConnection
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from craftsim.storage.limits import PAGE_BYTES, PAGE_CONNECTIONS

_PROTOCOL: Final = f"viser-v{viser.__version__}"
"""Of the page that the server gives out: one that is still open from before an update should be loaded again."""
Handler = Callable[[ServerConnection], Awaitable[None]]
_QUIET: Final = logging.getLogger(__name__)
_QUIET.addHandler(logging.NullHandler())
_QUIET.propagate = False
"""What strangers send is nothing to say on this terminal."""


def why_refused(host: str, headers: Headers) -> str:
    """Return why a request to a server that listens on an address is refused; empty where it is not."""
    hosts, origins = headers.get_all("Host"), headers.get_all("Origin")
    if len(hosts) != 1 or not _is_ours(host, _name(hosts[0])):
        return f"this is no name of the viewer; open it by the address of its machine, or with --host {host}"
    if origins and (len(origins) > 1 or _place(origins[0]) != hosts[0].lower()):
        return "the viewer talks to no page but its own"
    return ""


def _is_ours(host: str, name: str) -> bool:
    """Return whether a name cannot be one that somebody else has given to this machine."""
    if name in ("localhost", host.lower(), socket.gethostname().lower()):
        return bool(name)
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def _name(place: str) -> str:
    """Return the host of ``host:port``, in lower case; empty where there is none."""
    try:
        return urlsplit(f"//{place}").hostname or ""
    except ValueError:
        return ""


def _place(origin: str) -> str:
    """Return the ``host:port`` of an Origin; empty for one that has none, such as ``null``."""
    try:
        parts = urlsplit(origin)
    except ValueError:
        return ""
    return parts.netloc.lower() if parts.scheme in ("http", "https") else ""


def _protocols(headers: Headers) -> list[str]:
    return [name.strip() for names in headers.get_all("Sec-WebSocket-Protocol") for name in names.split(",")]


@contextmanager
def guarded(host: str, allows: Callable[[dict[str, Any]], bool]) -> Iterator[None]:
    """Let the server that viser starts meanwhile refuse strangers.

    Args:
        host: address on which it listens.
        allows: says of a message of a page whether it is one that viser may see; all others are dropped.

    Raises RuntimeError for a viser that starts none, or in another way.
    """
    started = []

    class Screened(ServerConnection):
        """viser believes what pages send: it sets any property of any part of the panel to any value."""

        def connection_made(self, transport: asyncio.BaseTransport) -> None:
            """Take up a connection, and let the one go that came first where there are too many.

            They would use up the files that this process may open.
            """
            super().connection_made(transport)
            there = [each for each in self.server.handlers if not each.transport.is_closing()]
            for each in there[:-PAGE_CONNECTIONS]:
                each.transport.abort()

        async def recv(self, decode: bool | None = None) -> Any:
            while True:
                data = await super().recv(decode)
                with contextlib.suppress(msgspec.DecodeError):
                    message = msgspec.msgpack.decode(data) if isinstance(data, bytes) else None
                    if isinstance(message, dict) and allows(message):
                        return data

    class Guarded(websockets.asyncio.server.serve):
        """viser offers no place for this but the class that it takes from websockets."""

        def __init__(self, handler: Handler, *places: Any, process_request: Any, **rest: Any) -> None:
            def first(connection: ServerConnection, request: Request) -> Response | None:
                if why := why_refused(host, request.headers):
                    return connection.respond(http.HTTPStatus.FORBIDDEN, f"{why}\n")
                if "Upgrade" in request.headers and _PROTOCOL not in _protocols(request.headers):
                    # viser would say so on this terminal.
                    return connection.respond(http.HTTPStatus.BAD_REQUEST, f"{_PROTOCOL} is spoken here\n")
                response: Response | None = process_request(connection, request)
                if response is not None:
                    response.headers["Content-Security-Policy"] = "frame-ancestors 'none'"
                return response

            rest |= {"max_size": PAGE_BYTES, "logger": _QUIET, "create_connection": Screened}
            super().__init__(handler, *places, process_request=first, **rest)
            started.append(self)

    module: Any = websockets.asyncio.server
    usual, module.serve = module.serve, Guarded
    try:
        yield
    finally:
        module.serve = usual
    if not started:
        raise RuntimeError("this version of viser does not start its server as craftsim expects")
