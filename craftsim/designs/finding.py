"""The design that words on the command line stand for: a name of the library, pictures, or a mesh."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from craftsim.designs.library import LIBRARY, make_design, sizes_of
from craftsim.designs.meshes import SUFFIXES, read_mesh
from craftsim.designs.pictures import read_pictures
from craftsim.discrete.files.design import Design
from craftsim.errors import InputError

RANDOM: Final = "random"
"""The name of a design that is drawn."""


def find_design(what: Sequence[str], size: Sequence[int] = (), text: str | None = None) -> Design:
    """Return a design of the library by its name, that of PNG files, a level each, or that of a mesh.

    ``size`` holds sizes of the library's design, or of a mesh the cells of its longer side. Raises InputError for words
    that stand for none, and for sizes and text that do not fit them.
    """
    suffixes = {Path(word).suffix.lower() for word in what}
    if suffixes == {".png"} and not size and text is None:
        return read_pictures([Path(word) for word in what])
    if len(what) == 1 and suffixes <= {*SUFFIXES} and len(size) < 2 and text is None:
        return read_mesh(Path(what[0]), *size)
    if len(what) == 1 and not suffixes & {".png", *SUFFIXES}:
        return make_design(what[0], size, text)
    given = f"{' '.join(what)[:80] or 'nothing'} with {len(size)} sizes{' and a text' if text else ''}"
    raise InputError(
        f"no design is {given}; allowed: one of {', '.join(LIBRARY)}, {RANDOM}, PNG files of a level each "
        f"without --size, or one file ({', '.join(SUFFIXES)}) with one --size or none"
    )


def listing() -> str:
    """Return the names of the library with the sizes that they have unless given, a line each."""
    width = max(map(len, LIBRARY))
    rows = []
    for name in LIBRARY:
        sizes = " ".join(f"{size}={number}" for size, number in sizes_of(name).items())
        rows.append(f"{name:<{width}}  {sizes}{'  --text ABC' if name == 'letters' else ''}")
    return "\n".join(rows)
