"""Triangles of meshes in files: OBJ, STL, PLY and binary glTF.

Counts are checked before memory is taken for them. Nothing but the file is opened, whatever it names.
"""

from __future__ import annotations

import io
import math
import re
from array import array
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from craftsim.compiled.arrays import Floats
from craftsim.errors import InputError
from craftsim.storage.limits import MESH, MESH_CORNERS, MESH_EARS, MESH_TRIANGLES, MIB, size_text
from craftsim.storage.reading import parse_json, read_bytes
from craftsim.workers.interrupts import defer_interrupts

_STL_HEAD_BYTES: Final = 84
_STL_FACET: Final = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("flags", "<u2")])
_STL_WORD: Final = re.compile(rb"\b(?:vertex\s+(\S+)\s+(\S+)\s+(\S+)|endloop)", re.IGNORECASE)
_FAR: Final = 1e6
"""Largest coordinate."""
_DIGITS: Final = 100
"""Smallest ratio of a mesh's extent to the steps of the numbers of its file."""
_GLB_HEAD_BYTES: Final = 20
_GLB_PARTS: Final = 2000
"""Number of nodes, and of arrays, of a glTF file."""
_GLB_ENTRIES: Final = 8 * MESH_TRIANGLES
"""Number of entries of all arrays of a glTF file: three corners of each triangle, and what belongs to a corner."""
_PLY_ELEMENT: Final = re.compile(rb"^\s*element\s+(\S+)\s+(\d{1,18})\s*$", re.MULTILINE)
_PLY_END: Final = re.compile(rb"^\s*end_header\s*$", re.MULTILINE)
_TRY_EXPORT: Final = "export it again as OBJ or STL"


def read_triangles(path: Path) -> Floats:
    """Return (n, 3, 3): the corners of the triangles of a mesh in the units of the file; polygons are divided.

    Raises InputError for what is no such file, damaged, without a face, too large, or has numbers that are none.
    """
    data = read_bytes(path, MESH)
    if not data.strip():
        raise InputError(
            f"{path}: the file is empty; allowed: {', '.join(READERS)} with faces; {_TRY_EXPORT}"
        )
    triangles = READERS[path.suffix.lower()](path, data)
    if not len(triangles):
        raise InputError(
            f"{path}: no faces; allowed: at least 4, which enclose a solid; {_TRY_EXPORT}"
        )
    sound = np.isfinite(triangles).all(axis=(1, 2))
    if not sound.all():
        raise InputError(
            f"{path}: face {int(np.argmin(sound)) + 1} has a corner that is NaN or infinite; "
            f"allowed: finite coordinates; {_TRY_EXPORT}"
        )
    furthest = np.abs(triangles).max()
    if furthest > _FAR:
        raise InputError(
            f"{path}: a corner at {furthest:.3g}; allowed: coordinates up to {_FAR:.0f} from 0; move the mesh there"
        )
    return triangles


def _read_obj(path: Path, data: bytes) -> Floats:
    """Return the triangles of an OBJ file; all but vertices and faces is ignored."""
    points = array("d")
    faces: dict[int, array[int]] = {}
    triangles = 0
    text = io.TextIOWrapper(io.BytesIO(data), encoding="latin-1", newline=None)
    continued = ""
    for number, line in enumerate(text, start=1):
        if line.endswith("\\\n"):
            continued += line[:-2] + " "
            continue
        words = (continued + line).partition("#")[0].split()
        continued = ""
        if not words:
            continue
        if words[0] == "v":
            points.extend(_numbers(path, number, words[1:4]))
        elif words[0] == "f":
            corners = [_obj_index(path, number, word, len(points) // 3) for word in words[1:]]
            if not 3 <= len(corners) <= MESH_CORNERS:
                raise InputError(
                    f"{path}:{number}: a face of {len(corners)} corners; allowed: 3 to {MESH_CORNERS}; "
                    "divide it into triangles where the mesh was made"
                )
            triangles += len(corners) - 2
            _check_number(path, triangles)
            faces.setdefault(len(corners), array("q")).extend(corners)
    if points:
        places = np.frombuffer(points, np.float64).reshape(-1, 3)
    else:
        places = np.empty((0, 3))
    polygons = []
    for n_corners in sorted(faces):
        numbers = np.frombuffer(faces[n_corners], np.int64).reshape(-1, n_corners)
        polygons.append(_divided(path, places[numbers]))
    if polygons:
        return np.concatenate(polygons)
    return np.empty((0, 3, 3))


def _numbers(path: Path, line: int, words: Sequence[str | bytes]) -> list[float]:
    """Return the coordinates of a vertex."""
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        raise InputError(
            f"{path}:{line}: a vertex with a word that is no number; {_TRY_EXPORT}"
        ) from None
    if len(numbers) != 3:
        raise InputError(f"{path}:{line}: a vertex of {len(numbers)} numbers; allowed: x, y and z")
    if not all(map(math.isfinite, numbers)):
        raise InputError(
            f"{path}:{line}: a vertex that is NaN or infinite; allowed: finite coordinates; {_TRY_EXPORT}"
        )
    return numbers


def _obj_index(path: Path, line: int, word: str, n_vertices: int) -> int:
    """Return the place, from 0, of the vertex that a corner of a face names: from 1 on, or from the last one, -1."""
    try:
        index = int(word.split("/")[0])
    except ValueError:
        raise InputError(
            f"{path}:{line}: a face with a corner '{word[:20]}'; allowed: numbers of vertices"
        ) from None
    if index > 0:
        place = index - 1
    else:
        place = n_vertices + index
    if index == 0 or not 0 <= place < n_vertices:
        raise InputError(
            f"{path}:{line}: a face with vertex {index}; allowed: the {n_vertices} vertices before it, from 1"
        )
    return place


def _read_stl(path: Path, data: bytes) -> Floats:
    """Return the triangles of an STL file; a binary one may begin with "solid", as ASCII ones do."""
    n_facets = 0
    if len(data) >= _STL_HEAD_BYTES:
        n_facets = int.from_bytes(data[80:84], "little")
    fits = len(data) == _STL_HEAD_BYTES + n_facets * _STL_FACET.itemsize
    if len(data) >= _STL_HEAD_BYTES and fits:
        _check_number(path, n_facets)
        facets = np.frombuffer(data, _STL_FACET, offset=_STL_HEAD_BYTES)
        with np.errstate(invalid="ignore"):  # Numbers that are none are refused later.
            triangles = facets["corners"].astype(np.float64)
        _check_digits(path, triangles)
        return triangles
    if data[:1024].lstrip()[:5].lower() == b"solid" and b"\0" not in data:
        return _read_ascii_stl(path, data)
    n_present = max(0, len(data) - _STL_HEAD_BYTES) / _STL_FACET.itemsize
    if len(data) < _STL_HEAD_BYTES:
        raise InputError(
            f"{path}: not an STL file: neither 'solid' at its beginning nor the {_STL_HEAD_BYTES} bytes of a binary "
            f"head; {_TRY_EXPORT}"
        )
    raise InputError(
        f"{path}: damaged: a binary STL file that says {n_facets} facets and has {n_present:.10g}; {_TRY_EXPORT}"
    )


def _check_digits(path: Path, triangles: Floats) -> None:
    """Raise InputError where a mesh is so far from 0 that numbers of 32 bits do not tell its corners apart."""
    corners = triangles.reshape(-1, 3)
    if not len(corners) or not np.isfinite(corners).all():
        return
    step = float(np.spacing(np.float32(np.abs(corners).max())))
    extent = float(np.ptp(corners, axis=0).max())
    if extent < _DIGITS * step:
        raise InputError(
            f"{path}: the mesh is {extent:.3g} long, and so far from 0 that binary STL rounds its corners to "
            f"{step:.2g}; move it to 0 before it is exported, or export OBJ"
        )


def _read_ascii_stl(path: Path, data: bytes) -> Floats:
    """Return the triangles of an ASCII STL file."""
    text = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    head = text.find(b"\n") + 1
    if not head:
        return np.empty((0, 3, 3))
    numbers = array("d")
    done = 0
    line = 2
    counted = head
    for word in _STL_WORD.finditer(text, head):
        line += text.count(b"\n", counted, word.start())
        counted = word.start()
        if word[1] is not None:
            numbers.extend(_numbers(path, line, [word[1], word[2], word[3]]))
            continue
        if len(numbers) - done != 9:
            raise InputError(
                f"{path}:{line}: a facet that ends with {(len(numbers) - done) // 3} vertices; allowed: 3; "
                f"{_TRY_EXPORT}"
            )
        done = len(numbers)
        _check_number(path, done // 9)
    if done != len(numbers):
        raise InputError(f"{path}: damaged: the file ends inside of a facet; {_TRY_EXPORT}")
    if not numbers:
        return np.empty((0, 3, 3))
    return np.frombuffer(numbers, np.float64).reshape(-1, 3, 3)


def _read_ply(path: Path, data: bytes) -> Floats:
    """Return the triangles of a PLY file."""
    with defer_interrupts():
        import trimesh

    end = _PLY_END.search(data[:65536])
    if not data.startswith(b"ply") or end is None:
        raise InputError(
            f"{path}: not a PLY file: no head that begins with 'ply' and ends with 'end_header'"
        )
    counts = {name: int(number) for name, number in _PLY_ELEMENT.findall(data[: end.start()])}
    n_faces = counts.get(b"face", 0)
    _check_number(path, n_faces)
    # An element takes a byte at least.
    if max(counts.values(), default=0) > len(data):
        raise InputError(
            f"{path}: damaged: the head says more elements than the file has bytes; {_TRY_EXPORT}"
        )
    if not n_faces:
        return np.empty((0, 3, 3))
    try:
        with np.errstate(invalid="ignore"):  # Numbers that are none are refused later.
            loaded: Any = trimesh.load_mesh(
                io.BytesIO(data), file_type="ply", skip_materials=True, process=False
            )
            vertices = np.array(loaded.vertices, np.float64).reshape(-1, 3)
            faces = np.array(loaded.faces, np.int64).reshape(-1, 3)
    # Whatever a parser of others raises for a file that is none.
    except Exception as error:
        raise InputError(
            f"{path}: not a mesh that can be read: {type(error).__name__}: {str(error)[:200]}; {_TRY_EXPORT}"
        ) from None
    if len(faces) < n_faces:
        raise InputError(
            f"{path}: damaged: the head says {n_faces} faces, and there are {len(faces)}; {_TRY_EXPORT}"
        )
    if len(faces) > n_faces:
        raise InputError(
            f"{path}: {n_faces} faces are {len(faces)} triangles; allowed: a PLY file of triangles alone; triangulate "
            "the mesh, or export it as OBJ"
        )
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise InputError(
            f"{path}: a face with vertex {int(max(faces.max(), -faces.min()))}; allowed: the {len(vertices)} vertices, "
            "from 0"
        )
    return vertices[faces]


def _read_glb(path: Path, data: bytes) -> Floats:
    """Return the triangles of a binary glTF file, turned so that its y, which is up there, is z."""
    with defer_interrupts():
        import trimesh

    if data[:4] != b"glTF" or data[16:20] != b"JSON":
        raise InputError(
            f"{path}: not a binary glTF file: it does not begin with 'glTF' and a part 'JSON'"
        )
    length = int.from_bytes(data[12:16], "little")
    if length > MIB:
        raise InputError(
            f"{path}: a head of {size_text(length)}; allowed: {size_text(MIB)}; export it without what is no mesh"
        )
    document = parse_json(data[_GLB_HEAD_BYTES : _GLB_HEAD_BYTES + length], str(path))
    try:
        triangles = _glb_triangles(path, document)
        _check_number(path, triangles)
        if not triangles:
            return np.empty((0, 3, 3))
        with np.errstate(all="ignore"):  # Numbers that are none are refused later.
            loaded: Any = trimesh.load_mesh(
                io.BytesIO(data), file_type="glb", skip_materials=True, process=False
            )
            if isinstance(loaded, trimesh.Scene):
                mesh = loaded.to_mesh()
            else:
                mesh = loaded
            corners = np.array(mesh.vertices, np.float64)[np.array(mesh.faces, np.int64)]
    except InputError:
        raise
    # Whatever a parser of others, or a document of another form, raises.
    except Exception as error:
        raise InputError(
            f"{path}: damaged: {type(error).__name__}: {str(error)[:200]}; export it again, or as STL, z up"
        ) from None
    right, up, backward = np.moveaxis(corners, 2, 0)
    return np.stack([right, -backward, up], axis=2)


def _glb_triangles(path: Path, document: Any) -> int:
    """Return how many triangles the nodes of a glTF document show, a mesh that several show several times.

    Raises InputError for what has too many parts, and for packed meshes.
    """
    nodes = document.get("nodes", [])
    accessors = document.get("accessors", [])
    children = []
    for node in nodes:
        for child in node.get("children", []):
            children.append(child)
    if document.get("extensionsRequired"):
        extensions = ", ".join(map(str, document["extensionsRequired"]))[:80]
        raise InputError(
            f"{path}: needs {extensions}; allowed: meshes that are not packed; export it without that"
        )
    if len(nodes) > _GLB_PARTS or len(accessors) > _GLB_PARTS or len(children) > len(set(children)):
        raise InputError(
            f"{path}: {len(nodes)} nodes, {len(accessors)} arrays; allowed: at most {_GLB_PARTS}, and each node below "
            "one other; join the parts where the mesh was made"
        )
    counts = [int(accessor["count"]) for accessor in accessors]
    if min(counts, default=0) < 0 or sum(counts) > _GLB_ENTRIES:
        raise InputError(f"{path}: arrays of {sum(counts)} entries; simplify the mesh")
    triangles = 0
    for node in nodes:
        if node.get("mesh") is None:
            continue
        for primitive in document["meshes"][node["mesh"]]["primitives"]:
            corners = primitive.get("indices", primitive["attributes"]["POSITION"])
            triangles += counts[corners] // 3
    return triangles


READERS: Final[dict[str, Callable[[Path, bytes], Floats]]] = {
    ".obj": _read_obj,
    ".stl": _read_stl,
    ".ply": _read_ply,
    ".glb": _read_glb,
}
"""Readers of files by suffix."""


def _check_number(path: Path, triangles: int) -> None:
    if triangles > MESH_TRIANGLES:
        raise InputError(
            f"{path}: {triangles} triangles or more; allowed: at most {MESH_TRIANGLES}; simplify the mesh"
        )


def _divided(path: Path, polygons: Floats) -> Floats:
    """Return triangles (m, 3, 3) of flat polygons (n, corners, 3), convex or not."""
    n_corners = polygons.shape[1]
    if n_corners == 3:
        return polygons
    following = np.roll(polygons, -1, axis=1)
    # Newell's normal of a polygon that may be a little uneven.
    normals = np.cross(polygons, following).sum(axis=1)
    bends = np.cross(following - polygons, np.roll(following, -1, axis=1) - following)
    along = np.einsum("ncj,nj->nc", bends, normals)
    convex = (along >= -1e-9 * np.abs(along).max(axis=1, keepdims=True)).all(axis=1)
    fans = polygons[convex]
    triangles = [
        np.stack([fans[:, 0], fans[:, i], fans[:, i + 1]], axis=1) for i in range(1, n_corners - 1)
    ]
    if np.count_nonzero(~convex) * n_corners**2 > MESH_EARS:
        raise InputError(
            f"{path}: {np.count_nonzero(~convex)} faces of {n_corners} corners that are not convex; allowed: at most "
            f"{MESH_EARS // n_corners**2}; triangulate the mesh where it was made"
        )
    for polygon, normal in zip(polygons[~convex], normals[~convex], strict=True):
        triangles.append(_cut_ears(polygon, normal))
    return np.concatenate(triangles)


def _cut_ears(polygon: Floats, normal: Floats) -> Floats:
    """Return triangles (m, 3, 3) of a polygon (n, 3) that is not convex, cutting one corner after the other."""
    axis = int(np.argmax(np.abs(normal)))
    flat = np.delete(polygon, axis, axis=1)
    sense = np.sign(normal[axis])
    if axis == 1:
        sense = -sense
    remaining = list(range(len(polygon)))
    triangles = []
    while len(remaining) > 3:
        numbers = np.array(remaining)
        before = flat[np.roll(numbers, 1)]
        corners = flat[numbers]
        after = flat[np.roll(numbers, -1)]
        areas = sense * _doubled_area(before, corners, after)
        # Of a polygon that crosses itself there may be none.
        ear = int(np.argmin(np.abs(areas)))
        for i in np.flatnonzero(areas > 0).tolist():
            if _is_ear(sense, before[i], corners[i], after[i], corners):
                ear = i
                break
        triangles.append(
            [remaining[ear - 1], remaining[ear], remaining[(ear + 1) % len(remaining)]]
        )
        del remaining[ear]
    triangles.append(remaining)
    return polygon[np.array(triangles)]


def _doubled_area(a: Floats, b: Floats, c: Floats) -> Floats:
    first = b - a
    second = c - a
    areas: Floats = first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0]
    return areas


def _is_ear(sense: float, a: Floats, b: Floats, c: Floats, points: Floats) -> bool:
    """Return whether a triangle has none of other points inside, corners of its own aside."""
    inside = (
        (sense * _doubled_area(a, b, points) >= 0)
        & (sense * _doubled_area(b, c, points) >= 0)
        & (sense * _doubled_area(c, a, points) >= 0)
    )
    for corner in (a, b, c):
        inside &= (points != corner).any(axis=1)
    return not inside.any()
