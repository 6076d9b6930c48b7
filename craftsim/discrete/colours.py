"""The colours of machines and things: in films, in pictures of the grid and in plots."""

from __future__ import annotations

from typing import Final

from craftsim.discrete.kinds import Kind

Rgb = tuple[float, float, float]
"""Red, green, blue, each 0..1."""

CAR_COLOURS: Final[tuple[Rgb, ...]] = (
    (0.80, 0.24, 0.22),
    (0.16, 0.47, 0.72),
    (0.20, 0.58, 0.32),
    (0.56, 0.33, 0.66),
    (0.88, 0.50, 0.12),
    (0.10, 0.60, 0.62),
    (0.72, 0.30, 0.50),
    (0.45, 0.42, 0.16),
)
"""What distinguishes the cars; car ids beyond the last start over."""

KIND_COLOURS: Final[dict[Kind, Rgb]] = {
    Kind.AIR: (1.0, 1.0, 1.0),
    Kind.GROUND: (0.93, 0.93, 0.92),
    Kind.WALL: (0.42, 0.44, 0.47),
    Kind.BLOCK: (0.93, 0.72, 0.35),
    Kind.FLAG: (0.80, 0.16, 0.20),
    Kind.FSLOPE: (0.36, 0.56, 0.76),
    Kind.GEAR: (0.25, 0.27, 0.30),
    Kind.BODY: (0.36, 0.56, 0.76),
    Kind.FOOT: (0.52, 0.70, 0.86),
}
"""What is in a cell; machines as their MJCF colours them, an unfolded slope's two cells as its base and its flap."""

TRIM: Final[Rgb] = (0.45, 0.32, 0.20)
"""The edges of a block."""
FLAG_POST: Final[Rgb] = (0.88, 0.84, 0.76)
"""The column under a flag."""
TYRE: Final[Rgb] = (0.13, 0.13, 0.14)
GOAL: Final[Rgb] = (0.10, 0.55, 0.25)
"""Goal cells and designs; darker than in films, where it is seen through."""
INK: Final[Rgb] = (0.15, 0.15, 0.16)
LINE: Final[Rgb] = (0.74, 0.74, 0.73)
"""Between cells."""


def car_colour(car: int) -> Rgb:
    """Return the colour of a car."""
    return CAR_COLOURS[car % len(CAR_COLOURS)]
