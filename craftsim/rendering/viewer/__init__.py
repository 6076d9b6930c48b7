"""The viewer in the browser: recorded runs and running ones; needs the extra ``view``."""

from __future__ import annotations

from importlib.util import find_spec
from typing import Final

from craftsim.storage.extras import need

VIEWER_HOST: Final = "127.0.0.1"
"""The address that only this machine reaches."""
VIEWER_PORT: Final = 8080


def has_viser() -> bool:
    """Return whether the library that only the viewer needs is installed here."""
    return find_spec("viser") is not None


def need_viser() -> None:
    """Raise InputError with the command that installs what is missing."""
    need("view", "the viewer needs", "viser")
