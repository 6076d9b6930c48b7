"""Reading of untrusted files: regular files only, within limits, with one kind of error."""

from __future__ import annotations

import gzip
import io
import os
import stat
import struct
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tokenize import TokenError
from typing import IO, Any, Final

import numpy as np
from numpy.typing import NDArray

from craftsim.errors import InputError
from craftsim.storage.limits import Limits, size_text
from craftsim.storage.paths import reason_of, unreadable

NamedArrays = dict[str, NDArray[np.generic]]

_MAX_AXES: Final = 6
_HEADER_BYTES: Final = 4096
_KINDS: Final = "biuf"
"""Allowed dtype kinds of arrays: booleans and numbers."""
_PACKED: Final = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
_ARCHIVE_ERRORS: Final = (
    *(zipfile.BadZipFile, zlib.error, OSError, struct.error, SyntaxError, TokenError),
    *(ValueError, EOFError, KeyError, RuntimeError, NotImplementedError, OverflowError),
)
"""Errors that zipfile and NumPy raise for invalid archives."""
_DIRECTORY_BYTES: Final = 512
"""Size of an entry in the directory of an archive."""


def open_file(path: Path, limits: Limits) -> IO[bytes]:
    """Open a regular file, without waiting. Raises InputError for any other, an unreadable or a too large one."""
    try:
        number = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except (OSError, ValueError) as error:
        raise unreadable(path, error) from error
    file = None
    if _is_regular(number):
        file = os.fdopen(number, "rb")
    if file is None:
        os.close(number)
        problem = "not a regular file"
        if path.is_dir():
            problem += " but a folder; name the file in it"
        raise InputError(f"{path}: {problem}")
    size = os.fstat(number).st_size
    if size > limits.file_bytes:
        file.close()
        raise InputError(
            f"{path}: {size_text(size)}; a {limits.noun} is no larger than the "
            f"{size_text(limits.file_bytes)} that are allowed"
        )
    return file


def read_bytes(path: Path, limits: Limits) -> bytes:
    """Return the content of a file; raises as :func:`open_file`."""
    try:
        with open_file(path, limits) as file:
            # It may grow while it is read.
            return file.read(limits.file_bytes)
    except OSError as error:
        raise unreadable(path, error) from error


def read_text(path: Path, limits: Limits) -> str:
    """Return a text, each line of which ends with a line feed, also where the file has carriage returns.

    Raises InputError with the line for invalid UTF-8, and as :func:`open_file`.
    """
    data = read_bytes(path, limits).replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data[: error.start].count(b"\n") + 1
        raise InputError(f"{path}:{line}: not UTF-8 text") from None


def parse_json(data: bytes, source: str) -> Any:
    """Return an unchecked JSON value; InputError, beginning with ``source``, for invalid JSON or over 200 levels."""
    from pydantic_core import from_json

    try:
        return from_json(data, allow_inf_nan=False)
    except ValueError as error:
        raise InputError(f"{source}: not JSON: {error}") from None


def read_lines(path: Path, limits: Limits, packed: bool = False) -> Iterator[tuple[int, bytes]]:
    """Yield the number and bytes of each line, including its end, a line feed; ``packed`` for a gzip file.

    Raises InputError for a line or content above its limit, and as :func:`open_file`.
    """
    with open_file(path, limits) as file:
        unpacked = file
        if packed:
            unpacked = gzip.GzipFile(fileobj=file)  # type: ignore[assignment]
        # Each byte is a character of Latin-1; unlike bytes, a text also ends its lines at carriage returns.
        lines = io.TextIOWrapper(unpacked, encoding="latin-1")
        number = total = 0
        while True:
            try:
                line = lines.readline(limits.line_bytes + 1).encode("latin-1")
            except (OSError, EOFError, zlib.error) as error:
                raise InputError(f"{path}: not a gzip file of text: {reason_of(error)}") from error
            if not line:
                return
            number = number + 1
            total = total + len(line)
            if len(line) > limits.line_bytes:
                raise InputError(
                    f"{path}:{number}: the line is longer than the {size_text(limits.line_bytes)} that are allowed"
                )
            if total > limits.content_bytes:
                raise InputError(
                    f"{path}:{number}: holds more than the {size_text(limits.content_bytes)} that are allowed"
                )
            yield number, line


def read_arrays(path: Path, limits: Limits) -> NamedArrays:
    """Return the arrays of an ``.npz`` file by name, without pickle.

    Headers are checked before memory is allocated. Raises InputError for an invalid file, or too many or large arrays.
    """
    try:
        with _open_archive(path, limits) as archive:
            return _arrays(path, archive)
    except _ARCHIVE_ERRORS as error:
        raise InputError(
            f"{path}: damaged or not an archive of arrays: {reason_of(error)}"
        ) from None


class _Archive(io.BufferedReader):
    """An archive to be opened: zipfile reads its directory in one piece, of at most ``max_bytes``."""

    max_bytes: int
    refusal: str

    def read(self, size: int | None = -1, /) -> bytes:
        """Return some bytes. Raises InputError for a larger piece."""
        if size is not None and size > self.max_bytes:
            raise InputError(self.refusal)
        return super().read(size)


@contextmanager
def _open_archive(path: Path, limits: Limits) -> Iterator[zipfile.ZipFile]:
    """Open a zip file, of which reading may raise _ARCHIVE_ERRORS. Raises InputError for one above its limits."""
    with open_file(path, limits) as file:
        bounded = _Archive(file.raw)  # type: ignore[attr-defined]
        bounded.max_bytes = limits.members * _DIRECTORY_BYTES
        bounded.refusal = f"{path}: too many files inside; allowed: at most {limits.members}"
        with zipfile.ZipFile(bounded) as archive:
            bounded.max_bytes = limits.file_bytes
            members = archive.infolist()
            total = sum(member.file_size for member in members)
            if len(members) > limits.members:
                raise InputError(
                    f"{path}: {len(members)} files inside; allowed: at most {limits.members}"
                )
            if total > limits.content_bytes:
                limit_text = size_text(limits.content_bytes)
                raise InputError(
                    f"{path}: unpacks to {size_text(total)}; allowed: at most {limit_text}"
                )
            if any(member.compress_type not in _PACKED for member in members):
                raise InputError(
                    f"{path}: packed in a way that is not allowed; allowed: stored or deflated"
                )
            yield archive


def _arrays(path: Path, archive: zipfile.ZipFile) -> NamedArrays:
    arrays: NamedArrays = {}
    for member in archive.infolist():
        name = member.filename.removesuffix(".npy")
        if name == member.filename or name in arrays:
            raise InputError(f"{path}: holds '{name[:40]}', which is not an array of its own name")
        arrays[name] = _array(f"{path}: array '{name[:40]}'", archive.read(member))
    return arrays


def _array(source: str, data: bytes) -> NDArray[np.generic]:
    file = io.BytesIO(data)
    version = np.lib.format.read_magic(file)
    if version != (1, 0):
        raise InputError(f"{source}: is of version {version} of NumPy's format; allowed: (1, 0)")
    shape, _, dtype = np.lib.format.read_array_header_1_0(file, max_header_size=_HEADER_BYTES)
    if dtype.kind not in _KINDS or dtype.itemsize > 8:
        raise InputError(f"{source}: holds {dtype}; allowed: booleans and numbers")
    n = dtype.itemsize
    n_bytes = len(data) - file.tell()
    for length in shape:
        n *= length
    if len(shape) > _MAX_AXES or n != n_bytes:
        raise InputError(
            f"{source}: claims shape {shape} of {dtype}, but there are {n_bytes} bytes"
        )
    file.seek(0)
    return np.lib.format.read_array(file, allow_pickle=False, max_header_size=_HEADER_BYTES)


def _is_regular(number: int) -> bool:
    """Return whether a descriptor is a regular file and not one of the kernel, which has no size and may block."""
    status = os.fstat(number)
    if not stat.S_ISREG(status.st_mode) or status.st_size:
        return stat.S_ISREG(status.st_mode)
    try:
        return not os.pread(number, 1, 0)
    except OSError:
        return False
