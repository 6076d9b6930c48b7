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

from craftsim.discrete.files.documents import Mapping, Sequence, Source, describe
from craftsim.errors import InputError
from craftsim.models.framing import Aim
from craftsim.models.parameter_files import numbers, read_keys
from craftsim.storage.limits import Range

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
    source, given = read_keys(path, ["lookat", *_RANGES])
    missing = [key for key in ("lookat", "distance", "azimuth", "elevation") if key not in given.items]
    if missing:
        source.fail(None, f"a camera needs {', '.join(missing)}; fovy alone can be left out")
    plain = {key: node for key, node in given.items.items() if key != "lookat"}
    figures = numbers(source, Mapping(1, plain, given.key_lines), "camera", list(_RANGES))
    values = {"fovy": _FOVY_DEG}
    for key, (value, line) in figures.items():
        values[key] = _within(source, line, f"camera.{key}", value, _RANGES[key])
    return Aim(
        _lookat(source, given), values["distance"], values["azimuth"], values["elevation"], values["fovy"]
    )


def _lookat(source: Source, given: Mapping) -> NDArray[np.float64]:
    node = given.items["lookat"]
    if not isinstance(node, Sequence) or len(node.items) != 3:
        source.fail(node.line, f"camera.lookat must be a list of x, y and z in metres, not {describe(node)}")
    entries = Mapping(node.line, dict(zip("xyz", node.items, strict=True)), dict.fromkeys("xyz", node.line))
    found = numbers(source, entries, "camera.lookat", list("xyz"))
    return np.array(
        [
            _within(source, line, f"camera.lookat.{axis}", value, _LOOKAT)
            for axis, (value, line) in found.items()
        ]
    )


def _within(source: Source, line: int, name: str, value: float, allowed: Range) -> float:
    try:
        allowed.check(name, value)
    except InputError as error:
        source.fail(line, str(error))
    return value
