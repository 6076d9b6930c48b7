"""A floor that is not a plane: tiles in the world, and the heights that a seed draws for them, written in place.

Each tile is a height field: its sides are vertical, so a wheel meets an edge as sharp as a tile's, and its face may be
flat or part of an undulation (docs/explanation/imperfections.md). The plane below is the bottom of their joints.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Final

import mujoco
import numpy as np

from craftsim.compiled.arrays import Floats
from craftsim.discrete.geometry import CELL_PITCH_M
from craftsim.discrete.grid import Cell
from craftsim.errors import InputError
from craftsim.mjcf.building import FLOOR_RGBA, GROUND
from craftsim.models.config import Amount, Length
from craftsim.storage.records import record

LEVEL: Final = 0.5
"""What a height of 0 is in the heights of a model's tiles."""
_NAME: Final = "floor"
"""The body of the tiles."""
MOST_TILES: Final = 4096
"""Of one floor: compiled in 0.2 s, and 0.1 ms of each physics step."""
_MOST_POINTS: Final = 2**20
"""Of one floor: 4 MB."""
_MARGIN_CELLS: Final = 0.5
"""Width of uneven floor around the area; what falls off its edge is caught by the plane below."""
_POINTS_A_WAVE: Final = 12
"""An arc of a wave's twelfth is 0.0086 of its height above its chord."""
_WAVES: Final = 6
_BELOW_M: Final = 0.001
"""By how much the plane lies below the lowest tile where there are no joints."""
_THICK_M: Final = 0.02
"""Of a tile: more than anything sinks in."""
_LEAST_SPAN_M: Final = 1e-4
"""A height field cannot have less."""


@record()
class Floor:
    """How uneven a floor is; hashable. Raises InputError for a figure outside [0, 1)."""

    lippage_m: Amount = 0.0
    """Largest difference in height between two tiles; each tile's height is drawn uniformly."""
    tile_m: Length = 0.3
    """Side of a square tile. Where their joints run, and in which direction, is drawn."""
    joint_m: Amount = 0.0
    """Width of the joints between tiles..."""
    joint_depth_m: Amount = 0.0
    """...and by how much their bottom lies below the lowest tile."""
    unevenness_m: Amount = 0.0
    """Height from the lowest to the highest point of the smooth undulation of the whole floor..."""
    wavelength_m: Length = 0.6
    """...and its shortest wavelength."""

    def __post_init__(self) -> None:
        if self.joint_m >= self.tile_m:
            raise ValueError(f"joint_m must be below tile_m, {self.tile_m:g}, not {self.joint_m:g}")

    @property
    def flat(self) -> bool:
        """Whether it is a plane."""
        return not (self.lippage_m or self.unevenness_m or (self.joint_m and self.joint_depth_m))

    @property
    def half_tile_m(self) -> float:
        """Half a tile's side, without its joint."""
        return (self.tile_m - self.joint_m) / 2

    @property
    def span_m(self) -> float:
        """Height from the lowest to the highest point that a tile can have."""
        return max(self.relief_m, _LEAST_SPAN_M)

    @property
    def relief_m(self) -> float:
        """Height from the lowest to the highest place on which something can stand."""
        return self.lippage_m + self.unevenness_m


FLAT: Final = Floor()


@lru_cache(maxsize=8)
def _layout(floor: Floor, size: Cell) -> tuple[float, Floats, int]:
    """Return the radius in metres of the circle that tiles cover however they lie, their centres, (n, 2) in metres,
    and the number of points along each side of a tile. Raises InputError for too many tiles."""
    radius = CELL_PITCH_M * math.hypot(*(n / 2 + _MARGIN_CELLS for n in size[:2]))
    # A tile may be shifted by half of its diagonal, and reaches as far from its centre.
    reach = radius + math.sqrt(2) * floor.tile_m
    n = math.ceil(reach / floor.tile_m)
    points = 2
    if floor.unevenness_m:
        points += math.ceil(_POINTS_A_WAVE * floor.tile_m / floor.wavelength_m - 1e-9) - 1
    if math.pi * n**2 > MOST_TILES or math.pi * (n * points) ** 2 > _MOST_POINTS:
        raise InputError(
            f"a floor of tiles of {floor.tile_m:g} m under {size[0]} by {size[1]} cells, with waves of "
            f"{floor.wavelength_m:g} m: too fine to compute; larger tiles, longer waves or a smaller world will do"
        )
    centres = floor.tile_m * np.stack(np.meshgrid(*2 * [np.arange(-n, n + 1)]), -1).reshape(-1, 2)
    return radius, centres[np.hypot(*centres.T) <= reach], points


def add_tiles(spec: mujoco.MjSpec, floor: Floor, size: Cell) -> None:
    """Put the tiles of a floor, which touch as the ground does, above it. Raises InputError for too many of them."""
    _, centres, count = _layout(floor, size)
    ground = spec.geom(GROUND)
    depth_m = (floor.joint_depth_m if floor.joint_m else 0.0) or _BELOW_M
    ground.pos[2] = -floor.relief_m / 2 - depth_m
    body = spec.worldbody.add_body(name=_NAME, pos=[*ground.pos[:2], 0.0])
    half = floor.half_tile_m
    span = floor.span_m
    alike = ("contype", "conaffinity", "friction", "solref", "solimp")
    surface = {name: getattr(ground, name) for name in alike}
    for number, (x, y) in enumerate(centres):
        tile = f"tile{number}"
        extent = [half, half, span, _THICK_M]
        flat = np.zeros(count**2)
        spec.add_hfield(name=tile, size=extent, nrow=count, ncol=count, userdata=flat)
        body.add_geom(
            name=tile,
            type=mujoco.mjtGeom.mjGEOM_HFIELD,
            hfieldname=tile,
            mass=0,
            pos=[x, y, -span / 2],
            rgba=FLOOR_RGBA,
            **surface,
        )


def tiles_body(model: mujoco.MjModel) -> int:
    """Return the body of the tiles, -1 where there are none."""
    return mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, _NAME)


def lay(model: mujoco.MjModel, floor: Floor, size: Cell, rng: np.random.Generator) -> float:
    """Draw the floor of a compiled model, alike for all parameters of a layout; return its largest height in metres."""
    layout = _layout(floor, size)
    turn_rad = rng.uniform(0, math.tau)
    x, y = floor.tile_m * rng.uniform(-0.5, 0.5, 2)
    waves = rng.uniform([0, 0.5, 0], [math.tau, 1, math.tau], (_WAVES, 3))
    heights = _heights(floor, layout, rng.uniform(-0.5, 0.5, len(layout[1])), waves)
    body = tiles_body(model)
    c = math.cos(turn_rad)
    s = math.sin(turn_rad)
    middle_x, middle_y, _ = model.geom_pos[model.geom(GROUND).id]
    model.body_pos[body, :2] = middle_x + c * x - s * y, middle_y + s * x + c * y
    model.body_quat[body] = math.cos(turn_rad / 2), 0.0, 0.0, math.sin(turn_rad / 2)
    model.hfield_data[:] = (heights / floor.span_m + LEVEL).ravel()
    return float(heights.max())


def _heights(
    floor: Floor, layout: tuple[float, Floats, int], steps: Floats, waves: Floats
) -> Floats:
    """Return (tile, row along y, column along x): heights in metres, 0 in the mean of what can be drawn.

    ``steps`` (n,) are the tiles' heights, from -0.5 to 0.5; ``waves`` (m, 3) have a direction in radians, a wave number
    as a share of the largest, and a phase in radians.
    """
    radius, centres, points = layout
    along = np.linspace(-floor.half_tile_m, floor.half_tile_m, points)
    x = centres[:, None, None, 0] + along[None, None, :]
    y = centres[:, None, None, 1] + along[None, :, None]
    heights = np.broadcast_to(
        floor.lippage_m * steps[:, None, None], (len(centres), points, points)
    )
    if not floor.unevenness_m:
        return heights
    wave = np.zeros(heights.shape)
    for towards, number, phase in waves:
        k = math.tau * number / floor.wavelength_m
        wave += np.sin(k * (math.cos(towards) * x + math.sin(towards) * y) + phase)
    # Of the lowest and the highest point those count where machines are.
    inside = wave[np.hypot(x, y) <= radius]
    low = float(inside.min())
    high = float(inside.max())
    share = np.clip((wave - low) / (high - low), 0.0, 1.0) - 0.5
    uneven: Floats = heights + floor.unevenness_m * share
    return uneven
