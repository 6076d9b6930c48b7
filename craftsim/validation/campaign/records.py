"""The records of a campaign, read from its file one at a time: a million of them fit into no memory."""

from __future__ import annotations

import json
import os
import weakref
from array import array
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, overload

from craftsim.errors import InputError
from craftsim.storage.limits import MIB
from craftsim.validation.campaign.items import TrialRecord

IN_MEMORY: Final = 16 * MIB
"""Text of records that is kept; of a longer one only the places of its lines."""


class Lines:
    """Where the line of each item is in a file; nowhere to begin with."""

    def __init__(self, n_items: int) -> None:
        """Of so many items."""
        self._starts = array("q", [-1]) * n_items
        self._lengths = array("q", [0]) * n_items

    def __len__(self) -> int:
        return len(self._starts)

    def __contains__(self, index: int) -> bool:
        return self._starts[index] >= 0

    def __getitem__(self, index: int) -> tuple[int, int]:
        """Return where the line of an item starts, and its length with its end."""
        return self._starts[index], self._lengths[index]

    @property
    def size(self) -> int:
        """Length of all lines together."""
        return sum(self._lengths)

    def put(self, index: int, start: int, length: int) -> None:
        """Say where the line of an item is."""
        self._starts[index], self._lengths[index] = start, length

    def missing(self) -> Iterator[int]:
        """Yield the items that have no line."""
        return (index for index, start in enumerate(self._starts) if start < 0)

    def in_order(self) -> Lines:
        """Return the places of the same lines, one after the other in the order of the items."""
        ordered, start = Lines(len(self)), 0
        for index, length in enumerate(self._lengths):
            ordered.put(index, start, length)
            start += length
        return ordered

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Lines) and self._starts == other._starts and self._lengths == other._lengths


class Records(Sequence[TrialRecord]):
    """The records of a campaign in the order of its items; each is read when it is asked for.

    They stay as they are when another campaign begins in the folder. Changes to a record that was given are lost.
    """

    def __init__(self, path: Path, lines: Lines) -> None:
        """Take them from a file, at the places given."""
        self._path, self._lines = path, lines
        self._bundles: Mapping[int, str] = {}
        self._read = _reader(path)

    def with_bundles(self, bundles: Mapping[int, str]) -> Records:
        """Return the same records, some of them with the folders of bundles, by index."""
        found = object.__new__(Records)
        found.__dict__ |= {**self.__dict__, "_bundles": {**self._bundles, **bundles}}
        return found

    def __len__(self) -> int:
        return len(self._lines)

    @overload
    def __getitem__(self, index: int) -> TrialRecord: ...

    @overload
    def __getitem__(self, index: slice) -> list[TrialRecord]: ...

    def __getitem__(self, index: int | slice) -> TrialRecord | list[TrialRecord]:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        place = range(len(self))[index]
        try:
            record: TrialRecord = json.loads(self._read(*self._lines[place]))
        except ValueError:
            raise InputError(f"{self._path}: was changed while it was in use") from None
        if place in self._bundles:
            record["bundle"] = self._bundles[place]
        return record

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Sequence):
            return NotImplemented
        return len(self) == len(other) and all(a == b for a, b in zip(self, other, strict=True))

    def __repr__(self) -> str:
        return f"<{len(self)} records of {self._path}>"

    def __reduce__(self) -> tuple[Any, ...]:
        return list, (list(self),)


def _reader(path: Path) -> Callable[[int, int], bytes]:
    """Return what reads so many bytes from a place of a file, even where another one takes the file's place."""
    if path.stat().st_size <= IN_MEMORY:
        text = path.read_bytes()
        return lambda start, length: text[start : start + length]
    number = os.open(path, os.O_RDONLY | os.O_CLOEXEC)

    def read(start: int, length: int) -> bytes:
        return os.pread(number, length, start)

    weakref.finalize(read, os.close, number)
    return read


def select(records: Iterable[TrialRecord], wanted: Callable[[TrialRecord], bool]) -> Iterable[TrialRecord]:
    """Return those of some records that are wanted, to be gone through more than once without holding them."""
    return _Selected(records, wanted)


class _Selected:
    def __init__(self, records: Iterable[TrialRecord], wanted: Callable[[TrialRecord], bool]) -> None:
        self._records, self._wanted = records, wanted

    def __iter__(self) -> Iterator[TrialRecord]:
        return filter(self._wanted, self._records)
