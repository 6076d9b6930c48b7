"""Odd words, names of policies and tasks, and damaged tables."""

from __future__ import annotations

import contextlib
import io
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np

from craftsim.cli import main
from craftsim.discrete.tasks import as_task
from craftsim.experiments.durations import Duration, read_durations, write_durations
from craftsim.storage.limits import SEED
from craftsim.validation.policies import make_policy
from fuzzing.mutations import mutated_bytes

ROWS = [
    Duration("LIFT", "none", 1, False, 12, 2.01, 1.9, 2.0, 2.2, 2.25),
    Duration("MOVE", "block", 2, True, 3, 3.5, 3.25, 3.5, 3.75, 3.8),
    Duration("UNFOLD", "fslope", 1, False, 1, 4.0, 4.0, 4.0, 4.0, 4.0),
]
NAMES = ["json:dumps", "own.policies:greedy", "strip", "shelf.yaml", "random", "tasks:corner", "os.path:join"]
LETTERS = (
    *(":", "::", ".", "..", "/", "\x00", "\x1b", "\udce9", " ", "\n", "~", "-", "\u202e", "x" * 300, "[/]", ""),
)  # fmt: skip
WORDS = [
    ["show", "strip", "--seed", "3"],
    ["bench", "rules", "--seconds", "0.5", "--worlds", "7"],
    ["validate", "strip", "--trials", "2", "--timeout", "30"],
]


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
    path.write_bytes(mutated_bytes(_table(), rng))
    read_durations(path)


def name(rng: np.random.Generator, folder: Path) -> None:
    """Look up a mutated name of a policy, or of a task."""
    with contextlib.chdir(folder):
        if rng.integers(2):
            make_policy(_name(rng), 0)
        else:
            as_task(_name(rng))


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
