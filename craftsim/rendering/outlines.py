"""Outlines of cars that a block or a slope hides, drawn into pictures; physics knows nothing of them."""

from __future__ import annotations

from typing import Final

import cv2
import mujoco
import numpy as np

from craftsim.compiled.arrays import Floats
from craftsim.discrete.drawing import car_colour
from craftsim.discrete.geometry import CELL_PITCH_M, LEVEL_HEIGHT_M
from craftsim.models.cameras import Aim
from craftsim.rendering.encode import Frame
from craftsim.rendering.trajectory import Trajectory

_STEEP_DEG: Final = -60.0
"""Elevation of a view from above, to which the numbers on the noses of cars are hidden, too."""
_HALO: Final = (255, 255, 255)
_THICK: Final = 240
"""Height of a picture over the thickness of an outline."""


def draw_outlines(
    picture: Frame, trajectory: Trajectory, model: mujoco.MjModel, data: mujoco.MjData, aim: Aim
) -> Frame:
    """Return a picture (height, width, 3) with outlines of the cars below blocks and slopes, as ``aim`` sees them."""
    physics = trajectory.physics
    covers = [data.xpos[block.body] for block in physics.blocks]
    covers += [data.xpos[slope.base.body] for slope in physics.slopes]
    hidden = []
    for number in range(len(physics.cars)):
        body = model.body(f"car{number}/smartcar").id
        if any(_is_above(cover, data.xpos[body]) for cover in covers):
            hidden.append((number, body))
    if not hidden:
        return picture
    outlined = np.ascontiguousarray(picture)
    if outlined is picture:
        outlined = picture.copy()
    for number, body in hidden:
        _draw_outline(outlined, trajectory, number, data.xpos[body], data.xmat[body], aim)
    return outlined


def _is_above(cover: Floats, car: Floats) -> bool:
    """Return whether an object stands in the cell of a car, or is lifted there."""
    beside_m = np.abs(cover[:2] - car[:2]).max()
    return bool(beside_m < CELL_PITCH_M / 2 and abs(cover[2] - car[2]) < LEVEL_HEIGHT_M)


def _draw_outline(
    picture: Frame, trajectory: Trajectory, number: int, place: Floats, turn: Floats, aim: Aim
) -> None:
    """Draw the outline of a car's chassis, and in a view from above its number."""
    height, width = picture.shape[:2]
    car = trajectory.physics.cars[number].parameters
    x_m = car.chassis_length_m / 2
    y_m = car.chassis_width_m / 2
    top_m = car.wheel_radius_m + car.chassis_top_m
    corners = [(x, y, z) for x in (-x_m, x_m) for y in (-y_m, y_m) for z in (0.0, top_m)]
    places = aim.project(np.array(corners) @ turn.reshape(3, 3).T + place, width / height)
    half = 0.5 * np.array([width, height])
    pixels = (half + half * places * [1, -1]).round().astype(np.int32)
    hull = cv2.convexHull(pixels)
    red, green, blue = (round(255 * channel) for channel in car_colour(number))
    thick = max(1, round(height / _THICK))
    cv2.polylines(picture, [hull], True, _HALO, 3 * thick, cv2.LINE_AA)
    cv2.polylines(picture, [hull], True, (red, green, blue), thick, cv2.LINE_AA)
    if aim.elevation_deg < _STEEP_DEG:
        x, y = pixels.mean(axis=0).round().astype(int).tolist()
        size = height / 600
        text = str(number)
        (wide, high), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, size, 2 * thick)
        corner = (x - wide // 2, y + high // 2)
        font = cv2.FONT_HERSHEY_SIMPLEX
        cv2.putText(picture, text, corner, font, size, _HALO, 5 * thick, cv2.LINE_AA)
        cv2.putText(picture, text, corner, font, size, (red, green, blue), 2 * thick, cv2.LINE_AA)
