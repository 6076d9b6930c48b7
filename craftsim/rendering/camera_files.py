"""Cameras that a person writes down: YAML files, bounded in size, each mistake named by file and line. Example::

lookat: [0.65, 0.65, 0.1]
distance: 2.5
azimuth: 120
elevation: -25
fovy: 30
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from craftsim.errors import InputError
from craftsim.models.framing import Aim
from craftsim.storage.limits import Range
from craftsim.storage.yaml import Document, Loc, described, number, read_keys

_RANGES: Final = {
    "distance": Range(0.05, 1000.0),
    "azimuth": Range(-360.0, 360.0),
    "elevation": Range(-90.0, 90.0),
    "fovy": Range(1.0, 120.0),
}
_LOOKAT: Final = Range(-1000.0, 1000.0)
_FOVY_DEG: Final = 45.0
"""Where the file gives none."""


def read_aim(path: Path) -> Aim:
    """Return the camera of a YAML file: lookat (x, y, z) and distance in metres, azimuth, elevation, fovy in degrees.

    Raises InputError, naming the file and line, for what is missing, unknown, no number or out of range.
    """
    document = read_keys(path, ["lookat", *_RANGES])
    given = document.plain
    missing = [key for key in ("lookat", "distance", "azimuth", "elevation") if key not in given]
    if missing:
        document.fail((), f"a camera needs {', '.join(missing)}; fovy alone can be left out")
    values = {"fovy": _FOVY_DEG}
    for key, allowed in _RANGES.items():
        if key in given:
            values[key] = _within(document, f"camera.{key}", given[key], allowed, (key,))
    return Aim(_lookat(document), values["distance"], values["azimuth"], values["elevation"], values["fovy"])


def _lookat(document: Document) -> NDArray[np.float64]:
    given = document.plain["lookat"]
    if not isinstance(given, list) or len(given) != 3:
        text = f"camera.lookat must be a list of x, y and z in metres, not {described(given)}"
        document.fail(("lookat",), text)
    places = enumerate(zip("xyz", given, strict=True))
    return np.array(
        [
            _within(document, f"camera.lookat.{axis}", value, _LOOKAT, ("lookat", i))
            for i, (axis, value) in places
        ]
    )


def _within(document: Document, name: str, value: object, allowed: Range, loc: Loc) -> float:
    found = number(document, value, name, loc)
    try:
        allowed.check(name, found)
    except InputError as error:
        document.fail(loc, str(error))
    return found
