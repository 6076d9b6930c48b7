"""The records of a run, read lazily from its folder, since a million of them do not fit into memory."""

from __future__ import annotations

import json
import reprlib
import sqlite3
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from craftsim.errors import InputError
from craftsim.experiments.experiment import ANY, MANIFEST, Form, Manifest, TrialRecord, read_as
from craftsim.storage.limits import RECORD_BYTES, SESSION
from craftsim.storage.paths import exists
from craftsim.storage.reading import open_file

DATABASE: Final = "session.db"
_LOG: Final = f"{DATABASE}-wal"
"""SQLite's write-ahead log; exists while a run is open."""
TRIALS_FILE: Final = "trials.jsonl"

_TABLES: Final = (
    "CREATE TABLE manifest (text TEXT NOT NULL)",
    "CREATE TABLE trials (number INTEGER PRIMARY KEY, record TEXT NOT NULL)",
    "CREATE TABLE further (stage TEXT, key TEXT, answer TEXT NOT NULL, PRIMARY KEY (stage, key))",
)
_PAGE: Final = 64
_DECIDED: Final = ("trials", "decided")
"""Stage and key of the note that a run needs no further trials."""


class StoredRecords(Sequence[TrialRecord]):
    """The records of a run in the order of its trials, each read on access.

    They remain valid when another run starts in the folder. Changes to a returned record are lost.
    """

    def __init__(self, database: sqlite3.Connection, path: Path, numbers: Sequence[int]) -> None:
        """Read from the open database of a run; ``numbers`` are those of its trials, ascending."""
        self.database = database
        self._path = path
        self._numbers = numbers

    def __len__(self) -> int:
        return len(self._numbers)

    def __getitem__(self, index: Any) -> Any:
        if isinstance(index, slice):
            return [self._read([number])[0] for number in self._numbers[index]]
        return self._read([self._numbers[index]])[0]

    def __iter__(self) -> Iterator[TrialRecord]:
        for first in range(0, len(self._numbers), _PAGE):
            yield from self._read(self._numbers[first : first + _PAGE])

    def only(self, numbers: Sequence[int]) -> StoredRecords:
        """Return the records of these trials alone, by ascending number."""
        return StoredRecords(self.database, self._path, numbers)

    def of_trial(self, number: int) -> TrialRecord:
        """Return the record of the trial with this number, which was run."""
        return self._read([number])[0]

    def _read(self, numbers: Sequence[int]) -> list[TrialRecord]:
        """Return the records of consecutive trials of the run."""
        try:
            rows = texts(self.database, numbers[0], numbers[-1] + 1)
        except sqlite3.Error:
            rows = []
        if [number for number, _ in rows] != list(numbers):
            raise InputError(f"{self._path}: was changed while it was in use")
        return [json.loads(text) for _, text in rows]

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Sequence):
            return NotImplemented
        return len(self) == len(other) and all(a == b for a, b in zip(self, other, strict=True))

    def __repr__(self) -> str:
        return f"<{len(self)} records of {self._path}>"

    def __reduce__(self) -> tuple[Any, ...]:
        return list, (list(self),)


@dataclass(frozen=True)
class RecordView:
    """Records filtered or changed by a function at each iteration, without keeping them in memory."""

    records: Iterable[TrialRecord]
    view: Callable[[Iterable[TrialRecord]], Iterator[TrialRecord]]

    def __iter__(self) -> Iterator[TrialRecord]:
        return self.view(self.records)


@dataclass(frozen=True)
class Finished:
    """A finished run."""

    folder: Path
    manifest: Mapping[str, Any]
    records: StoredRecords


def holds_run(folder: Path) -> bool:
    """Return whether a folder has the files of a run, whatever is in them."""
    return exists(folder / DATABASE)


def read_finished(folder: Path, command: str, form: Form = ANY) -> Finished:
    """Return the finished run of a command.

    Raises:
        InputError: the folder holds no run, an unfinished run, one of another command, or invalid records.
    """
    return read_any(folder, {command: form}, f"give the --out of an earlier 'craftsim {command}'")


def read_any(folder: Path, forms: Mapping[str, Form], remedy: str) -> Finished:
    """Return the finished run of one of several commands; ``remedy`` ends messages, otherwise as read_finished."""
    path = folder / DATABASE
    with disk_errors(folder):
        if not exists(path):
            raise InputError(f"{folder} holds no run; {remedy}")
        open_file(path, SESSION).close()
        database = read_only(path)
        if not has_tables(database, path):
            raise InputError(f"{path}: holds no run; {remedy}")
        manifest = stored_manifest(database, path)
        command = manifest["command"]
        n = manifest["items"]
        if command not in forms:
            raise InputError(
                f"{folder} holds a run of {reprlib.repr(f'craftsim {command}')}; {remedy}"
            )
        finish = f"finish it with 'craftsim {command} --resume --out {folder}' and the options that it was begun with"
        if exists(folder / _LOG):
            raise InputError(f"{folder} holds a run that goes on, or was cut off; {finish}")
        numbers = []
        for record in checked(database, path, n, forms[command], "choose another folder"):
            numbers.append(record["index"])
        if len(numbers) < n and not is_decided(database):
            raise InputError(
                f"{folder} holds an unfinished run ({len(numbers)} of {n} trials); {finish}"
            )
    return Finished(folder, manifest, StoredRecords(database, path, numbers))


def note_decided(database: sqlite3.Connection) -> None:
    """Note that the trials without a record are not needed, see :class:`StoppingRule`."""
    database.execute("INSERT OR REPLACE INTO further VALUES (?, ?, ?)", (*_DECIDED, "true"))


def forget_decided(database: sqlite3.Connection) -> None:
    """Remove the note of :func:`note_decided`, as a run that goes on may need further trials."""
    database.execute("DELETE FROM further WHERE stage = ? AND key = ?", _DECIDED)


def is_decided(database: sqlite3.Connection) -> bool:
    """Return whether the trials without a record are not needed."""
    query = "SELECT 1 FROM further WHERE stage = ? AND key = ?"
    return bool(database.execute(query, _DECIDED).fetchall())


def checked(
    database: sqlite3.Connection, path: Path, n: int, form: Form, remedy: str
) -> Iterator[TrialRecord]:
    """Yield the records of ``n`` trials in a database. Raises InputError, with the remedy, for an invalid one."""
    numbers = "SELECT ifnull(min(number), 0), ifnull(max(number), -1) FROM trials"
    ((first, last),) = database.execute(numbers).fetchall()
    if first < 0:
        raise InputError(f"{path}: holds trial {first} of {n}; {remedy}")
    if last >= n:
        raise InputError(f"{path}: holds trial {last} of {n}; {remedy}")
    for start in range(first, last + 1, _PAGE):
        for number, text in texts(database, start, start + _PAGE):
            # In a damaged file there may be anything, numbers and nothing at all too.
            if isinstance(text, str):
                data = text.encode()
            elif isinstance(text, bytes):
                data = text
            else:
                data = b""
            place = f"{path}: trial {number}"
            record = form.record(data, f"{place}: not a trial's record", remedy)
            if record["index"] != number:
                raise InputError(f"{place} says that it is {record['index']}; {remedy}")
            yield record


def differences(old: Any, new: Any, key: str = "") -> Iterator[tuple[str, tuple[Any, Any]]]:
    """Yield the dotted names of differing values, with both values."""
    if isinstance(old, dict) and isinstance(new, dict):
        for name in sorted({*old, *new}):
            dotted = name
            if key:
                dotted = f"{key}.{name}"
            yield from differences(old.get(name), new.get(name), dotted)
    elif old != new:
        yield key, (old, new)


def connected(uri: str) -> sqlite3.Connection:
    """Return a connection to a database; an empty URI gives a temporary one."""
    # Without waiting: who has it locked has it for as long as a run takes.
    database = sqlite3.connect(
        uri, timeout=0, isolation_level=None, check_same_thread=False, uri=True
    )
    database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, RECORD_BYTES)
    database.execute("PRAGMA trusted_schema = OFF")
    return database


def read_only(path: Path) -> sqlite3.Connection:
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
    try:
        statements = {
            sql
            for (sql,) in database.execute("SELECT sql FROM sqlite_master WHERE sql IS NOT NULL")
        }
    except UnicodeDecodeError:  # SQLite's message about a damaged table quotes it
        statements = {""}
    if statements and statements != set(_TABLES):
        raise InputError(f"{path}: not a run's database; move it away, or choose another folder")
    return bool(statements)


def stored_manifest(database: sqlite3.Connection, path: Path) -> Manifest:
    """Return the manifest in a database. Raises InputError if it is missing or invalid."""
    rows = [text for (text,) in database.execute("SELECT text FROM manifest LIMIT 2")]
    text = ""
    if len(rows) == 1 and isinstance(rows[0], str):
        text = rows[0]
    manifest: Manifest = read_as(
        MANIFEST, text.encode(), f"{path}: not a run's manifest", "choose another folder"
    )
    return manifest


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
