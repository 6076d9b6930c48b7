"""Whether a car of given parameters can work at all: on the slope, in a cell, under tables, and lifting them."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from craftsim.discrete.geometry import INCLINE_RAD
from craftsim.discrete.readback import LIFT_RANGE_M

if TYPE_CHECKING:
    from craftsim.mjcf.parameters import BlockParameters, Machines, SmartcarParameters

_CLEARANCE_M: Final = 0.0005
"""What must be left between chassis and slope."""
_PLATE_GAP_M: Final = 0.0002
"""What must be left between the wheels and the plate of a lowered board."""
_HEAD_ROOM_M: Final = 0.001
"""What must be left between a lowered board and what it drives under."""
_ROOM_BESIDE_M: Final = 0.010
"""What must be left between a car and the legs that it drives between."""
_LIFT_MARGIN_M: Final = 0.002
"""A lift must keep this far from the range in which a load counts as carried."""


def _require(holds: bool, name: str, message: str) -> None:
    if not holds:
        raise ValueError(f"{name} {message}")


def check_car(car: SmartcarParameters) -> None:
    """Raise ValueError, naming the parameter, for a car that does not fit together or grounds on a slope."""
    radius, bottom, half = car.wheel_radius_m, car.chassis_bottom_m, car.chassis_length_m / 2
    gap = car.wheel_x_m - radius
    _require(gap > 0, "wheel_x_m", f"must be above the wheel's radius, {radius:g}, not {car.wheel_x_m:g}")
    inner = car.wheel_y_m - car.wheel_width_m / 2
    _require(inner > 0, "wheel_y_m", f"must be above half a wheel's width, not {car.wheel_y_m:g}")
    _require(
        bottom < car.chassis_com_m < car.chassis_top_m,
        "chassis_com_m",
        f"must lie between {bottom:g} and {car.chassis_top_m:g}, not at {car.chassis_com_m:g}",
    )
    room = min(half, car.chassis_top_m - bottom)
    _require(
        car.chassis_chamfer_m < room,
        "chassis_chamfer_m",
        f"must be below {room:g}, not {car.chassis_chamfer_m:g}",
    )
    under = max(car.chassis_top_m, radius + _PLATE_GAP_M) + car.board_thickness_m
    _require(
        car.board_top_m >= under - 1e-9,
        "board_top_m",
        f"is {car.board_top_m:g}; at least {under:.4f} keeps the plate above chassis and wheels",
    )
    _require(
        car.roller_radius_m < radius / 2, "roller_radius_m", f"must be below half the wheel's, {radius / 2:g}"
    )
    rollers = car.rollers_per_wheel * car.roller_mass_kg
    _require(
        rollers < 0.5 * car.wheel_mass_kg,
        "wheel_mass_kg",
        f"must be above {2 * rollers:g}, twice its rollers'",
    )
    _require(
        car.wheel_torque_nm > car.gear_friction_nm,
        "wheel_torque_nm",
        f"is {car.wheel_torque_nm:g} and must be above gear_friction_nm, {car.gear_friction_nm:g}, to turn the wheel",
    )
    _check_slope(car)


def _check_slope(car: SmartcarParameters) -> None:
    radius, bottom, half_turn = car.wheel_radius_m, car.chassis_bottom_m, INCLINE_RAD / 2
    # Astride the crest each axle's ground falls by half the incline, seen from the car.
    over_crest = radius / math.cos(half_turn) - car.wheel_x_m * math.tan(half_turn) + bottom
    least = (car.wheel_x_m * math.tan(half_turn) - bottom + _CLEARANCE_M) * math.cos(half_turn)
    _require(
        over_crest > _CLEARANCE_M,
        "wheel_radius_m",
        f"is {radius:g}: the chassis would ground on the crest of a slope; at least {least:.4f} with this "
        f"wheelbase and chassis_bottom_m",
    )
    # At the foot, as the front wheels touch the incline, the two lower corners of the nose are beyond it.
    half, chamfer = car.chassis_length_m / 2, car.chassis_chamfer_m
    touch = car.wheel_x_m + radius * math.tan(half_turn)
    for x, z in ((half - chamfer, bottom), (half, bottom + chamfer)):
        ground = max(0.0, x - touch) * math.tan(INCLINE_RAD)
        _require(
            radius + z - ground > _CLEARANCE_M,
            "chassis_length_m",
            f"is {car.chassis_length_m:g}: the nose would run into the foot of a slope; shorten it, or enlarge "
            f"wheel_x_m or chassis_chamfer_m",
        )


def check_machines(machines: Machines) -> None:
    """Raise ValueError, naming the parameter, for a car that does not fit under the loads or cannot lift them."""
    for car in machines.cars:
        _check_room(car, machines.block)
        slope = machines.slope
        low = min(machines.block.underside_m, slope.underside_m)
        high = max(machines.block.underside_m, machines.slope.underside_m)
        rest = car.board_rest_m
        # The boss passes below a slope's back bar.
        room = min(low, slope.underside_m + slope.stop_back_rise_m - car.boss_height_m) - _HEAD_ROOM_M
        _require(
            rest <= room + 1e-9,
            "board_top_m",
            f"and wheel_radius_m put the lowered board {rest:.4f} over the floor; "
            f"at most {room:.4f} drives under a slope",
        )
        least = high - rest + LIFT_RANGE_M[0] + _LIFT_MARGIN_M
        most = low - rest + LIFT_RANGE_M[1] - _LIFT_MARGIN_M
        _require(
            least <= car.board_travel_m <= most,
            "board_travel_m",
            f"is {car.board_travel_m:g}; from {least:.4f} to {most:.4f} lifts blocks and slopes clear of the ground",
        )


def _check_room(car: SmartcarParameters, block: BlockParameters) -> None:
    room = block.leg_offset_m - block.leg_side_m / 2 - _ROOM_BESIDE_M
    for name, reach, most in (
        ("chassis_length_m", car.chassis_length_m / 2, f"{2 * room:.3f}"),
        ("chassis_width_m", car.chassis_width_m / 2, f"{2 * room:.3f}"),
        ("wheel_x_m", car.wheel_x_m + car.wheel_radius_m, f"{room - car.wheel_radius_m:.4f}"),
        ("wheel_y_m", car.wheel_y_m + car.wheel_width_m / 2, f"{room - car.wheel_width_m / 2:.4f}"),
    ):
        figure = getattr(car, name)
        _require(reach <= room, name, f"is {figure:g}; at most {most} passes between a block's legs")
