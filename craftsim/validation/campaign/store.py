"""The folder of a campaign: what is finished is on disk at once, whatever happens next.

``campaign.json`` says what the campaign is; ``trials.jsonl`` gets one line for each finished item, in the order in
which they finish, and is put into the items' order at the end.
"""

from __future__ import annotations

import json
import os
import reprlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, Final

from craftsim.errors import InputError
from craftsim.storage.folders import owned, remove
from craftsim.storage.limits import MIB, size_text
from craftsim.storage.limits import TRIALS as TRIALS_LIMITS
from craftsim.storage.reading import read_lines
from craftsim.storage.writing import whole, write_whole
from craftsim.validation.campaign.header import CAMPAIGN, Header, described, differences, read_header
from craftsim.validation.campaign.items import Failure, Item, TrialRecord, identity, line_of, make_record
from craftsim.validation.campaign.records import Lines, Records
from craftsim.validation.campaign.schema import ANY, Form

TRIALS: Final = "trials.jsonl"
_FILES: Final = ("report.json", "report.html", "durations.csv")
_FOLDERS: Final = ("bundles", "films", "trajectories", "worlds", "smallest")
"""What a campaign leaves besides; it goes when another one begins in its folder."""


class Store:
    """The records of one campaign, whose folder it owns until it is closed."""

    def __init__(
        self, out: Path, header: Header, items: Sequence[Item], resume: bool, form: Form = ANY
    ) -> None:
        """Begin a campaign in a folder, or go on with the one that is there.

        Raises:
            InputError: the folder cannot be written to; somebody else owns it; it holds results of no campaign,
                or an unfinished campaign and ``resume`` is not set; or, with it, holds another campaign, or
                records that cannot be read.
        """
        if len({item.key for item in items}) != len(items):
            raise ValueError("keys of a campaign's items must be unique")
        self.out, self._path = out, out / TRIALS
        self._items, self._form, self._header = items, form, described(header, items)
        self._lines = Lines(len(items))
        with ExitStack() as opened:
            opened.enter_context(owned(out))
            with _disk(out):
                _check_places(out)
                self._number = self._open()
                opened.callback(lambda: os.close(self._number))
                self._begin(resume)
            self._opened = opened.pop_all()

    @property
    def n_kept(self) -> int:
        """How many trials are on disk."""
        found = start = last = 0
        while text := os.pread(self._number, MIB, start):
            if (place := text.rfind(b"\n")) >= 0:
                found, last = found + text.count(b"\n"), start + place
            start += len(text)
            if start - last > TRIALS_LIMITS.line_bytes + MIB:
                allowed = size_text(TRIALS_LIMITS.line_bytes)
                raise InputError(
                    f"{self._path}:{found + 1}: the line is longer than the {allowed} that are allowed"
                )
        return found

    def kept(self) -> Iterator[TrialRecord]:
        """Yield the records of an earlier run without an error."""
        kept = [index for index in range(len(self._items)) if index in self._lines]
        for start, length in sorted(map(self._lines.__getitem__, kept)):
            yield json.loads(os.pread(self._number, length, start))

    def missing(self) -> Iterator[tuple[int, Item]]:
        """Yield the items that have no record, with their numbers."""
        return ((index, self._items[index]) for index in self._lines.missing())

    def append(self, record: TrialRecord) -> TrialRecord:
        """Write a record down for good, and return it as it would be read back.

        One that is longer than a line may be gives way to one of a failure. Raises InputError where the disk does not
        take it.
        """
        line, index = line_of(record), record["index"]
        if len(line) > TRIALS_LIMITS.line_bytes:
            allowed = size_text(TRIALS_LIMITS.line_bytes)
            failure = Failure(f"its record has {size_text(len(line))}; allowed: at most {allowed}")
            line = line_of(make_record(self._items[index], index, failure))
        with _disk(self.out):
            start = os.lseek(self._number, 0, os.SEEK_END)
            try:
                rest = memoryview(line)
                while rest:
                    rest = rest[os.write(self._number, rest) :]
                os.fsync(self._number)
            except OSError:
                os.ftruncate(self._number, start)
                raise
        self._lines.put(index, start, len(line))
        written: TrialRecord = json.loads(line)
        return written

    def finish(self) -> Records:
        """Return all records in the order of the items, and leave them on disk in that order."""
        ordered = self._lines.in_order()
        with _disk(self.out):
            if ordered != self._lines or ordered.size != os.fstat(self._number).st_size:
                with whole(self._path) as partial, partial.open("wb") as file:
                    for index in range(len(self._items)):
                        start, length = self._lines[index]
                        file.write(os.pread(self._number, length, start))
            return Records(self._path, ordered)

    def close(self) -> None:
        """Let others open the folder."""
        self._opened.close()

    def _open(self) -> int:
        """Open the file of records; no link is followed, and a pipe is not waited for."""
        flags = os.O_RDWR | os.O_APPEND | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
        return os.open(self._path, flags, 0o666)

    def _begin(self, resume: bool) -> None:
        path = self.out / CAMPAIGN
        there = read_header(path) if path.exists() else None
        n_lines = self.n_kept
        if there is not None and resume and n_lines:
            _check_same(path, there, self._header)
            self._read()
            return
        if there is not None and 0 < n_lines < there["items"]:
            raise InputError(
                f"{self.out} holds an unfinished campaign ({n_lines} of {there['items']} trials): go on with "
                "--resume, or choose another --out, or remove that folder"
            )
        for name in (*_FILES, *_FOLDERS):
            remove(self.out / name)
        # A file of its own: who still holds the records of the campaign before can read on.
        self._path.unlink()
        before, self._number = self._number, self._open()
        os.close(before)
        write_whole(path, json.dumps(self._header, indent=2, sort_keys=True) + "\n")

    def _read(self) -> None:
        """Take every whole line without an error; what a kill left of the last one is cut off."""
        start = 0
        for number, line in read_lines(self._path, TRIALS_LIMITS):
            if not line.endswith(b"\n"):
                break
            record = read_record(self._form, line, f"{self._path}:{number}", "its trial is run again")
            index = record["index"]
            if index >= len(self._items) or {**record, **identity(self._items[index], index)} != record:
                raise InputError(
                    f"{self._path}:{number}: trial {reprlib.repr(record['key'])} is none of this campaign; "
                    "delete this line"
                )
            if record["error"] is None:
                self._lines.put(index, start, len(line))
            start += len(line)
        os.ftruncate(self._number, start)


def read_record(form: Form, line: bytes, where: str, remedy: str) -> TrialRecord:
    """Return the record that a line holds; raise InputError, with the remedy, for one that is none."""
    try:
        return form.record(line, f"{where}: not a trial's record")
    except InputError as error:
        raise InputError(f"{error}; delete this line, and {remedy}") from None


def _check_places(out: Path) -> None:
    """Raise InputError where something else is in the place of a file or folder of a campaign, or a stranger's."""
    for name in (CAMPAIGN, TRIALS, *_FILES, *_FOLDERS):
        path, what = out / name, "folder" if name in _FOLDERS else "regular file"
        fits = path.is_dir() if name in _FOLDERS else path.is_file()
        if os.path.lexists(path) and (path.is_symlink() or not fits):
            raise InputError(f"{path}: not a {what}; move it away, or choose another --out")
    trials = out / TRIALS
    strangers = [TRIALS] if trials.exists() and trials.stat().st_size else []
    strangers += [name for name in (*_FILES, *_FOLDERS) if (out / name).exists()]
    if strangers and not (out / CAMPAIGN).exists():
        raise InputError(
            f"{out} holds {' and '.join(strangers)}, but no {CAMPAIGN} that says what campaign they are of; "
            f"choose another --out, or move them away, or put {CAMPAIGN} back"
        )


def _check_same(path: Path, there: Mapping[str, Any], wanted: Mapping[str, Any]) -> None:
    for key, (old, new) in differences(there, wanted):
        raise InputError(
            f"{path}: cannot go on with another campaign: its {key} is {reprlib.repr(old)}, not {reprlib.repr(new)}; "
            "use the options that it was begun with, or choose another --out"
        )


@contextmanager
def _disk(out: Path) -> Iterator[None]:
    """Turn what the disk refuses into a message for people."""
    try:
        yield
    except OSError as error:
        raise InputError(
            f"cannot write into {out}: {error.strerror}; what was finished is kept: make room, then --resume"
        ) from error
