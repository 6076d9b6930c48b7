"""How much a file of each format may hold; docs/limits.md shows the table.

Nothing is read, unpacked or built before the limit that it falls under has been checked, so that no file, whoever
wrote it, costs more than seconds and a few hundred megabytes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from craftsim.errors import InputError

KIB: Final = 1024
MIB: Final = 1024 * KIB


@dataclass(frozen=True)
class Limits:
    """What a file may hold at most."""

    what: str
    """The file in words, for messages."""
    file_bytes: int
    """On disk."""
    content_bytes: int
    """Unpacked, for all of it together; the same as on disk where nothing is packed."""
    line_bytes: int = 0
    """For a single line, unpacked, in a format that is read line by line."""
    members: int = 64
    """Files in an archive."""


def _plain(what: str, size: int, line_bytes: int = 0) -> Limits:
    return Limits(what, size, size, line_bytes)


YAML: Final = _plain("YAML file", 256 * KIB)
TEXT: Final = _plain("plan", 256 * KIB)
BUNDLE: Final = _plain("bundle.json", 8 * MIB)
ARRAYS: Final = Limits("archive of arrays", 16 * MIB, 64 * MIB)
STARTS: Final = Limits("file of starts", 32 * MIB, 64 * MIB)
RECORDING: Final = Limits("recording", 64 * MIB, 256 * MIB, line_bytes=MIB)
HEADER: Final = _plain("campaign.json", 4 * MIB)
TRIALS: Final = _plain("trials.jsonl", 64 * 1024 * MIB, line_bytes=16 * MIB)
POLICY: Final = _plain("policy file", 128 * MIB)
RUN: Final = Limits("run file", 4096 * MIB, 4096 * MIB, members=1024)
REPORT: Final = _plain("report.json", 64 * MIB)
TABLE: Final = _plain("CSV table", 16 * MIB)

PICKLE_BYTES: Final = 4 * MIB
"""Of the table of contents of a policy or run file."""
PICKLE_STEPS: Final = 500_000
"""Of that table: values in it, about."""
CURVE_POINTS: Final = 20_000
"""Of a learning curve."""
LARGEST_WEIGHT: Final = 1e4
"""Of a network."""
START_WORLDS: Final = 20_000
"""Of a file of starts."""
RECORDS: Final = 200_000
"""Of a recording."""
RECORDED_CELLS: Final = 50_000_000
"""Of all its records together."""
RECORDED_CARS: Final = 64
"""Of a record."""
RECORDED_DEPTH: Final = 64
"""Of the search of the action helper."""
RECORDED_TICKS: Final = 1_000_000
"""Of an episode."""

ALL: Final = (YAML, TEXT, BUNDLE, ARRAYS, STARTS, RECORDING, HEADER, TRIALS, POLICY, RUN, REPORT, TABLE)


@dataclass(frozen=True)
class Range:
    """What a number may be, both ends included; what is no number at all lies outside."""

    low: float
    high: float

    def check(self, name: str, value: float) -> None:
        """Raise InputError, beginning with ``name``, for a value outside."""
        if not self.low <= value <= self.high:
            shown = text if len(text := str(value)) <= 40 else f"{text[:37]}..."
            raise InputError(f"{name} is {shown}; allowed: {self}")

    def __str__(self) -> str:
        """Return the range in words.

        Example:
            >>> str(Range(0, 1_000_000)), str(Range(0.01, 3600))
            ('0 to 1000000', '0.01 to 3600')
        """
        return f"{self.low} to {self.high}"


SEED: Final = Range(0, 2**63 - 1)
"""What each of the libraries that draw takes."""
BATCH: Final = Range(1, 100_000)
"""Worlds that are stepped side by side on the grid."""
TRAIN_STEPS: Final = Range(1, 10**12)
TRAIN_EPISODES: Final = Range(1, 100_000)
SHARE: Final = Range(0, 1)
BONUS: Final = Range(0, 1000)
"""Of novelty."""
NETWORK_WIDTH: Final = Range(1, 4096)


def size_text(n_bytes: int) -> str:
    """Return a size as people say it.

    Example:
        >>> size_text(256 * KIB), size_text(64 * 1024 * MIB)
        ('256 KiB', '64 GiB')
    """
    for unit, factor in (("GiB", 1024 * MIB), ("MiB", MIB), ("KiB", KIB)):
        if n_bytes >= factor:
            return f"{n_bytes / factor:.4g} {unit}"
    return f"{n_bytes} bytes"
