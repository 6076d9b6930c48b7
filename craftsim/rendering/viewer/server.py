"""The web server of the viewer: viser, open where it was asked for or not at all."""

from __future__ import annotations

import contextlib
import errno
import io
import socket

from viser import ViserServer

from craftsim.errors import InputError
from craftsim.rendering.viewer.extra import LOOPBACK, PORT
from craftsim.rendering.viewer.guard import guarded


class LocalServer(ViserServer):
    """A server that says nothing on standard output and is not shared beyond its address."""

    def __init__(self, host: str = LOOPBACK, port: int = PORT) -> None:
        """Listen on an address and a port, any free one if it is 0.

        Raises InputError for an address or a port that cannot be had, where viser would go on to other ports, or try
        for ever.
        """
        _try(host, port)
        with contextlib.redirect_stdout(io.StringIO()), guarded(host):
            super().__init__(host=host, port=port, verbose=False)
        if port not in (0, self.get_port()):
            self.stop()
            raise InputError(_in_use(host, port))

    @property
    def address(self) -> str:
        """What to type into a browser on this machine."""
        host = self.get_host()
        shown = {"0.0.0.0": "localhost", "::": "localhost"}.get(host, f"[{host}]" if ":" in host else host)
        return f"http://{shown}:{self.get_port()}"

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
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        with socket.create_server((host, port), family=family):
            pass
    except PermissionError:
        raise InputError(f"port {port} is for the system alone; try --port {PORT}") from None
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            raise InputError(_in_use(host, port)) from None
        why = error.strerror or error
        raise InputError(f"cannot listen on {host}, port {port}: {why}; try --host {LOOPBACK}") from None


def _in_use(host: str, port: int) -> str:
    return f"port {port} of {host} is in use; try another --port, or 0 for one that is free"
