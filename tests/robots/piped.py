"""Processes of tests/forked.py whose output is read while they run."""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import forked


@contextmanager
def piped(*words: object) -> Iterator[tuple[Any, Any, Any]]:
    """Yield such a process and what reads its two outputs as they come; it is killed in the end."""
    with tempfile.TemporaryDirectory() as folder:
        out, err = Path(folder) / "out", Path(folder) / "err"
        for place in (out, err):
            os.mkfifo(place)
        process = forked.start(*words, out=str(out), err=str(err))
        try:
            with out.open(encoding="utf-8") as said, err.open(encoding="utf-8") as errors:
                yield process, said, errors
        finally:
            process.kill()
            process.join()
