"""Cameras that a person writes down: YAML files. Example::

lookat: [0.65, 0.65, 0.1]
distance: 2.5
azimuth: 120
elevation: -25
fovy: 30
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np

from craftsim.models.framing import Aim
from craftsim.storage.limits import Range
from craftsim.storage.records import record
from craftsim.storage.yaml import read_document

_Metres = Annotated[float, Range(-1000.0, 1000.0)]


@record(kw_only=True)
class _File:
    lookat: tuple[_Metres, _Metres, _Metres]
    distance: Annotated[float, Range(0.05, 1000.0)]
    azimuth: Annotated[float, Range(-360.0, 360.0)]
    elevation: Annotated[float, Range(-90.0, 90.0)]
    fovy: Annotated[float, Range(1.0, 120.0)] = 45.0


def read_aim(path: Path) -> Aim:
    """Return the camera of a YAML file: lookat (x, y, z) and distance in metres, azimuth, elevation, fovy in degrees.

    Raises InputError, naming the file and line, for what is missing, unknown, no number or out of range.
    """
    file = read_document(path).to(_File)
    return Aim(np.array(file.lookat), file.distance, file.azimuth, file.elevation, file.fovy)
