"""The visual meshes of the smartcar, made from its figures."""

from __future__ import annotations

import numpy as np
import trimesh

from craftsim.mjcf.parameters import SmartcarParameters
from craftsim.mjcf.solids import Parts, between, box, loft, rectangle, square, turned

_WELL_GAP_M = 0.0034
"""Between a wheel and its well."""


def _well_radius(car: SmartcarParameters) -> float:
    return car.wheel_radius_m + _WELL_GAP_M


def _well_inner_y(car: SmartcarParameters) -> float:
    """Return where the wells begin: just inside the wheels' inner faces."""
    return car.wheel_y_m - car.wheel_width_m / 2 - 0.0025


def chassis(car: SmartcarParameters) -> Parts:
    """Body with wheel arches and a bumper at either end; origin on the axle line, midway."""
    bottom, top = car.chassis_bottom_m, car.chassis_top_m
    half, inner_y, chamfer = car.chassis_length_m / 2, _well_inner_y(car), car.chassis_chamfer_m
    bumper, bevel = 0.002, 0.004

    def level(half_x: float, half_y: float, z: float) -> np.ndarray:
        return rectangle((-half_x, half_x), (-half_y, half_y), z)

    nose = half - bumper
    body = loft(
        [
            level(nose - chamfer, inner_y, bottom),
            level(nose, inner_y, bottom + chamfer),
            level(nose, inner_y, top - bevel),
            level(nose - bevel, inner_y, top),
        ]
    )
    strip = half - 0.006
    strips = [
        box((side * strip - 0.006, side * strip + 0.006), (-0.056, 0.056), (0.004, 0.022), bumper)
        for side in (-1, 1)
    ]
    return [body, *strips, *_arches(car)]


def _arches(car: SmartcarParameters) -> Parts:
    """What is left of the chassis beside the wheels: a column between them and a corner above each."""
    bottom, top, well, axle = car.chassis_bottom_m, car.chassis_top_m, _well_radius(car), car.wheel_x_m
    low = min(0.0, bottom)
    heights = np.array([low, 0.75 * low, 0.375 * low, 0.0, 0.3 * top, 0.5 * top, 0.7 * top, 0.88 * top, top])
    half_well = np.sqrt(np.maximum(well**2 - heights**2, 0.0))
    column_half = np.maximum(axle - half_well, 0.001)
    parts = []
    end = car.chassis_length_m / 2 - 0.001
    corner_z = np.array([0.37 * top, 0.52 * top, 0.7 * top, 0.88 * top, top])
    corner_start = axle + np.sqrt(np.maximum(well**2 - corner_z**2, 0.0))
    inside = corner_start < end + 0.001
    for y in (
        (-car.chassis_width_m / 2, -_well_inner_y(car)),
        (_well_inner_y(car), car.chassis_width_m / 2),
    ):
        parts.append(loft([rectangle((-h, h), y, z) for h, z in zip(column_half, heights, strict=True)]))
        for side in (-1, 1):
            rings = [
                rectangle((start, end) if side > 0 else (-end, -start), y, z)
                for start, z in zip(corner_start[inside], corner_z[inside], strict=True)
            ]
            if len(rings) > 1:
                parts.append(loft(rings))
    return parts


def chassis_trim(car: SmartcarParameters) -> Parts:
    """Lamps at the front and a stripe on each flank: a second colour over the chassis."""
    front, half_y, top = car.chassis_length_m / 2, car.chassis_width_m / 2, car.chassis_top_m
    lamps = [
        box((front - 0.010, front - 0.0012), (y - 0.011, y + 0.011), (top - 0.022, top - 0.010), 0.002)
        for y in (-0.042, 0.042)
    ]
    flanks = [
        box((-0.036, 0.036), (y - 0.0004, y + 0.0004), (top - 0.0095, top - 0.0035))
        for y in (-half_y, half_y)
    ]
    return [*lamps, *flanks]


def wheel_hub(car: SmartcarParameters) -> Parts:
    """Two spoked side plates and the axle boss of a mecanum wheel about the y axis."""
    half = car.wheel_width_m / 2
    rim = car.wheel_radius_m - 0.0111
    bevelled = half - 0.0015
    parts = [
        turned(
            [[0, -half], [0.010, -half], [0.0115, -bevelled], [0.0115, bevelled], [0.010, half], [0, half]],
            16,
        )
    ]
    for y in (-1, 1):
        inner, outer = between(y * (half - 0.004), y * (half - 0.0007))
        hub = rim - 0.010
        parts.append(turned([[hub, inner], [rim, inner], [rim, outer], [hub, outer], [hub, inner]], 30))
        for angle in np.arange(5) * (2 * np.pi / 5):
            spoke = box((0.009, rim - 0.0085), (inner, outer), (-0.0035, 0.0035))
            parts.append(spoke.apply_transform(trimesh.transformations.rotation_matrix(angle, (0, 1, 0))))
    return parts


def board(car: SmartcarParameters) -> Parts:
    """Lifting plate with the boss that seats in what it lifts; origin at the middle of the plate's top."""
    half_x, half_y, thickness = car.board_length_m / 2, car.board_width_m / 2, car.board_thickness_m
    plate = box((-half_x, half_x), (-half_y, half_y), (-thickness, 0.0), min(0.001, thickness / 3))
    foot, top = car.boss_side_m, car.boss_top_side_m
    boss = loft([square(foot, -0.001), square(foot, 0.0), square(top, car.boss_height_m)])
    return [plate, boss]


def board_pads(car: SmartcarParameters) -> Parts:
    """Rubber strips along the edges of the lifting plate and across its boss, 0.6 mm proud."""
    x_edge, y_edge, y_boss = (
        car.board_length_m / 2 - 0.017,
        car.board_width_m / 2 - 0.008,
        car.boss_side_m / 2 - 0.009,
    )
    edge = [box((x - 0.009, x + 0.009), (-y_edge, y_edge), (-0.001, 0.0006)) for x in (-x_edge, x_edge)]
    height = car.boss_height_m
    boss = [
        box((x - 0.006, x + 0.006), (-y_boss, y_boss), (height - 0.002, height + 0.0006))
        for x in (-0.030, 0.0, 0.030)
    ]
    return [*edge, *boss]


def lift_post(car: SmartcarParameters) -> Parts:
    """Column under the lifting plate that slides in the chassis, 7 mm longer than the board's travel."""
    bottom = -car.board_travel_m - 0.007
    post = box((-0.020, 0.020), (-0.020, 0.020), (bottom, -0.002))
    ribs = [box((-0.026, 0.026), (y - 0.003, y + 0.003), (bottom, -0.002)) for y in (-0.012, 0.012)]
    return [post, *ribs]
