"""Ways to damage a file."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import numpy as np

YAML_PIECES = (
    "0", "-1", "1", "3", "99", "1e9", ".nan", "~", "''", "\"", "[", "]", "{", "}", ":", ",", "- ", "\n", "  ", "\t",
    "&a", "*a", "!t", "#", "---\n", "...\n", "x", "yaw: 1", "id: 0", "load: flag", "slope: 2", "snapshot: {}\n",
    "flag:\n  - {id: 0, x: 1, y: 1, z: 1}\n", "wall:\n", "goal:\n", "null",
    "\u00e9", "\x00", "\u2028", "\ud7ff", "%YAML 9.9\n",
)  # fmt: skip
BYTE_PIECES = (
    *(b"0", b"-", b"1e999", b"NaN", b"[", b"]", b"{", b"}", b":", b",", b"null", b'"', b"\\", b"\n", b"  ", b"- "),
    *(b"\xff", b"\x00", b"\xed\xa0\x80", b"&a", b"*a", b"!t", b"---\n", b"9" * 40, b"[" * 300, b"x: 1", b"slope: 2"),
    *(b"\xef\xbb\xbf", b"\x1b[31m", b"\xe2\x80\xae"),
)  # fmt: skip
JSON_VALUES = (
    *(b"null", b"true", b"-1", b"0", b"99", b"1e308", b"1e999", b"-0.0", b"NaN", b'"x"', b'""', b"[]", b"{}"),
    *(b'[{"a": []}]', b'"\\ud800"', b'"\\u0000"', b'"bundles/.."', b"9" * 400, b"9" * 5000, b"[" * 300),
    b"[" * 150 + b"]" * 150,
)  # fmt: skip
VALUES: Sequence[Any] = (
    *(None, True, False, "", "x", "1", [], {}, [[]], {"a": 1}, [None], -1, 0, 1, 2, 3, 99, 2**31, 2**63, 10**400),
    *(-(10**30), 0.5, -0.0, 1e-300, 1e-9, 1e9, 1e300, -1e300, float("nan"), float("inf"), "\x1b[31m", "\u00e9" * 9),
)  # fmt: skip
_JSON_VALUE = re.compile(rb'"[^"]*"|-?\d+\.?\d*(?:e-?\d+)?|true|false|null')


def mutated_text(text: str, rng: np.random.Generator, pieces: Sequence[str] = YAML_PIECES) -> str:
    """Return a text with a few pieces cut out, put in, doubled or swapped, or with other digits."""
    for _ in range(rng.integers(1, 5)):
        a, b = sorted(rng.integers(0, len(text) + 1, 2))
        b = min(b, a + int(rng.integers(0, 30)))
        piece = pieces[rng.integers(len(pieces))]
        kind = rng.integers(5)
        if kind == 0:
            text = text[:a] + text[b:]
        elif kind == 1:
            text = text[:a] + piece + text[a:]
        elif kind == 2:
            text = text[:a] + piece + text[b:]
        elif kind == 3:
            text = text[:b] + text[a:]
        else:
            text = _other_digit(text, rng)
    return text


def mutated_bytes(data: bytes, rng: np.random.Generator, pieces: Sequence[bytes] = BYTE_PIECES) -> bytes:
    """Return bytes of which a few are flipped, cut out, doubled, swapped or overwritten, or that end too early."""
    for _ in range(rng.integers(1, 5)):
        a, b = sorted(int(place) for place in rng.integers(0, len(data) + 1, 2))
        b = min(b, a + int(rng.integers(1, 40)))
        match rng.integers(9):
            case 0:
                data = data[:a] + data[b:]
            case 1:
                data = data[:a] + pieces[rng.integers(len(pieces))] + data[a:]
            case 2:
                data = data[:a] + pieces[rng.integers(len(pieces))] + data[b:]
            case 3:
                data = data[:b] + data[a:]
            case 4:
                data = data[:a] + rng.bytes(b - a) + data[b:]
            case 5:
                data = data[:a] + bytes(255 - byte for byte in data[a:b]) + data[b:]
            case 6:
                data = (
                    data[:a]
                    + bytes(byte ^ 1 << int(rng.integers(8)) for byte in data[a : a + 1])
                    + data[a + 1 :]
                )
            case 7:
                data = data[b:] + data[:a]
            case _:
                data = data[:a]
    return data


def mutated_json(data: bytes, rng: np.random.Generator) -> bytes:
    """Return a text of JSON with one to three things changed, values more often than anything else."""
    for _ in range(rng.integers(1, 4)):
        found = list(_JSON_VALUE.finditer(data))
        if not found or rng.random() < 0.3:
            data = mutated_bytes(data, rng)
            continue
        one = found[rng.integers(len(found))]
        data = data[: one.start()] + JSON_VALUES[rng.integers(len(JSON_VALUES))] + data[one.end() :]
    return data


def mutated_document(document: Any, rng: np.random.Generator) -> Any:
    """Replace, remove, double or add something anywhere in a document of JSON, in place; return it."""
    places: list[tuple[Any, Any]] = []
    waiting = [document]
    while waiting:
        node = waiting.pop()
        keys = node if isinstance(node, dict) else range(len(node)) if isinstance(node, list) else ()
        places += [(node, key) for key in keys]
        waiting += [node[key] for key in keys]
    node, key = places[rng.integers(len(places))]
    match rng.integers(6):
        case 0 if isinstance(node, dict):
            node[f"{key}x"] = node[key]
        case 1:
            del node[key]
        case 2 if isinstance(node, list):
            node *= int(rng.integers(2, 50))
        case 3 if isinstance(node[key], int | float):
            node[key] *= float(10.0 ** rng.integers(-9, 10))
        case _:
            node[key] = VALUES[rng.integers(len(VALUES))]
    return document


def _other_digit(text: str, rng: np.random.Generator) -> str:
    start = int(rng.integers(0, len(text) + 1))
    for place in (*range(start, len(text)), *range(start)):
        if text[place].isdigit():
            return text[:place] + str(rng.integers(-2, 12)) + text[place + 1 :]
    return text
