"""Meshes as Wavefront OBJ text, with normals: flat faces stay flat, and only what is to look round is smoothed.

From a file without normals MuJoCo works out its own, and smooths over bevels and facets, which shows as gradients on
flat faces.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import trimesh
from numpy.typing import NDArray

from craftsim.mjcf.solids import Parts

_CREASE_RAD: Final = math.radians(30)
"""Faces that meet at less than this look like one round face: a bevel has 45 degrees, a cylinder of 16 sides 22.5."""


def obj(parts: Parts) -> bytes:
    """Return the OBJ text of some solids as one mesh.

    Points lie on a grid of a micrometre and normals have three decimals: the last digits of sines differ between maths
    libraries, the files must not.
    """
    lines: list[str] = []
    normals: dict[str, int] = {}
    faces: list[str] = []
    first = 1
    for part in parts:
        part.vertices = np.round(part.vertices, 6) + 0.0
        lines += [f"v {x:.6g} {y:.6g} {z:.6g}" for x, y, z in part.vertices.tolist()]
        corners = np.round(_corner_normals(part), 3) + 0.0
        for face, three in zip(part.faces.tolist(), corners.tolist(), strict=True):
            words = []
            for vertex, (x, y, z) in zip(face, three, strict=True):
                number = normals.setdefault(f"vn {x:.3g} {y:.3g} {z:.3g}", len(normals) + 1)
                words.append(f"{first + vertex}//{number}")
            faces.append(f"f {' '.join(words)}")
        first += len(part.vertices)
    return ("\n".join([*lines, *normals, *faces]) + "\n").encode()


def _corner_normals(part: trimesh.Trimesh) -> NDArray[np.float64]:
    """Return the unit normal (n, 3, 3) of each corner of each face.

    It is the mean, weighted by area, over the faces around the corner's point that meet the face at less than a crease.
    """
    own = part.face_normals
    around = part.vertex_faces[part.faces]  # (n, 3, most faces at a point), -1 where there are fewer
    near = np.einsum("ni,ncki->nck", own, own[around]) > math.cos(_CREASE_RAD)
    weights = np.where((around >= 0) & near, part.area_faces[around], 0.0)
    mean = np.einsum("nck,ncki->nci", weights, own[around])
    normal: NDArray[np.float64] = mean / np.linalg.norm(mean, axis=2, keepdims=True)
    return normal
