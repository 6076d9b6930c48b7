"""The floor of a stage: the area with its grid and its coordinates, and bare floor around it as far as one sees."""

from __future__ import annotations

from typing import Final

import mujoco

from craftsim.discrete.geometry import CELL_PITCH_M
from craftsim.rendering.painting import FLOOR_RGB, floor, label_strip_m, painted

FLOORS: Final = ("ground", "area")
"""Geoms that show shadows and must cast none."""
_AROUND_M: Final = 30.0
"""How far the floor goes on around the area: further than any camera sees."""
_PROUD_M: Final = 0.0005
"""So high the area lies on the ground, so that the two do not flicker."""


def lay_floor(spec: mujoco.MjSpec, size: tuple[int, ...], brightness: float) -> None:
    """Draw the floor of an area of ``size`` cells; ``brightness``, from 0 to 1, suits the light that there is."""
    bare = spec.add_material(name="bare", rgba=[*(brightness * c / 255 for c in FLOOR_RGB), 1.0])
    drawn = painted(spec, "drawn", floor(*size[:2]))
    drawn.rgba = [brightness, brightness, brightness, 1.0]
    for material in (bare, drawn):
        material.specular = material.shininess = 0.0
    strip = label_strip_m(*size[:2])
    length, width = (n * CELL_PITCH_M / 2 for n in size[:2])
    ground = spec.geom("ground")
    ground.material, ground.size = "bare", [length + _AROUND_M, width + _AROUND_M, 0.05]
    spec.worldbody.add_geom(
        name="area",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        pos=[length, width, _PROUD_M],
        size=[length + strip, width + strip, 0.05],
        material="drawn",
        contype=0,
        conaffinity=0,
    )
