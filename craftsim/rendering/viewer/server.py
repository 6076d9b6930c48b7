"""The web server of the viewer: viser, open where it was asked for or not at all."""

from __future__ import annotations

import contextlib
import errno
import io
import socket
from typing import Any, Final

from pydantic import TypeAdapter, ValidationError
from viser import GuiButtonHandle, GuiDropdownHandle, GuiSliderHandle, ViserServer
from viser._messages import SceneNodeClickMessage, ViewerCameraMessage

from craftsim.errors import InputError
from craftsim.rendering.viewer.extra import LOOPBACK, PORT
from craftsim.rendering.viewer.guard import guarded

_POINTED: Final[dict[str, TypeAdapter[Any]]] = {
    kind.__name__: TypeAdapter(kind) for kind in (ViewerCameraMessage, SceneNodeClickMessage)
}
"""Messages about the scene, by name; viser itself only warns where one is of other types."""


class LocalServer(ViserServer):
    """A server that says nothing on standard output and is not shared beyond its address."""

    def __init__(self, host: str = LOOPBACK, port: int = PORT) -> None:
        """Listen on an address and a port, any free one if it is 0.

        Raises InputError for an address or a port that cannot be had, where viser would go on to other ports, or try
        for ever.
        """
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
            case {"type": "GuiUpdateMessage", "uuid": str(part), "updates": {"value": value, **others}}:
                return not others and self._offers(part, value)
        return False

    def _offers(self, part: str, value: object) -> bool:
        """Return whether a part of the panel can be set to a value."""
        # viser has no public way from the name that a page uses to the part.
        match self.gui._gui_input_handle_from_uuid.get(part):
            case GuiDropdownHandle() as choice:
                return value in choice.options
            case GuiSliderHandle() as slider:
                return isinstance(value, int | float) and slider.min <= value <= slider.max
            case GuiButtonHandle():
                return isinstance(value, bool)
        return False

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
    except (OSError, TypeError, ValueError) as error:
        if isinstance(error, OSError) and error.errno == errno.EADDRINUSE:
            raise InputError(_in_use(host, port)) from None
        why = getattr(error, "strerror", None) or error
        raise InputError(f"cannot listen on {host}, port {port}: {why}; try --host {LOOPBACK}") from None


def _in_use(host: str, port: int) -> str:
    return f"port {port} of {host} is in use; try another --port, or 0 for one that is free"
