"""The folder of a campaign: what is finished is on disk at once, whatever happens next.

``campaign.json`` says what the campaign is; ``trials.jsonl`` gets one line for each finished item, in the order in
which they finish, and is put into the items' order at the end.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Final

from craftsim.errors import InputError
from craftsim.report import output_directory, plain, versions
from craftsim.storage.writing import write_whole
from craftsim.validation.campaign.items import Item, TrialRecord

SCHEMA_VERSION: Final = 1
TRIALS: Final = "trials.jsonl"
CAMPAIGN: Final = "campaign.json"
_NEEDED: Final = {"key", "index", "agrees", "error", "attempts"}
_RESULTS: Final = ("report.json", "report.html", "durations.csv", "bundles", "films", "worlds")
"""What a campaign leaves besides; it goes when another one begins in its folder."""


@dataclass(frozen=True)
class Header:
    """What decides the results of a campaign, besides its items."""

    command: str
    seed: int
    config: Mapping[str, Any]


class Store:
    """The records of one campaign; one process at a time may have it open."""

    def __init__(self, out: Path, header: Header, items: Sequence[Item], resume: bool) -> None:
        """Begin a campaign in a folder, or go on with the one that is there.

        Raises:
            InputError: the folder cannot be written to; another process works in it; it holds an unfinished
                campaign and ``resume`` is not set; or, with it, holds another campaign, or records that cannot be
                read.
        """
        self.out = output_directory(out)
        self._index = {item.key: i for i, item in enumerate(items)}
        if len(self._index) != len(items):
            raise ValueError("keys of a campaign's items must be unique")
        self._header = _header(header, items)
        self.records: dict[str, TrialRecord] = {}
        with _disk(self.out):
            self._file = self._open()
            try:
                self._begin(resume)
            except BaseException:
                self._file.close()
                raise

    @property
    def n_kept(self) -> int:
        """How many trials are on disk."""
        return (self.out / TRIALS).read_bytes().count(b"\n")

    def append(self, records: Iterable[TrialRecord]) -> None:
        """Write records down for good; raise InputError where the disk does not take them."""
        lines = {record["key"]: _line(record) for record in records}
        with _disk(self.out):
            self._file.write("".join(lines.values()).encode())
            self._file.flush()
            os.fsync(self._file.fileno())
        # As they would be read back, so that a resumed campaign has the very same.
        self.records |= {key: json.loads(line) for key, line in lines.items()}

    def finish(self) -> list[TrialRecord]:
        """Return all records in the order of the items, and leave them on disk in that order."""
        records = [self.records[key] for key in self._index]
        with _disk(self.out):
            write_whole(self.out / TRIALS, "".join(map(_line, records)))
        return records

    def close(self) -> None:
        """Let others open the folder."""
        self._file.close()

    def _open(self) -> IO[bytes]:
        file = (self.out / TRIALS).open("a+b", buffering=0)
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            file.close()
            raise InputError(f"another process is running a campaign in {self.out}") from None
        return file

    def _begin(self, resume: bool) -> None:
        path = self.out / CAMPAIGN
        there = read_header(path) if path.exists() else None
        if resume and there is not None:
            _check_same(path, there, self._header)
            self._read()
            return
        n_lines = self.n_kept
        if there is not None and 0 < n_lines < there["items"]:
            raise InputError(
                f"{self.out} holds an unfinished campaign ({n_lines} of {there['items']} trials): go on with "
                "--resume, or choose another --out, or remove that folder"
            )
        if there is not None:
            for name in _RESULTS:
                _remove(self.out / name)
        self._file.truncate(0)
        write_whole(path, json.dumps(self._header, indent=2, sort_keys=True) + "\n")

    def _read(self) -> None:
        """Read back every whole line without an error; what a kill left of the last one is cut off."""
        path = self.out / TRIALS
        data = path.read_bytes()
        whole = data.rfind(b"\n") + 1
        self._file.truncate(whole)
        for number, record in _records(path, data[:whole], "its trial is run again"):
            key = record["key"]
            if key not in self._index or record["index"] != self._index[key]:
                raise InputError(f"{path}:{number}: trial '{key}' is none of this campaign; delete this line")
            if record["error"] is None:
                self.records[key] = record


def _header(header: Header, items: Sequence[Item]) -> dict[str, Any]:
    keys = "\n".join(item.key for item in items)
    described = {
        "schema_version": SCHEMA_VERSION,
        "command": header.command,
        "seed": header.seed,
        "versions": versions(),
        "config": plain(header.config),
        "items": len(items),
        "keys": hashlib.sha256(keys.encode()).hexdigest(),
    }
    loaded: dict[str, Any] = json.loads(json.dumps(described))
    return loaded


def read_header(path: Path) -> dict[str, Any]:
    """Return what a campaign's folder says that it is; raise InputError for a file that says nothing of the kind."""
    try:
        header = json.loads(path.read_text(encoding="utf-8"))
        header["items"] + 0
    except (ValueError, TypeError, KeyError):
        raise InputError(f"{path}: not a campaign's description; choose another folder") from None
    loaded: dict[str, Any] = header
    return loaded


@dataclass(frozen=True)
class FinishedCampaign:
    """A campaign that has come to its end."""

    folder: Path
    header: Mapping[str, Any]
    """What the campaign was: command, seed, versions, config."""
    records: list[TrialRecord]


def read_finished(folder: Path, command: str) -> FinishedCampaign:
    """Return the finished campaign of a command.

    Raises:
        InputError: the folder holds no campaign, an unfinished one or another command's, or a line that is no record.
    """
    path = folder / CAMPAIGN
    if not path.is_file():
        raise InputError(f"{folder} holds no campaign; give the --out of an earlier 'craftsim {command}'")
    header = read_header(path)
    if header.get("command") != command:
        raise InputError(
            f"{folder} holds a campaign of 'craftsim {header.get('command')}'; give the --out of an earlier "
            f"'craftsim {command}'"
        )
    lines = folder / TRIALS
    data = lines.read_bytes() if lines.is_file() else b""
    if (found := data.count(b"\n")) < header["items"]:
        raise InputError(
            f"{folder} holds an unfinished campaign ({found} of {header['items']} trials); "
            f"finish it with 'craftsim {command} --resume --out {folder}' and the options that it was begun with"
        )
    records = [record for _, record in _records(lines, data, "--resume runs its trial again")]
    return FinishedCampaign(folder, header, records)


def _records(path: Path, data: bytes, remedy: str) -> Iterator[tuple[int, TrialRecord]]:
    """Yield the number and the record of each whole line; raise InputError, with the remedy, for one that is none."""
    for number, line in enumerate(data.split(b"\n")[:-1], start=1):
        try:
            record: TrialRecord = json.loads(line)
            if not record.keys() >= _NEEDED:
                raise KeyError
        except (ValueError, AttributeError, KeyError):
            raise InputError(
                f"{path}:{number}: not a trial's record; delete this line, and {remedy}"
            ) from None
        yield number, record


def _check_same(path: Path, there: Mapping[str, Any], wanted: Mapping[str, Any]) -> None:
    for key, (old, new) in differences(there, wanted):
        raise InputError(
            f"{path}: cannot go on with another campaign: its {key} is {old!r}, not {new!r}; use the options that "
            "it was begun with, or choose another --out"
        )


def differences(old: Any, new: Any, key: str = "") -> Iterator[tuple[str, tuple[Any, Any]]]:
    """Yield the dotted names of what differs, with both values."""
    if isinstance(old, dict) and isinstance(new, dict):
        for name in sorted({*old, *new}):
            yield from differences(old.get(name), new.get(name), f"{key}.{name}" if key else name)
    elif old != new:
        yield key, (old, new)


def _line(record: TrialRecord) -> str:
    return json.dumps(record, sort_keys=True, allow_nan=False) + "\n"


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


@contextmanager
def _disk(out: Path) -> Iterator[None]:
    """Turn what the disk refuses into a message for people."""
    try:
        yield
    except OSError as error:
        raise InputError(
            f"cannot write into {out}: {error.strerror}; what was finished is kept: make room, then --resume"
        ) from error
