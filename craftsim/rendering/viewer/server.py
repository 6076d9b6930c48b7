"""The web server of the viewer: viser, on the given address only, and for its own page only.

A page of another site cannot read the answers of a server on this machine, but it may open a websocket to it: its
Origin header tells. A page whose host name is pointed to this machine afterwards (DNS rebinding) has the viewer's own
origin: that name in its Host header tells.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import http
import io
import ipaddress
import logging
import socket
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from typing import Any, Final
from urllib.parse import SplitResult, urlsplit

import msgspec
import viser
import websockets.asyncio.server
from pydantic import TypeAdapter, ValidationError
from viser import GuiButtonHandle, GuiDropdownHandle, GuiSliderHandle, ViserServer
from viser._messages import SceneNodeClickMessage, ViewerCameraMessage
from websockets.asyncio.server import ServerConnection
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from craftsim.errors import InputError
from craftsim.rendering.viewer import VIEWER_HOST, VIEWER_PORT
from craftsim.storage.limits import PAGE_BYTES, PAGE_CONNECTIONS
from craftsim.storage.paths import reason_of
from craftsim.workers.copying import NotCopyable

_POINTED: Final[dict[str, TypeAdapter[Any]]] = {
    kind.__name__: TypeAdapter(kind) for kind in (ViewerCameraMessage, SceneNodeClickMessage)
}
"""Messages about the scene, by name; viser itself only warns where one is of other types."""
_PROTOCOL: Final = f"viser-v{viser.__version__}"
"""Of the page that the server gives out: one that is still open from before an update should be loaded again."""
_Handler = Callable[[ServerConnection], Awaitable[None]]
_QUIET: Final = logging.getLogger(__name__)
_QUIET.addHandler(logging.NullHandler())
_QUIET.propagate = False
"""Invalid requests are not reported on the terminal."""


class LocalServer(NotCopyable, ViserServer):
    """A server that says nothing on standard output and is not shared beyond its address."""

    _instead = "start another one"

    def __init__(self, host: str = VIEWER_HOST, port: int = VIEWER_PORT) -> None:
        """Listen on an address and a port, 0 for a free one; InputError where viser would try others."""
        _try(host, port)
        with contextlib.redirect_stdout(io.StringIO()), guarded(host, self._allows):
            super().__init__(host=host, port=port, verbose=False)
        if port not in (0, self.get_port()):
            self.stop()
            raise InputError(_in_use(host, port))

    def _allows(self, message: dict[str, Any]) -> bool:
        """Return whether a page may send this: where its camera is, what was clicked, or a choice that there is."""
        match message:
            case {"type": "ViewerCameraMessage" | "SceneNodeClickMessage" as kind, **rest}:
                with contextlib.suppress(ValidationError):
                    _POINTED[kind].validate_python(rest)
                    return True
            case {
                "type": "GuiUpdateMessage",
                "uuid": str(part),
                "updates": {"value": value, **others},
            }:
                return not others and self._offers(part, value)
        return False

    def _offers(self, control: str, value: object) -> bool:
        # viser has no public way from the name that a page uses to the part.
        match self.gui._gui_input_handle_from_uuid.get(control):
            case GuiDropdownHandle() as choice:
                return value in choice.options
            case GuiSliderHandle() as slider:
                return isinstance(value, int | float) and slider.min <= value <= slider.max
            case GuiButtonHandle():
                return isinstance(value, bool)
        return False

    @property
    def address(self) -> str:
        """Address to type into a browser on this machine."""
        host = self.get_host()
        shown_host = {"0.0.0.0": "localhost", "::": "localhost"}.get(
            host, f"[{host}]" if ":" in host else host
        )
        return f"http://{shown_host}:{self.get_port()}"

    def stop(self) -> None:
        """Close the address and all connections."""
        with contextlib.redirect_stdout(io.StringIO()):
            super().stop()

    def request_share_url(self, verbose: bool = True) -> str | None:
        """Refuse what any page may ask of viser: a tunnel that makes it public."""
        return None


def _try(host: str, port: int) -> None:
    """Raise InputError where nothing can listen."""
    try:
        if ":" in host:
            family = socket.AF_INET6
        else:
            family = socket.AF_INET
        with socket.create_server((host, port), family=family):
            pass
    except PermissionError:
        raise InputError(f"port {port} is for the system alone; try --port {VIEWER_PORT}") from None
    except (OSError, TypeError, ValueError) as error:
        if isinstance(error, OSError) and error.errno == errno.EADDRINUSE:
            raise InputError(_in_use(host, port)) from None
        reason = reason_of(error)
        raise InputError(
            f"cannot listen on {host}, port {port}: {reason}; try --host {VIEWER_HOST}"
        ) from None


def _in_use(host: str, port: int) -> str:
    return f"port {port} of {host} is in use; try another --port, or 0 for one that is free"


_ALIVE: Final = "/alive"
"""What the page asks for now and then, to learn whether the server is still there."""
_WATCH: Final = f"""<style>
@media (max-width: 599px) {{ canvas {{ transform: translateY(-25vh) }} }}
</style>
<script>
setInterval(async () => {{
  let ended = false
  try {{ await fetch("{_ALIVE}", {{cache: "no-store"}}) }} catch {{ ended = true }}
  let note = document.getElementById("craftsim-ended")
  if (!note) {{
    note = document.createElement("div")
    note.id = "craftsim-ended"
    note.setAttribute("role", "alert")
    note.style = "position:fixed;z-index:9999;top:0;left:0;right:0;padding:0.75em;background:#c92a2a;color:white;" +
      "font-family:sans-serif;text-align:center"
    note.textContent = "craftsim has ended: nothing here is live any more. Start 'craftsim view' again."
    document.body.append(note)
  }}
  note.hidden = !ended
}}, 2000)
</script></body>""".encode()
"""Says in the page that the server has ended; viser lets its panel fade, without a word.

On a narrow screen the panel covers the lower half: the middle of the scene is moved to the middle of the upper half.
"""


def _watch_server(response: Response) -> None:
    """Add :data:`_WATCH` to a page."""
    if (
        response.headers.get("Content-Type", "").startswith("text/html")
        and b"</body>" in response.body
    ):
        before, _, after = response.body.rpartition(b"</body>")
        response.body = before + _WATCH + after
        del response.headers["Content-Length"]
        response.headers["Content-Length"] = str(len(response.body))


def refusal_of(host: str, headers: Headers) -> str:
    """Return why a request to a server that listens on an address is refused; empty where it is not."""
    hosts = headers.get_all("Host")
    origins = headers.get_all("Origin")
    if len(hosts) != 1 or not _is_ours(host, _parts(f"//{hosts[0]}").hostname or ""):
        return f"this is no name of the viewer; open it by the address of its machine, or with --host {host}"
    origin = _parts(origins[0] if origins else "")
    place = ""
    if origin.scheme in ("http", "https"):
        place = origin.netloc.lower()
    if origins and (len(origins) > 1 or place != hosts[0].lower()):
        return "the viewer talks to no page but its own"
    return ""


def _is_ours(host: str, name: str) -> bool:
    """Return whether a name cannot be one that somebody else has given to this machine."""
    if name in ("localhost", host.lower(), socket.gethostname().lower()):
        return bool(name)
    with contextlib.suppress(ValueError):
        ipaddress.ip_address(name)
        return True
    return False


def _parts(url: str) -> SplitResult:
    """Return the parts of an address; all are empty of one that is none."""
    with contextlib.suppress(ValueError):
        return urlsplit(url)
    return urlsplit("")


@contextmanager
def guarded(host: str, allows: Callable[[dict[str, Any]], bool]) -> Iterator[None]:
    """Let the server that viser starts within the block, on the address ``host``, refuse other pages.

    ``allows`` says of a message of a page whether viser may see it; all others are dropped. Raises RuntimeError for a
    viser that starts no server, or in another way.
    """
    started = []

    class Screened(ServerConnection):
        """Drops messages that viser would accept: it sets any property of any part of the panel to any value."""

        def connection_made(self, transport: asyncio.BaseTransport) -> None:
            """Take up a connection, and let the one go that came first where there are too many.

            They would use up the files that this process may open.
            """
            super().connection_made(transport)
            open_handlers = [
                handler for handler in self.server.handlers if not handler.transport.is_closing()
            ]
            for handler in open_handlers[:-PAGE_CONNECTIONS]:
                handler.transport.abort()

        async def recv(self, decode: bool | None = None) -> Any:
            while True:
                data = await super().recv(decode)
                with contextlib.suppress(msgspec.DecodeError):
                    message = None
                    if isinstance(data, bytes):
                        message = msgspec.msgpack.decode(data)
                    if isinstance(message, dict) and allows(message):
                        return data

    class Guarded(websockets.asyncio.server.serve):
        """Checks requests; viser has no hook for this but the class that it takes from websockets."""

        def __init__(
            self, handler: _Handler, *places: Any, process_request: Any, **options: Any
        ) -> None:
            def first(connection: ServerConnection, request: Request) -> Response | None:
                reason = refusal_of(host, request.headers)
                if reason:
                    return connection.respond(http.HTTPStatus.FORBIDDEN, f"{reason}\n")
                if request.path == _ALIVE:
                    return connection.respond(http.HTTPStatus.OK, "")
                spoken = ",".join(request.headers.get_all("Sec-WebSocket-Protocol")).split(",")
                if "Upgrade" in request.headers and _PROTOCOL not in map(str.strip, spoken):
                    # viser would say so on this terminal.
                    return connection.respond(
                        http.HTTPStatus.BAD_REQUEST, f"{_PROTOCOL} is spoken here\n"
                    )
                # A compressed page could not be added to.
                if "Accept-Encoding" in request.headers:
                    del request.headers["Accept-Encoding"]
                response: Response | None = process_request(connection, request)
                if response is not None:
                    _watch_server(response)
                    response.headers["Content-Security-Policy"] = "frame-ancestors 'none'"
                return response

            options |= {"max_size": PAGE_BYTES, "logger": _QUIET, "create_connection": Screened}
            super().__init__(handler, *places, process_request=first, **options)
            started.append(self)

    module: Any = websockets.asyncio.server
    usual = module.serve
    module.serve = Guarded
    try:
        yield
    finally:
        module.serve = usual
    if not started:
        raise RuntimeError("this version of viser does not start its server as craftsim expects")
