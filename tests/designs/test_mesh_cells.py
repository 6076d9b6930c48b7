"""The cells that a mesh fills: the drawn ones, however they are drawn and written, wherever they lie."""

from fractions import Fraction
from itertools import product

import numpy as np
import pytest
import trimesh
from designs.cell_meshes import (
    CELL_M,
    SHAPES,
    cells_of,
    columns,
    cubes,
    heights_of,
    hull,
    split,
    triangles,
    write_mesh,
)
from scipy.optimize import linprog
from scipy.spatial import ConvexHull

from craftsim.designs.finding import read_mesh
from craftsim.designs.solids import MARGIN_CELLS, filled_cells
from craftsim.discrete.grid import Kind
from craftsim.errors import InputError

ORIGINS = ((0, 0, 0), (0.1, -7.3, 0.7), (1000 / 3, -123.456, 10))
SCALES = (None, 1e-3, 1000 / 3, 7.7)
FORMATS = (("obj", False), ("stl", False), ("stl", True))


def _blocks(path, length=None):
    return {*read_mesh(path, length).of_kind(Kind.BLOCK)}


def _drawn(shape):
    """Return the cells of a shape, its triangles in metres, and the cells of its longer side."""
    heights = heights_of(shape)
    return cells_of(heights), triangles(cubes(cells_of(heights))) * CELL_M, max(heights.shape)


@pytest.mark.parametrize("shape", SHAPES)
def test_a_mesh_drawn_cell_by_cell_gives_the_drawn_cells_at_any_place_scale_and_format(
    shape, tmp_path
):
    want, facets, length = _drawn(shape)
    for origin, scale, (suffix, is_ascii) in product(ORIGINS, SCALES, FORMATS):
        moved = (facets + np.array(origin)) * (scale or 1)
        path = write_mesh(tmp_path / f"a.{suffix}", moved, is_ascii)
        assert _blocks(path, None if scale is None else length) == want, (
            origin,
            scale,
            suffix,
            is_ascii,
        )


@pytest.mark.parametrize("shape", SHAPES)
def test_cubes_columns_and_hulls_in_any_order_and_division_are_one_building(shape, tmp_path):
    want, facets, length = _drawn(shape)
    rng = np.random.default_rng(1)
    heights = heights_of(shape)
    single = np.concatenate([hull(want), _faces_inside(want)])
    ways = {
        "columns": triangles(columns(heights)) * CELL_M,
        "hull": triangles(hull(want)) * CELL_M,
        "single faces inside": triangles(single) * CELL_M,
        "twice": np.concatenate([facets, facets]),
        "inside out": facets[:, ::-1],
        "some cubes inside out": _turned_cubes(facets, rng),
        "facets either way": np.where(
            rng.random((len(facets), 1, 1)) < 0.5, facets, facets[:, ::-1]
        ),
        "any order": rng.permutation(facets),
        "divided": split(split(triangles(hull(want)) * CELL_M, rng), rng),
        "cubes divided": split(facets, rng),
        "rounded to millimetres": np.round(facets, 3),
        "rounded to centimetres": np.round(facets, 2),
        "uneven": facets + rng.uniform(-1e-5, 1e-5, facets.shape),
    }
    for way, drawn in ways.items():
        assert _blocks(write_mesh(tmp_path / "a.obj", drawn)) == want, way
        # Divided by a length that is a centimetre off, a high building is off by more.
        if way != "rounded to centimetres":
            assert _blocks(write_mesh(tmp_path / "a.stl", drawn * 1000), length) == want, way


@pytest.mark.parametrize("shape", SHAPES)
def test_quarter_turns_and_mirrors_turn_and_mirror_the_building(shape, tmp_path):
    want, facets, length = _drawn(shape)
    grid = np.zeros(np.max([*want], axis=0) + np.array([1, 1, 0]), np.bool_)
    for x, y, z in want:
        grid[x, y, z - 1] = True
    for turns, mirrored in product(range(4), (False, True)):
        angle = turns * np.pi / 2
        matrix = np.array(
            [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]]
        )
        if mirrored:
            matrix = matrix @ np.diag([-1.0, 1.0, 1.0])
        expected = np.rot90(grid[::-1] if mirrored else grid, turns)
        path = write_mesh(tmp_path / "a.stl", facets @ matrix.T)
        assert _blocks(path) == {(x, y, z + 1) for x, y, z in np.argwhere(expected).tolist()}
        assert _blocks(path, length) == _blocks(path)


def test_a_mesh_of_other_lengths_turns_and_moves_with_its_building_too(tmp_path):
    rng = np.random.default_rng(4)
    for _ in range(12):
        sizes = rng.uniform(0.3, 1.7, 3)
        facets = triangles(columns(rng.integers(0, 4, (4, 3)) + 1)) * CELL_M * sizes
        building = _grid(write_mesh(tmp_path / "a.stl", facets))
        angle = np.pi / 2
        quarter = np.array(
            [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]]
        )
        turned = _grid(write_mesh(tmp_path / "a.obj", facets @ quarter.T + rng.normal(size=3)))
        mirrored = _grid(write_mesh(tmp_path / "a.stl", facets * (-1, 1, 1) + rng.normal(size=3)))
        np.testing.assert_array_equal(turned, np.rot90(building))
        np.testing.assert_array_equal(mirrored, building[::-1])


def _grid(path):
    design = read_mesh(path)
    grid = np.zeros(design.size, np.bool_)
    for x, y, z in design.of_kind(Kind.BLOCK):
        grid[x, y, z - 1] = True
    return grid


def _faces_inside(cells):
    """Return the faces between two filled cells, once each."""
    own = {tuple(map(tuple, np.sort(face, axis=0))): face for face in cubes(cells)}
    outer = {tuple(map(tuple, np.sort(face, axis=0))) for face in hull(cells)}
    inside = [face for key, face in own.items() if key not in outer]
    return np.array(inside).reshape(-1, 4, 3)


def _turned_cubes(facets, rng):
    """Return the triangles with those of some cubes turned round: a cube has six of either half."""
    halves = facets.reshape(2, -1, 6, 3, 3)
    turned = rng.random((1, halves.shape[1], 1, 1, 1)) < 0.5
    return np.where(turned, halves[..., ::-1, :], halves).reshape(-1, 3, 3)


def _box(low, high):
    mesh = trimesh.creation.box(bounds=[low, high])
    return mesh.triangles.view(np.ndarray)


def _filled(boxes, shape):
    """Return what is filled by exact arithmetic: where a box meets the inner part of a cell."""
    margin = Fraction(3, 100)
    cells = np.zeros(shape, np.bool_)
    for cell in np.ndindex(*shape):
        for low, high in boxes:
            cells[cell] |= all(
                b > i + margin and a < i + 1 - margin
                for a, b, i in zip(low, high, cell, strict=True)
            )
    return cells


def test_overlapping_boxes_in_any_order_fill_what_exact_arithmetic_says():
    rng = np.random.default_rng(2)
    for _ in range(60):
        boxes = []
        for _ in range(rng.integers(1, 6)):
            # Places of hundredths of a cell, the borders and the margins among them.
            ends = np.sort(
                rng.choice([*range(0, 401, 25), *range(0, 401, 100), 7, 96, 104, 196], (2, 3)),
                axis=0,
            )
            boxes.append([[Fraction(int(end), 100) for end in row] for row in ends])
        boxes = [
            (low, high) for low, high in boxes if all(a < b for a, b in zip(low, high, strict=True))
        ]
        if not boxes:
            continue
        parts = [_box(*(np.array(ends, float) for ends in box)) for box in boxes]
        facets = rng.permutation(np.concatenate(parts))
        if rng.random() < 0.5:
            facets = facets[:, ::-1]
        np.testing.assert_array_equal(
            filled_cells("boxes", facets, (4, 4, 4)), _filled(boxes, (4, 4, 4))
        )


def test_parts_that_overlap_fill_both_where_one_is_inside_out():
    one = _box((0, 0, 0), (3, 3, 2))
    other = _box((1, 1, 0), (4, 4, 2))
    for facets in (np.concatenate([one, other[:, ::-1]]), np.concatenate([one[:, ::-1], other])):
        expected = np.zeros((4, 4, 2), np.bool_)
        expected[:3, :3] = True
        expected[1:, 1:] = True
        np.testing.assert_array_equal(filled_cells("two", facets, (4, 4, 2)), expected)


def test_a_turned_convex_solid_fills_the_cells_whose_inner_part_it_meets():
    rng = np.random.default_rng(3)
    shape = (4, 4, 3)
    for _ in range(6):
        points = rng.uniform(0.2, 1, (1, 3)) * rng.normal(size=(12, 3)) + (2, 2, 1.5)
        convex = ConvexHull(np.clip(points, 0.01, (3.99, 3.99, 2.99)))
        filled = filled_cells("hull", convex.points[convex.simplices], shape)
        for cell in np.ndindex(*shape):
            bounds = [(i + MARGIN_CELLS, i + 1 - MARGIN_CELLS) for i in cell]
            meets = (
                linprog(
                    [0, 0, 0], convex.equations[:, :3], -convex.equations[:, 3], bounds=bounds
                ).status
                == 0
            )
            assert filled[cell] == meets, cell


def test_a_cavity_is_empty_and_what_stands_over_it_has_nothing_below(tmp_path):
    outer = _box((0, 0, 0), (3, 3, 3))
    inner = _box((1, 1, 1), (2, 2, 2))[:, ::-1]
    for facets in (np.concatenate([outer, inner]), np.concatenate([outer, inner])[:, ::-1]):
        filled = filled_cells("hollow", facets, (3, 3, 3))
        assert not filled[1, 1, 1]
        assert filled.sum() == 26
    solid = filled_cells("one in another", np.concatenate([outer, inner[:, ::-1]]), (3, 3, 3))
    assert solid.all()
    ring = [cell for cell in np.ndindex(3, 3, 3) if cell != (1, 1, 1)]
    drawn = triangles(cubes([(x, y, z + 1) for x, y, z in ring])) * CELL_M
    with pytest.raises(InputError, match=r"nothing is below the blocks at \(1, 1, 3\)"):
        read_mesh(write_mesh(tmp_path / "a.obj", drawn))


@pytest.mark.parametrize("shape", SHAPES)
def test_a_surface_that_is_drawn_from_both_sides_fills_the_same_cells(shape, tmp_path):
    want, facets, _ = _drawn(shape)
    outside = triangles(hull(want)) * CELL_M
    for drawn in (facets, outside):
        for order in (
            np.arange(2 * len(drawn)),
            np.random.default_rng(2).permutation(2 * len(drawn)),
        ):
            both = np.concatenate([drawn, drawn[:, ::-1]])[order]
            assert _blocks(write_mesh(tmp_path / "a.obj", both)) == want


def test_a_cavity_of_a_surface_that_is_drawn_from_both_sides_is_empty():
    outer = _box((0, 0, 0), (5, 5, 3))
    inner = _box((1, 1, 1), (4, 4, 2))[:, ::-1]
    solid = np.concatenate([outer, inner])
    filled = filled_cells("a.obj", np.concatenate([solid, solid[:, ::-1]]), (5, 5, 3))
    assert np.array_equal(filled, filled_cells("a.obj", solid, (5, 5, 3)))
    assert not filled[1:4, 1:4, 1].any()


def test_a_plate_of_a_centimetre_is_seen_and_what_reaches_less_than_the_margin_is_not(tmp_path):
    plate = write_mesh(tmp_path / "a.obj", _box((0, 0, 0), (3 * CELL_M[0], 0.01, 0.01)))
    assert read_mesh(plate).size == (3, 1, 1)
    for share, size in ((0.0298, 1), (0.03, 2), (0.0302, 2)):
        high = CELL_M * (1, 1, 1 + share)
        assert read_mesh(write_mesh(tmp_path / "b.stl", _box((0, 0, 0), high))).size == (1, 1, size)
    with pytest.raises(
        InputError, match=r"reaches 3% of a cell into none; allowed: a solid .* larger --size"
    ):
        read_mesh(write_mesh(tmp_path / "c.obj", _box((0, 0, 0), (3, 3, 0.003))))


@pytest.mark.parametrize(
    ("name", "length"), [("cylinder", 7), ("cylinder", 12), ("cone", 10), ("dome", 9)]
)
def test_a_symmetric_mesh_gives_a_symmetric_building(name, length, tmp_path):
    mesh = {
        "cylinder": trimesh.creation.cylinder(1, 0.6, sections=48),
        "cone": trimesh.creation.cone(1, 1, sections=48),
        "dome": trimesh.creation.revolve([[0, 0], [1, 0], [0.7, 0.7], [0, 1]], sections=48),
    }[name]
    design = read_mesh(write_mesh(tmp_path / "a.stl", mesh.triangles.view(np.ndarray)), length)
    grid = np.zeros(design.size, np.bool_)
    for x, y, z in design.of_kind(Kind.BLOCK):
        grid[x, y, z - 1] = True
    assert design.size[:2] == (length, length)
    for symmetric in (grid[::-1], grid[:, ::-1], grid.transpose(1, 0, 2)):
        np.testing.assert_array_equal(grid, symmetric)


def test_open_surfaces_are_refused_whichever_face_is_missing(tmp_path):
    whole = _box((0, 0, 0), CELL_M * (3, 2, 2))
    for i in range(len(whole)):
        with pytest.raises(
            InputError, match="not a closed surface: 3 edges belong to one face alone"
        ):
            read_mesh(write_mesh(tmp_path / "a.stl", np.delete(whole, i, axis=0)))
    for axis in range(3):
        tube = whole[np.abs(np.ptp(whole[:, :, axis], axis=1)) > 0]
        with pytest.raises(InputError, match="not a closed surface: 8 edges"):
            read_mesh(write_mesh(tmp_path / "a.obj", tube))
