"""What ``paper`` quality adds to a scene: light and shadows, and materials."""

from __future__ import annotations

import math
from typing import Final

import mujoco
import numpy as np

from craftsim.discrete.drawing import Rgb
from craftsim.discrete.geometry import CELL_PITCH_M
from craftsim.rendering.painting import painted, wood

_MATERIALS: Final = {
    "plastic": (0.45, 0.55),
    "rubber": (0.10, 0.10),
    "metal": (0.85, 0.75),
    "matt": (0.15, 0.20),
}
"""Specular and shininess."""
_WOOD: Final = "wood"
_WOOD_RGB: Final = (222, 178, 118)
_Look = tuple[str, Rgb | None]
_LOOKS: Final[dict[str, _Look]] = {
    "chassis_visual": ("plastic", None),
    "chassis_trim": ("plastic", (0.96, 0.96, 0.97)),
    "board_visual": ("metal", (0.78, 0.79, 0.80)),
    "board_pads": ("rubber", (0.13, 0.13, 0.14)),
    "lift_post": ("metal", (0.62, 0.64, 0.67)),
    "hub": ("metal", (0.50, 0.52, 0.55)),
    "roller": ("rubber", (0.14, 0.14, 0.15)),
    "table_visual": (_WOOD, (1.0, 1.0, 1.0)),
    "trim": (_WOOD, (0.66, 0.55, 0.46)),
    "flag_visual": ("plastic", None),
    "base_visual": ("matt", (0.40, 0.49, 0.58)),
    "flap_visual": ("matt", (0.56, 0.66, 0.75)),
    "gear": ("metal", (0.72, 0.66, 0.50)),
    "worm": ("metal", (0.52, 0.54, 0.57)),
    "knuckle": ("metal", (0.40, 0.42, 0.45)),
    "pad": ("rubber", (0.16, 0.17, 0.19)),
}
"""Material and colour (r, g, b; None leaves that which it has) of the visual geoms whose names begin so."""
_WALL_RGB: Final = (0.60, 0.60, 0.60)

_SKY_RGB: Final = [0.97, 0.97, 0.97], [0.86, 0.86, 0.84]
"""Overhead and at the horizon, where the floor ends."""
_SUN: Final = np.array([-0.42, -0.38, 1.0])
"""Towards the light: from the left of the overview, so that shadows fall to the right and backwards."""
_SUNS: Final = 3
"""Lights that make up the sun: together they blur the edges of its shadows. Each costs as much as a picture without."""
_SUN_SPREAD: Final = 0.035
"""How far these stand from the middle of the sun."""
_SHADOW_PIXELS: Final = 3072
_SHADOW_RADII: Final = 1.4
"""Half the width of what a map of shadows covers, over the radius of the area. MuJoCo reads its maps by up to a pixel
too far out, which speckles faces with their own shadow towards the light, in the outer half of the map."""
_SHADOW_SHIFT: Final = 0.35
"""By so many radii the maps are moved towards the light: nothing then stands in that half."""
_FAR_RADII: Final = 40.0
"""How far cameras and lights see."""


def dress(spec: mujoco.MjSpec, size: tuple[int, ...], height_m: float) -> None:
    """Give a scene over an area of ``size`` cells, built up to a height, the looks of ``paper`` quality."""
    _light(spec, size, height_m)
    _give_materials(spec)
    sky = spec.texture("sky")
    sky.rgb1, sky.rgb2 = _SKY_RGB
    spec.visual.quality.offsamples = 8


def _light(spec: mujoco.MjSpec, size: tuple[int, ...], height_m: float) -> None:
    spec.delete(spec.light("sun"))
    head = spec.visual.headlight
    head.ambient, head.diffuse, head.specular = [0.52] * 3, [0.16] * 3, [0.05] * 3
    centre = np.array([size[0] * CELL_PITCH_M, size[1] * CELL_PITCH_M, height_m]) / 2
    radius = float(np.linalg.norm(centre))
    aside = _SHADOW_SHIFT * radius * np.array([*_SUN[:2], 0.0]) / float(np.hypot(*_SUN[:2]))
    for number in range(_SUNS):
        angle = number * math.tau / _SUNS
        towards = _SUN + np.array([math.cos(angle), math.sin(angle), 0.0]) * _SUN_SPREAD
        towards /= np.linalg.norm(towards)
        spec.worldbody.add_light(
            name=f"sun{number}",
            type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
            pos=centre + aside + 3 * radius * towards,
            dir=-towards,
            diffuse=[0.42 / _SUNS] * 3,
            specular=[0.30 / _SUNS] * 3,
            castshadow=True,
        )
    spec.visual.quality.shadowsize = _SHADOW_PIXELS
    spec.visual.map.shadowclip, spec.visual.map.zfar = _SHADOW_RADII, _FAR_RADII
    spec.stat.extent, spec.stat.center = radius, centre


def _give_materials(spec: mujoco.MjSpec) -> None:
    for name, (specular, shininess) in _MATERIALS.items():
        spec.add_material(name=name, specular=specular, shininess=shininess)
    grain = painted(spec, _WOOD, wood(np.random.default_rng(0), _WOOD_RGB))
    grain.specular, grain.shininess = 0.12, 0.2
    for geom in spec.geoms:
        if (look := _look(geom.name, geom.group)) is None:
            continue
        geom.material, rgb = look
        if rgb is not None:
            geom.rgba = [*rgb, 1.0]


def _look(name: str, group: int) -> _Look | None:
    """Return material and colour of a geom, None for one that keeps its own."""
    part, _, own = name.partition("/")
    look = next((look for start, look in _LOOKS.items() if own.startswith(start)), None)
    if look is None or group != 2:
        return None
    return ("matt", _WALL_RGB) if part.startswith("wall") else look


def dressed_rgb(name: str, group: int) -> Rgb | None:
    """Return the colour of a geom in ``paper`` quality where there are no materials; None for one that keeps its own.

    Args:
        name: of the geom in a world, such as ``car0/board_visual``.
        group: of the geom; only what is there to be seen is dressed.
    """
    material, rgb = _look(name, group) or ("", None)
    if rgb is None or material != _WOOD:
        return rgb
    red, green, blue = (tint * grain / 255 for tint, grain in zip(rgb, _WOOD_RGB, strict=True))
    return red, green, blue
