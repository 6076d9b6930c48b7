"""Designs from pictures: a PNG for each level from the floor up, a pixel for each cell."""

from __future__ import annotations

import io
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from craftsim.discrete.files.blueprint import MAX_SIDE
from craftsim.discrete.files.design import Design
from craftsim.errors import InputError
from craftsim.storage.limits import PICTURE
from craftsim.storage.reading import read_bytes

_HEAD: Final = struct.Struct(">8s4x4sII")
"""Signature, name of the first chunk, width and height."""
_SIGNATURE: Final = b"\x89PNG\r\n\x1a\n"
_DEEP_WHITE: Final = 0xFFFF
_NAMED: Final = 8
"""Floating cells that an error names."""


def read_pictures(paths: Sequence[Path]) -> Design:
    """Return the design that pictures show, the floor's first; x is to the right and y up.

    White and transparent pixels are background, all others blocks. Raises InputError for files that are no PNG, for
    sides that differ or are too long, for nothing but background, and for blocks that float.
    """
    if len(paths) > MAX_SIDE:
        raise InputError(f"{len(paths)} pictures; allowed: a level each, at most {MAX_SIDE}")
    levels = [_read(path) for path in paths]
    for path, level in zip(paths, levels, strict=True):
        if level.shape != levels[0].shape:
            raise InputError(
                f"{path}: {level.shape[0]} x {level.shape[1]} pixels; allowed: as many as {paths[0]} has, "
                f"{levels[0].shape[0]} x {levels[0].shape[1]}"
            )
    return design_of_cells(paths[0], np.stack(levels, axis=2))


def design_of_cells(name: Path, cells: NDArray[np.bool_]) -> Design:
    """Return the design of the cells (L, W, H) that are set; raise InputError for none, too many, and floating ones."""
    design = Design.of(name, ((x, y, z + 1) for x, y, z in np.argwhere(cells).tolist()))
    if floating := design.floating():
        shown = ", ".join(map(str, floating[:_NAMED])) + (
            f" and {len(floating) - _NAMED} more" if len(floating) > _NAMED else ""
        )
        raise InputError(
            f"{name}: nothing is below the blocks at {shown}; allowed: on the ground or on a block"
        )
    return design


def _read(path: Path) -> NDArray[np.bool_]:
    """Return (width, height) of a picture: where it is not background."""
    data = read_bytes(path, PICTURE)
    if len(data) < _HEAD.size or _HEAD.unpack_from(data)[:2] != (_SIGNATURE, b"IHDR"):
        raise InputError(f"{path}: not a PNG file")
    width, height = _HEAD.unpack_from(data)[2:]
    if not (0 < width <= MAX_SIDE and 0 < height <= MAX_SIDE):
        raise InputError(
            f"{path}: {width} x {height} pixels; allowed: 1 to {MAX_SIDE} each way, one for each cell"
        )
    try:
        with Image.open(io.BytesIO(data), formats=["PNG"]) as image:
            if image.size != (width, height):
                raise ValueError("sides that differ from those it begins with")
            deep = image.mode.startswith("I")
            pixels = np.asarray(image if deep else image.convert("RGBA"))
    # Whatever a parser of others raises for a file that is none.
    except Exception as error:
        raise InputError(f"{path}: damaged: {str(error)[:200] or type(error).__name__}") from None
    # What has 16 bits a pixel is grey and opaque.
    white = pixels == _DEEP_WHITE if deep else (pixels[..., :3] == 0xFF).all(axis=2) | (pixels[..., 3] == 0)
    return np.ascontiguousarray(~white[::-1].T)
