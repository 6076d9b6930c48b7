"""The slope, a ramp that folds into a box: a hollow base, and a wedge, the flap, on a motorised hinge.

Frame: origin on the floor under the centre of the base, x downhill, z up. At hinge angle 0 the flap lies on the floor
in the next cell and continues the incline (16 degrees); at pi it lies upside down on the base and the top is level.
"""

from __future__ import annotations

import math
from typing import Final

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from craftsim.mjcf.building import (
    SEEN_GROUP,
    TOUCHES,
    MachineBuilder,
    Pose,
    digits,
    micro,
    surface,
    volume,
)
from craftsim.mjcf.machines import Machines
from craftsim.mjcf.parameters import BEVEL, SEAT, SlopeParameters
from craftsim.mjcf.solids import (
    ClosedSolid,
    Interval,
    Point,
    Polygon,
    Ring,
    between,
    loft,
    plate_xz,
    turned,
)

_LIP_M: Final = 0.001
"""Thickness of the flap's edge."""
_TEETH: Final = 18
_GEAR_ROOT: Final = 0.86
"""Radius between a gear's teeth, over that of their tips."""
_WORM_POINTS = 12
_WORM_RINGS = 8
"""Of a ring, and rings in a turn of the thread."""
_SIDES: Final = {"left": 1, "right": -1}
_DARK: Final = [0.25, 0.27, 0.30, 1.0]


def add_slope(
    spec: mujoco.MjSpec, prefix: str, pose: Pose, machines: Machines, visual: bool = True
) -> None:
    """Add a slope to a spec; the arguments are as of :func:`craftsim.mjcf.car.add_car`."""
    slope = machines.slope
    of_solid = {
        **TOUCHES["things"],
        **surface(machines.contact, slope.friction),
        "rgba": [0.35, 0.55, 0.75, 0.4],
    }
    builder = MachineBuilder(spec, prefix, "slope", visual, slope_looks, slope, **of_solid)
    body = builder.body(pose)
    body.sleep = mujoco.mjtSleepPolicy.mjSLEEP_ALLOWED
    flap = body.add_body(name=f"{prefix}flap", pos=digits((slope.hinge_x_m, 0.0, slope.hinge_z_m)))
    _show(builder, slope, body, flap)
    solids, density, gear_kg = _shapes(slope)
    for name, (corners, mass) in solids.items():
        builder.add_hull(flap if name == "flap" else body, builder.solid, name, corners, mass=mass)
    # Pads: two level rails that a smartcar's board lifts by, low enough that its plate clears the incline, and two
    # bars, higher than the rails, that stop its boss: it slides in below pad_back, and seats between the four.
    look = {"group": SEEN_GROUP, "rgba": [0.20, 0.22, 0.25, 1.0]}
    pad = builder.geoms("pad", type=mujoco.mjtGeom.mjGEOM_BOX, **look)
    for name, spans in _pads(slope).items():
        builder.add_box(body, pad, name, spans, density)
    size = [slope.gear_radius_m, digits(slope.gear_width_m / 2), 0]
    gear = builder.geoms("gear", type=mujoco.mjtGeom.mjGEOM_CYLINDER, size=size, mass=gear_kg)
    for side, sign in _SIDES.items():
        place = digits((slope.hinge_x_m, sign * _gear_y(slope), slope.hinge_z_m))
        builder.add(body, gear, f"gear_{side}", pos=place, zaxis=[0, 1, 0])
    _add_hinge(builder, flap, machines)


def _add_hinge(builder: MachineBuilder, flap: mujoco.MjsBody, machines: Machines) -> None:
    slope = machines.slope
    contact = machines.contact
    prefix = builder.prefix
    folded = digits(round(slope.hinge_range_rad, 8))
    flap.add_joint(
        name=f"{prefix}hinge",
        axis=[0, -1, 0],
        range=[-slope.hinge_margin_rad, folded],
        damping=[slope.hinge_damping_nms_rad, 0, 0],
        frictionloss=slope.hinge_friction_nm,
        armature=slope.hinge_armature_kgm2,
    )
    # MuJoCo leaves out contact between a body and its child: pairs, which have friction along each axis, put it back.
    twist = contact.torsional_friction_m
    roll = contact.rolling_friction_m
    of_surface = surface(contact, slope.friction)
    of_surface["friction"] = [slope.friction, slope.friction, twist, roll, roll]
    for below in ("incline", "wall_left", "wall_right"):
        builder.spec.add_pair(geomname1=f"{prefix}flap", geomname2=prefix + below, **of_surface)
    limits = slope.hinge_speed_rad_s, slope.hinge_torque_nm, folded
    builder.add_drive("hinge", slope.hinge_stiffness_nm_rad, slope.hinge_gain_nms_rad, *limits)


def _shapes(p: SlopeParameters) -> tuple[dict[str, tuple[list[Point], float]], float, float]:
    """Return a slope's convex solids by name, with corners and mass; the base's density; and the mass of a gear."""
    half = p.side_m / 2
    rise = _rise(p)
    inner = half - p.wall_thickness_m
    skin = p.skin_m / math.cos(p.incline_rad)
    back = _incline(p, (-half))
    front = _incline(p, half)
    start = p.hinge_x_m - half
    end = start + p.side_m
    floor = -p.hinge_z_m
    flap_outline = [
        # Its heel is cut away: it would drag over the floor when the flap begins to turn.
        (start, floor + p.heel_m),
        (start + p.heel_m, floor),
        (end, floor),
        (start, -rise * start),
        (end, -rise * end),
    ]
    volumes = [
        2 * inner * p.side_m * skin,
        p.wall_thickness_m * p.side_m * (back + front) / 2,
        math.pi * p.gear_radius_m**2 * p.gear_width_m,
    ]
    pad_volume = sum(volume(*spans) for spans in _pads(p).values())
    density = p.base_mass_kg / (volumes[0] + 2 * volumes[1] + 2 * volumes[2] + pad_volume)
    incline_kg, wall_kg, gear_kg = micro([density * volume for volume in volumes])
    ends = ((-half, back), (half, front), (-half, back - skin), (half, front - skin))
    wall = ((-half, 0.0), (half, 0.0), (-half, back), (half, front))
    solids = {
        "incline": (_prism(ends, (-inner, inner)), incline_kg),
        "wall_left": (_prism(wall, (inner, half)), wall_kg),
        "wall_right": (_prism(wall, (-inner, -half)), wall_kg),
        "flap": (_prism(flap_outline, (-half, half)), p.flap_mass_kg),
    }
    return solids, density, gear_kg


def _prism(outline: Polygon, ends: tuple[float, float]) -> list[Point]:
    return [(x, y, z) for x, z in outline for y in ends]


def _gear_y(p: SlopeParameters) -> float:
    return p.side_m / 2 - p.wall_thickness_m


def _rise(p: SlopeParameters) -> float:
    return p.hinge_z_m / (2 * p.hinge_x_m)


def _pads(p: SlopeParameters) -> dict[str, tuple[Interval, ...]]:
    """Return the rails that a board lifts by, and the bars that stop its boss at their lower edges."""
    inner = SEAT.boss_side_m / 2 + p.boss_play_m
    outer = SEAT.board_width_m / 2
    rear = -SEAT.board_length_m / 2
    low = p.underside_m
    rail = low, low + p.pad_thickness_m
    back = low + p.stop_back_rise_m
    front = low + p.stop_front_rise_m
    stop_back = inner - BEVEL * p.stop_back_rise_m
    stop_front = inner - BEVEL * p.stop_front_rise_m
    return {
        "pad_left": ((rear, p.pad_front_m), (inner, outer), rail),
        "pad_right": ((rear, p.pad_front_m), (-outer, -inner), rail),
        "pad_back": ((rear, -stop_back), (-inner, inner), (back, back + p.pad_thickness_m)),
        "pad_front": (
            (stop_front, p.pad_front_m),
            (-inner, inner),
            (front, front + p.stop_thickness_m),
        ),
    }


def _show(
    builder: MachineBuilder, p: SlopeParameters, base: mujoco.MjsBody, flap: mujoco.MjsBody
) -> None:
    """Add what is only seen: base, flap, gears' teeth, a knuckle at the hinge, and a worm and motor under each gear."""
    hinge_x = p.hinge_x_m
    hinge_z = p.hinge_z_m
    builder.show(base, "base_visual", "slope_base", [0.36, 0.56, 0.76, 1.0])
    builder.show(flap, "flap_visual", "slope_flap", [0.52, 0.70, 0.86, 1.0])
    builder.show(
        base,
        "knuckle_visual",
        "",
        _DARK,
        type=mujoco.mjtGeom.mjGEOM_CYLINDER,
        pos=digits((hinge_x, 0.0, hinge_z - 0.0041)),
        size=[0.0038, digits(_gear_y(p) - p.gear_width_m / 2), 0],
        zaxis=[0, 1, 0],
    )
    x, y, z = worm_offset(p)
    for side, sign in _SIDES.items():
        gear_y = sign * _gear_y(p)
        place = digits((hinge_x + x, gear_y + sign * y, hinge_z + z))
        builder.show(base, f"worm_{side}_visual", "worm", [0.40, 0.42, 0.45, 1.0], pos=place)
        builder.show(flap, f"gear_{side}_visual", "gear", _DARK, pos=digits((0.0, gear_y, 0.0)))


def worm_offset(p: SlopeParameters) -> Point:
    """Return where the worm stands that drives a slope's left gear, from the gear's centre: below, and off the wall.

    It is only to be seen: its pitch circle, of a quarter of the gear's radius, touches that of the gear.
    """
    return 0.0, -0.325 * p.gear_radius_m, -(0.93 + 0.25) * p.gear_radius_m


def slope_looks(p: SlopeParameters) -> dict[str, list[ClosedSolid]]:
    """Return the solids of the meshes that are only seen, by name.

    The base has its origin on the floor, in its middle; the flap, unfolded, on the hinge's axis; gear and worm in the
    middle of their teeth and thread.
    """
    return {
        "slope_base": _slope_base(p),
        "slope_flap": _slope_flap(p),
        "gear": _gear(p),
        "worm": _worm(p),
    }


def _incline(p: SlopeParameters, x: float) -> float:
    """Return the height of the slope's incline at x, in the slope's frame (floor at z = 0)."""
    return p.hinge_z_m - _rise(p) * (x - p.hinge_x_m)


def _below_incline(p: SlopeParameters, start: float, end: float, gap: float) -> list[list[float]]:
    """Return the (x, z) ends of a line that runs so far under the incline."""
    return [[x, _incline(p, x) - gap] for x in (start, end)]


def _slope_base(p: SlopeParameters) -> list[ClosedSolid]:
    """Fixed wedge: incline plate on two framed side walls; origin on the floor, +x downhill."""
    back = -p.side_m / 2
    front = p.side_m / 2
    side_y = p.side_m / 2
    skin = p.skin_m + 0.0002
    face = _below_incline(p, front, back, 0.0)
    parts = [plate_xz(_below_incline(p, back, front, skin) + face, (-side_y, side_y))]
    # walls end just under the plate's face, so that the two do not flicker
    rim = 0.0005
    rail = 0.014
    wall_top = _below_incline(p, front, back, rim)
    for side in (-1, 1):
        wall = between(side * (side_y - 0.010), side * (side_y - 0.004))
        parts.append(plate_xz([[back, 0], [front, 0], *wall_top], wall))
        frame = between(side * (side_y - 0.007), side * (side_y - 0.0))
        post = between(side * (side_y - 0.007), side * (side_y - 0.001))
        parts.append(plate_xz([[back, 0], [front, 0], [front, rail], [back, rail]], frame))
        parts.append(plate_xz(_below_incline(p, back, front, rail) + wall_top, frame))
        for x in (back + 0.001, -rail / 2, front - 0.001 - rail):
            foot = [[x, 0.002], [x + rail, 0.002]]
            end = _below_incline(p, x + rail, x, rail - 0.002)
            parts.append(plate_xz(foot + end, post))
    return parts


def _slope_flap(p: SlopeParameters) -> list[ClosedSolid]:
    """Hinged wedge, unfolded, its root notched for the gears; origin on the hinge axis (along y)."""
    ground = -p.hinge_z_m
    rise = _rise(p)
    half = p.side_m / 2
    start = p.hinge_x_m - half
    end = start + p.side_m
    lip_x = (p.hinge_z_m - _LIP_M) / rise  # where the wedge is as thin as its lip

    def ring(x: float, half_y: float, bevel: float, heel: float = 0.0, sunk: float = 0.0) -> Ring:
        top = max(-rise * x, ground + _LIP_M) - sunk
        bottom = ground + heel
        low = bottom + bevel
        high = top - bevel
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
    bevels = {notch: 0.002, end - 0.02125: 0.002, lip_x: 0.0003, end: 0.0003}
    wedge = loft([ring(x, half, bevel) for x, bevel in bevels.items()])
    return [root, wedge]


def _gear(p: SlopeParameters) -> list[ClosedSolid]:
    """Toothed disc about the y axis, with a boss."""
    tip = p.gear_radius_m
    half = p.gear_width_m / 2
    root = _GEAR_ROOT * tip
    angles = []
    radii = []
    for tooth in range(_TEETH):
        for tooth_share, radius in ((0.0, root), (0.30, root), (0.45, tip), (0.80, tip)):
            angles.append((tooth + tooth_share) * 2 * np.pi / _TEETH)
            radii.append(radius)
    outline = np.column_stack(
        [np.multiply(radii, np.cos(angles)), np.multiply(radii, np.sin(angles))]
    )
    disc = plate_xz(outline, (0.0008 - half, half - 0.0008))
    inset = half - 0.001
    boss = [[0, -half], [0.0075, -half], [0.009, -inset], [0.009, inset], [0.0075, half], [0, half]]
    return [disc, turned(boss, 20)]


def _worm(p: SlopeParameters) -> list[ClosedSolid]:
    """Worm about the x axis that meshes with a gear above its middle, and the motor behind it."""
    pitch_radius = 0.25 * p.gear_radius_m
    depth = (1 - _GEAR_ROOT) / 2 * p.gear_radius_m
    pitch = np.pi * (1 + _GEAR_ROOT) * p.gear_radius_m / _TEETH
    around = np.arange(_WORM_POINTS) * (2 * np.pi / _WORM_POINTS)
    start = 0.125 * pitch  # a gap faces up where a tooth of the gear hangs lowest

    def ring(x: float, radius: ArrayLike) -> Ring:
        along = np.full(_WORM_POINTS, x)
        return np.column_stack([along, radius * np.sin(around), radius * np.cos(around)])

    places = np.linspace(-1.5, 1.5, 3 * _WORM_RINGS + 1) * pitch
    thread = []
    for x in places:
        turn = (x - start) / pitch - around / (2 * np.pi)
        thread.append(
            ring(x, pitch_radius - depth * np.clip(1.4 * np.cos(2 * np.pi * turn), -1, 1))
        )
    back = places[0]
    motor = 0.325 * p.gear_radius_m
    shaft = pitch_radius - depth
    axle = loft([ring(back - 0.004, shaft), ring(back + 0.001, shaft)])
    body = [
        ring(back - 0.034, motor - 0.001),
        ring(back - 0.033, motor),
        ring(back - 0.004, motor),
        ring(back - 0.003, motor - 0.001),
    ]
    return [loft(thread), axle, loft(body)]
