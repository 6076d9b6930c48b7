"""The cells that a solid fills, from the triangles of its surface.

A cell is filled where the solid reaches 3 % of a cell or more into it, measured from each of the cell's faces: where
it meets the inner part of the cell that is left without a margin of 3 % on each side. The margin is 9.7 mm of a cell's
width and 5.6 mm of its height. It is wider than what rounding moves a border that is drawn between two cells, also in
files whose coordinates are whole centimetres (5 mm at most), and thinner than a plate of 1 cm.

Nothing is decided on a border of cells, where surfaces naturally lie: surfaces are held against the inner parts of
cells, and what lies inside is read along lines through inner points.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from craftsim.compiled.arrays import Flags, Floats
from craftsim.errors import InputError
from craftsim.storage.limits import MESH_PIECES

MARGIN_CELLS: Final = 0.03
"""Depth, in cells, to which a solid may reach into a cell from each of its faces and leave it empty."""
_MARGIN: Final = MARGIN_CELLS - 1e-4
"""A little less, so that what reaches exactly 3 % does not depend on rounding."""
_INNER_POINT: Final = (0.5613789, 0.4471993, 0.5272837)
"""A point of the inner part of a cell. It is not the middle, where edges of triangles naturally pass."""
_FLAT: Final = 1e-6
"""Height of a triangle, in cells, below which it has no area."""
_HOLE: Final = 0.01
"""Area, as a share of a cell's face, up to which a hole is taken for closed where no line passes through it."""
_CHUNK: Final = 1 << 13
"""Number of pairs of a triangle and a box that are divided at once."""


@dataclass(frozen=True)
class _Crossings:
    """Crossings of a surface with lines along one axis, through the inner points of all cells."""

    blocked: Flags
    """True for a crossing before the inner point of a cell, and after that of the cell before. Shape as the grid, but
    one longer along the axis."""
    winding: NDArray[np.int32]
    """Number of times more that the surface was entered than left at the inner point of a cell. Shape as the grid."""
    inside: Flags
    """True where the surface was crossed an odd number of times at the inner point of a cell. Shape as the grid."""
    balanced: bool
    """Each line leaves the surface as often as it enters it."""
    even: bool
    """Each line crosses the surface an even number of times."""


def number_of_cells(extent: float) -> int:
    """Return how many cells, in a row in the middle of an extent in cells, it reaches into."""
    return max(1, int(np.ceil(extent - 2 * _MARGIN)))


def number_of_levels(height: float) -> int:
    """Return how many levels a height in levels, from a floor, reaches into."""
    return max(1, int(np.ceil(height - _MARGIN)))


def filled_cells(name: str, triangles: Floats, shape: tuple[int, int, int]) -> Flags:
    """Return which cells of a grid of a shape (L, W, H) a solid fills.

    It does not matter which way the triangles face, whether parts overlap or touch, or whether there are faces inside.
    A cavity is empty where all triangles face outwards, or all inwards.

    Args:
        name: of the file, for messages.
        triangles: (n, 3, 3): corners of the surface, in cells from the corner of the grid.
        shape: of the grid.

    Raises InputError for a surface that is not closed, and for one of too many pieces.
    """
    from scipy.ndimage import label

    triangles = _without_backs(triangles[_heights(triangles) > _FLAT])
    crossings = [_crossings(name, triangles, shape, axis) for axis in range(3)]
    touched = _touched(name, triangles, shape)
    if not _encloses(crossings, touched) or _area_of_holes(triangles) > _HOLE:
        _check_no_holes(name, triangles)
    # A grid of twice the size holds the faces between cells, too: even places along one axis.
    walls = np.ones([2 * side + 1 for side in shape], np.bool_)
    walls[1::2, 1::2, 1::2] = touched
    walls[0::2, 1::2, 1::2] = crossings[0].blocked
    walls[1::2, 0::2, 1::2] = crossings[1].blocked
    walls[1::2, 1::2, 0::2] = crossings[2].blocked
    pieces, _ = label(np.pad(~walls, 1, constant_values=True))
    # Behind one more place around.
    outside = pieces[2:-2:2, 2:-2:2, 2:-2:2] == pieces[0, 0, 0]
    filled: Flags = touched | ~(outside | _cavities(crossings, touched))
    return filled


def _without_backs(triangles: Floats) -> Floats:
    """Return triangles without the second sides of a surface that is drawn from both sides, the first in order kept.

    Lines that enter such a surface leave it at once, so that all within would be taken for a cavity. A surface of which
    only some triangles have two sides, as where two boxes touch, is returned as it is.
    """
    _, numbers = np.unique(np.round(triangles.reshape(-1, 3), 6), axis=0, return_inverse=True)
    corners = numbers.reshape(-1, 3)
    smallest = np.argmin(corners, axis=1)
    turned = np.take_along_axis(corners, (smallest[:, None] + np.arange(3)) % 3, axis=1)
    sides = np.unique(turned, axis=0)
    backs = np.unique(turned[:, [0, 2, 1]], axis=0)
    if not np.array_equal(sides, backs):
        return triangles
    _, first = np.unique(np.sort(corners, axis=1), axis=0, return_index=True)
    return triangles[np.sort(first)]


def _encloses(crossings: list[_Crossings], touched: Flags) -> bool:
    """Return whether lines along all axes say the same of what is inside, as those that cross a closed surface do."""
    inside = [crossing.inside[~touched] for crossing in crossings]
    agree = all(np.array_equal(inside[0], same) for same in inside[1:])
    return agree and all(crossing.even for crossing in crossings)


def _cavities(crossings: list[_Crossings], touched: Flags) -> Flags:
    """Return the cells that the surface says are not inside of it; none where its triangles face either way."""
    windings = [crossing.winding for crossing in crossings]
    agree = all(np.array_equal(windings[0], winding) for winding in windings[1:])
    one_way = windings[0].min() >= 0 or windings[0].max() <= 0
    if not (agree and one_way and all(crossing.balanced for crossing in crossings)):
        return np.zeros_like(touched)
    cavities: Flags = ~touched & (crossings[0].winding == 0)
    return cavities


def _heights(triangles: Floats) -> Floats:
    """Return (n,): the smallest heights of triangles (n, 3, 3)."""
    sides = triangles - np.roll(triangles, 1, axis=1)
    longest = np.linalg.norm(sides, axis=2).max(axis=1)
    doubled_area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    heights: Floats = doubled_area / np.maximum(longest, 1e-300)
    return heights


def _touched(name: str, triangles: Floats, shape: tuple[int, int, int]) -> Flags:
    """Return which cells of a grid have a part of the surface in their inner part.

    Boxes of cells that a triangle meets are divided into eight until they are single cells.
    """
    touched = np.zeros(shape, np.bool_)
    eighths = np.array(list(np.ndindex(2, 2, 2)))
    # Eight boxes that are as large as a triangle hold it.
    sides = np.exp2(np.ceil(np.log2(np.maximum(np.ptp(triangles, axis=1).max(axis=1), 1)))).astype(
        np.int64
    )
    pending = []
    for side in np.unique(sides).tolist():
        members = np.flatnonzero(sides == side)
        corners = side * np.floor(triangles[members].min(axis=1) / side).astype(np.int64)
        pending.append((members, corners, 2 * side))
    divided = 0
    while pending:
        members, corners, side = pending.pop()
        if len(members) > _CHUNK:
            pending.append((members[_CHUNK:], corners[_CHUNK:], side))
            members = members[:_CHUNK]
            corners = corners[:_CHUNK]
        half = side // 2
        corners = (corners[:, None] + half * eighths).reshape(-1, 3)
        members = np.repeat(members, len(eighths))
        inside = ((corners < shape) & (corners + half > 0)).all(axis=1)
        members = members[inside]
        corners = corners[inside]
        met = _meet(triangles[members], corners + _MARGIN, corners + (half - _MARGIN))
        members = members[met]
        corners = corners[met]
        divided += len(members)
        if divided > MESH_PIECES:
            raise _too_fine(name)
        if half == 1:
            touched[tuple(corners.T)] = True
        else:
            pending.append((members, corners, half))
    return touched


def _meet(triangles: Floats, low: Floats, high: Floats) -> Flags:
    """Return which of some triangles (n, 3, 3) meet boxes, from corners (n, 3) to corners (n, 3).

    Both are convex, so that they meet unless they are apart along one of 13 directions: the normals of the box, that
    of the triangle, and the cross products of their edges (Akenine-Moeller, 2001).
    """
    met = (triangles.min(axis=1) <= high).all(axis=1) & (triangles.max(axis=1) >= low).all(axis=1)
    chosen = np.flatnonzero(met)
    half = ((high - low) / 2)[chosen]
    corners = triangles[chosen] - ((high + low) / 2)[chosen][:, None]
    edges = np.roll(corners, -1, axis=1) - corners
    directions = [np.cross(edges[:, 0], edges[:, 1])]
    for axis in np.eye(3):
        directions += [np.cross(axis, edges[:, i]) for i in range(3)]
    together = np.ones(len(chosen), np.bool_)
    for direction in directions:
        places = np.einsum("nij,nj->ni", corners, direction)
        radius = np.einsum("nj,nj->n", half, np.abs(direction))
        together &= (places.min(axis=1) <= radius) & (places.max(axis=1) >= -radius)
    met[chosen] = together
    return met


def _crossings(name: str, triangles: Floats, shape: tuple[int, int, int], axis: int) -> _Crossings:
    """Return where lines along an axis cross a surface."""
    # The axis last, the others in a circle, so that triangles keep the way that they face.
    order = [(axis + 1) % 3, (axis + 2) % 3, axis]
    turned = triangles[:, :, order] - np.array(_INNER_POINT)[order]
    rows, columns, length = (shape[i] for i in order)
    # The lines are at whole numbers now.
    first = np.maximum(np.ceil(turned[:, :, :2].min(axis=1)), 0).astype(np.int64)
    last = np.minimum(np.floor(turned[:, :, :2].max(axis=1)), (rows - 1, columns - 1)).astype(
        np.int64
    )
    counts = np.maximum(last - first + 1, 0)
    numbers = counts[:, 0] * counts[:, 1]
    if numbers.sum() > MESH_PIECES:
        raise _too_fine(name)
    entered = np.zeros((rows, columns, length + 1), np.int32)
    crossed = np.zeros((rows, columns, length + 1), np.int32)
    ends = np.cumsum(numbers)
    begin = 0
    while begin < len(turned):
        done = 0
        if begin:
            done = ends[begin - 1]
        end = max(begin + 1, int(np.searchsorted(ends, done + _CHUNK, side="right")))
        members = np.repeat(np.arange(begin, end), numbers[begin:end])
        places = np.arange(len(members)) - np.repeat(
            ends[begin:end] - numbers[begin:end] - done, numbers[begin:end]
        )
        i = first[members, 0] + places // np.maximum(counts[members, 1], 1)
        j = first[members, 1] + places % np.maximum(counts[members, 1], 1)
        sense, depth = _cross(turned[members], i, j)
        hit = sense != 0
        # Before the first inner point, between two, or behind the last.
        k = np.clip(np.ceil(depth[hit]), 0, length).astype(np.int64)
        np.add.at(entered, (i[hit], j[hit], k), sense[hit])
        np.add.at(crossed, (i[hit], j[hit], k), 1)
        begin = end
    winding = np.cumsum(entered, axis=2, dtype=np.int32)
    number = np.cumsum(crossed, axis=2, dtype=np.int32)
    back = np.argsort(order)
    return _Crossings(
        blocked=(crossed > 0).transpose(back),
        winding=winding[:, :, :-1].transpose(back),
        inside=(number[:, :, :-1] % 2 == 1).transpose(back),
        balanced=not winding[:, :, -1].any(),
        even=not (number[:, :, -1] % 2).any(),
    )


def _cross(
    triangles: Floats, i: NDArray[np.int64], j: NDArray[np.int64]
) -> tuple[NDArray[np.int64], Floats]:
    """Return where lines at (i, j) along the last axis meet triangles (n, 3, 3), one each.

    Returns (n,): 1 for a line that enters there, as it comes from below, -1 for one that leaves, and 0 for none; and
    (n,): the place on the last axis.
    """
    corners = triangles[:, :, :2] - np.stack([i, j], axis=1)[:, None]
    following = np.roll(corners, -1, axis=1)
    # Doubled areas of the triangles that the line makes with each edge: the weights of the opposite corners.
    areas = corners[:, :, 0] * following[:, :, 1] - corners[:, :, 1] * following[:, :, 0]
    enters = np.all(areas < 0, axis=1).astype(np.int64)
    leaves = np.all(areas > 0, axis=1).astype(np.int64)
    sense: NDArray[np.int64] = enters - leaves
    weights = np.roll(areas, -1, axis=1)
    total = weights.sum(axis=1)
    total[sense == 0] = 1.0
    depth: Floats = (weights * triangles[:, :, 2]).sum(axis=1) / total
    return sense, depth


def _area_of_holes(triangles: Floats) -> float:
    """Return the length of the sum of the areas of triangles as vectors: 0 for a closed surface that faces one way."""
    areas = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]) / 2
    return float(np.linalg.norm(areas.sum(axis=0)))


def _check_no_holes(name: str, triangles: Floats) -> None:
    """Raise InputError if an edge of a surface belongs to one triangle alone.

    A surface without such an edge encloses what is in it, even if it has single faces inside, as between two cells.
    """
    _, numbers = np.unique(np.round(triangles.reshape(-1, 3), 6), axis=0, return_inverse=True)
    corners = numbers.reshape(-1, 3)
    edges = np.sort(
        np.stack([corners, np.roll(corners, -1, axis=1)], axis=2).reshape(-1, 2), axis=1
    )
    distinct, count = np.unique(edges, axis=0, return_counts=True)
    lone = distinct[count == 1]
    if len(lone):
        raise InputError(
            f"{name}: not a closed surface: {len(lone)} edges belong to one face alone, so that there is no inside; "
            "allowed: closed solids; fill the holes and give thin sheets a thickness where the mesh was made"
        )


def _too_fine(name: str) -> InputError:
    return InputError(
        f"{name}: too fine: the faces pass through more than {MESH_PIECES} cells, counted for each face; simplify the "
        "mesh, or choose a smaller --size"
    )
