"""Textures drawn with OpenCV: the floor with its grid and coordinates, the numbers on cars, wood."""

from __future__ import annotations

from typing import Final

import cv2
import mujoco
import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.geometry import CELL_PITCH_M

Pixels = NDArray[np.uint8]
"""A texture, shape (height, width, 3), red green blue."""

STRIP_SHARE: Final = 0.13
"""Width of the strip with the coordinates around an area, over the area's longer side."""
STRIP_CELLS: Final = 0.6
"""At most, in cells."""
FLOOR_RGB: Final = (243, 243, 241)
_AREA_RGB: Final = (253, 253, 251)
_LINE_RGB: Final = (196, 199, 202)
_EDGE_RGB: Final = (120, 126, 132)
_TEXT_RGB: Final = (92, 98, 104)
_FONT: Final = cv2.FONT_HERSHEY_SIMPLEX
_CELL_PIXELS: Final = 160
_MOST_PIXELS: Final = 4096
"""Of a side of a texture: what every OpenGL has."""


def painted(spec: mujoco.MjSpec, name: str, pixels: Pixels) -> mujoco.MjsMaterial:
    """Add a texture, and a material of the same name that shows it, to a scene; return the material.

    A square one covers each of the six sides of a thing that it is put on; another one is for a plane.
    """
    texture = spec.add_texture(name=name, type=mujoco.mjtTexture.mjTEXTURE_2D)
    texture.height, texture.width, texture.nchannel = pixels.shape
    texture.data = pixels.tobytes()
    material = spec.add_material(name=name)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name
    return material


def label_strip_m(length: int, width: int) -> float:
    """Return the width in metres of the strip with the coordinates around an area of so many cells."""
    return CELL_PITCH_M * min(STRIP_CELLS, STRIP_SHARE * max(length, width))


def floor(length: int, width: int) -> Pixels:
    """Return an area of ``length`` x ``width`` cells seen from above, x to the right and y upwards.

    In a strip around it stand the coordinates of the cells: those along x below the area, those along y to its right.
    """
    strip_cells = label_strip_m(length, width) / CELL_PITCH_M
    pitch = min(_CELL_PIXELS, int(_MOST_PIXELS / (max(length, width) + 2 * strip_cells)))
    strip = round(strip_cells * pitch)
    right, bottom = strip + length * pitch, strip + width * pitch
    picture = np.full((bottom + strip, right + strip, 3), FLOOR_RGB, np.uint8)
    picture[strip:bottom, strip:right] = _AREA_RGB
    thin, thick = max(1, pitch // 60), max(2, pitch // 40)
    for x in range(strip + pitch, right, pitch):
        cv2.line(picture, (x, strip), (x, bottom), _LINE_RGB, thin, cv2.LINE_AA)
    for y in range(strip + pitch, bottom, pitch):
        cv2.line(picture, (strip, y), (right, y), _LINE_RGB, thin, cv2.LINE_AA)
    cv2.rectangle(picture, (strip, strip), (right, bottom), _EDGE_RGB, thick, cv2.LINE_AA)
    for cell in range(length):
        _write(
            picture, str(cell), (strip + (cell + 0.5) * pitch, bottom + 0.55 * strip), 0.55 * strip, _TEXT_RGB
        )
    for cell in range(width):
        _write(
            picture, str(cell), (right + 0.55 * strip, bottom - (cell + 0.5) * pitch), 0.55 * strip, _TEXT_RGB
        )
    return picture


def number_plate(number: int, rgb: tuple[float, float, float]) -> Pixels:
    """Return a car's number on a plate of the car's colour, 0 to 1 each, with a white rim."""
    side = 256
    colour = tuple(round(255 * channel) for channel in rgb)
    picture = np.full((side, side, 3), colour, np.uint8)
    cv2.rectangle(picture, (10, 10), (side - 11, side - 11), (250, 250, 250), 8, cv2.LINE_AA)
    text = str(number)
    _write(
        picture, text, (side / 2, side / 2), side * (0.60 if len(text) == 1 else 0.44), (250, 250, 250), 0.13
    )
    return picture


def wood(rng: np.random.Generator, rgb: tuple[int, int, int]) -> Pixels:
    """Return a board's face of a colour with its grain along the picture's rows."""
    side = 512
    rows = np.arange(side)[:, None]
    bend = cv2.GaussianBlur(rng.normal(0, 1, (side, side)), (0, 0), 60) * 900
    rings = 0.5 + 0.5 * np.sin((rows + bend) / 9.0)
    fibre = cv2.GaussianBlur(rng.normal(0, 1, (side, side)), (0, 0), sigmaX=24, sigmaY=0.8)
    shade = 1.0 - 0.07 * rings + 0.35 * fibre / fibre.std() * 0.1
    picture: Pixels = np.clip(shade[:, :, None] * rgb, 0, 255).astype(np.uint8)
    return picture


def _write(
    picture: Pixels,
    text: str,
    centre: tuple[float, float],
    height: float,
    rgb: tuple[int, int, int],
    weight: float = 0.10,
) -> None:
    """Write a text of a height in pixels about a point (column, row)."""
    thickness = max(1, round(weight * height))
    scale = cv2.getFontScaleFromHeight(_FONT, max(4, round(height)), thickness)
    (width, tall), _ = cv2.getTextSize(text, _FONT, scale, thickness)
    corner = round(centre[0] - width / 2), round(centre[1] + tall / 2)
    cv2.putText(picture, text, corner, _FONT, scale, rgb, thickness, cv2.LINE_AA)
