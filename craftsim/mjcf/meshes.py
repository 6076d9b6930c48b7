"""The visual meshes of the machines: which there are, and their OBJ files for any figures.

Metres; x forward, y left, z up. Dimensions are the machines' figures; what only decorates (bevels, spokes, ribs, lamps)
is our own. The meshes are pictures: contact shapes live in the MJCF, and walkable faces agree with them within 1 mm.
Equal figures give equal bytes everywhere.

The meshes of the nominal machines are files in ``meshes``; ``meshes.json`` beside that folder records the lengths that
they were made from. Other lengths, an edit of a nominal figure included, are noticed by comparing with that record, and
the meshes are then made in memory.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import fields
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

from craftsim.mjcf.parameters import BlockParameters, SlopeParameters, SmartcarParameters, digest_of

Figures = SmartcarParameters | BlockParameters | SlopeParameters

NAMES: Final[dict[type, tuple[str, ...]]] = {
    SmartcarParameters: ("chassis", "chassis_trim", "wheel_hub", "board", "board_pads", "lift_post"),
    BlockParameters: ("block", "block_trim", "flag"),
    SlopeParameters: ("slope_base", "slope_flap", "gear", "worm"),
}
"""The meshes that are made from each kind of figures."""

FOLDER: Final = Path(__file__).parent / "meshes"
RECORD: Final = Path(__file__).parent / "meshes.json"


def _kind(figures: Figures) -> type:
    return next(kind for kind in NAMES if isinstance(figures, kind))


def lengths(figures: Figures) -> dict[str, float]:
    """Return the figures that shape a machine, by name: its lengths."""
    return {f.name: getattr(figures, f.name) for f in fields(_kind(figures)) if f.name.endswith("_m")}


@lru_cache(maxsize=1)
def _recorded() -> dict[str, dict[str, float]]:
    recorded: dict[str, dict[str, float]] = json.loads(RECORD.read_text(encoding="utf-8"))
    return recorded


def shipped(figures: Figures) -> bool:
    """Return whether the files in ``meshes`` were made from these lengths."""
    return _recorded().get(_kind(figures).__name__) == lengths(figures)


def mesh_file(figures: Figures, name: str) -> str:
    """Return the file name of a mesh, relative to the MJCF; other lengths than those of the files give another name."""
    if shipped(figures):
        return f"meshes/{name}.obj"
    return f"meshes/{name}-{digest_of(dict(lengths(figures)))[:8]}.obj"


@lru_cache(maxsize=64)
def mesh_bytes(figures: Figures) -> dict[str, bytes]:
    """Return the OBJ text of every mesh of a machine by its file name: read if the files are of it, else made."""
    if shipped(figures):
        return {
            mesh_file(figures, name): (FOLDER / f"{name}.obj").read_bytes() for name in NAMES[_kind(figures)]
        }
    return {mesh_file(figures, name): data for name, data in make_meshes(figures).items()}


def mesh_parts(figures: Figures) -> dict[str, Any]:
    """Return the closed parts of every mesh of a machine, lists of trimesh solids, by name."""
    from craftsim.mjcf import block_meshes, car_meshes, slope_meshes

    modules = {
        SmartcarParameters: car_meshes,
        BlockParameters: block_meshes,
        SlopeParameters: slope_meshes,
    }
    makers: dict[str, Callable[[Figures], Any]] = vars(modules[_kind(figures)])
    return {name: makers[name](figures) for name in NAMES[_kind(figures)]}


def make_meshes(figures: Figures) -> dict[str, bytes]:
    """Make every mesh of a machine; return its OBJ text by name."""
    from craftsim.mjcf.wavefront import obj

    return {name: obj(parts) for name, parts in mesh_parts(figures).items()}
