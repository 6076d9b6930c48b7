"""Seeing what is written in a folder as it happens, by Linux's inotify."""

from __future__ import annotations

import ctypes
import os
import re
import select
import struct
import time
from collections.abc import Iterator
from pathlib import Path

_MODIFY, _MOVED_TO, _CREATE = 0x2, 0x80, 0x100
_HEAD = struct.Struct("iIII")


class Writings:
    """A folder, and those in it, that are watched."""

    def __init__(self, folder: Path) -> None:
        """Begin to watch a folder, which is there."""
        self._libc = ctypes.CDLL(None, use_errno=True)
        self._number = self._libc.inotify_init1(os.O_NONBLOCK | os.O_CLOEXEC)
        self._root, self._folders = folder, dict[int, Path]()
        self._watch(folder)

    def __enter__(self) -> Writings:
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self._number)

    def until(self, moment: float) -> Iterator[str]:
        """Yield the kinds of what is written, until a moment of the clock."""
        while (left := moment - time.monotonic()) > 0:
            if not select.select([self._number], [], [], min(left, 0.05))[0]:
                yield ""
                continue
            for path in self._read():
                yield kind(path.relative_to(self._root))

    def _watch(self, folder: Path) -> list[Path]:
        """Watch a folder; return what is in it already."""
        events = _MODIFY | _MOVED_TO | _CREATE
        self._folders[self._libc.inotify_add_watch(self._number, bytes(folder), events)] = folder
        found = list(folder.iterdir()) if folder.is_dir() else []
        return found + [inner for path in found if path.is_dir() for inner in self._watch(path)]

    def _read(self) -> Iterator[Path]:
        data = os.read(self._number, 65536)
        while data:
            number, _, _, length = _HEAD.unpack_from(data)
            name = data[_HEAD.size : _HEAD.size + length].rstrip(b"\0").decode()
            data = data[_HEAD.size + length :]
            path = self._folders[number] / name
            yield path
            if path.is_dir() and path not in self._folders.values():
                yield from self._watch(path)


def kind(path: Path) -> str:
    """Return what a file is to a run: its name, or that of the folder that it is in; partial ones are of their own."""
    return ("partial " if path.name.startswith(".") else "") + re.sub(
        r"^\.partial-\d+-", "", path.parts[0]
    )
