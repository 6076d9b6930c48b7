"""The database of a run as somebody else may leave it: cut off or damaged."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterable
from contextlib import closing
from pathlib import Path


def cut_off(folder: Path, kept: Iterable[int]) -> None:
    """Leave a folder as a kill does after some trials, with half a line of the next one."""
    with closing(sqlite3.connect(folder / "session.db")) as database, database:
        numbers = list(kept)
        database.execute(f"DELETE FROM trials WHERE number NOT IN ({','.join(map(str, numbers))})")
    lines = (folder / "trials.jsonl").read_bytes().splitlines(keepends=True)
    (folder / "trials.jsonl").write_bytes(
        b"".join(lines[number] for number in numbers) + lines[0][:100]
    )


def put(folder: Path, number: int, record: object, manifest: object = None) -> None:
    """Put something in the place of a record, and of the manifest."""
    with closing(sqlite3.connect(folder / "session.db")) as database, database:
        database.execute("INSERT OR REPLACE INTO trials VALUES (?, ?)", (number, record))
        if manifest is not None:
            database.execute("UPDATE manifest SET text = ?", (manifest,))


def manifest_of(folder: Path) -> dict:
    """Return what a run's database says that it is."""
    with closing(sqlite3.connect(folder / "session.db")) as database:
        ((text,),) = database.execute("SELECT text FROM manifest")
    return json.loads(text)
