"""Mutated words, names and tables: one case a call, for ``make test`` and ``make fuzz``."""

from __future__ import annotations

import contextlib
import io
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np

from craftsim.cli import main
from craftsim.discrete.tasks import task_of
from craftsim.errors import InputError
from craftsim.storage.limits import SEED
from craftsim.validation.runs.policies import make_policy
from craftsim.validation.statistics.durations import Duration, read_durations, write_durations

ROWS = [
    Duration("LIFT", "none", 1, False, 12, 2.01, 1.9, 2.0, 2.2, 2.25),
    Duration("MOVE", "block", 2, True, 3, 3.5, 3.25, 3.5, 3.75, 3.8),
    Duration("UNFOLD", "fslope", 1, False, 1, 4.0, 4.0, 4.0, 4.0, 4.0),
]
PIECES = [
    *(b",", b"\n", b"\r", b'"', b"True", b"nan", b"-inf", b"1e999", b"9" * 5000, b"-1", b"0x1", b"\xff"),
    *(
        b"\x00",
        b"\xef\xbb\xbf",
        b"LIFT,none,1,False,",
        b"\xed\xa0\x80",
        b"\xe2\x80\xae",
        b"\x1b[31m",
        b",,,,",
    ),
]
NAMES = ["json:dumps", "own.policies:greedy", "strip", "shelf.yaml", "random", "tasks:corner", "os.path:join"]
LETTERS = [
    ":",
    "::",
    ".",
    "..",
    "/",
    "\x00",
    "\x1b",
    "\udce9",
    " ",
    "\n",
    "~",
    "-",
    "\u202e",
    "x" * 300,
    "[/]",
    "",
]
WORDS = [
    ["show", "strip", "--seed", "3"],
    ["bench", "rules", "--seconds", "0.5", "--worlds", "7"],
    ["validate", "strip", "--trials", "2", "--timeout", "30"],
]


def mutated(data: bytes, rng: np.random.Generator) -> bytes:
    """Return bytes with a few pieces cut out, put in, flipped or swapped."""
    for _ in range(rng.integers(1, 5)):
        a, b = sorted(rng.integers(0, len(data) + 1, 2))
        b = min(b, a + int(rng.integers(0, 30)))
        piece = PIECES[rng.integers(len(PIECES))]
        kind = rng.integers(5)
        if kind == 0:
            data = data[:a] + data[b:]
        elif kind == 1:
            data = data[:a] + piece + data[b:]
        elif kind == 2 and a < len(data):
            data = data[:a] + bytes([data[a] ^ 1 << int(rng.integers(8))]) + data[a + 1 :]
        elif kind == 3:
            data = data[b:] + data[:a]
        else:
            data = data[:b] + data[a:]
    return data


@cache
def _table() -> bytes:
    """Return the bytes of a table that is as it should be."""
    with tempfile.TemporaryDirectory() as folder:
        return write_durations(Path(folder), ROWS).read_bytes()


def _name(rng: np.random.Generator) -> str:
    text = NAMES[rng.integers(len(NAMES))]
    for _ in range(rng.integers(1, 4)):
        a, b = sorted(rng.integers(0, len(text) + 1, 2))
        text = text[:a] + LETTERS[rng.integers(len(LETTERS))] + text[b if rng.integers(2) else a :]
    return text


def table(rng: np.random.Generator, folder: Path) -> None:
    """Read a mutated table of durations."""
    path = folder / "durations.csv"
    path.write_bytes(mutated(_table(), rng))
    with contextlib.suppress(InputError):
        read_durations(path)


def name(rng: np.random.Generator, folder: Path) -> None:
    """Look up a mutated name of a policy, or of a task."""
    with contextlib.suppress(InputError), contextlib.chdir(folder):
        if rng.integers(2):
            make_policy(_name(rng), 0)
        else:
            task_of(_name(rng))


def number(rng: np.random.Generator, folder: Path) -> None:
    """Give a command a number that no command takes, in all manners of writing."""
    words = list(WORDS[rng.integers(len(WORDS))])
    odd = [str(-int(rng.integers(1, 2**62))), str(SEED.high * int(rng.integers(2, 2**40)))]
    odd += ["nan", "inf", "-inf", "1e400"]
    odd += ["9" * int(rng.integers(25, 9000)), "", "x", "1__0", "0x10", "1;2", "\udce9", "\x1b[0m"]
    words[-1] = odd[rng.integers(len(odd))]
    screen = io.StringIO()
    with contextlib.redirect_stdout(screen), contextlib.redirect_stderr(screen), contextlib.chdir(folder):
        try:
            status = main(words)
        except SystemExit as error:  # a word that is no number at all
            status = error.code
    assert status == 2, words


TARGETS: dict[str, Callable[[np.random.Generator, Path], None]] = {
    "durations": table,
    "names": name,
    "numbers": number,
}


def attack(rng: np.random.Generator, folder: Path) -> None:
    """Make and read one mutated case; those that take longer, less often."""
    TARGETS[str(rng.choice(list(TARGETS), p=[0.85, 0.13, 0.02]))](rng, folder)
