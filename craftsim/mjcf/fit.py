"""Whether a car of given parameters can work at all: on the slope, in a cell, under tables, and lifting them."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from craftsim.discrete.geometry import INCLINE_RAD
from craftsim.discrete.readback import LIFT_RANGE_M

if TYPE_CHECKING:
    from craftsim.mjcf.parameters import Machines, SmartcarParameters

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


def _require(holds: bool, message: str) -> None:
    if not holds:
        raise ValueError(message)


def check_car(car: SmartcarParameters) -> None:
    """Raise ValueError, naming the parameter, for a car that does not fit together or grounds on a slope."""
    radius = car.wheel_radius_m
    bottom = car.chassis_bottom_m
    top = car.chassis_top_m
    x = car.wheel_x_m
    y = car.wheel_y_m
    com = car.chassis_com_m
    half = car.chassis_length_m / 2
    chamfer = car.chassis_chamfer_m
    _require(x > radius, f"wheel_x_m must be above the wheel's radius, {radius:g}, not {x:g}")
    _require(y > car.wheel_width_m / 2, f"wheel_y_m must be above half a wheel's width, not {y:g}")
    _require(
        bottom < com < top, f"chassis_com_m must lie between {bottom:g} and {top:g}, not at {com:g}"
    )
    room = min(half, top - bottom)
    _require(chamfer < room, f"chassis_chamfer_m must be below {room:g}, not {chamfer:g}")
    under = max(top, radius + _PLATE_GAP_M) + car.board_thickness_m
    _require(
        car.board_top_m >= under - 1e-9,
        f"board_top_m is {car.board_top_m:g}; at least {under:.4f} keeps the plate above chassis and wheels",
    )
    largest = radius / 2
    _require(
        car.roller_radius_m < largest,
        f"roller_radius_m must be below half the wheel's, {largest:g}",
    )
    smallest = 2 * car.rollers_per_wheel * car.roller_mass_kg
    _require(
        car.wheel_mass_kg > smallest,
        f"wheel_mass_kg must be above {smallest:g}, twice its rollers'",
    )
    torque = car.wheel_torque_nm
    friction = car.gear_friction_nm
    _require(
        torque > friction,
        f"wheel_torque_nm is {torque:g} and must be above gear_friction_nm, {friction:g}, to turn the wheel",
    )
    half_turn = INCLINE_RAD / 2
    # Astride the crest each axle's ground falls by half the incline, seen from the car.
    over_crest = radius / math.cos(half_turn) - x * math.tan(half_turn) + bottom
    smallest = (x * math.tan(half_turn) - bottom + _CLEARANCE_M) * math.cos(half_turn)
    _require(
        over_crest > _CLEARANCE_M,
        f"wheel_radius_m is {radius:g}: the chassis would ground on the crest of a slope; at least {smallest:.4f} with "
        f"this wheelbase and chassis_bottom_m",
    )
    # At the foot, as the front wheels touch the incline, the two lower corners of the nose are beyond it.
    touch = x + radius * math.tan(half_turn)
    for along, z in ((half - chamfer, bottom), (half, bottom + chamfer)):
        ground = max(0.0, along - touch) * math.tan(INCLINE_RAD)
        _require(
            radius + z - ground > _CLEARANCE_M,
            f"chassis_length_m is {car.chassis_length_m:g}: the nose would run into the foot of a slope; shorten it, "
            f"or enlarge wheel_x_m or chassis_chamfer_m",
        )


def check_machines(machines: Machines) -> None:
    """Raise ValueError, naming the parameter, for a car that does not fit under the loads or cannot lift them."""
    block = machines.block
    slope = machines.slope
    low, high = sorted((block.underside_m, slope.underside_m))
    # The boss passes below a slope's back bar.
    bars = slope.underside_m + slope.stop_back_rise_m
    half_room = block.leg_offset_m - block.leg_side_m / 2 - _ROOM_BESIDE_M
    for car in machines.cars:
        for name, reach, limit in (
            ("chassis_length_m", car.chassis_length_m / 2, f"{2 * half_room:.3f}"),
            ("chassis_width_m", car.chassis_width_m / 2, f"{2 * half_room:.3f}"),
            (
                "wheel_x_m",
                car.wheel_x_m + car.wheel_radius_m,
                f"{half_room - car.wheel_radius_m:.4f}",
            ),
            (
                "wheel_y_m",
                car.wheel_y_m + car.wheel_width_m / 2,
                f"{half_room - car.wheel_width_m / 2:.4f}",
            ),
        ):
            message = (
                f"{name} is {getattr(car, name):g}; at most {limit} passes between a block's legs"
            )
            _require(reach <= half_room, message)
        lowered = car.board_rest_m
        travel = car.board_travel_m
        room = min(low, bars - car.boss_height_m) - _HEAD_ROOM_M
        _require(
            lowered <= room + 1e-9,
            f"board_top_m and wheel_radius_m put the lowered board {lowered:.4f} over the floor; "
            f"at most {room:.4f} drives under a slope",
        )
        shortest = high - lowered + LIFT_RANGE_M[0] + _LIFT_MARGIN_M
        longest = low - lowered + LIFT_RANGE_M[1] - _LIFT_MARGIN_M
        _require(
            shortest <= travel <= longest,
            f"board_travel_m is {travel:g}; from {shortest:.4f} to {longest:.4f} lifts blocks and slopes clear of the "
            f"ground",
        )
