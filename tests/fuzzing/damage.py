"""One generator of damage, for files of any format.

A file is damaged as it stands, or inside: where the ending of its name has codecs, one of them gives a document (of
mappings, lists, texts, bytes, numbers and arrays), something in that is changed, and it is packed again.
"""

from __future__ import annotations

import copy
import gzip
import io
import json
import re
import sqlite3
import tempfile
import zipfile
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
import torch
from learning.training_files import read_content, write_content
from robots.bags import loose_bag

PIECES = (
    *(b"0", b"-1", b"1", b"3", b"99", b"1e9", b"1e999", b"-0.0", b".nan", b"NaN", b"~", b"null", b"true", b"''"),
    *(b'"', b'"x"', b"[", b"]", b"{", b"}", b"[]", b"{}", b":", b",", b"- ", b"\n", b"  ", b"\t", b"\\", b"#", b"x"),
    *(b"&a", b"*a", b"!t", b"---\n", b"...\n", b"%YAML 9.9\n", b"wall:\n", b"goal:\n", b"snapshot: {}\n", b"yaw: 1"),
    *(b"id: 0", b"load: flag", b"slope: 2", b"flag:\n  - {id: 0, x: 1, y: 1, z: 1}\n", b'"bundles/.."'),
    *(b'"\\ud800"', b'"\\u0000"', b"9" * 40, b"9" * 5000, b"[" * 300, b"[" * 150 + b"]" * 150, b"x" * 300),
    *(b"\x00", b"\xff", b"\xed\xa0\x80", b"\xef\xbb\xbf", b"\xe2\x80\xa8", b"\xe2\x80\xae", b"\x1b[31m", b"\xc3\xa9"),
    *(b"::", b"..", b"/", b"\xed\xb3\xa9"),
)  # fmt: skip
VALUES = (
    *(None, True, False, "", "x", "1", [], {}, [[]], {"a": 1}, [None], -1, 0, 1, 2, 3, 99, 2**31, 2**63, 10**400),
    *(-(10**30), 0.5, -0.0, 1e-300, 1e-9, 1e9, 1e300, -1e300, float("nan"), float("inf"), "\x1b[31m", "\xe9" * 9),
    *("\ud800", "x" * 100, "bundles/..", np.zeros(0, np.float32), np.full((2, 4), np.nan, np.float32)),
)  # fmt: skip
_VALUE = re.compile(rb'"[^"]*"|[\w.+-]+')
Codec = tuple[Callable[[bytes], Any], Callable[[Any], bytes]]


def damaged(name: str, data: bytes, rng: np.random.Generator) -> bytes:
    """Return the content of a file of this name, as it stands or inside changed in one to four places."""
    codecs = CODECS.get(Path(name).suffix, ())
    if codecs and rng.random() < 0.7:
        unpack, pack = codecs[rng.integers(len(codecs))]
        document = unpack(data)
        try:
            for _ in range(rng.integers(1, 4)):
                change(document, rng)
            return pack(document)
        except (
            AttributeError,
            KeyError,
            TypeError,
            ValueError,
            RuntimeError,
            OverflowError,
            sqlite3.Error,
        ):
            pass  # The format cannot say that.
    return damaged_bytes(data, rng)


def damaged_bytes(data: bytes, rng: np.random.Generator) -> bytes:
    """Return bytes with a few pieces cut out, put in, doubled, swapped, flipped or exchanged; mostly within text."""
    kinds = 6 if data.isascii() and rng.random() < 0.8 else 11
    for _ in range(rng.integers(1, 5)):
        a, b = sorted(int(place) for place in rng.integers(0, len(data) + 1, 2))
        b = min(b, a + int(rng.integers(1, 40)))
        piece = PIECES[rng.integers(len(PIECES))]
        match rng.integers(kinds):
            case 0:
                data = data[:a] + data[b:]
            case 1:
                data = data[:a] + piece + data[a:]
            case 2:
                data = data[:a] + piece + data[b:]
            case 3:
                data = data[:b] + data[a:]
            case 4 | 5:
                # A word or number, here or after here.
                if (found := _VALUE.search(data, a)) is not None:
                    other = str(rng.integers(-2, 12)).encode() if rng.random() < 0.5 else piece
                    data = data[: found.start()] + other + data[found.end() :]
            case 6:
                data = data[:a] + rng.bytes(b - a) + data[b:]
            case 7:
                data = data[:a] + bytes(255 - byte for byte in data[a:b]) + data[b:]
            case 8:
                data = (
                    data[:a]
                    + bytes(byte ^ 1 << int(rng.integers(8)) for byte in data[a : a + 1])
                    + data[a + 1 :]
                )
            case 9:
                data = data[b:] + data[:a]
            case _:
                data = data[:a]
    return data


def places(node: Any) -> Iterator[tuple[Any, Any]]:
    """Yield each container within a document with each of its keys."""
    for key, value in list(node.items() if isinstance(node, dict) else enumerate(node)):
        yield node, key
        if isinstance(value, dict | list):
            yield from places(value)


def change(document: Any, rng: np.random.Generator) -> None:
    """Replace, remove, double or add something anywhere in a document."""
    found = list(places(document))
    if not found:
        return
    node, key = found[rng.integers(len(found))]
    match rng.integers(7):
        case 0 if isinstance(node, dict):
            node[f"{key}x"] = node[key]
        case 1:
            del node[key]
        case 2 if isinstance(node, list):
            node *= int(rng.integers(2, 50))
        case 3 | 4 if isinstance(node[key], int | float):
            node[key] *= float(10.0 ** rng.integers(-9, 10))
        case 3 | 4 | 5 if isinstance(node[key], bytes):
            node[key] = damaged_bytes(node[key], rng)
        case 3 | 4 | 5 if isinstance(node[key], np.ndarray) and node[key].size:
            node[key] = _other_array(node[key], rng)
        case _:
            node[key] = copy.deepcopy(
                VALUES[rng.integers(len(VALUES))]
            )  # which later changes would change


def _other_array(array: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    match rng.integers(4):
        case 0:
            return array.reshape(-1)[: int(rng.integers(array.size))]
        case 1:
            with np.errstate(invalid="ignore"):
                return array.astype(rng.choice(["int8", "int64", "float64"]))
    other = array.copy()
    value = np.array((-32768, -3, -1, 2, 4, 7, 9, 99, 127, 2**30)[rng.integers(10)])
    other.reshape(-1)[rng.integers(array.size)] = value.astype(array.dtype)
    return other


def _lines(data: bytes) -> list[Any]:
    return [json.loads(line) for line in data.splitlines()]


def _joined(document: Any) -> bytes:
    return b"".join(json.dumps(line).encode() + b"\n" for line in document)


def _arrays(data: bytes) -> dict[str, Any]:
    with np.load(io.BytesIO(data)) as archive:
        return dict(archive)


def _archive(document: Any) -> bytes:
    file = io.BytesIO()
    np.savez(file, **document)
    return file.getvalue()


def _members(data: bytes) -> dict[str, bytes]:
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def _zipped(document: dict[str, Any]) -> bytes:
    """Return an archive with right sums of what is wrong."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        for name, data in document.items():
            archive.writestr(name, data)
    return file.getvalue()


def _records(data: bytes) -> list[Any]:
    """Return the manifest and the records of a run's database."""
    with closing(sqlite3.connect(":memory:")) as database:
        database.deserialize(data)
        query = "SELECT text FROM manifest UNION ALL SELECT record FROM trials"
        return [data, *(json.loads(text) for (text,) in database.execute(query))]


def _database(document: list[Any]) -> bytes:
    """Return a database, as the first entry has it, with other records."""
    data, manifest, *records = document
    if not data:
        raise ValueError  # SQLite would say that it has no memory for that.
    with closing(sqlite3.connect(":memory:")) as database:
        database.deserialize(data)
        with database:
            database.execute("UPDATE manifest SET text = ?", (json.dumps(manifest),))
            database.execute("DELETE FROM trials")
            for number, record in enumerate(records):
                database.execute("INSERT INTO trials VALUES (?, ?)", (number, json.dumps(record)))
        return database.serialize()


def _content() -> Codec:
    """Return the codec of a file of training; its tensors are arrays in the document."""

    def unpack(data: bytes) -> Any:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "a.safetensors"
            path.write_bytes(data)
            return _mapped(read_content(path), torch.Tensor, lambda tensor: tensor.numpy().copy())

    def pack(document: Any) -> bytes:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "a.safetensors"
            write_content(path, _mapped(document, np.ndarray, torch.tensor))
            return path.read_bytes()

    return unpack, pack


def _mapped(node: Any, kind: type, function: Callable[[Any], Any]) -> Any:
    if isinstance(node, dict):
        return {key: _mapped(value, kind, function) for key, value in node.items()}
    if isinstance(node, list):
        return [_mapped(value, kind, function) for value in node]
    return function(node) if isinstance(node, kind) else node


def _one(unpack: Callable[[bytes], bytes], pack: Callable[[bytes], bytes] = bytes) -> Codec:
    return lambda data: {"content": unpack(data)}, lambda document: pack(document["content"])


_ZIP: Codec = (_members, _zipped)
CODECS: dict[str, tuple[Codec, ...]] = {
    ".json": ((json.loads, lambda document: json.dumps(document).encode()),),
    ".jsonl": ((_lines, _joined),),
    ".gz": (
        (
            lambda data: _lines(gzip.decompress(data)),
            lambda document: gzip.compress(_joined(document), 1),
        ),
        _one(gzip.decompress, lambda data: gzip.compress(data, 1)),
    ),
    ".npz": ((_arrays, _archive), _ZIP),
    ".db": ((_records, _database),),
    ".msgpack": ((msgpack.unpackb, lambda document: msgpack.packb(document, default=str)),),
    ".safetensors": (_content(),),
    ".mcap": (_one(loose_bag),),
}
"""By the ending of a file's name: what unpacks and packs."""
