"""Designs from pictures and meshes, the sound and the hostile ones."""

import struct
import zlib

import cv2
import numpy as np
import pytest

from craftsim.designs.finding import find_design, read_mesh, read_pictures
from craftsim.discrete.grid import Kind
from craftsim.errors import InputError

FLOATING = b"v 0 0 3\nv 1 0 3\nv 0 1 3\nv 0 0 0\nv 0 0 .1\nv .1 0 0\nf 1 2 3\nf 4 5 6\n"


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
        InputError, match=r"nothing is below the blocks at \(1, 0, 2\), \(3, 0, 2\); allowed: on the"
    ):
        read_pictures([floor, upper])


def test_a_box_in_metres_fills_its_cells_and_size_scales_it(box):
    assert read_mesh(box("box.stl", 3, 2, 2)).size == (3, 2, 2)
    assert len(_blocks(read_mesh(box("box.obj", 3, 2, 2)))) == 12
    assert read_mesh(box("box.stl", 3, 2, 2), 6).size == (6, 4, 4)


def _png(width: int, height: int) -> bytes:
    """Return the head of a picture of such sides, with the rows of one pixel."""

    def chunk(name: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    head = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    rows = chunk(b"IDAT", zlib.compress(b"\0\0"))
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + rows + chunk(b"IEND", b"")


def test_a_hostile_file_is_one_message_with_the_file_and_why(tmp_path, recwarn):
    for name, data, message in (
        ("a.png", b"", "not a PNG file"),
        ("a.png", b"GIF89a" + bytes(60), "not a PNG file"),
        ("a.png", _png(60_000, 60_000), "60000 x 60000 pixels; allowed: 1 to 128 each way"),
        ("a.png", _png(0, 3), "0 x 3 pixels; allowed"),
        ("a.png", _png(3, 3)[:40], "damaged"),
        ("a.png", b"\x89PNG\r\n\x1a\n" + bytes(2 << 20), "no larger than the 1 MiB"),
        ("a.obj", b"", "not a sound mesh"),
        ("a.obj", b"v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "not a sound mesh"),
        ("a.obj", b"v 0 0 0\nf 1 2 3\n", "not a mesh that can be read"),
        ("a.obj", b"v 0 0 0\nv 1e5 0 0\nv 0 1e5 0\nf 1 2 3\n", "cells; allowed: 128 each way; scale it with"),
        ("a.obj", b"v 0 0 0\nv 40 0 0\nv 0 40 0\n" + b"f 1 2 3\n" * 50, "faces make about .* pieces of half"),
        ("a.obj", FLOATING, "nothing is below"),
        ("a.stl", b"solid x\n", "not a sound mesh"),
        ("a.stl", bytes(80) + struct.pack("<I", 1) + b"\1\0\xa0\x7f" * 12 + bytes(2), "not a sound mesh"),
        ("a.stl", bytes(80) + b"\xff\xff\xff\xff" + bytes(50), "not a sound mesh"),
    ):
        (tmp_path / name).write_bytes(data)
        with pytest.raises(InputError, match=message) as caught:
            find_design([str(tmp_path / name)])
        assert str(tmp_path / name) in str(caught.value)
    assert [str(one.message) for one in recwarn] == []


def test_files_that_a_mesh_names_are_not_opened(tmp_path, monkeypatch):
    opened = []
    monkeypatch.setattr("builtins.open", lambda *words, **options: opened.append(words))
    (tmp_path / "a.obj").write_bytes(b"mtllib secret.mtl\nusemtl x\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    assert read_mesh(tmp_path / "a.obj").size == (4, 4, 1)
    assert not [words for words in opened if "secret" in str(words)]


def test_pictures_of_other_sides_none_at_all_and_folders_are_refused(picture, tmp_path):
    with pytest.raises(InputError, match="2 x 1 pixels; allowed: as many as"):
        read_pictures([picture("a.png", "#.."), picture("b.png", "#.")])
    with pytest.raises(InputError, match="no cells"):
        read_pictures([picture("a.png", "...")])
    for path in (tmp_path, tmp_path / "none.png"):
        with pytest.raises(InputError, match=r"not a regular file|no such file|cannot be read"):
            read_pictures([path])


def test_words_that_do_not_go_together_are_refused():
    for words in (([],), (["a.png"], [3]), (["a.png", "wall"],), (["a.obj", "b.obj"],), (["a.obj"], [1, 2])):
        with pytest.raises(InputError, match=r"no design is .* sizes.*; allowed: one of wall"):
            find_design(*words)
