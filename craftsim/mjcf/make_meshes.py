"""Make the visual meshes of the machines: ``python -m craftsim.mjcf.make_meshes [DIRECTORY]``.

Metres; x forward, y left, z up. Dimensions are the published ones of CraftEnv's robot description where it
has them; what only decorates (bevels, spokes, ribs, lamps) is our own. The files are pictures: contact shapes
live in the MJCF, and walkable faces agree with them within 1 mm. The same script makes the same bytes
everywhere.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Final

import numpy as np
import trimesh

from craftsim.mjcf.solids import between, box, loft, moved, plate_xz, rectangle, square, turned

Parts = list[trimesh.Trimesh]

# Car
AXLE_X: Final = 0.060
WELL_RADIUS: Final = 0.053
WELL_INNER_Y: Final = 0.059
CHASSIS_HALF_X: Final = 0.110
CHASSIS_HALF_Y: Final = 0.0835
CHASSIS_Z: Final = (-0.040, 0.050)
CHASSIS_CHAMFER: Final = 0.025
# Block
HALF_CELL: Final = 0.160
DECK_Z: Final = (0.1155, 0.185)
LEG_AT: Final = 0.1475
LEG_HALF: Final = 0.0125
# Slope: hinge axis in the slope's frame, rise over run of the incline
HINGE_X: Final = 0.16125
HINGE_Z: Final = 0.0925
RISE: Final = HINGE_Z / (2 * HINGE_X)
FLAP_X: Final = (0.00125, 0.32125)
NOTCH_END_X: Final = 0.022
NOTCH_Y: Final = 0.140
LIP: Final = 0.001


def chassis() -> Parts:
    """Body with wheel arches and a bumper at either end; origin on the axle line, midway."""
    bottom, top = CHASSIS_Z
    bumper, bevel = 0.002, 0.004

    def level(half_x: float, half_y: float, z: float) -> np.ndarray:
        return rectangle((-half_x, half_x), (-half_y, half_y), z)

    nose = CHASSIS_HALF_X - bumper
    body = loft(
        [
            level(nose - CHASSIS_CHAMFER, WELL_INNER_Y, bottom),
            level(nose, WELL_INNER_Y, bottom + CHASSIS_CHAMFER),
            level(nose, WELL_INNER_Y, top - bevel),
            level(nose - bevel, WELL_INNER_Y, top),
        ]
    )
    strips = [
        box((side * 0.104 - 0.006, side * 0.104 + 0.006), (-0.056, 0.056), (0.004, 0.022), bumper)
        for side in (-1, 1)
    ]
    return [body, *strips, *_arches()]


def _arches() -> Parts:
    """What is left of the chassis beside the wheels: a column between them and a corner above each."""
    heights = np.array([-0.040, -0.030, -0.015, 0.0, 0.015, 0.025, 0.035, 0.044, 0.050])
    half_well = np.sqrt(WELL_RADIUS**2 - heights**2)
    column_half = AXLE_X - half_well
    corner_z = np.array([0.0185, 0.026, 0.035, 0.044, 0.050])
    corner_start = AXLE_X + np.sqrt(WELL_RADIUS**2 - corner_z**2)
    parts = []
    for y in ((-CHASSIS_HALF_Y, -WELL_INNER_Y), (WELL_INNER_Y, CHASSIS_HALF_Y)):
        parts.append(loft([rectangle((-h, h), y, z) for h, z in zip(column_half, heights, strict=True)]))
        for side in (-1, 1):
            rings = [
                rectangle((start, 0.109) if side > 0 else (-0.109, -start), y, z)
                for start, z in zip(corner_start, corner_z, strict=True)
            ]
            parts.append(loft(rings))
    return parts


def chassis_trim() -> Parts:
    """Lamps at the front and a stripe on each flank: a second colour over the chassis."""
    lamps = [box((0.100, 0.1088), (y - 0.011, y + 0.011), (0.028, 0.040), 0.002) for y in (-0.042, 0.042)]
    flanks = [
        box((-0.036, 0.036), (y - 0.0004, y + 0.0004), (0.0405, 0.0465))
        for y in (-CHASSIS_HALF_Y, CHASSIS_HALF_Y)
    ]
    return [*lamps, *flanks]


def wheel_hub() -> Parts:
    """Two spoked side plates and the axle boss of a mecanum wheel about the y axis."""
    parts = [
        turned(
            [[0, -0.0215], [0.010, -0.0215], [0.0115, -0.020], [0.0115, 0.020], [0.010, 0.0215], [0, 0.0215]],
            16,
        )
    ]
    for y in (-1, 1):
        inner, outer = between(y * 0.0175, y * 0.0208)
        parts.append(
            turned([[0.0285, inner], [0.0385, inner], [0.0385, outer], [0.0285, outer], [0.0285, inner]], 30)
        )
        for angle in np.arange(5) * (2 * np.pi / 5):
            spoke = box((0.009, 0.030), (inner, outer), (-0.0035, 0.0035))
            parts.append(spoke.apply_transform(trimesh.transformations.rotation_matrix(angle, (0, 1, 0))))
    return parts


def board() -> Parts:
    """Lifting plate with the boss that seats in what it lifts; origin at the middle of the plate's top."""
    plate = box((-0.097, 0.097), (-0.100, 0.100), (-0.003, 0.0), 0.001)
    boss = loft([square(0.110, -0.001), square(0.110, 0.0), square(0.100, 0.005)])
    return [plate, boss]


def board_pads() -> Parts:
    """Rubber strips along the edges of the lifting plate and across its boss, 0.6 mm proud."""
    edge = [box((x - 0.009, x + 0.009), (-0.092, 0.092), (-0.001, 0.0006)) for x in (-0.080, 0.080)]
    boss = [box((x - 0.006, x + 0.006), (-0.046, 0.046), (0.003, 0.0056)) for x in (-0.030, 0.0, 0.030)]
    return [*edge, *boss]


def lift_post() -> Parts:
    """Column under the lifting plate that slides in the chassis, for the board's travel of 0.045."""
    post = box((-0.020, 0.020), (-0.020, 0.020), (-0.052, -0.002))
    ribs = [box((-0.026, 0.026), (y - 0.003, y + 0.003), (-0.052, -0.002)) for y in (-0.012, 0.012)]
    return [post, *ribs]


def block() -> Parts:
    """Table: deck with a pocket under it, four legs, round seats on top; origin on the floor."""
    bottom, top = DECK_Z
    bevel = 0.005
    deck = loft(
        [
            square(0.112, bottom + 0.006),
            square(0.112, bottom),
            square(2 * (HALF_CELL - bevel), bottom),
            square(2 * HALF_CELL, bottom + bevel),
            square(2 * HALF_CELL, top - bevel),
            square(2 * (HALF_CELL - bevel), top),
        ]
    )
    foot = loft([square(0.019, 0.0), square(2 * LEG_HALF, 0.003), square(2 * LEG_HALF, bottom + 0.001)])
    ring = [[0.0085, 0.184], [0.0115, 0.184], [0.0112, 0.1856], [0.0088, 0.1856], [0.0085, 0.184]]
    seat = trimesh.creation.revolve(np.array(ring), sections=20)
    corners = [(x, y) for x in (-LEG_AT, LEG_AT) for y in (-LEG_AT, LEG_AT)]
    return [deck, *(moved(foot, x, y) for x, y in corners), *(moved(seat, x, y) for x, y in corners)]


def block_trim() -> Parts:
    """Plates on the block's four flanks, 0.5 mm proud: a second colour over the block."""
    parts = []
    for quarter in range(4):
        panel = box((0.158, 0.1605), (-0.120, 0.120), (0.132, 0.168), 0.0)
        parts.append(
            panel.apply_transform(trimesh.transformations.rotation_matrix(quarter * np.pi / 2, (0, 0, 1)))
        )
    return parts


def incline(x: float) -> float:
    """Return the height of the slope's incline at x, in the slope's frame (floor at z = 0)."""
    return HINGE_Z - RISE * (x - HINGE_X)


def _under_incline(start: float, end: float, foot: float, gap: float) -> list[list[float]]:
    """Return the (x, z) outline between a height over the floor and a gap under the incline."""
    return [[start, foot], [end, foot], [end, incline(end) - gap], [start, incline(start) - gap]]


def slope_base() -> Parts:
    """Fixed wedge: incline plate on two framed side walls; origin on the floor, +x downhill."""
    back, front = -HALF_CELL, HALF_CELL
    plate = plate_xz(
        [
            [back, incline(back) - 0.0042],
            [front, incline(front) - 0.0042],
            [front, incline(front)],
            [back, incline(back)],
        ],
        (-HALF_CELL, HALF_CELL),
    )
    parts = [plate]
    rim, rail = 0.0005, 0.014  # walls end just under the plate's face, so that the two do not flicker
    for side in (-1, 1):
        parts.append(plate_xz(_under_incline(back, front, 0.0, rim), between(side * 0.150, side * 0.156)))
        frame, post = between(side * 0.153, side * 0.160), between(side * 0.153, side * 0.159)
        parts.append(plate_xz([[back, 0], [front, 0], [front, rail], [back, rail]], frame))
        top = [[back, incline(back) - rail], [front, incline(front) - rail]]
        parts.append(plate_xz([*top, [front, incline(front) - rim], [back, incline(back) - rim]], frame))
        for x in (back + 0.001, -rail / 2, front - 0.001 - rail):
            parts.append(plate_xz(_under_incline(x, x + rail, 0.002, rail - 0.002), post))
    return parts


def slope_flap() -> Parts:
    """Hinged wedge, unfolded, its root notched for the gears; origin on the hinge axis (along y)."""
    ground = -HINGE_Z
    start, end = FLAP_X
    lip_x = (HINGE_Z - LIP) / RISE  # where the wedge is as thin as its lip

    def ring(x: float, half_y: float, bevel: float, heel: float = 0.0) -> np.ndarray:
        top, bottom = max(-RISE * x, ground + LIP), ground + heel
        low, high = bottom + bevel, top - bevel
        corners = [(half_y - bevel, bottom), (half_y, low), (half_y, high), (half_y - bevel, top)]
        outline = corners + [(-y, z) for y, z in corners[::-1]]
        return np.array([[x, y, z] for y, z in outline])

    # The heel is cut away: it would drag over the floor when the flap begins to turn.
    root = loft([ring(start, NOTCH_Y, 0.002, heel=0.020), ring(NOTCH_END_X + 0.001, NOTCH_Y, 0.002)])
    wedge = loft(
        [
            ring(NOTCH_END_X, HALF_CELL, 0.002),
            ring(0.300, HALF_CELL, 0.002),
            ring(lip_x, HALF_CELL, 0.0003),
            ring(end, HALF_CELL, 0.0003),
        ]
    )
    return [root, wedge]


def gear() -> Parts:
    """Toothed disc about the y axis, with a boss."""
    teeth = 18
    angles, radii = [], []
    for tooth in range(teeth):
        for part, radius in ((0.0, 0.0172), (0.30, 0.0172), (0.45, 0.020), (0.80, 0.020)):
            angles.append((tooth + part) * 2 * np.pi / teeth)
            radii.append(radius)
    outline = np.column_stack([np.multiply(radii, np.cos(angles)), np.multiply(radii, np.sin(angles))])
    disc = plate_xz(outline, (-0.0052, 0.0052))
    boss = turned(
        [[0, -0.006], [0.0075, -0.006], [0.009, -0.005], [0.009, 0.005], [0.0075, 0.006], [0, 0.006]], 20
    )
    return [disc, boss]


def flag() -> Parts:
    """Pole and pennant standing on a block's deck; origin on the floor, at the block's middle."""
    pole = [[0, 0], [0.018, 0], [0.018, 0.003], [0.0045, 0.006], [0.0035, 0.158], [0.006, 0.161]]
    rod = trimesh.creation.revolve(np.array([*pole, [0.006, 0.165], [0, 0.168]]), sections=14)
    rings = []
    for along in np.linspace(0.0, 1.0, 9):
        wave = 0.006 * np.sin(2 * np.pi * 1.1 * along) * along
        half = 0.034 * (1 - 0.92 * along)
        corners = [(-0.0008, -half), (0.0008, -half), (0.0008, half), (-0.0008, half)]
        rings.append(np.array([[0.002 + 0.105 * along, wave + y, 0.118 + z] for y, z in corners]))
    return [moved(part, z=DECK_Z[1]) for part in (rod, loft(rings))]


MESHES: Final[dict[str, Callable[[], Parts]]] = {
    function.__name__: function
    for function in (
        chassis,
        chassis_trim,
        wheel_hub,
        board,
        board_pads,
        lift_post,
        block,
        block_trim,
        slope_base,
        slope_flap,
        gear,
        flag,
    )
}
"""Closed parts of every mesh by file name; parts may touch or overlap."""


def write_meshes(directory: Path) -> None:
    """Write every mesh as a binary STL file into a directory, which is made if it is missing."""
    directory.mkdir(parents=True, exist_ok=True)
    for name, make in MESHES.items():
        parts = make()
        for part in parts:
            # A micrometre grid: the last digits of sines differ between maths libraries, the files must not.
            part.vertices = np.round(part.vertices, 6) + 0.0
        (directory / f"{name}.stl").write_bytes(
            trimesh.exchange.stl.export_stl(trimesh.util.concatenate(parts))
        )


if __name__ == "__main__":
    write_meshes(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent / "meshes")
