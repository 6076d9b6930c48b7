"""How much a file of each format may hold; docs/limits.md shows the table.

Nothing is read, unpacked or built before the limit that it falls under has been checked, so that no file, whoever
wrote it, costs more than seconds and a few hundred megabytes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

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


def _plain(what: str, size: int, line_bytes: int = 0) -> Limits:
    return Limits(what, size, size, line_bytes)


YAML: Final = _plain("YAML file", 256 * KIB)
TEXT: Final = _plain("plan", 256 * KIB)
BUNDLE: Final = _plain("bundle.json", 8 * MIB)
ARRAYS: Final = Limits("archive of arrays", 16 * MIB, 64 * MIB)
STARTS: Final = Limits("file of starts", 32 * MIB, 128 * MIB)
RECORDING: Final = Limits("recording", 256 * MIB, 4096 * MIB, line_bytes=4 * MIB)
HEADER: Final = _plain("campaign.json", 4 * MIB)
TRIALS: Final = _plain("trials.jsonl", 64 * 1024 * MIB, line_bytes=16 * MIB)
POLICY: Final = _plain("policy file", 64 * MIB)
RUN: Final = _plain("run file", 256 * MIB)
REPORT: Final = _plain("report.json", 64 * MIB)
TABLE: Final = _plain("CSV table", 16 * MIB)

JSON_VALUES: Final = 200_000
"""Values in a JSON document that is read whole, about: commas are counted."""
YAML_VALUES: Final = 40_000
"""Values in a YAML file, lists and mappings included; so many a world may also make when it is written out."""
YAML_DEPTH: Final = 8
"""Levels of lists and mappings in a YAML file."""

PHYSICS_CELLS: Final = 8192
"""Of the area of a world in physics: nine times that of the largest random world."""
PHYSICS_CARS: Final = 16
PHYSICS_PARTS: Final = 128
"""Cars, loads, blocks, slopes, flags and walls of a world in physics together: what compiles, and settles
while all of it moves, in 2 s and 500 MB."""
PHYSICS_GOALS: Final = 1024
"""Cells that are marked in a world in physics."""
PHYSICS_STEPS: Final = 1_000_000
"""Of a replay: an hour of simulated time at the usual time step."""
SHRINK_S: Final = 3600.0
"""Of simulated time, for all trials of the search for the smallest world of one failure."""
STEP_ACTIONS: Final = 2000
"""Scheduled together, in one step of a recipe: 2 s of scheduling."""
RECIPE_ACTIONS: Final = 10_000
ACTIONS_WITHOUT_TIME: Final = 1000
"""Of a recipe, beyond one in each control period: what the rules forbid takes no simulated time."""

ALL: Final = (YAML, TEXT, BUNDLE, ARRAYS, STARTS, RECORDING, HEADER, TRIALS, POLICY, RUN, REPORT, TABLE)


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
