"""Designs from pictures and meshes, the sound and the hostile ones."""

import json
import re
import struct
import subprocess
import sys
import zlib

import cv2
import numpy as np
import pytest
import trimesh
from PIL import Image

from craftsim.designs.finding import find_design, read_mesh, read_pictures
from craftsim.discrete.geometry import CELL_PITCH_M, LEVEL_HEIGHT_M
from craftsim.discrete.grid import Kind
from craftsim.errors import InputError


def _blocks(design):
    return {*design.of_kind(Kind.BLOCK)}


def test_a_picture_a_level_is_a_design_with_y_up(picture):
    design = read_pictures([picture("a.png", "#..", "##."), picture("b.png", "...", "#..")])
    assert _blocks(design) == {(0, 1, 1), (0, 0, 1), (1, 0, 1), (0, 0, 2)}


def test_any_colour_but_white_is_a_block_and_what_is_transparent_is_not(picture, tmp_path):
    red = picture("red.png", "#.", ink=(0, 0, 255))
    clear = picture("clear.png", "#.", ink=(9, 9, 9, 255), paper=(0, 0, 0, 0))
    assert _blocks(read_pictures([red])) == _blocks(read_pictures([clear])) == {(0, 0, 1)}
    for name, pixels in (
        ("grey.png", np.array([[7, 255]], np.uint8)),
        ("deep.png", np.array([[7, 65535]], np.uint16)),
    ):
        cv2.imwrite(str(tmp_path / name), pixels)
        assert _blocks(read_pictures([tmp_path / name])) == {(0, 0, 1)}


def test_blocks_that_float_are_named(picture):
    floor, upper = picture("floor.png", "#.#."), picture("upper.png", "####")
    with pytest.raises(
        InputError,
        match=r"nothing is below the blocks at \(1, 0, 2\), \(3, 0, 2\); allowed: on the",
    ):
        read_pictures([floor, upper])


def test_a_box_in_metres_fills_its_cells_and_size_scales_it(box):
    assert read_mesh(box("box.stl", 3, 2, 2)).size == (3, 2, 2)
    assert len(_blocks(read_mesh(box("box.obj", 3, 2, 2)))) == 12
    assert read_mesh(box("box.stl", 3, 2, 2), 6).size == (6, 4, 4)


def _png(width: int, height: int, kind: bytes = b"tEXt", content: bytes = b"a\0a") -> bytes:
    """Return the head of a picture of such sides, a part of another kind, and the rows of one pixel."""

    def chunk(name: bytes, data: bytes) -> bytes:
        return (
            struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))
        )

    head = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    rows = chunk(b"IDAT", zlib.compress(b"\0\0"))
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", head)
        + chunk(kind, content)
        + rows
        + chunk(b"IEND", b"")
    )


def _tetrahedron(high: float) -> bytes:
    return b"v 0 0 %g\nv 1 0 %g\nv 0 1 %g\nv 0 0 %g\n" % (high, high, high, high + 0.1)


def _faces(first: int) -> bytes:
    corners = [(1, 3, 2), (1, 2, 4), (2, 3, 4), (3, 1, 4)]
    return b"".join(
        b"f %d %d %d\n" % tuple(first - 1 + corner for corner in face) for face in corners
    )


def _stl(n_facets: int, facets: bytes = b"", head: bytes = b"") -> bytes:
    return head.ljust(80, b"\0") + struct.pack("<I", n_facets) + facets


def _ply(n_vertices: int, n_faces: int, *lines: str) -> bytes:
    head = (
        "ply",
        "format ascii 1.0",
        f"element vertex {n_vertices}",
        *(f"property float {axis}" for axis in "xyz"),
        f"element face {n_faces}",
        "property list uchar int vertex_indices",
        "end_header",
    )
    return "\n".join([*head, *lines, ""]).encode()


def _glb(document: object) -> bytes:
    text = json.dumps(document).encode()
    parts = struct.pack("<I4s", len(text), b"JSON") + text
    return b"glTF" + struct.pack("<II", 2, 12 + len(parts)) + parts


TRIANGLE = {
    "accessors": [{"count": 600, "type": "VEC3", "componentType": 5126}],
    "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
    "scene": 0,
    "scenes": [{"nodes": [0]}],
}
SOLID = _tetrahedron(0) + _faces(1)
FACET = (
    "facet normal 0 0 0\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n"
)
NAN_FACET = b"\1\0\xa0\x7f" * 12 + bytes(2)
HOSTILE = (
    ("a.png", b"", "not a PNG or JPEG file; allowed: .png, .jpg, .jpeg; save it as PNG"),
    ("a.png", b"GIF89a" + bytes(60), "not a PNG or JPEG file"),
    ("a.png", _png(60_000, 60_000), "more than 100 million pixels; allowed: 1 to 128 each way"),
    ("a.png", _png(9_000, 10_000), "9000 x 10000 pixels; allowed: 1 to 128 each way"),
    (
        "a.png",
        _png(3, 3, b"zTXt", b"a\0\0" + zlib.compress(bytes(99 << 20))),
        "damaged: Decompressed data too large",
    ),
    ("a.png", _png(3, 3, b"eXIf", b"MM\0*" + bytes(1000)), "damaged: image file is truncated"),
    ("a.png", _png(0, 3), "damaged|0 x 3 pixels; allowed"),
    ("a.png", _png(3, 3)[:40], "damaged"),
    ("a.png", b"\x89PNG\r\n\x1a\n" + bytes(17 << 20), "no larger than the 16 MiB"),
    ("a.jpg", b"\xff\xd8\xff\xe0" + bytes(60), "damaged"),
    (
        "a.obj",
        b"",
        "the file is empty; allowed: .obj, .stl, .ply, .glb with faces; export it again",
    ),
    ("a.obj", b"# nothing\nv 0 0 0\n", "no faces; allowed: at least 4, which enclose a solid"),
    ("a.obj", b"v 0 0 nan\n" + SOLID, ":1: a vertex that is NaN or infinite; allowed: finite"),
    ("a.obj", b"v 0 0 1e999\n" + SOLID, ":1: a vertex that is NaN or infinite"),
    ("a.obj", b"v 0 0 x\n" + SOLID, ":1: a vertex with a word that is no number"),
    ("a.obj", b"v 0 0\n" + SOLID, ":1: a vertex of 2 numbers; allowed: x, y and z"),
    (
        "a.obj",
        b"v 0 0 0\nf 1 2 3\n",
        ":2: a face with vertex 2; allowed: the 1 vertices before it, from 1",
    ),
    ("a.obj", b"v 0 0 0\nf 1 0 1\n", ":2: a face with vertex 0"),
    ("a.obj", b"v 0 0 0\nf 1 1\n", ":2: a face of 2 corners; allowed: 3 to 64; divide it"),
    ("a.obj", b"v 0 0 0\nf 1 a 1\n", ":2: a face with a corner 'a'; allowed: numbers of vertices"),
    (
        "a.obj",
        b"v 2e6 0 0\n" + SOLID + b"f 1 2 3\n",
        "a corner at 2e\\+06; allowed: .* move the mesh there",
    ),
    (
        "a.obj",
        b"v 1e5 0 0\n" + SOLID + b"f 1 2 3\n",
        "cells in metres; allowed: 128 each way; scale it with --size",
    ),
    (
        "a.obj",
        SOLID[: -len(b"f 3 1 4\n")],
        "not a closed surface: 3 edges belong to one face alone",
    ),
    (
        "a.obj",
        _tetrahedron(0) + _tetrahedron(3) + _faces(1) + _faces(5),
        "nothing is below the blocks at",
    ),
    ("a.stl", b"solid x\n", "no faces; allowed"),
    ("a.stl", b"solid x\n" + FACET[:60].encode(), "damaged: the file ends inside of a facet"),
    (
        "a.stl",
        b"solid x\n" + FACET.replace("vertex 1 0 0\n", "").encode(),
        ":6: a facet that ends with 2 vertices",
    ),
    (
        "a.stl",
        b"solid x\n" + FACET.replace("1 0 0", "1 0 nan").encode(),
        ":5: a vertex that is NaN",
    ),
    (
        "a.stl",
        b"solid x\n" + FACET.replace("1 0 0", "1,0 0 0").encode(),
        ":5: a vertex with a word that is no number",
    ),
    ("a.stl", b"solid x\n" + FACET.encode(), "not a closed surface: 3 edges"),
    ("a.stl", b"hello", "not an STL file: neither 'solid' at its beginning nor the 84 bytes"),
    ("a.stl", _stl(0), "no faces; allowed"),
    ("a.stl", _stl(1, NAN_FACET), "face 1 has a corner that is NaN or infinite"),
    (
        "a.stl",
        _stl(3, bytes(50), b"solid x"),
        "damaged: a binary STL file that says 3 facets and has 1;",
    ),
    ("a.stl", _stl(2**32 - 1, bytes(50)), "says 4294967295 facets and has 1;"),
    ("a.ply", b"solid", "not a PLY file"),
    ("a.ply", _ply(10**9, 1), "damaged: the head says more elements than the file has bytes"),
    ("a.ply", _ply(3, 10**9), "1000000000 triangles or more; allowed: at most 200000"),
    ("a.ply", _ply(3, 0, "0 0 0", "1 0 0", "0 1 0"), "no faces"),
    (
        "a.ply",
        _ply(3, 1, "0 0 0", "1 0 0", "0 1 0", "3 0 1 7"),
        "a face with vertex 7; allowed: the 3 vertices",
    ),
    (
        "a.ply",
        _ply(4, 1, "0 0 0", "1 0 0", "1 1 0", "0 1 0", "4 0 1 2 3"),
        "1 faces are 2 triangles; .* triangulate",
    ),
    (
        "a.ply",
        _ply(3, 1, "0 0 0", "1 0 0", "0 1 0"),
        "damaged: the head says 1 faces, and there are 0",
    ),
    (
        "a.npy",
        b"",
        ".npy files are not read; allowed: pictures of a level each .* call Design.of in Python",
    ),
    ("a.gltf", b"", ".gltf files are not read; .* export it as STL, z up"),
    ("a.glb", b"solid", "not a binary glTF file"),
    ("a.glb", _glb({"nodes": [{"mesh": 7}]}), "damaged: (KeyError|IndexError)"),
    (
        "a.glb",
        _glb({"nodes": [{"children": [1]}, {}, {"children": [1]}]}),
        "each node below one other",
    ),
    (
        "a.glb",
        _glb({"nodes": [{"children": [0], "mesh": 0}], **TRIANGLE}),
        "damaged|no faces|not a closed surface",
    ),
    ("a.glb", _glb({"nodes": [{}] * 3000}), "3000 nodes, 0 arrays; allowed: at most 2000"),
    (
        "a.glb",
        _glb({"accessors": [{"count": 10**12}]}),
        "arrays of 1000000000000 entries; simplify",
    ),
    (
        "a.glb",
        _glb({"nodes": [{"mesh": 0}] * 1999, **TRIANGLE}),
        "[0-9]+ triangles or more; allowed: at most 200000",
    ),
    (
        "a.glb",
        _glb({"extensionsRequired": ["KHR_draco_mesh_compression"]}),
        "needs KHR_draco_mesh_compression; allowed",
    ),
    ("a.glb", _glb({"nodes": []}), "no faces"),
    ("a.glb", _glb([]), "damaged: AttributeError"),
    (
        "a.glb",
        _glb([[]] * 1_000_000),
        "a head of .* MiB; allowed: 1 MiB; export it without what is no mesh",
    ),
    (
        "a.glb",
        _glb({"nodes": [{"mesh": 0}], "buffers": [{"uri": "/etc/passwd"}], **TRIANGLE}),
        "damaged|no faces|edges",
    ),
    ("a.gif", b"", ".gif files are not read; .* convert it to one of these"),
)


@pytest.mark.parametrize(("name", "data", "message"), HOSTILE)
def test_a_hostile_file_is_one_message_with_the_file_and_why(
    name, data, message, tmp_path, recwarn
):
    (tmp_path / name).write_bytes(data)
    with pytest.raises(InputError, match=message) as caught:
        find_design([str(tmp_path / name)])
    assert str(tmp_path / name) in str(caught.value)
    assert [str(warning.message) for warning in recwarn] == []


def test_files_that_a_mesh_names_are_not_opened(tmp_path, monkeypatch):
    opened = []
    (tmp_path / "a.obj").write_bytes(b"mtllib secret.mtl\nusemtl x\n" + SOLID)
    with monkeypatch.context() as patch:
        patch.setattr("builtins.open", lambda *words, **options: opened.append(words))
        assert read_mesh(tmp_path / "a.obj").size[2] == 1
        document = {
            "nodes": [{"mesh": 0}],
            "buffers": [{"uri": "secret.bin", "byteLength": 7200}],
            **TRIANGLE,
        }
        document["bufferViews"] = [{"buffer": 0, "byteOffset": 0, "byteLength": 7200}]
        (tmp_path / "a.glb").write_bytes(_glb(document))
        with pytest.raises(InputError, match="damaged"):
            read_mesh(tmp_path / "a.glb")
    assert not [words for words in opened if "secret" in str(words)]


def test_ends_of_lines_continued_lines_and_what_comes_with_corners_do_not_matter(tmp_path, box):
    path = box("box.obj", 3, 2, 2)
    text = path.read_bytes()
    plain = _blocks(read_mesh(path))
    (tmp_path / "other.obj").write_bytes(
        re.sub(rb"f (\d+) (\d+) (\d+)", rb"f \1/1/1 \\\n \2//1 \3/2 # a comment", text)
    )
    assert _blocks(read_mesh(tmp_path / "other.obj")) == plain
    for end in (b"\r", b"\r\n"):
        path.write_bytes(text.replace(b"\n", end))
        assert _blocks(read_mesh(path)) == plain
    stl = box("box.stl", 3, 2, 2)
    trimesh.load_mesh(stl).export(tmp_path / "ascii.stl", file_type="stl_ascii")
    for end in (b"\n", b"\r", b"\r\n"):
        (tmp_path / "end.stl").write_bytes(
            (tmp_path / "ascii.stl").read_bytes().replace(b"\n", end)
        )
        assert _blocks(read_mesh(tmp_path / "end.stl")) == plain


def test_a_binary_stl_that_begins_as_an_ascii_one_is_binary(tmp_path, box):
    path = box("box.stl", 3, 2, 2)
    path.write_bytes(b"solid facet".ljust(80) + path.read_bytes()[80:])
    assert read_mesh(path).size == (3, 2, 2)


def test_ply_files_are_read_binary_and_ascii(tmp_path, box):
    mesh = trimesh.load_mesh(box("box.stl", 3, 2, 2))
    for encoding in ("binary", "ascii"):
        (tmp_path / "box.ply").write_bytes(mesh.export(file_type="ply", encoding=encoding))
        assert read_mesh(tmp_path / "box.ply").size == (3, 2, 2)


def test_binary_gltf_is_read_with_y_up_in_all_its_places(tmp_path):
    scene = trimesh.Scene()
    part = trimesh.creation.box((CELL_PITCH_M, LEVEL_HEIGHT_M, CELL_PITCH_M))
    for x, y, z in ((0, 0, 0), (1, 0, 0), (1, 1, 0), (1, 0, 1)):
        place = (x * CELL_PITCH_M, y * LEVEL_HEIGHT_M, z * CELL_PITCH_M)
        scene.add_geometry(part, transform=trimesh.transformations.translation_matrix(place))
    scene.export(tmp_path / "a.glb")
    # Its z is towards who looks, -y of a design.
    assert _blocks(read_mesh(tmp_path / "a.glb")) == {(0, 1, 1), (1, 1, 1), (1, 1, 2), (1, 0, 1)}


def test_a_mesh_too_far_from_0_for_its_numbers_is_refused(tmp_path, box):
    mesh = trimesh.load_mesh(box("box.stl", 3, 2, 2))
    mesh.apply_translation((5e5, 0, 0)).export(tmp_path / "far.stl")
    with pytest.raises(
        InputError, match=r"so far from 0 that binary STL rounds its corners to 0.031; move it to 0"
    ):
        read_mesh(tmp_path / "far.stl")


def test_faces_of_many_corners_are_filled_inside_alone(tmp_path):
    outline = [(0, 0), (3, 0), (3, 1), (1, 1), (1, 2), (3, 2), (3, 3), (0, 3)]
    corners = [
        (x * CELL_PITCH_M, y * CELL_PITCH_M, z * 1.5 * LEVEL_HEIGHT_M)
        for z in (0, 1)
        for x, y in outline
    ]
    n = len(outline)
    for way in (1, -1):
        faces = [[*range(n, 0, -1)], [*range(n + 1, 2 * n + 1)]]
        faces += [[i + 1, (i + 1) % n + 1, (i + 1) % n + 1 + n, i + 1 + n] for i in range(n)]
        lines = [f"v {x} {y} {z}" for x, y, z in corners]
        lines += ["f " + " ".join(map(str, face[::way])) for face in faces]
        (tmp_path / "c.obj").write_text("\n".join(lines))
        columns = {(x, y) for x, y, _ in _blocks(read_mesh(tmp_path / "c.obj"))}
        assert columns == {(x, y) for x in range(3) for y in range(3)} - {(1, 1), (2, 1)}


@pytest.mark.parametrize(
    "name", ["corners.obj", "long.obj", "triangles.obj", "all.stl", "lines.stl", "all.ply"]
)
def test_a_file_of_megabytes_is_refused_in_seconds_and_little_memory(name, tmp_path):
    points = b"v 0 0 0\nv 1 0 0\nv 0 1 0.3\n"
    facets = FACET.encode() * 60_000
    data = {
        "corners.obj": points + b"f 1 2 3\n" * 450_000,
        "long.obj": points + b"f" + b" 1 2 3" * 1_300_000,
        "triangles.obj": points + b"f 1 2 3\n" * 190_000,
        "all.stl": _stl(
            160_000, np.random.default_rng(0).random((160_000, 50)).astype(np.uint8).tobytes()
        ),
        "lines.stl": b"solid x\n" + facets[: 8 << 20],
        "all.ply": _ply(400_000, 100_000, *["0 0 0.5"] * 400_000, *["3 0 1 2"] * 100_000),
    }[name]
    (tmp_path / name).write_bytes(data)
    words = [sys.executable, "-c", MEASURED, str(tmp_path / name)]
    process = subprocess.run(words, capture_output=True, text=True, timeout=120)
    assert process.returncode == 0, process.stderr
    memory_mib, cpu_s = map(float, process.stdout.split())
    assert memory_mib < 300
    assert cpu_s < 20


MEASURED = """
import resource, sys, time
import scipy.ndimage, trimesh
from craftsim.designs.finding import find_design
from craftsim.errors import InputError
def peak_mib():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
before, begun = peak_mib(), time.process_time()
try:
    find_design([sys.argv[1]], [128])
except InputError:
    print(peak_mib() - before, time.process_time() - begun)
"""


def test_jpeg_pictures_are_read_and_what_is_unclear_is_refused(tmp_path):
    rng = np.random.default_rng(0)
    for quality in (90, 95, 100):
        blocks = rng.random((9, 12)) < 0.5
        cv2.imwrite(
            str(tmp_path / "a.jpg"), np.where(blocks, 0, 255), [cv2.IMWRITE_JPEG_QUALITY, quality]
        )
        expected = {(x, 8 - y, 1) for y, x in np.argwhere(blocks).tolist()}
        assert _blocks(read_pictures([tmp_path / "a.jpg"])) == expected
    cv2.imwrite(str(tmp_path / "grey.jpg"), np.full((8, 8), 220, np.uint8))
    with pytest.raises(
        InputError,
        match=r"for sure: 64, the first in row 1 from the top, column 1, at 86.\d% of white",
    ):
        find_design([str(tmp_path / "grey.jpg")])


def test_a_photograph_that_was_turned_is_read_as_it_is_seen(tmp_path):
    upright = Image.fromarray(np.array([[0, 255, 255]], np.uint8))
    turned = Image.Exif()
    turned[274] = 6  # A quarter clockwise.
    upright.save(tmp_path / "a.jpg", exif=turned, quality=100)
    assert _blocks(read_pictures([tmp_path / "a.jpg"])) == {(0, 2, 1)}


def test_a_photo_is_scaled_to_the_cells_of_its_longer_side(tmp_path):
    photo = np.full((480, 640), 200, np.uint8)
    photo[100:250, 100:400] = 90  # row 0 is the top
    photo += np.random.default_rng(0).integers(0, 40, photo.shape, np.uint8)
    Image.fromarray(photo).save(tmp_path / "a.jpg", quality=60)
    design = find_design([str(tmp_path / "a.jpg")], [8])
    # A cell is 80 pixels: columns 1.25 to 5 and rows 1.25 to 3.125 from the top, at least half of each cell.
    assert _blocks(design) == {(x, y, 1) for x in (1, 2, 3, 4) for y in (3, 4)}
    with pytest.raises(InputError, match="1 to 128 each way, one for each cell; --size N scales"):
        find_design([str(tmp_path / "a.jpg")])
    Image.new("L", (5000, 10)).save(tmp_path / "wide.png")
    with pytest.raises(InputError, match="5000 x 10 pixels; allowed: 1 to 4096 each way"):
        find_design([str(tmp_path / "wide.png")], [8])


def test_almost_white_is_background_and_half_transparent_is_what_it_looks_like_on_paper(picture):
    cream = picture("cream.png", "#.", paper=(240, 250, 254))
    assert _blocks(read_pictures([cream])) == {(0, 0, 1)}
    faint = picture("faint.png", "#.", ink=(0, 0, 0, 255), paper=(0, 0, 0, 12))
    assert _blocks(read_pictures([faint])) == {(0, 0, 1)}
    light = picture("light.png", "#.", ink=(9, 9, 9), paper=(220, 220, 220))
    with pytest.raises(
        InputError, match=r"row 1 from the top, column 2, at 86.\d% of white; allowed: 92% or more"
    ):
        read_pictures([light])


def test_pictures_of_other_sides_none_at_all_and_folders_are_refused(picture, tmp_path):
    with pytest.raises(InputError, match="2 x 1 cells; allowed: as many as"):
        read_pictures([picture("a.png", "#.."), picture("b.png", "#.")])
    with pytest.raises(InputError, match="no cells"):
        read_pictures([picture("a.png", "...")])
    for path in (tmp_path, tmp_path / "none.png"):
        with pytest.raises(InputError, match=r"not a regular file|no such file|cannot be read"):
            read_pictures([path])


def test_words_that_do_not_go_together_are_refused():
    for words in (
        ([],),
        (["a.png"], [3, 2]),
        (["a.png", "wall"],),
        (["a.obj", "b.obj"],),
        (["a.obj"], [1, 2]),
    ):
        with pytest.raises(InputError, match=r"no design is .* sizes.*; allowed: one of wall"):
            find_design(*words)
