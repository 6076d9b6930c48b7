"""The records of a run, read lazily from its folder, since a million of them do not fit into memory."""

from __future__ import annotations

import json
import reprlib
import sqlite3
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, overload

from craftsim.errors import InputError
from craftsim.experiments.experiment import ANY, Form, Manifest, TrialRecord, manifest_of
from craftsim.storage.limits import HEADER, SESSION
from craftsim.storage.limits import TRIALS as TRIALS_LIMITS
from craftsim.storage.paths import exists
from craftsim.storage.reading import open_file, read_bytes, read_lines

DATABASE: Final = "session.db"
LOG: Final = f"{DATABASE}-wal"
"""SQLite's write-ahead log; exists while a run is open."""
TRIALS: Final = "trials.jsonl"
OLD: Final = "campaign.json"
"""Manifest of a run of craftsim 0.2, whose records are in ``trials.jsonl``."""

_TABLES: Final = (
    "CREATE TABLE manifest (text TEXT NOT NULL)",
    "CREATE TABLE trials (number INTEGER PRIMARY KEY, record TEXT NOT NULL)",
    "CREATE TABLE further (stage TEXT, key TEXT, answer TEXT NOT NULL, PRIMARY KEY (stage, key))",
)
_PAGE: Final = 64
"""Records read in one query."""


class Records(Sequence[TrialRecord]):
    """The records of a run in the order of its trials, each read on access.

    They remain valid when another run starts in the folder. Changes to a returned record are lost.
    """

    def __init__(self, database: sqlite3.Connection, where: Path, length: int) -> None:
        """Read from the open database of a run."""
        self._databases, self._where, self._length = [database], where, length
        self._bundles: Mapping[int, str] = {}

    def with_bundles(self, bundles: Mapping[int, str]) -> Records:
        """Return these records with the folders of bundles added, by index."""
        made = Records(self._databases[0], self._where, self._length)
        made._databases, made._bundles = self._databases, {**self._bundles, **bundles}
        return made

    def read_from(self, database: sqlite3.Connection) -> None:
        """Read from another database from now on, also for records derived from these."""
        self._databases[0] = database

    def __len__(self) -> int:
        return self._length

    @overload
    def __getitem__(self, index: int) -> TrialRecord: ...

    @overload
    def __getitem__(self, index: slice) -> list[TrialRecord]: ...

    def __getitem__(self, index: int | slice) -> TrialRecord | list[TrialRecord]:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(self._length))]
        place = range(self._length)[index]
        return next(self._some(place, place + 1))

    def __iter__(self) -> Iterator[TrialRecord]:
        for first in range(0, self._length, _PAGE):
            yield from self._some(first, min(first + _PAGE, self._length))

    def of(self, numbers: Iterable[int]) -> Iterator[TrialRecord]:
        """Yield the records of some trials."""
        return map(self.__getitem__, numbers)

    def _some(self, first: int, end: int) -> Iterator[TrialRecord]:
        try:
            found = texts(self._databases[0], first, end)
        except sqlite3.Error:
            found = []
        if len(found) != end - first:
            raise InputError(f"{self._where}: was changed while it was in use")
        for number, text in found:
            record: TrialRecord = json.loads(text)
            if number in self._bundles:
                record["bundle"] = self._bundles[number]
            yield record

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Sequence):
            return NotImplemented
        return len(self) == len(other) and all(a == b for a, b in zip(self, other, strict=True))

    def __repr__(self) -> str:
        return f"<{self._length} records of {self._where}>"

    def __reduce__(self) -> tuple[Any, ...]:
        return list, (list(self),)


@dataclass(frozen=True)
class Selected:
    """A re-iterable filter of records, without keeping them in memory."""

    records: Iterable[TrialRecord]
    wanted: Callable[[TrialRecord], bool]

    def __iter__(self) -> Iterator[TrialRecord]:
        return filter(self.wanted, self.records)


@dataclass(frozen=True)
class Finished:
    """A finished run."""

    folder: Path
    manifest: Mapping[str, Any]
    """Command, seed, versions, config."""
    records: Records


def read_finished(folder: Path, command: str, form: Form = ANY) -> Finished:
    """Return the finished run of a command, also of craftsim 0.2.

    Raises:
        InputError: the folder holds no run, an unfinished run, one of another command, or invalid records.
    """
    with described(folder, f"give the --out of an earlier 'craftsim {command}'") as (database, manifest):
        if manifest["command"] != command:
            raise InputError(
                f"{folder} holds a run of {reprlib.repr('craftsim ' + manifest['command'])}; "
                f"give the --out of an earlier 'craftsim {command}'"
            )
        n = manifest["items"]
        finish = f"finish it with 'craftsim {command} --resume --out {folder}' and the options that it was begun with"
        if exists(folder / LOG):
            raise InputError(f"{folder} holds a run that goes on, or was cut off; {finish}")
        if exists(folder / DATABASE):
            found = sum(1 for _ in checked(database, folder / DATABASE, n, form, "choose another folder"))
        else:
            found = _take_lines(database, folder / TRIALS, n, form)
        if found < n:
            raise InputError(f"{folder} holds an unfinished run ({found} of {n} trials); {finish}")
    return Finished(folder, manifest, Records(database, folder / DATABASE, n))


@contextmanager
def described(folder: Path, remedy: str) -> Iterator[tuple[sqlite3.Connection, Manifest]]:
    """Open the database in a folder for reading; yield it with its manifest.

    Raises InputError, with the remedy, for a folder without a valid run.
    """
    path = folder / DATABASE
    with disk_errors(folder):
        if exists(path):
            open_file(path, SESSION).close()
            database = as_it_is(path)
            if not has_tables(database, path):
                raise InputError(f"{path}: holds no run; {remedy}")
            yield database, stored_manifest(database, path)
            return
        if not exists(folder / OLD):
            raise InputError(f"{folder} holds no run; {remedy}")
        yield with_tables(connected("")), old_manifest(folder)


def old_manifest(folder: Path) -> Manifest:
    """Return the manifest of a run of craftsim 0.2. Raises InputError if it is invalid."""
    return _manifest(read_bytes(folder / OLD, HEADER), folder / OLD)


def _manifest(data: bytes, path: Path) -> Manifest:
    try:
        return manifest_of(data, f"{path}: not a run's manifest")
    except InputError as error:
        raise InputError(f"{error}; choose another folder") from None


def _take_lines(database: sqlite3.Connection, path: Path, n: int, form: Form) -> int:
    """Copy the lines of a run of craftsim 0.2 into a database; return how many of its ``n`` trials have a record."""
    with database:
        for number, line in read_lines(path, TRIALS_LIMITS) if exists(path) else ():
            if not line.endswith(b"\n"):
                break
            record = _checked(form, line, f"{path}:{number}", n, "delete this line")
            put = "INSERT OR REPLACE INTO trials VALUES (?, ?)"
            database.execute(put, (record["index"], line.decode()))
    ((found,),) = database.execute("SELECT count(*) FROM trials")
    return int(found)


def checked(
    database: sqlite3.Connection, path: Path, n: int, form: Form, remedy: str
) -> Iterator[TrialRecord]:
    """Yield the records of ``n`` trials in a database. Raises InputError, with the remedy, for an invalid one."""
    numbers = "SELECT ifnull(min(number), 0), ifnull(max(number), -1) FROM trials"
    ((first, last),) = database.execute(numbers).fetchall()
    if first < 0 or last >= n:
        raise InputError(f"{path}: holds trial {first if first < 0 else last} of {n}; {remedy}")
    for start in range(first, last + 1, _PAGE):
        for number, text in texts(database, start, start + _PAGE):
            # In a damaged file there may be anything, numbers and nothing at all too.
            data = text.encode() if isinstance(text, str) else text if isinstance(text, bytes) else b""
            record = _checked(form, data, f"{path}: trial {number}", n, remedy)
            if record["index"] != number:
                raise InputError(f"{path}: trial {number} says that it is {record['index']}; {remedy}")
            yield record


def _checked(form: Form, data: bytes, where: str, n: int, remedy: str) -> TrialRecord:
    try:
        record = form.record(data, f"{where}: not a trial's record")
    except InputError as error:
        raise InputError(f"{error}; {remedy}") from None
    if record["index"] >= n:
        raise InputError(f"{where}: index: {record['index']}, but the run has {n} trials; {remedy}")
    return record


def differences(old: Any, new: Any, key: str = "") -> Iterator[tuple[str, tuple[Any, Any]]]:
    """Yield the dotted names of differing values, with both values."""
    if isinstance(old, dict) and isinstance(new, dict):
        for name in sorted({*old, *new}):
            yield from differences(old.get(name), new.get(name), f"{key}.{name}" if key else name)
    elif old != new:
        yield key, (old, new)


def connected(uri: str) -> sqlite3.Connection:
    """Return a connection to a database; an empty URI gives a temporary one."""
    # Without waiting: who has it locked has it for as long as a run takes.
    database = sqlite3.connect(uri, timeout=0, isolation_level=None, check_same_thread=False, uri=True)
    database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, TRIALS_LIMITS.line_bytes)
    database.execute("PRAGMA trusted_schema = OFF")
    return database


def as_it_is(path: Path) -> sqlite3.Connection:
    """Return a connection that reads the present file without locks, even after it is replaced."""
    database = connected(f"{path.absolute().as_uri()}?immutable=1")
    database.execute("PRAGMA user_version").fetchall()
    return database


def with_tables(
    database: sqlite3.Connection, manifest: Mapping[str, Any] | None = None
) -> sqlite3.Connection:
    """Create the tables of a run in an empty database, in one transaction, and return it."""
    database.execute("BEGIN")
    for table in _TABLES:
        database.execute(table)
    if manifest is not None:
        database.execute("INSERT INTO manifest VALUES (?)", (json.dumps(manifest, sort_keys=True),))
    database.execute("COMMIT")
    return database


def has_tables(database: sqlite3.Connection, path: Path) -> bool:
    """Return whether a database has the tables of a run; False if it is empty. Raises InputError for any other.

    Views and triggers are refused, since they could execute code.
    """
    found = {sql for (sql,) in database.execute("SELECT sql FROM sqlite_master WHERE sql IS NOT NULL")}
    if found and found != set(_TABLES):
        raise InputError(f"{path}: not a run's database; move it away, or choose another folder")
    return bool(found)


def stored_manifest(database: sqlite3.Connection, path: Path) -> Manifest:
    """Return the manifest in a database. Raises InputError if it is missing or invalid."""
    found = [text for (text,) in database.execute("SELECT text FROM manifest LIMIT 2")]
    return _manifest(found[0].encode() if len(found) == 1 and isinstance(found[0], str) else b"", path)


def texts(database: sqlite3.Connection, first: int, end: int) -> list[tuple[int, str]]:
    """Return the records of some trials as JSON, with their indices, in order.

    Fetched completely, because an unfinished statement would block writes to the database.
    """
    query = "SELECT number, record FROM trials WHERE number >= ? AND number < ? ORDER BY number"
    return database.execute(query, (first, end)).fetchall()


@contextmanager
def disk_errors(out: Path) -> Iterator[None]:
    """Turn errors of the disk or the database into InputError."""
    try:
        yield
    except OSError as error:
        raise InputError(
            f"cannot write into {out}: {error.strerror}; what was finished is kept: make room, then --resume"
        ) from error
    except sqlite3.Error as error:
        name = getattr(error, "sqlite_errorname", "")
        if name.startswith(("SQLITE_BUSY", "SQLITE_LOCKED")):
            text = f"{out} is in use: another craftsim writes into it; wait until it has ended, or choose another --out"
        elif name.startswith(("SQLITE_FULL", "SQLITE_IOERR", "SQLITE_CANTOPEN", "SQLITE_READONLY")):
            text = f"cannot write into {out}: {error}; what was finished is kept: make room, then --resume"
        else:
            text = f"{out / DATABASE}: not a run's database: {error}; choose another folder"
        raise InputError(text) from error
