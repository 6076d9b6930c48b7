"""The visual meshes of the slope, made from its figures."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from craftsim.mjcf.parameters import SlopeParameters
from craftsim.mjcf.solids import Parts, Ring, between, loft, plate_xz, turned

_LIP_M: Final = 0.001
"""Thickness of the flap's edge."""
_TEETH: Final = 18
_GEAR_ROOT: Final = 0.86
"""Radius between a gear's teeth, over that of their tips."""
_WORM_POINTS, _WORM_RINGS = 12, 8
"""Of a ring, and rings in a turn of the thread."""


def _rise(p: SlopeParameters) -> float:
    """Return rise over run of the incline."""
    return p.hinge_z_m / (2 * p.hinge_x_m)


def _incline(p: SlopeParameters, x: float) -> float:
    """Return the height of the slope's incline at x, in the slope's frame (floor at z = 0)."""
    return p.hinge_z_m - _rise(p) * (x - p.hinge_x_m)


def _under_incline(
    p: SlopeParameters, start: float, end: float, foot: float, gap: float
) -> list[list[float]]:
    """Return the (x, z) outline between a height over the floor and a gap under the incline."""
    return [[start, foot], [end, foot], [end, _incline(p, end) - gap], [start, _incline(p, start) - gap]]


def slope_base(p: SlopeParameters) -> Parts:
    """Fixed wedge: incline plate on two framed side walls; origin on the floor, +x downhill."""
    back, front = -p.side_m / 2, p.side_m / 2
    side_y, skin = p.side_m / 2, p.skin_m + 0.0002
    plate = plate_xz(
        [
            [back, _incline(p, back) - skin],
            [front, _incline(p, front) - skin],
            [front, _incline(p, front)],
            [back, _incline(p, back)],
        ],
        (-side_y, side_y),
    )
    parts = [plate]
    rim, rail = 0.0005, 0.014  # walls end just under the plate's face, so that the two do not flicker
    for side in (-1, 1):
        parts.append(
            plate_xz(
                _under_incline(p, back, front, 0.0, rim),
                between(side * (side_y - 0.010), side * (side_y - 0.004)),
            )
        )
        frame, post = (between(side * (side_y - 0.007), side * (side_y - inset)) for inset in (0.0, 0.001))
        parts.append(plate_xz([[back, 0], [front, 0], [front, rail], [back, rail]], frame))
        top = [[back, _incline(p, back) - rail], [front, _incline(p, front) - rail]]
        parts.append(
            plate_xz([*top, [front, _incline(p, front) - rim], [back, _incline(p, back) - rim]], frame)
        )
        for x in (back + 0.001, -rail / 2, front - 0.001 - rail):
            parts.append(plate_xz(_under_incline(p, x, x + rail, 0.002, rail - 0.002), post))
    return parts


def slope_flap(p: SlopeParameters) -> Parts:
    """Hinged wedge, unfolded, its root notched for the gears; origin on the hinge axis (along y)."""
    ground, rise, half = -p.hinge_z_m, _rise(p), p.side_m / 2
    start = p.hinge_x_m - half
    end = start + p.side_m
    lip_x = (p.hinge_z_m - _LIP_M) / rise  # where the wedge is as thin as its lip

    def ring(x: float, half_y: float, bevel: float, heel: float = 0.0, sunk: float = 0.0) -> np.ndarray:
        top, bottom = max(-rise * x, ground + _LIP_M) - sunk, ground + heel
        low, high = bottom + bevel, top - bevel
        corners = [(half_y - bevel, bottom), (half_y, low), (half_y, high), (half_y - bevel, top)]
        outline = corners + [(-y, z) for y, z in corners[::-1]]
        return np.array([[x, y, z] for y, z in outline])

    notch = p.heel_m + 0.002
    # The heel is cut away: it would drag over the floor when the flap begins to turn.
    # It ends sunk into the wedge: where two faces lie in one another, lights that cast shadows count twice.
    root = loft(
        [
            ring(start, half - 0.020, 0.002, heel=p.heel_m),
            ring(notch, half - 0.020, 0.002),
            ring(notch + 0.001, half - 0.020, 0.002, sunk=0.001),
        ]
    )
    wedge = loft(
        [
            ring(notch, half, 0.002),
            ring(end - 0.02125, half, 0.002),
            ring(lip_x, half, 0.0003),
            ring(end, half, 0.0003),
        ]
    )
    return [root, wedge]


def gear(p: SlopeParameters) -> Parts:
    """Toothed disc about the y axis, with a boss."""
    tip, half = p.gear_radius_m, p.gear_width_m / 2
    root = _GEAR_ROOT * tip
    angles, radii = [], []
    for tooth in range(_TEETH):
        for part, radius in ((0.0, root), (0.30, root), (0.45, tip), (0.80, tip)):
            angles.append((tooth + part) * 2 * np.pi / _TEETH)
            radii.append(radius)
    outline = np.column_stack([np.multiply(radii, np.cos(angles)), np.multiply(radii, np.sin(angles))])
    disc = plate_xz(outline, (0.0008 - half, half - 0.0008))
    inset = half - 0.001
    boss = turned(
        [[0, -half], [0.0075, -half], [0.009, -inset], [0.009, inset], [0.0075, half], [0, half]], 20
    )
    return [disc, boss]


def worm(p: SlopeParameters) -> Parts:
    """Worm about the x axis that meshes with a gear above its middle, and the motor behind it."""
    pitch_radius, depth = 0.25 * p.gear_radius_m, (1 - _GEAR_ROOT) / 2 * p.gear_radius_m
    pitch = np.pi * (1 + _GEAR_ROOT) * p.gear_radius_m / _TEETH
    around = np.arange(_WORM_POINTS) * (2 * np.pi / _WORM_POINTS)
    start = 0.125 * pitch  # a gap faces up where a tooth of the gear hangs lowest

    def ring(x: float, radius: ArrayLike) -> Ring:
        along = np.full(_WORM_POINTS, x)
        return np.column_stack([along, radius * np.sin(around), radius * np.cos(around)])

    places = np.linspace(-1.5, 1.5, 3 * _WORM_RINGS + 1) * pitch
    turns = [(x - start) / pitch - around / (2 * np.pi) for x in places]
    thread = [
        ring(x, pitch_radius - depth * np.clip(1.4 * np.cos(2 * np.pi * turn), -1, 1))
        for x, turn in zip(places, turns, strict=True)
    ]
    back = places[0]
    motor, shaft = 0.325 * p.gear_radius_m, pitch_radius - depth
    axle = loft([ring(back - 0.004, shaft), ring(back + 0.001, shaft)])
    body = [ring(back - length, radius) for length, radius in ((0.034, motor - 0.001), (0.033, motor))]
    body += [ring(back - length, radius) for length, radius in ((0.004, motor), (0.003, motor - 0.001))]
    return [loft(thread), axle, loft(body)]
