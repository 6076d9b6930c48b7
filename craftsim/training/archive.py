"""What ``torch.save`` wrote, read such that nothing in it can run, or ask for more than the file holds.

The pickle inside is looked through before it is read, and tensors are only described: whoever wants one compares its
shape first and reads it then. Torch itself reads such files safely too, but makes what they ask for.
"""

from __future__ import annotations

import pickle
import pickletools
import zipfile
from collections import OrderedDict
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from craftsim.errors import InputError
from craftsim.storage.limits import PICKLE_BYTES, PICKLE_STEPS, Limits
from craftsim.storage.reading import ARCHIVE_ERRORS, open_archive

if TYPE_CHECKING:
    import torch

_STEPS: Final = frozenset(
    {
        *("PROTO", "STOP", "GLOBAL", "REDUCE", "BUILD", "BINPERSID"),
        *("BINPUT", "LONG_BINPUT", "BINGET", "LONG_BINGET", "MARK"),
        *("NONE", "NEWTRUE", "NEWFALSE", "BININT", "BININT1", "BININT2", "LONG1", "BINFLOAT", "BINUNICODE"),
        *("EMPTY_DICT", "SETITEM", "SETITEMS", "EMPTY_LIST", "APPEND", "APPENDS"),
        *("EMPTY_TUPLE", "TUPLE", "TUPLE1", "TUPLE2", "TUPLE3"),
    }
)
"""Steps of a pickle with which torch writes tensors and plain values."""
_STORAGES: Final = {
    "FloatStorage": ("float32", 4),
    "DoubleStorage": ("float64", 8),
    "LongStorage": ("int64", 8),
    "IntStorage": ("int32", 4),
    "ShortStorage": ("int16", 2),
    "BoolStorage": ("bool", 1),
}
"""Type and size of the elements of each kind of storage."""
_MAX_DEPTH: Final = 20


class Saved(NamedTuple):
    """A tensor in a file, not read yet."""

    dtype: str
    shape: tuple[int, ...]
    first: int
    """Of its elements in the storage."""
    storage: zipfile.ZipInfo
    archive: zipfile.ZipFile

    def read(self) -> torch.Tensor:
        """Return the tensor."""
        import torch

        data = bytearray(self.archive.read(self.storage))
        if not data:
            return torch.empty(self.shape, dtype=getattr(torch, self.dtype))
        n = 1
        for length in self.shape:
            n *= length
        if self.dtype == "bool":
            every = torch.frombuffer(data, dtype=torch.uint8) != 0
        else:
            every = torch.frombuffer(data, dtype=getattr(torch, self.dtype))
        return every[self.first : self.first + n].reshape(self.shape)


@contextmanager
def reading_archive(path: Path, limits: Limits) -> Iterator[Any]:
    """Give what a file holds: plain values, and tensors as :class:`Saved`, to be read within the block.

    Raises InputError for another file.
    """
    try:
        with open_archive(path, limits) as archive:
            yield _plain(_load(archive))
    except ARCHIVE_ERRORS as error:
        raise _refused(path, error) from None


def _refused(path: Path, error: Exception) -> InputError:
    return InputError(f"{path}: not a file that 'craftsim train' wrote, or damaged ({error})")


def _load(archive: zipfile.ZipFile) -> Any:
    members = {member.filename.lower(): member for member in archive.infolist()}
    pickles = [name for name in members if name.endswith("data.pkl")]
    if len(pickles) != 1 or len(members) != len(archive.infolist()):
        raise ValueError("it has not one table of contents")
    if any(member.compress_type != zipfile.ZIP_STORED for member in members.values()):
        raise ValueError("it is compressed")
    folder = pickles[0].removesuffix("data.pkl")
    if folder + "byteorder" in members and archive.read(members[folder + "byteorder"]) != b"little":
        raise ValueError("its numbers are written in another order of bytes")
    if members[pickles[0]].file_size > PICKLE_BYTES:
        raise ValueError("its table of contents is too large")
    data = archive.read(members[pickles[0]])
    _check_steps(data)
    try:
        return _Unpickler(data, archive, members, folder).load()
    except Exception as error:  # the unpickler raises whatever its parts do
        raise ValueError(f"{type(error).__name__}: {error}") from None


def _check_steps(data: bytes) -> None:
    """Raise ValueError for a pickle that does anything but list plain values and tensors."""
    for number, (step, argument, _) in enumerate(pickletools.genops(data)):
        if number >= PICKLE_STEPS:
            raise ValueError("its table of contents is too long")
        if step.name not in _STEPS:
            raise ValueError(f"step {step.name}")
        # The table of remembered objects is as long as the largest number in it.
        if step.name.endswith("PUT") and (argument or 0) > PICKLE_STEPS:
            raise ValueError(f"object {argument}")


class _Unpickler(pickle.Unpickler):
    """Knows what torch names for tensors, and nothing else."""

    def __init__(
        self, data: bytes, archive: zipfile.ZipFile, members: dict[str, zipfile.ZipInfo], folder: str
    ) -> None:
        super().__init__(BytesIO(data))
        self.archive, self.members, self.folder = archive, members, folder

    def find_class(self, module: str, name: str) -> Any:
        known = {
            ("collections", "OrderedDict"): OrderedDict,
            ("torch._utils", "_rebuild_tensor_v2"): self._tensor,
            ("torch", "Size"): tuple,
            ("torch", "device"): str,
        }
        if module == "torch" and name in _STORAGES:
            return name
        if (module, name) not in known:
            raise ValueError(f"it names {module}.{name}")
        return known[module, name]

    def persistent_load(self, number: Any) -> Any:
        _, kind, key, _, length = number
        member = self.members[f"{self.folder}data/{key}"]
        if member.file_size != length * _STORAGES[kind][1]:
            raise ValueError(f"storage {key} has {member.file_size} bytes, not {length} numbers")
        return kind, length, member

    def _tensor(
        self, storage: Any, first: int, shape: tuple[int, ...], stride: tuple[int, ...], *_: Any
    ) -> Saved:
        kind, length, member = storage
        step = 1
        for n, found in reversed(list(zip(shape, stride, strict=True))):
            if type(n) is not int or n < 0 or (n > 1 and found != step):
                raise ValueError("a tensor with gaps")
            step *= n
        if type(first) is not int or not 0 <= first <= first + step <= length:
            raise ValueError("a tensor beyond its storage")
        return Saved(_STORAGES[kind][0], tuple(shape), first, member, self.archive)


def _plain(value: Any) -> Any:
    """Return a copy of plain values and tensors, without what hangs on them."""
    left = PICKLE_STEPS

    def copy(value: Any, depth: int) -> Any:
        nonlocal left
        left -= 1
        if left < 0 or depth > _MAX_DEPTH:
            raise ValueError("it is nested too deep, or within itself")
        match value:
            case Saved() | None | bool() | int() | float() | str():
                return value
            case dict():
                if not all(type(key) in (str, int) for key in dict.keys(value)):
                    raise ValueError("a key that is neither text nor number")
                return {key: copy(item, depth + 1) for key, item in dict.items(value)}
            case list() | tuple():
                return type(value)(copy(item, depth + 1) for item in value)
        raise ValueError(f"{type(value).__name__}")

    return copy(value, 0)
