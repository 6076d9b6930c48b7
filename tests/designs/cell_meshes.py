"""Buildings drawn cell by cell, and files of meshes that show them."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.geometry import CELL_PITCH_M, LEVEL_HEIGHT_M

CELL_M: Final = np.array([CELL_PITCH_M, CELL_PITCH_M, LEVEL_HEIGHT_M])
_CORNERS: Final = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.float64)
_QUADS: Final = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
"""The faces of a cube, seen from outside counterclockwise."""

SHAPES: Final[dict[str, tuple[str, ...]]] = {
    "stair": ("123",),
    "towers": ("11011",),
    "ring": ("1111", "1001", "1001", "1111"),
    "court": ("33333", "30003", "30003", "33333"),
    "two_cubes": ("101",),
    "ell": ("100", "100", "111"),
    "u": ("101", "101", "111"),
    "checker": ("1010", "0101", "1010", "0101"),
    "pyramid": ("11111", "12221", "12321", "12221", "11111"),
    "wall": ("222222",),
    "platform": ("1111", "1111", "1111"),
    "cube": ("1",),
    "tower": ("4",),
    "diagonal": ("200", "010", "003"),
    "odd": ("3100", "0120", "1004"),
}
"""Heights in cells, the row with the largest y first."""


def heights_of(shape: str) -> NDArray[np.int64]:
    """Return (L, W): the heights of a shape."""
    rows = [[int(sign) for sign in row] for row in SHAPES[shape]]
    return np.array(rows)[::-1].T


def cells_of(heights: NDArray[np.int64]) -> set[tuple[int, int, int]]:
    """Return the filled cells (x, y, level)."""
    return {
        (int(x), int(y), z + 1)
        for x, y in np.argwhere(heights > 0)
        for z in range(int(heights[x, y]))
    }


def cubes(cells: Sequence[tuple[int, int, int]]) -> NDArray[np.float64]:
    """Return the faces (n, 4, 3), in cells, of a cube for each cell, also where two cubes touch."""
    faces = [_CORNERS[list(quad)] + (x, y, z - 1) for x, y, z in sorted(cells) for quad in _QUADS]
    return np.array(faces)


def columns(heights: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the faces (n, 4, 3), in cells, of a box for each column."""
    faces = []
    for x, y in np.argwhere(heights > 0).tolist():
        box = _CORNERS * (1, 1, heights[x, y]) + (x, y, 0)
        faces += [box[list(quad)] for quad in _QUADS]
    return np.array(faces)


def hull(cells: Sequence[tuple[int, int, int]]) -> NDArray[np.float64]:
    """Return the faces (n, 4, 3), in cells, between filled cells and empty ones."""
    filled = set(cells)
    faces = []
    for x, y, z in sorted(filled):
        for quad in _QUADS:
            corners = _CORNERS[list(quad)]
            step = np.rint(2 * (corners.mean(axis=0) - 0.5)).astype(int).tolist()
            if (x + step[0], y + step[1], z + step[2]) not in filled:
                faces.append(corners + np.array([x, y, z - 1]))
    return np.array(faces)


def triangles(faces: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return two triangles (2 n, 3, 3) for each face."""
    return np.concatenate([faces[:, [0, 1, 2]], faces[:, [0, 2, 3]]])


def split(facets: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.float64]:
    """Return triangles of which about half are divided at a random place of their longest edge."""
    divided = []
    for facet in facets:
        if rng.random() < 0.5:
            divided.append(facet)
            continue
        lengths = np.linalg.norm(facet - np.roll(facet, -1, axis=0), axis=1)
        first = int(np.argmax(lengths))
        a, b, c = np.roll(facet, -first, axis=0)
        share = rng.uniform(0.1, 0.9)
        middle = a + share * (b - a)
        divided += [np.array([a, middle, c]), np.array([middle, b, c])]
    return np.array(divided)


def write_mesh(path: Path, facets: NDArray[np.float64], ascii_stl: bool = False) -> Path:
    """Write triangles as the format that the name's ending says, OBJ or STL."""
    if path.suffix == ".obj":
        lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in facets.reshape(-1, 3).tolist()]
        lines += [f"f {3 * i + 1} {3 * i + 2} {3 * i + 3}" for i in range(len(facets))]
        path.write_text("\n".join(lines) + "\n")
    elif ascii_stl:
        lines = ["solid drawn"]
        for facet in facets.tolist():
            lines += ["facet normal 0 0 0", "outer loop"]
            lines += [f"vertex {x:.9g} {y:.9g} {z:.9g}" for x, y, z in facet]
            lines += ["endloop", "endfacet"]
        path.write_text("\n".join([*lines, "endsolid drawn"]) + "\n")
    else:
        record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("flags", "<u2")])
        records = np.zeros(len(facets), record)
        records["corners"] = facets
        path.write_bytes(
            b"solid drawn".ljust(80) + struct.pack("<I", len(facets)) + records.tobytes()
        )
    return path
