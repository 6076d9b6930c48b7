"""The kinds of images that are arrays for learning: their shapes, numbers and units."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal, get_args

import numpy as np

from craftsim.errors import InputError, suggestion
from craftsim.mjcf.block import TABLE_NAMES
from craftsim.storage.limits import IMAGE_PIXELS, PHYSICS_PARTS

ImageKind = Literal["rgb", "depth", "segmentation"]
IMAGE_KINDS: Final[tuple[ImageKind, ...]] = get_args(ImageKind)
FAR_M: Final = 100.0
"""What is further from the image plane, or nothing at all, has this depth."""
LABELS: Final = tuple(dict.fromkeys(("ground", "wall", "car", "block", "flag", "slope", *TABLE_NAMES)))
"""The kinds of machines, in the order of their numbers in a segmentation."""


@dataclass(frozen=True)
class Pixels:
    """What a pixel of a kind of image holds."""

    shape: tuple[int, ...]
    dtype: Any
    low: float
    high: float


PIXELS: Final[dict[ImageKind, Pixels]] = {
    "rgb": Pixels((3,), np.uint8, 0, 255),
    "depth": Pixels((), np.float32, 0.0, FAR_M),
    "segmentation": Pixels((2,), np.int16, -1, PHYSICS_PARTS + 1),  # with the ground and the walls
}


def check_images(size: object, kinds: Sequence[str]) -> None:
    """Raise InputError for a size or for kinds of images that there are not."""
    whole = isinstance(size, tuple) and len(size) == 2 and all(type(n) is int and n > 0 for n in size)
    if not (whole and size[0] * size[1] <= IMAGE_PIXELS):  # type: ignore[index]
        raise InputError(
            f"an image's size is {size!r}; allowed: (width, height) in pixels, 1 and more, {IMAGE_PIXELS} at most"
        )
    if isinstance(kinds, str) or not kinds or len(set(kinds)) != len(kinds):
        raise InputError(
            f"the kinds of images are {kinds!r}; allowed: one or more of {', '.join(IMAGE_KINDS)}"
        )
    for kind in kinds:
        if kind not in IMAGE_KINDS:
            raise InputError(
                f"unknown kind of image '{kind}'{suggestion(str(kind), IMAGE_KINDS)}; "
                f"there are {', '.join(IMAGE_KINDS)}"
            )
