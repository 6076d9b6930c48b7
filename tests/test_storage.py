"""The door for files: what is read stays within limits, what is written is whole."""

import gzip
import io
import os
import zipfile
from pathlib import Path

import numpy as np
import pytest

from craftsim.errors import InputError
from craftsim.storage.limits import Limits
from craftsim.storage.paths import exists, is_file, is_folder, resolved
from craftsim.storage.reading import open_file, parse_json, read_arrays, read_lines, read_text
from craftsim.storage.writing import whole, write_whole

SMALL = Limits("thing", 4096, 20_000, line_bytes=100)


def test_only_a_regular_file_within_its_limit_is_opened(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "large").write_bytes(b"x" * 4097)
    (tmp_path / "link").symlink_to(tmp_path / "large")
    for name, message in {
        "gone": "no such file",
        "pipe": "not a regular file",
        ".": "not a regular file but a folder; name the file in it",
        "large": "4.001 KiB; a thing is no larger than the 4 KiB",
        "link": "larger",
        "a" * 300: "cannot be read",
        "a\0b": "cannot be read",
        "large/below": "cannot be read",
    }.items():
        with pytest.raises(InputError, match=message):
            open_file(tmp_path / name, SMALL)
    with pytest.raises(InputError, match="not a regular file"):
        open_file(Path("/dev/zero"), SMALL)


def test_a_file_of_the_kernel_is_refused_for_one_may_have_to_wait_for_it(tmp_path):
    with pytest.raises(InputError, match="/proc/kmsg: "):  # whether or not it may be opened
        read_text(Path("/proc/kmsg"), SMALL)
    with pytest.raises(InputError, match="not a regular file"):
        read_text(Path("/proc/self/status"), SMALL)
    (tmp_path / "empty").touch()
    assert read_text(tmp_path / "empty", SMALL) == ""


def test_a_path_leads_to_something_or_to_nothing_or_is_refused(tmp_path):
    (tmp_path / "file").touch()
    (tmp_path / "link").symlink_to("file")
    (tmp_path / "dangling").symlink_to("gone")
    (tmp_path / "loop").symlink_to("loop")
    for name in ("file", "link"):
        assert (exists(tmp_path / name), is_file(tmp_path / name), is_folder(tmp_path / name)) == (
            1,
            1,
            0,
        )
        assert resolved(tmp_path / name) == tmp_path.resolve() / "file"
    assert (exists(tmp_path), is_file(tmp_path), is_folder(tmp_path)) == (1, 0, 1)
    for name in ("gone", "dangling", "file/below"):
        assert not exists(tmp_path / name)
        resolved(tmp_path / name)
    for name in ("loop", "loop/below", "x" * 300, "a\0b"):
        for ask in (exists, is_file, is_folder):
            with pytest.raises(InputError, match="cannot be read"):
                ask(tmp_path / name)
    with pytest.raises(InputError, match="cannot be read"):
        resolved(tmp_path / "a\0b")


def test_text_that_is_not_utf_8_is_named_with_its_line(tmp_path):
    (tmp_path / "text").write_bytes(b"one\ntwo \xe9\n")
    with pytest.raises(InputError, match=r"text:2: not UTF-8"):
        read_text(tmp_path / "text", SMALL)


def test_json_that_is_none_is_our_error(tmp_path):
    for text in ("[" * 100_000, "1" * 5000, "NaN", '"\\ud800"', "", "{", '{"a": 1,}', "\x00"):
        with pytest.raises(InputError, match="here: not JSON"):
            parse_json(text.encode(), "here")
    assert parse_json(b'{"a": [1, 2.5, "\xc3\xa9", null]}', "here") == {
        "a": [1, 2.5, "\u00e9", None]
    }


def test_packed_lines_are_counted_as_they_come(tmp_path):
    path = tmp_path / "lines.gz"
    path.write_bytes(gzip.compress(b"one\ntwo\nthree"))
    assert list(read_lines(path, SMALL, packed=True)) == [
        (1, b"one\n"),
        (2, b"two\n"),
        (3, b"three"),
    ]
    path.write_bytes(gzip.compress(b" " * 10**6))
    with pytest.raises(InputError, match=r"gz:1: the line is longer than the 100 bytes"):
        list(read_lines(path, SMALL, packed=True))
    path.write_bytes(gzip.compress(b"0123456789\n" * 10_000))
    with pytest.raises(InputError, match=r"gz:1819: holds more than"):
        list(read_lines(path, SMALL, packed=True))
    for data in (
        b"no gzip",
        gzip.compress(b"x" * 50)[:-4],
        gzip.compress(b"a\n")[:12] + b"\xff" * 8,
    ):
        path.write_bytes(data)
        with pytest.raises(InputError, match="not a gzip file"):
            list(read_lines(path, SMALL, packed=True))


def _npz(path, members, compression=zipfile.ZIP_DEFLATED):
    with zipfile.ZipFile(path, "w", compression) as archive:
        for name, data in members:
            archive.writestr(name, data)


def _npy(array, old=b"", new=b""):
    file = io.BytesIO()
    np.lib.format.write_array(file, array, allow_pickle=True)
    return file.getvalue().replace(old, new) if old else file.getvalue()


def test_arrays_are_read_as_they_were_written(tmp_path):
    arrays = {"a": np.arange(6.0).reshape(2, 3), "b": np.array([True]), "c": np.int8(3)}
    arrays |= {"d": np.zeros((0, 4)), "e": np.asfortranarray(arrays["a"])}
    np.savez_compressed(tmp_path / "a.npz", **arrays)
    read = read_arrays(tmp_path / "a.npz", SMALL)
    assert all(np.array_equal(read[name], array) and read[name].dtype == np.asarray(array).dtype
               for name, array in arrays.items())  # fmt: skip


HOSTILE = {
    "huge claim": [("a.npy", _npy(np.zeros(3), b"(3,)", b"(9,)"))],
    "objects": [("a.npy", _npy(np.array([{}])))],
    "text": [("a.npy", _npy(np.array(["x"])))],
    "a long header": [
        ("a.npy", b"\x93NUMPY\x01\x00" + (60_000).to_bytes(2, "little") + b" " * 60_000)
    ],
    "no array": [("a.npy", b"hello")],
    "no name": [("a.txt", b"hello")],
    "two of a name": [("a.npy", _npy(np.zeros(1))), ("a.npy", _npy(np.zeros(1)))],
    "too many": [(f"{i}.npy", b"") for i in range(100)],
    "a bomb": [("a.npy", b"\0" * 10**6)],
    "a short one": [("a.npy", _npy(np.zeros(3))[:-1])],
    "many axes": [("a.npy", _npy(np.zeros((1,) * 7)))],
    "negative": [("a.npy", _npy(np.zeros(3), b"(3,)", b"(-3,)"))],
}


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_an_archive_that_claims_too_much_is_refused(tmp_path):
    for name in HOSTILE:
        _npz(tmp_path / "a.npz", HOSTILE[name])
        with pytest.raises(InputError, match=r"a\.npz"):
            read_arrays(tmp_path / "a.npz", SMALL)


def test_other_packing_and_a_plain_array_are_refused(tmp_path):
    _npz(tmp_path / "a.npz", [("a.npy", _npy(np.zeros(3)))], zipfile.ZIP_LZMA)
    np.save(tmp_path / "plain.npy", np.zeros(3))
    for name, message in {"a.npz": "packed in a way", "plain.npy": "not an archive"}.items():
        with pytest.raises(InputError, match=message):
            read_arrays(tmp_path / name, SMALL)


def test_a_file_is_whole_or_as_it_was(tmp_path):
    path = tmp_path / "a.txt"
    assert write_whole(path, "caf\u00e9 \ud800") == path
    assert path.read_bytes() == b"caf\xc3\xa9 \\ud800"
    with pytest.raises(ZeroDivisionError), whole(path) as partial:
        partial.write_bytes(bytes(partial.write_text("half") // 0))
    with (
        pytest.raises(InputError, match=r"a\.txt: cannot be written: nothing was written"),
        whole(path),
    ):
        pass
    assert path.read_bytes().startswith(b"caf")
    assert list(tmp_path.iterdir()) == [path]
