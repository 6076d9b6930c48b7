"""Designs from words on the command line: a name of the library, pictures, or a mesh.

A picture is a PNG or JPEG file for each level from the floor up, a pixel for each cell; or, with a size, of any
resolution, such as a photo.
"""

from __future__ import annotations

import io
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageOps

from craftsim.designs.library import BUILDINGS, make_design, sizes_of
from craftsim.designs.meshes import READERS, read_triangles
from craftsim.designs.solids import MARGIN_CELLS, filled_cells, number_of_cells, number_of_levels
from craftsim.discrete.files.design import Design
from craftsim.discrete.geometry import CELL_PITCH_M, LEVEL_HEIGHT_M
from craftsim.discrete.grid import MAX_SIDE
from craftsim.errors import InputError
from craftsim.storage.limits import PICTURE
from craftsim.storage.reading import read_bytes

RANDOM_DESIGN: Final = "random"
"""The name of a design that is drawn."""
_SUFFIXES: Final = tuple(READERS)
"""Suffixes of meshes."""

_PICTURES: Final = (".png", ".jpg", ".jpeg")
"""Suffixes of pictures."""

_PNG: Final = b"\x89PNG\r\n\x1a\n"
_JPEG: Final = b"\xff\xd8\xff"
_WHITE: Final = 0xFF
_DEEP_WHITE: Final = 0xFFFF
_BACKGROUND: Final = 0.92
"""Lightness, as a share of white, from which on a pixel is background: paper that was scanned, or packed as JPEG."""
_DARKEST_UNCLEAR: Final = 0.8
"""Lightness above which a pixel is no block for sure."""
_ADVICE: Final = {
    ".npy": "write a PNG for each level, or call Design.of in Python, which takes cells (x, y, level)",
    **dict.fromkeys(
        (".gltf", ".3mf", ".dae", ".fbx", ".off", ".step", ".stp", ".blend", ".x3d"),
        "export it as STL, z up",
    ),
}
"""Advice for other files, by suffix."""
_LONGEST_PHOTO: Final = 4096
"""Number of pixels of the longer side of a picture that is scaled."""
_HALF: Final = 0.5 - 1e-6
"""Share of a cell of a scaled picture that is dark where there is a block, less what 32 bits round."""
_NAMED: Final = 8
"""Number of floating cells that an error names."""
_SHORTEST: Final = 1e-9
"""Length of the shortest mesh, in the units of its file."""
_CELL_M: Final = np.array([CELL_PITCH_M, CELL_PITCH_M, LEVEL_HEIGHT_M])


def find_design(words: Sequence[str], size: Sequence[int] = (), text: str | None = None) -> Design:
    """Return a design of the library by its name, that of pictures, a level each, or that of a mesh.

    ``size`` holds sizes of the library's design, or of a picture or a mesh the cells of its longer side. Raises
    InputError for words that stand for none, and for sizes and text that do not fit them.
    """
    suffixes = {Path(word).suffix.lower() for word in words}
    if suffixes and suffixes <= {*_PICTURES} and len(size) < 2 and text is None:
        return read_pictures([Path(word) for word in words], *size)
    if len(words) == 1 and suffixes <= {*_SUFFIXES} and len(size) < 2 and text is None:
        return read_mesh(Path(words[0]), *size)
    if len(words) == 1 and suffixes == {""}:
        return make_design(words[0], size, text)
    formats = (
        f"pictures of a level each ({', '.join(_PICTURES)}) or one mesh ({', '.join(_SUFFIXES)})"
    )
    for word in words:
        suffix = Path(word).suffix.lower()
        if suffix not in ("", *_PICTURES, *_SUFFIXES):
            advice = _ADVICE.get(suffix, "convert it to one of these")
            raise InputError(
                f"{word[:80]}: {suffix[:20]} files are not read; allowed: {formats}; {advice}"
            )
    request = f"{' '.join(words)[:80] or 'nothing'} with {len(size)} sizes"
    if text:
        request += " and a text"
    raise InputError(
        f"no design is {request}; allowed: one of {', '.join(BUILDINGS)}, {RANDOM_DESIGN}, {formats} with one --size "
        "or none"
    )


def listing() -> str:
    """Return the names of the library with the sizes that they have unless given, a line each."""
    width = max(map(len, BUILDINGS))
    rows = []
    for name in BUILDINGS:
        sizes = " ".join(f"{size}={number}" for size, number in sizes_of(name).items())
        row = f"{name:<{width}}  {sizes}"
        if name == "letters":
            row += "  --text ABC"
        rows.append(row)
    return "\n".join(rows)


def read_pictures(paths: Sequence[Path], length: int | None = None) -> Design:
    """Return the design that pictures show, the floor's first; x is to the right and y up.

    Pixels that are white, almost white or transparent are background, clearly darker ones blocks. With a ``length``,
    the cells of its longer side, a picture is divided into square cells, and a cell is filled where at least half of
    it is dark: darker than Otsu's threshold of the picture (1979), which divides light from dark best.

    Raises InputError for files that are neither PNG nor JPEG, for pixels between the two, for sides that differ or are
    too long, for nothing but background, and for blocks that float.
    """
    if len(paths) > MAX_SIDE:
        raise InputError(f"{len(paths)} pictures; allowed: a level each, at most {MAX_SIDE}")
    levels = [_read_picture(path, length) for path in paths]
    for path, level in zip(paths, levels, strict=True):
        if level.shape != levels[0].shape:
            raise InputError(
                f"{path}: {level.shape[0]} x {level.shape[1]} cells; allowed: as many as {paths[0]} has, "
                f"{levels[0].shape[0]} x {levels[0].shape[1]}"
            )
    return _design_of(paths[0], np.stack(levels, axis=2))


def _design_of(name: Path, cells: NDArray[np.bool_]) -> Design:
    """Return the design of the cells (L, W, H) that are set; raise InputError for none, too many, and floating ones."""
    design = Design.of(name, ((x, y, z + 1) for x, y, z in np.argwhere(cells).tolist()))
    floating = design.floating()
    if floating:
        places = ", ".join(map(str, floating[:_NAMED]))
        if len(floating) > _NAMED:
            places += f" and {len(floating) - _NAMED} more"
        raise InputError(
            f"{name}: nothing is below the blocks at {places}; allowed: on the ground or on a block"
        )
    return design


def _read_picture(path: Path, length: int | None) -> NDArray[np.bool_]:
    """Return (width, height) of a picture, in cells: where it is not background."""
    data = read_bytes(path, PICTURE)
    is_png = data.startswith(_PNG)
    longest = MAX_SIDE
    allowed = f"pixels; allowed: 1 to {MAX_SIDE} each way, one for each cell; --size N scales it"
    if length is not None:
        longest = _LONGEST_PHOTO
        allowed = f"pixels; allowed: 1 to {longest} each way; scale the picture down"
    if not (is_png or data.startswith(_JPEG)):
        raise InputError(
            f"{path}: not a PNG or JPEG file; allowed: {', '.join(_PICTURES)}; save it as PNG"
        )
    try:
        # Only the head is read before the sides are known to be allowed.
        with (
            warnings.catch_warnings(action="ignore"),
            Image.open(io.BytesIO(data), formats=["PNG", "JPEG"]) as image,
        ):
            if not (0 < min(image.size) <= max(image.size) <= longest):
                raise InputError(f"{path}: {image.width} x {image.height} {allowed}")
            lightness = _lightness(ImageOps.exif_transpose(image), is_png)
    except InputError:
        raise
    except Image.DecompressionBombError:
        raise InputError(f"{path}: more than 100 million {allowed}") from None
    # Whatever a parser of others raises for a file that is none.
    except Exception as error:
        raise InputError(f"{path}: damaged: {str(error)[:200] or type(error).__name__}") from None
    if length is not None:
        return _scaled(lightness, length)
    unclear = np.argwhere((lightness > _DARKEST_UNCLEAR) & (lightness < _BACKGROUND))
    if len(unclear):
        row, column = unclear[0].tolist()
        raise InputError(
            f"{path}: pixels that are neither background nor blocks for sure: {len(unclear)}, the first in row "
            f"{row + 1} from the top, column {column + 1}, at {lightness[row, column]:.1%} of white; allowed: "
            f"{_BACKGROUND:.0%} or more for background, {_DARKEST_UNCLEAR:.0%} or less for blocks; save it as PNG in "
            "black and white, for JPEG mixes what lies side by side"
        )
    return np.ascontiguousarray(lightness[::-1].T < _BACKGROUND)


def _scaled(lightness: NDArray[np.float64], length: int) -> NDArray[np.bool_]:
    """Return (width, height) of a picture with ``length`` cells along its longer side: where at least half is dark."""
    grey = (_WHITE * lightness).round().astype(np.uint8)
    threshold, _ = cv2.threshold(grey, 0, _WHITE, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
    dark = (grey <= threshold).astype(np.float32)
    scale = length / max(grey.shape)
    height, width = (max(1, round(scale * side)) for side in grey.shape)
    share = cv2.resize(dark, (width, height), interpolation=cv2.INTER_AREA)
    return np.ascontiguousarray(share[::-1].T >= _HALF)


def _lightness(image: Image.Image, is_png: bool) -> NDArray[np.float64]:
    """Return (height, width) of an image on white paper: 0 to 1, of a PNG that of the darkest of its three colours.

    JPEG keeps the colour of a pixel only together with its neighbours', but the lightness of each.
    """
    if image.mode.startswith("I"):
        # Grey of 16 bits.
        deep: NDArray[np.float64] = np.asarray(image) / _DEEP_WHITE
        return deep
    paper = Image.new("RGBA", image.size, "white")
    paper.alpha_composite(image.convert("RGBA"))
    if not is_png:
        return np.asarray(paper.convert("L")) / _WHITE
    darkest: NDArray[np.float64] = np.asarray(paper)[..., :3].min(axis=2) / _WHITE
    return darkest


def read_mesh(path: Path, length: int | None = None) -> Design:
    """Return the design of the cells that a mesh, z up, fills (:mod:`craftsim.designs.solids`).

    A block's cell is CELL_PITCH_M wide and LEVEL_HEIGHT_M high. Metres are metres, unless ``length`` says how many
    cells the longer of its sides on the floor is to have; its proportions stay. The mesh stands on the floor, in the
    middle of as many cells as it is long and wide.

    Raises InputError for what is no mesh, not closed, too large, too fine or too thin, and for blocks that would float.
    """
    triangles = read_triangles(path)
    low = triangles.min(axis=(0, 1))
    extent_m = triangles.max(axis=(0, 1)) - low
    longest = float(extent_m[:2].max())
    if longest < _SHORTEST:
        raise InputError(f"{path}: the mesh has no length on the floor; allowed: a solid, z up")
    scale = 1.0
    if length is not None:
        scale = length * CELL_PITCH_M / longest
    # Divided first: the smallest mesh is as good as the largest.
    cells = (triangles - low) / (_CELL_M / scale)
    extent = extent_m / (_CELL_M / scale)
    if (extent > MAX_SIDE + MARGIN_CELLS).any():
        extent_text = " x ".join(f"{side:.0f}" for side in extent)
        raise InputError(
            f"{path}: {extent_text} cells in metres; allowed: {MAX_SIDE} each way; scale it with --size, also a mesh "
            "in millimetres"
        )
    shape = (number_of_cells(extent[0]), number_of_cells(extent[1]), number_of_levels(extent[2]))
    cells[..., :2] += (np.array(shape[:2]) - extent[:2]) / 2
    filled = filled_cells(str(path), cells, shape)
    if not filled.any():
        extent_text = " x ".join(f"{side:.3g}" for side in extent)
        raise InputError(
            f"{path}: the mesh, {extent_text} cells large, reaches {MARGIN_CELLS:.0%} of a cell into none; allowed: a "
            "solid that fills a cell at least; scale it with a larger --size, or make its walls thicker"
        )
    return _design_of(path, filled)
