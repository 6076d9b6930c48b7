"""Limits of the size of files and of what is in them; docs/reference/limits.md lists them.

Each limit is checked before anything is read, unpacked or built, so that any file is refused in seconds and within a
few hundred megabytes. Ranges of options stand in the rooms whose options they are, those that several rooms share here.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

from craftsim.errors import InputError

KIB: Final = 1024
MIB: Final = 1024 * KIB


@dataclass(frozen=True)
class Limits:
    """Size limits of a file format."""

    noun: str
    """The file in words, for messages."""
    file_bytes: int
    """On disk."""
    content_bytes: int
    """Unpacked; the same as on disk for a format that is not packed."""
    line_bytes: int = 0
    """Size of an unpacked line, in a format that is read by lines."""
    members: int = 64
    """Files in an archive."""


def _plain(noun: str, size: int, line_bytes: int = 0) -> Limits:
    return Limits(noun, size, size, line_bytes)


YAML: Final = _plain("YAML file", 256 * KIB)
TEXT: Final = _plain("plan or list of actions", 256 * KIB)
KEY: Final = _plain("key of robots", 64 * KIB)
BUNDLE: Final = _plain("bundle.json", 8 * MIB)
ARRAYS: Final = Limits("archive of arrays", 16 * MIB, 64 * MIB)
TRAJECTORY: Final = Limits("trajectory", 256 * MIB, 1024 * MIB)
STARTS: Final = Limits("file of starts", 32 * MIB, 64 * MIB)
RECORDING: Final = Limits("recording", 64 * MIB, 256 * MIB, line_bytes=MIB)
SESSION: Final = _plain("session.db", 64 * 1024 * MIB)
POLICY: Final = _plain("policy file", 128 * MIB)
RUN: Final = _plain("run file", 4096 * MIB)
TABLE: Final = _plain("CSV table", 16 * MIB)
LOG: Final = _plain("log", 64 * MIB, line_bytes=4 * KIB)
PICTURE: Final = _plain("picture of a level", 16 * MIB)
MESH: Final = _plain("mesh", 8 * MIB)
MJCF: Final = _plain("MJCF file", MIB)
BAG: Final = Limits("ROS 2 bag", 256 * MIB, 1024 * MIB)

JSON_VALUES: Final = 200_000
"""Approximate number of values in a JSON document (number of commas)."""
YAML_VALUES: Final = 40_000
"""Number of values in a YAML file, including lists and mappings; also the limit of a written world."""
DESIGN_CELLS: Final = 4000
"""Number of cells of a design: as many as a goal file can list."""
MESH_TRIANGLES: Final = 200_000
"""Number of triangles of a mesh."""
MESH_CORNERS: Final = 64
"""Number of corners of a face of a mesh."""
MESH_EARS: Final = 400_000
"""Sum of the squares of the numbers of corners of the faces of a mesh that are not convex."""
MESH_PIECES: Final = 500_000
"""Number of cells that the triangles of a mesh pass through, counted for each triangle."""
YAML_DEPTH: Final = 8
"""Levels of lists and mappings in a YAML file."""

PHYSICS_CARS: Final = 128
"""Number of cars of a world in physics. If all of them drive, a simulated second takes about 0.6 s of CPU time."""
PHYSICS_PARTS: Final = 1024
"""Number of cars, loads, blocks, slopes, flags and walls of a world in physics together. At rest they compile and
settle in about 2 s and need 60 MiB; MuJoCo reserves 2 GiB of address space. If everything falls it takes several times
as long. Time and address space grow as the square of the number: for twice as many they are 8 s and 8 GiB."""
PHYSICS_GOALS: Final = 1024
"""Number of marked cells of a world in physics."""
PHYSICS_STEPS: Final = 1_000_000
"""Steps of a replay: an hour of simulated time at the default time step."""
MINIMIZE_S: Final = 3600.0
"""Simulated time of all trials of one minimization."""
STEP_ACTIONS: Final = 2000
"""Actions in one step of a recipe, which are scheduled together in about 2 s."""
RECIPE_ACTIONS: Final = 10_000
ACTIONS_WITHOUT_TIME: Final = 1000
"""Actions of a recipe beyond one in each control period: forbidden actions take no simulated time."""

UNIT_LENGTH: Final = 1e-3
"""Tolerance for the length of a unit quaternion that craftsim or a robot of its protocol has written."""

RECORD_BYTES: Final = 16 * MIB
"""Size of the record of a trial."""
MAX_ERROR_CHARACTERS: Final = 8000
"""Length of an error message, and of a traceback, in a record; the middle of a longer one is left out."""

POLICY_HEAD_BYTES: Final = MIB
"""Size of the head of a policy file."""
RUN_HEAD_BYTES: Final = 4 * MIB
"""Size of the head of a run file."""
CURVE_POINTS: Final = 20_000
"""Number of points of a learning curve."""
LARGEST_WEIGHT: Final = 1e4
"""Largest weight of a network."""
STAGES: Final = 100
"""Number of earlier tasks of a curriculum."""
TITLE_CHARACTERS: Final = 200
"""Length of the title of a study."""
START_WORLDS: Final = 20_000
"""Number of worlds in a file of starts."""
RECORDS: Final = 200_000
"""Number of records in a recording."""
RECORDED_CELLS: Final = 50_000_000
"""Number of cells of all records of a recording together."""
RECORDED_CARS: Final = 64
"""Number of cars in a record."""
RECORDED_DEPTH: Final = 64
"""Search depth of the action helper in a recording."""
RECORDED_TICKS: Final = 1_000_000
"""Number of ticks of a recorded episode."""

FILE_LIMITS: Final = tuple(value for value in list(vars().values()) if isinstance(value, Limits))
"""The limits of all formats."""


def shorten(text: str, max_characters: int) -> str:
    """Return a text, a long one without its end."""
    if len(text) <= max_characters:
        return text
    return f"{text[: max_characters - 3]}..."


@dataclass(frozen=True)
class Range:
    """The allowed range of a number, ends included by default; nan lies outside.

    As an annotation, ``Annotated[int, Range(0, 3)]``, it is checked by pydantic and by the command line.
    """

    low: float = -math.inf
    high: float = math.inf
    above: bool = False
    """The lower end is excluded."""
    below: bool = False
    """The upper end is excluded."""

    __is_annotated_types_grouped_metadata__ = True

    def __iter__(self) -> Iterator[Any]:
        """Yield the bounds for pydantic."""
        from annotated_types import Ge, Gt, Le, Lt

        if self.low > -math.inf:
            yield Gt(self.low) if self.above else Ge(self.low)
        if self.high < math.inf:
            yield Lt(self.high) if self.below else Le(self.high)

    def __call__(self, _type: Any, value: Any) -> None:
        """Raise ValueError for a number outside, or one of several, for the command line; None is not given."""
        numbers = value if isinstance(value, tuple) else (value,)
        for number in numbers:
            if number is not None and number not in self:
                raise ValueError(f"allowed: {self}")

    def __contains__(self, value: float) -> bool:
        if not self.low <= value <= self.high:
            return False
        if self.above and value == self.low:
            return False
        return not (self.below and value == self.high)

    def check(self, name: str, value: float) -> None:
        """Raise InputError, beginning with ``name``, for a value outside."""
        if value not in self:
            raise InputError(f"{name} is {shorten(str(value), 40)}; allowed: {self}")

    def out(self, value: float) -> str:
        """Return the message for a value outside."""
        return f"{shorten(str(value), 40)} is out of range, allowed: {self}"

    @property
    def words(self) -> str:
        """The range in words after a noun."""
        text = str(self)
        if text.startswith("above"):
            return text
        if text.startswith("at"):
            return f"of {text}"
        return f"from {text}"

    def __str__(self) -> str:
        """Return the range in words.

        Example:
            >>> str(Range(0, 1_000_000)), str(Range(0.01, 3600)), str(Range(0, 3, above=True)), str(Range(0))
            ('0 to 1000000', '0.01 to 3600', 'above 0 and at most 3', 'at least 0')
        """
        # Without ".0", so that equal ranges have equal texts.
        if isinstance(self.low, float):
            low = f"{self.low:.12g}"
        else:
            low = str(self.low)
        if isinstance(self.high, float):
            high = f"{self.high:.12g}"
        else:
            high = str(self.high)
        if not (self.above or self.below or math.inf in (-self.low, self.high)):
            return f"{low} to {high}"
        ends = []
        if self.low > -math.inf:
            word = "above" if self.above else "at least"
            ends.append(f"{word} {low}")
        if self.high < math.inf:
            word = "below" if self.below else "at most"
            ends.append(f"{word} {high}")
        return " and ".join(ends)


SEED: Final = Range(0, 2**63 - 1)
"""Seeds that all libraries accept."""
WORKERS: Final = Range(1, 256)
PORTS: Final = Range(0, 65_535)
TIMEOUT_S: Final = Range(0.01, 7 * 24 * 3600)
SHARE: Final = Range(0, 1)

MESSAGE_BYTES: Final = 128 * KIB
"""Size of a message to or from robots."""
PAGE_BYTES: Final = MIB
"""Size of a message from a page of the viewer."""
PAGE_CONNECTIONS: Final = 64
"""Concurrent connections to the viewer; a page takes a few."""
ROBOT_CONNECTIONS: Final = 32
"""Concurrent connections to robots, each with buffers of up to 128 KiB in and 320 KiB out."""

FRAME_PIXELS: Final = 4096 * 2304
IMAGE_PIXELS: Final = 2048 * 2048
"""Number of pixels of an image observation."""

IDENTIFIED_S: Final = 1800.0
"""Duration of a log for identification."""
BAG_MESSAGES: Final = 400_000
"""Messages of each of the three topics: half an hour at 200 Hz. Each command becomes a row of the log."""
BAG_MESSAGE_BYTES: Final = 64 * KIB
"""Size of one of these messages."""
BAG_CHUNK_BYTES: Final = 64 * MIB
"""Size of a chunk of messages, packed and unpacked, and of a skipped message."""
BAG_RECORDS: Final = 5_000_000
"""Number of records of a bag."""


def size_text(n_bytes: int) -> str:
    """Return a size in words.

    Example:
        >>> size_text(256 * KIB), size_text(64 * 1024 * MIB)
        ('256 KiB', '64 GiB')
    """
    for unit, factor in (("GiB", 1024 * MIB), ("MiB", MIB), ("KiB", KIB)):
        if n_bytes >= factor:
            return f"{n_bytes / factor:.4g} {unit}"
    return f"{n_bytes} bytes"
