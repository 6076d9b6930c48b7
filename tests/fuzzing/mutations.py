"""Ways to damage a file."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

YAML_PIECES = (
    "0", "-1", "1", "3", "99", "1e9", ".nan", "~", "''", "\"", "[", "]", "{", "}", ":", ",", "- ", "\n", "  ", "\t",
    "&a", "*a", "!t", "#", "---\n", "...\n", "x", "yaw: 1", "id: 0", "load: flag", "slope: 2", "snapshot: {}\n",
    "flag:\n  - {id: 0, x: 1, y: 1, z: 1}\n", "wall:\n", "goal:\n", "null",
    "\u00e9", "\x00", "\u2028", "\ud7ff", "%YAML 9.9\n",
)  # fmt: skip
JSON_PIECES = (
    "0", "-1", "1e400", "-1e9", "NaN", "null", "true", "\"\"", "\"\\ud800\"", "[]", "{}", "[", "]", "{", "}", ",", ":",
    "\"x\"", "1.5", "9" * 30, "\x00", "\u00e9", "\n", "\\", "[[[[", "\"a\":1,", "-", "0.0000001",
)  # fmt: skip


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


def mutated_bytes(data: bytes, rng: np.random.Generator) -> bytes:
    """Return bytes of which a few are flipped, cut out, doubled or overwritten."""
    for _ in range(rng.integers(1, 4)):
        a = int(rng.integers(0, max(1, len(data))))
        b = a + int(rng.integers(1, 40))
        kind = rng.integers(4)
        if kind == 0:
            data = data[:a] + bytes([data[a] ^ (1 << int(rng.integers(8)))] if data else b"") + data[a + 1 :]
        elif kind == 1:
            data = data[:a] + data[b:]
        elif kind == 2:
            data = data[:b] + data[a:]
        else:
            data = data[:a] + rng.bytes(b - a) + data[b:]
    return data


def _other_digit(text: str, rng: np.random.Generator) -> str:
    start = int(rng.integers(0, len(text) + 1))
    for place in (*range(start, len(text)), *range(start)):
        if text[place].isdigit():
            return text[:place] + str(rng.integers(-2, 12)) + text[place + 1 :]
    return text
