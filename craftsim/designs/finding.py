"""The design that words on the command line stand for: a name of the library, pictures, or a mesh.

A picture is a PNG for each level from the floor up, a pixel for each cell; meshes are voxelised by trimesh.
"""

from __future__ import annotations

import io
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from craftsim.designs.library import LIBRARY, make_design, sizes_of
from craftsim.discrete.files.design import Design
from craftsim.discrete.geometry import CELL_PITCH_M, LEVEL_HEIGHT_M
from craftsim.discrete.grid import MAX_SIDE
from craftsim.errors import InputError
from craftsim.storage.limits import MESH, MESH_PIECES, PICTURE
from craftsim.storage.reading import read_bytes

RANDOM: Final = "random"
"""The name of a design that is drawn."""
SUFFIXES: Final = (".obj", ".stl")
"""Suffixes of meshes."""

_HEAD: Final = struct.Struct(">8s4x4sII")
"""Signature, name of the first chunk, width and height."""
_SIGNATURE: Final = b"\x89PNG\r\n\x1a\n"
_DEEP_WHITE: Final = 0xFFFF
_NAMED: Final = 8
"""Number of floating cells that an error names."""
_CELL_M: Final = np.array([CELL_PITCH_M, CELL_PITCH_M, LEVEL_HEIGHT_M])
_EDGE: Final = 1e-6
"""Tolerance, in cells: what lies on the border of two cells counts to the inner one."""


def find_design(what: Sequence[str], size: Sequence[int] = (), text: str | None = None) -> Design:
    """Return a design of the library by its name, that of PNG files, a level each, or that of a mesh.

    ``size`` holds sizes of the library's design, or of a mesh the cells of its longer side. Raises InputError for words
    that stand for none, and for sizes and text that do not fit them.
    """
    suffixes = {Path(word).suffix.lower() for word in what}
    if suffixes == {".png"} and not size and text is None:
        return read_pictures([Path(word) for word in what])
    if len(what) == 1 and suffixes <= {*SUFFIXES} and len(size) < 2 and text is None:
        return read_mesh(Path(what[0]), *size)
    if len(what) == 1 and not suffixes & {".png", *SUFFIXES}:
        return make_design(what[0], size, text)
    given = f"{' '.join(what)[:80] or 'nothing'} with {len(size)} sizes{' and a text' if text else ''}"
    raise InputError(
        f"no design is {given}; allowed: one of {', '.join(LIBRARY)}, {RANDOM}, PNG files of a level each "
        f"without --size, or one file ({', '.join(SUFFIXES)}) with one --size or none"
    )


def listing() -> str:
    """Return the names of the library with the sizes that they have unless given, a line each."""
    width = max(map(len, LIBRARY))
    rows = []
    for name in LIBRARY:
        sizes = " ".join(f"{size}={number}" for size, number in sizes_of(name).items())
        rows.append(f"{name:<{width}}  {sizes}{'  --text ABC' if name == 'letters' else ''}")
    return "\n".join(rows)


def read_pictures(paths: Sequence[Path]) -> Design:
    """Return the design that pictures show, the floor's first; x is to the right and y up.

    White and transparent pixels are background, all others blocks. Raises InputError for files that are no PNG, for
    sides that differ or are too long, for nothing but background, and for blocks that float.
    """
    if len(paths) > MAX_SIDE:
        raise InputError(f"{len(paths)} pictures; allowed: a level each, at most {MAX_SIDE}")
    levels = [_read_picture(path) for path in paths]
    for path, level in zip(paths, levels, strict=True):
        if level.shape != levels[0].shape:
            raise InputError(
                f"{path}: {level.shape[0]} x {level.shape[1]} pixels; allowed: as many as {paths[0]} has, "
                f"{levels[0].shape[0]} x {levels[0].shape[1]}"
            )
    return _design_of(paths[0], np.stack(levels, axis=2))


def _design_of(name: Path, cells: NDArray[np.bool_]) -> Design:
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


def _read_picture(path: Path) -> NDArray[np.bool_]:
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


def read_mesh(path: Path, length: int | None = None) -> Design:
    """Return the design of the cells that a mesh, z up, touches or encloses.

    A block's cell is CELL_PITCH_M wide and LEVEL_HEIGHT_M high. Metres are metres, unless ``length`` says how many
    cells the longer of its sides on the floor is to have; its proportions stay.

    Raises InputError for what is no mesh, too large or too fine, and for blocks that would float.
    """
    vertices, faces = _read_mesh(path)
    corners = vertices - vertices.min(axis=0)
    if length is not None:
        longest = corners[:, :2].max()
        if longest <= 0:
            raise InputError(
                f"{path}: the mesh has no length on the floor, so that it cannot be scaled to --size"
            )
        corners *= length * CELL_PITCH_M / longest
    # In cells, from just above 0 to just below the number of cells.
    corners /= _CELL_M
    extent = corners.max(axis=0)
    if (extent > MAX_SIDE).any():
        shown = " x ".join(f"{side:.0f}" for side in extent)
        raise InputError(f"{path}: {shown} cells; allowed: {MAX_SIDE} each way; scale it with --size")
    corners = np.minimum(np.maximum(corners, _EDGE), np.maximum(extent - _EDGE, _EDGE))
    pieces = _pieces(corners[faces])
    if pieces > MESH_PIECES:
        raise InputError(
            f"{path}: {len(faces)} faces make about {pieces:.0f} pieces of half a cell; allowed: {MESH_PIECES}; "
            "simplify the mesh, or choose a smaller --size"
        )
    return _design_of(path, _solid(corners, faces))


def _read_mesh(path: Path) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the vertices (n, 3) and faces (m, 3) of a file; nothing but it is opened, whatever it names."""
    import trimesh

    data = read_bytes(path, MESH)
    try:
        with np.errstate(invalid="ignore"):  # Numbers that are none are refused below.
            loaded: Any = trimesh.load_mesh(
                io.BytesIO(data), file_type=path.suffix[1:].lower(), skip_materials=True, process=False
            )
            mesh = loaded.to_mesh() if isinstance(loaded, trimesh.Scene) else loaded
            vertices = np.array(mesh.vertices, np.float64).reshape(-1, 3)
            faces = np.array(mesh.faces, np.int64).reshape(-1, 3)
    # Whatever a parser of others raises for a file that is none.
    except Exception as error:
        raise InputError(
            f"{path}: not a mesh that can be read: {type(error).__name__}: {str(error)[:200]}"
        ) from None
    sound = len(vertices) and len(faces) and np.isfinite(vertices).all() and np.abs(vertices).max() < 1e6
    if not sound or faces.min() < 0 or faces.max() >= len(vertices):
        raise InputError(f"{path}: not a sound mesh; allowed: faces, with corners less than 1000 km away")
    return vertices, faces


def _pieces(triangles: NDArray[np.float64]) -> float:
    """Return into about how many pieces, of half a cell each, voxelisation divides triangles (n, 3, 3)."""
    edges = np.linalg.norm(triangles - np.roll(triangles, 1, axis=1), axis=2).max(axis=1)
    return float((4.0 ** np.ceil(np.log2(np.maximum(2 * edges, 1)))).sum())


def _solid(corners: NDArray[np.float64], faces: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return (L, W, H): the cells that a surface touches or encloses."""
    import trimesh
    from scipy.ndimage import binary_fill_holes

    # A voxel is centred on whole numbers there.
    surface = trimesh.Trimesh(corners - 0.5, faces, process=False).voxelized(1.0)
    cells = np.rint(surface.points).astype(np.int64)
    touched = np.zeros(cells.max(axis=0) + 1, np.bool_)
    touched[tuple(cells.T)] = True
    filled: NDArray[np.bool_] = binary_fill_holes(touched)
    return filled
