"""Designs from meshes, by trimesh's voxelisation into cells."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from craftsim.designs.pictures import design_of_cells
from craftsim.discrete.files.blueprint import MAX_SIDE
from craftsim.discrete.files.design import Design
from craftsim.discrete.geometry import CELL_PITCH_M, LEVEL_HEIGHT_M
from craftsim.errors import InputError
from craftsim.storage.limits import MESH, MESH_PIECES
from craftsim.storage.reading import read_bytes

SUFFIXES: Final = (".obj", ".stl")
_CELL_M: Final = np.array([CELL_PITCH_M, CELL_PITCH_M, LEVEL_HEIGHT_M])
_EDGE: Final = 1e-6
"""Of a cell: what lies on the border of two counts to the inner one."""


def read_mesh(path: Path, length: int | None = None) -> Design:
    """Return the design of the cells that a mesh, z up, touches or encloses.

    A block's cell is CELL_PITCH_M wide and LEVEL_HEIGHT_M high. Metres are metres, unless ``length`` says how many
    cells the longer of its sides on the floor is to have; its proportions stay.

    Raises InputError for what is no mesh, too large or too fine, and for blocks that would float.
    """
    vertices, faces = _read(path)
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
    return design_of_cells(path, _solid(corners, faces))


def _read(path: Path) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the vertices (n, 3) and faces (m, 3) of a file; nothing but it is opened, whatever it names."""
    import trimesh

    data = read_bytes(path, MESH)
    try:
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
