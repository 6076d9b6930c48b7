"""Shapes, masses and inertias that follow from the machines' figures, as their MJCF templates need them.

Points are corner points of convex solids in the frame of their body, in metres.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from craftsim.mjcf.parameters import BlockParameters, SlopeParameters, SmartcarParameters

Point = tuple[float, float, float]
Outline = list[tuple[float, float]]
"""Corners (x, z) of a convex polygon, in order."""


@dataclass(frozen=True)
class Box:
    """A box: its centre and half sizes, and its share of a mass."""

    centre: Point
    half: Point
    mass: float = 0.0

    @classmethod
    def over(cls, x: tuple[float, float], y: tuple[float, float], z: tuple[float, float]) -> Box:
        """Return the box over three intervals."""
        low, high = zip(x, y, z, strict=True)
        (x0, y0, z0), (x1, y1, z1) = low, high
        return cls(
            ((x0 + x1) / 2, (y0 + y1) / 2, (z0 + z1) / 2), ((x1 - x0) / 2, (y1 - y0) / 2, (z1 - z0) / 2)
        )

    @property
    def volume(self) -> float:
        """Volume in cubic metres."""
        return 8 * math.prod(self.half)


def bevel(car: SmartcarParameters) -> float:
    """Return by how much a boss narrows on each side per metre of its height."""
    return (car.boss_side_m - car.boss_top_side_m) / 2 / car.boss_height_m


def levels(*rings: tuple[float, float, float]) -> list[Point]:
    """Return the corners of level rectangles about the z axis: half length, half width and height of each."""
    return [(sx * x, sy * y, z) for x, y, z in rings for sx in (-1, 1) for sy in (-1, 1)]


def hull(car: SmartcarParameters) -> list[Point]:
    """Return the corners of the chassis with its chamfered lower edges, over the floor."""
    half, side, cut = car.chassis_length_m / 2, car.chassis_width_m / 2, car.chassis_chamfer_m
    bottom, top = (car.wheel_radius_m + z for z in (car.chassis_bottom_m, car.chassis_top_m))
    return levels((half, side, bottom + cut), (half, side, top), (half - cut, side, bottom))


def boss(car: SmartcarParameters) -> list[Point]:
    """Return the corners of the bevelled boss, over the board's upper face, on which it stands 1 mm deep."""
    foot, top = car.boss_side_m / 2, car.boss_top_side_m / 2
    return levels((foot, foot, -0.001), (foot, foot, 0.0), (top, top, car.boss_height_m))


def chassis_inertia(car: SmartcarParameters) -> Point:
    """Return the inertia of the chassis about its centre: that of its solid hull."""
    half, cut = car.chassis_length_m / 2, car.chassis_chamfer_m
    bottom, top = car.chassis_bottom_m, car.chassis_top_m
    outline = [
        (-half, bottom + cut),
        (cut - half, bottom),
        (half - cut, bottom),
        (half, bottom + cut),
        (half, top),
        (-half, top),
    ]
    _, xx, zz = _second_moments(outline)
    yy = car.chassis_width_m**2 / 12
    m = car.chassis_mass_kg
    return m * (yy + zz), m * (xx + zz), m * (xx + yy)


def hub_inertia(car: SmartcarParameters) -> Point:
    """Return the inertia of a wheel without its rollers: a solid cylinder about y, less its rollers at their places.

    A roller is an ellipsoid at 45 degrees to the axle.
    """
    n, m, radius = car.rollers_per_wheel, car.roller_mass_kg, car.wheel_radius_m
    along, across = (
        0.4 * m * car.roller_radius_m**2,
        0.2 * m * (car.roller_radius_m**2 + car.roller_half_length_m**2),
    )
    offset = m * (radius - car.roller_radius_m) ** 2
    about_axle = (along + across) / 2
    spin = car.wheel_spin_inertia_kgm2 - n * (about_axle + offset)
    cylinder = car.wheel_mass_kg * (3 * radius**2 + car.wheel_width_m**2) / 12
    tumble = cylinder - n * ((along + 2 * across - about_axle) + offset) / 2
    return tumble, spin, tumble


def table(block: BlockParameters, car: SmartcarParameters) -> dict[str, Box]:
    """Return deck and frame of a block by name, its deck's mass shared by volume."""
    half, pocket = block.side_m / 2, block.pocket_side_m / 2
    low, high = block.underside_m, block.underside_m + block.pocket_depth_m
    relief = block.frame_relief_m
    side = pocket - relief * bevel(car)
    boxes = {
        "deck": Box.over((-half, half), (-half, half), (high, block.height_m)),
        "frame_front": Box.over((pocket, half), (-half, half), (low, high)),
        "frame_back": Box.over((-half, -pocket), (-half, half), (low, high)),
        "frame_left": Box.over((-pocket, pocket), (side, half), (low + relief, high)),
        "frame_right": Box.over((-pocket, pocket), (-half, -side), (low + relief, high)),
    }
    return _share(boxes, block.deck_mass_kg / sum(box.volume for box in boxes.values()))


@dataclass(frozen=True)
class SlopeShape:
    """Shapes of a slope."""

    incline: list[Point]
    walls: dict[str, list[Point]]
    flap: list[Point]
    pads: dict[str, Box]
    incline_mass: float
    wall_mass: float
    gear_mass: float


def slope(p: SlopeParameters, car: SmartcarParameters) -> SlopeShape:
    """Return a slope's shapes, the mass of its base shared by volume."""
    half, rise = p.side_m / 2, p.hinge_z_m / (2 * p.hinge_x_m)
    inner, skin = half - p.wall_thickness_m, p.skin_m / math.cos(p.incline_rad)
    back, front = (p.hinge_z_m - rise * (x - p.hinge_x_m) for x in (-half, half))
    skin_outline = [(-half, back - skin), (half, front - skin), (half, front), (-half, back)]
    wall_outline = [(-half, 0.0), (half, 0.0), (half, front), (-half, back)]
    pads = _pads(p, car)
    volumes = [2 * inner * _second_moments(skin_outline)[0]]
    volumes += [p.wall_thickness_m * _second_moments(wall_outline)[0]]
    volumes += [math.pi * p.gear_radius_m**2 * p.gear_width_m]
    density = p.base_mass_kg / (
        volumes[0] + 2 * volumes[1] + 2 * volumes[2] + sum(pad.volume for pad in pads.values())
    )
    start = p.hinge_x_m - half
    end, floor = start + p.side_m, -p.hinge_z_m
    return SlopeShape(
        incline=[
            (x, y, z)
            for ends in (((-half, back), (half, front)), ((-half, back - skin), (half, front - skin)))
            for x, z in ends
            for y in (-inner, inner)
        ],
        walls={
            side: [
                (x, sign * y, z)
                for ends in (((-half, 0.0), (half, 0.0)), ((-half, back), (half, front)))
                for x, z in ends
                for y in (inner, half)
            ]
            for side, sign in (("left", 1), ("right", -1))
        },
        flap=[
            (x, y, z)
            for x, z in (
                (start, floor + p.heel_m),
                (start + p.heel_m, floor),
                (end, floor),
                (start, -rise * start),
                (end, -rise * end),
            )
            for y in (-half, half)
        ],
        pads=_share(pads, density),
        incline_mass=density * volumes[0],
        wall_mass=density * volumes[1],
        gear_mass=density * volumes[2],
    )


def worm_offset(p: SlopeParameters) -> Point:
    """Return where the worm stands that drives a slope's left gear, from the gear's centre: below, and off the wall.

    It is only to be seen: its pitch circle, of a quarter of the gear's radius, touches that of the gear.
    """
    return 0.0, -0.325 * p.gear_radius_m, -(0.93 + 0.25) * p.gear_radius_m


def _pads(p: SlopeParameters, car: SmartcarParameters) -> dict[str, Box]:
    """Return the rails that a board lifts by, and the bars that stop its boss at their lower edges."""
    inner, outer = car.boss_side_m / 2 + p.boss_play_m, car.board_width_m / 2
    rear, low = -car.board_length_m / 2, p.underside_m
    rail = low, low + p.pad_thickness_m
    back, front = low + p.stop_back_rise_m, low + p.stop_front_rise_m
    stop_back, stop_front = (
        car.boss_side_m / 2 + p.boss_play_m - bevel(car) * z
        for z in (p.stop_back_rise_m, p.stop_front_rise_m)
    )
    return {
        "pad_left": Box.over((rear, p.pad_front_m), (inner, outer), rail),
        "pad_right": Box.over((rear, p.pad_front_m), (-outer, -inner), rail),
        "pad_back": Box.over((rear, -stop_back), (-inner, inner), (back, back + p.pad_thickness_m)),
        "pad_front": Box.over(
            (stop_front, p.pad_front_m), (-inner, inner), (front, front + p.stop_thickness_m)
        ),
    }


def _share(boxes: dict[str, Box], density: float) -> dict[str, Box]:
    return {name: Box(box.centre, box.half, density * box.volume) for name, box in boxes.items()}


def _second_moments(outline: Outline) -> tuple[float, float, float]:
    """Return a polygon's area, and the means of x^2 and z^2 over it about its centroid (shoelace formulas)."""
    area = sx = sz = sxx = szz = 0.0
    for (x0, z0), (x1, z1) in zip(outline, outline[1:] + outline[:1], strict=True):
        cross = x0 * z1 - x1 * z0
        area += cross / 2
        sx += (x0 + x1) * cross / 6
        sz += (z0 + z1) * cross / 6
        sxx += (x0 * x0 + x0 * x1 + x1 * x1) * cross / 12
        szz += (z0 * z0 + z0 * z1 + z1 * z1) * cross / 12
    return area, sxx / area - (sx / area) ** 2, szz / area - (sz / area) ** 2
