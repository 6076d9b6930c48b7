"""The mecanum smartcar with a lifting board, on either drive.

Frame: origin on the floor between the wheels, x forward, y left, z up. Seen from above the upper rollers point at the
car's centre (X arrangement). Four motors turn its wheels, and friction on the ground drives it. With the drive
``rollers`` each wheel bears ten free rollers. With ``wheels`` it has one tyre, whose friction acts along the roller
that would touch (craftsim/models/wheel_contacts.py).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any, Final

import mujoco
import numpy as np

from craftsim.discrete.drawing import car_colour
from craftsim.mjcf.building import (
    CORNERS,
    SEEN_GROUP,
    TOUCHES,
    MachineBuilder,
    Pose,
    both,
    digits,
    dry_friction,
    friction,
    set_inertia,
    surface,
)
from craftsim.mjcf.machines import Machines
from craftsim.mjcf.parameters import ContactParameters, SmartcarParameters
from craftsim.mjcf.solids import ClosedSolid, Point, between, box, loft, rectangle, square, turned

WHEELS: Final = tuple(f"wheel_{corner}" for corner in CORNERS)
"""Order of everything that is given per wheel: front left, front right, rear left, rear right."""
_ROLLER_GAP_M: Final = 0.0002
"""What comes so near to a roller is listed as a contact before it touches (craftsim/models/effects.py)."""
_WELL_GAP_M: Final = 0.0034
"""Between a wheel and its well."""
TYRE: Final = 0.47470
"""The first of a tyre's ``user`` numbers in a model, by which it is known."""
SIDE, ACROSS, HALF_WIDTH, N_USER = 1, 2, 3, 4
"""The places of the others, and how many there are: to which side its rollers turn, +1 or -1, the coefficient of
friction across them, and half the width of the tread."""
_TYRE_SOLMIX: Final = 1e6
"""So much more than that of other geoms that it decides alone."""
_FLANK_SHARE: Final = 0.9
"""Of a wheel's radius: its flanks touch nothing that the tread rolls on."""
_BLACK: Final = [0.13, 0.13, 0.14, 1.0]
_HUB_RGBA: Final = [0.30, 0.31, 0.33, 1.0]


def _wheel_inertia(car: SmartcarParameters) -> Point:
    """Return the inertia of a wheel, a solid cylinder about y."""
    tumble = car.wheel_mass_kg * (3 * car.wheel_radius_m**2 + car.wheel_width_m**2) / 12
    return tumble, car.wheel_spin_inertia_kgm2, tumble


def _hub_inertia(car: SmartcarParameters) -> Point:
    """Return the inertia of a solid cylinder about y less a wheel's rollers, ellipsoids at 45 degrees to the axle."""
    n, m, radius = car.rollers_per_wheel, car.roller_mass_kg, car.wheel_radius_m
    along = 0.4 * m * car.roller_radius_m**2
    across = 0.2 * m * (car.roller_radius_m**2 + car.roller_half_length_m**2)
    offset = m * (radius - car.roller_radius_m) ** 2
    about_axle = (along + across) / 2
    cylinder, cylinder_spin, _ = _wheel_inertia(car)
    spin = cylinder_spin - n * (about_axle + offset)
    tumble = cylinder - n * ((along + 2 * across - about_axle) + offset) / 2
    return tumble, spin, tumble


def _second_moments(outline: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Return the means of x^2 and z^2 over a polygon about its centroid (shoelace formulas)."""
    area = sx = sz = sxx = szz = 0.0
    for (x0, z0), (x1, z1) in zip(outline, [*outline[1:], outline[0]], strict=True):
        cross = x0 * z1 - x1 * z0
        area += cross / 2
        sx += (x0 + x1) * cross / 6
        sz += (z0 + z1) * cross / 6
        sxx += (x0 * x0 + x0 * x1 + x1 * x1) * cross / 12
        szz += (z0 * z0 + z0 * z1 + z1 * z1) * cross / 12
    return sxx / area - (sx / area) ** 2, szz / area - (sz / area) ** 2


def _chassis_inertia(car: SmartcarParameters) -> Point:
    """Return the inertia of the chassis about its centre: that of its solid hull."""
    half, cut = car.chassis_length_m / 2, car.chassis_chamfer_m
    bottom, top = car.chassis_bottom_m, car.chassis_top_m
    sides = [
        (-half, bottom + cut),
        (cut - half, bottom),
        (half - cut, bottom),
        (half, bottom + cut),
    ]
    xx, zz = _second_moments([*sides, (half, top), (-half, top)])
    yy, m = car.chassis_width_m**2 / 12, car.chassis_mass_kg
    return m * (yy + zz), m * (xx + zz), m * (xx + yy)


def _levels(*rings: Point) -> list[Point]:
    """Return the corners of level rectangles about the z axis: half length, half width and height of each."""
    return [(sx * x, sy * y, z) for x, y, z in rings for sx in (-1, 1) for sy in (-1, 1)]


def _hull(car: SmartcarParameters) -> list[Point]:
    half, side, cut = car.chassis_length_m / 2, car.chassis_width_m / 2, car.chassis_chamfer_m
    bottom, top = (car.wheel_radius_m + z for z in (car.chassis_bottom_m, car.chassis_top_m))
    return _levels((half, side, bottom + cut), (half, side, top), (half - cut, side, bottom))


def _boss(car: SmartcarParameters) -> list[Point]:
    """Return the corners of the bevelled boss, over the board's upper face, on which it stands 1 mm deep."""
    foot, top = car.boss_side_m / 2, car.boss_top_side_m / 2
    return _levels((foot, foot, -0.001), (foot, foot, 0.0), (top, top, car.boss_height_m))


def add_car(
    spec: mujoco.MjSpec,
    prefix: str,
    pose: Pose,
    machines: Machines,
    number: int = 0,
    visual: bool = True,
) -> None:
    """Add a smartcar to a spec; ``prefix`` begins the names of its parts, its number decides its parameters and colour.

    ``visual`` is whether it has what is only seen, and its camera.
    """
    car, contact = machines.car(number), machines.contact
    of_solid = {**TOUCHES["hulls"], **surface(contact, car.chassis_friction)}
    of_solid |= {"rgba": [0.75, 0.25, 0.25, 0.4]}
    builder = MachineBuilder(spec, prefix, "smartcar", visual, looks, car, **of_solid)
    body = builder.body(pose)
    body.sleep = mujoco.mjtSleepPolicy.mjSLEEP_ALLOWED
    # Its hull has no mass of its own.
    builder.add_hull(body, builder.solid, "hull", _hull(car), mass=0)
    axles = [0, 0, car.wheel_radius_m]
    builder.show(body, "chassis_visual", "chassis", [*car_colour(number), 1.0], pos=axles)
    builder.show(body, "chassis_trim", "chassis_trim", [0.95, 0.95, 0.98, 1.0], pos=axles)
    if visual:
        nose, pitch = car.chassis_length_m / 2 + car.camera_proud_m, car.camera_pitch_rad
        body.add_camera(
            name=f"{prefix}front",
            pos=digits((nose, 0.0, car.wheel_radius_m + car.camera_z_m)),
            xyaxes=digits((0.0, -1.0, 0.0, -math.sin(pitch), 0.0, math.cos(pitch))),
            fovy=digits(math.degrees(car.camera_fovy_rad)),
        )
    # Inertia of the solid hull about its own centre, at the centre of mass.
    set_inertia(
        body, car.wheel_radius_m + car.chassis_com_m, car.chassis_mass_kg, _chassis_inertia(car)
    )
    if machines.drive == "rollers":
        _add_rollers(builder, body, contact)
    else:
        _add_tyres(builder, body, contact)
    _add_board(builder, body, contact)


def _places(car: SmartcarParameters) -> Iterator[tuple[str, int, list[float]]]:
    """Yield of each wheel its corner, the side to which its rollers turn, and its place."""
    for corner, (x, y) in CORNERS.items():
        yield corner, x * y, [x * car.wheel_x_m, y * car.wheel_y_m, car.wheel_radius_m]


def _add_guard(
    builder: MachineBuilder,
    body: mujoco.MjsBody,
    corner: str,
    share: float,
    touches: str,
    **where: Any,
) -> None:
    """Add a wheel's envelope, of a share of its radius; it is round, so that it need not turn."""
    car, kind = builder.parameters, mujoco.mjtGeom.mjGEOM_CYLINDER
    size = [*digits((share * car.wheel_radius_m, car.wheel_width_m / 2)), 0]
    guard = builder.geoms("guard", type=kind, size=size, mass=0, **TOUCHES[touches])
    builder.add(body, guard, f"guard_{corner}", zaxis=[0, 1, 0], **where)


def _add_rollers(builder: MachineBuilder, body: mujoco.MjsBody, contact: ContactParameters) -> None:
    """Add four wheels of free rollers with their motors."""
    car: SmartcarParameters = builder.parameters
    roller = builder.geoms(
        "roller",
        type=mujoco.mjtGeom.mjGEOM_ELLIPSOID,
        size=[car.roller_radius_m, car.roller_radius_m, car.roller_half_length_m],
        mass=car.roller_mass_kg,
        group=SEEN_GROUP,
        gap=_ROLLER_GAP_M,
        friction=friction(contact, car.roller_friction),
        rgba=_BLACK,
        **TOUCHES["wheels"],
    )
    dry, out = dry_friction(contact), digits(car.roller_radius_m - car.wheel_radius_m)
    for corner, side, place in _places(car):
        mass = digits(car.wheel_mass_kg - car.rollers_per_wheel * car.roller_mass_kg)
        wheel = _add_wheel(builder, body, contact, corner, place, mass, _hub_inertia(car))
        _add_guard(builder, wheel, corner, 1.0, "guards")
        for number in range(car.rollers_per_wheel):
            name = f"roller_{corner}{number:02}"
            spoke = wheel.add_frame(euler=[0, number * digits(math.tau / car.rollers_per_wheel), 0])
            bearing = spoke.add_body(
                name=builder.prefix + name, pos=[0, 0, out], zaxis=[1, -side, 0]
            )
            # A plain bearing: without its dry friction a car perched on two rollers would roll away.
            bearing.add_joint(
                name=builder.prefix + name,
                axis=[0, 0, 1],
                damping=[car.roller_damping_nms_rad, 0, 0],
                frictionloss=car.roller_bearing_friction_nm,
                **dry,
            )
            builder.add(bearing, roller, name)
    _add_wheel_motors(builder)


def _add_tyres(builder: MachineBuilder, body: mujoco.MjsBody, contact: ContactParameters) -> None:
    """Add four wheels with one tyre each, and their motors."""
    car: SmartcarParameters = builder.parameters
    tyre = builder.geoms(
        "tyre",
        type=mujoco.mjtGeom.mjGEOM_SPHERE,
        size=[car.wheel_radius_m, 0, 0],
        mass=0,
        friction=friction(contact, car.roller_friction),
        solref=[car.tyre_time_constant_s, contact.damping_ratio],
        solmix=_TYRE_SOLMIX,
        **TOUCHES["wheels"],
    )
    seen = {
        "type": mujoco.mjtGeom.mjGEOM_CYLINDER,
        "size": [*digits((0.97 * car.wheel_radius_m, car.wheel_width_m / 2)), 0],
        "zaxis": [0, 1, 0],
    }
    inertia = _wheel_inertia(car)
    for corner, side, place in _places(car):
        wheel = _add_wheel(builder, body, contact, corner, place, car.wheel_mass_kg, inertia)
        builder.show(wheel, f"tread_{corner}", "", _BLACK, **seen)
        # On the chassis: MuJoCo looks at pairs of bodies first, of which there are fewer then.
        _add_guard(builder, body, corner, _FLANK_SHARE, "flanks", pos=place)
        numbers = [TYRE, -side, *digits((car.friction_across, car.wheel_width_m / 2))]
        builder.add(wheel, tyre, f"tyre_{corner}", userdata=numbers)
    _add_wheel_motors(builder)


def _add_wheel(
    builder: MachineBuilder,
    body: mujoco.MjsBody,
    contact: ContactParameters,
    corner: str,
    place: list[float],
    mass_kg: float,
    inertia_kgm2: Point,
) -> mujoco.MjsBody:
    """Add a wheel on its hinge, without what touches the ground."""
    car: SmartcarParameters = builder.parameters
    name = f"{builder.prefix}wheel_{corner}"
    wheel = body.add_body(name=name, pos=place)
    set_inertia(wheel, 0.0, mass_kg, inertia_kgm2)
    # The gear's dry friction holds a loaded car on the slope without power.
    wheel.add_joint(
        name=name,
        axis=[0, 1, 0],
        frictionloss=car.gear_friction_nm,
        damping=[car.wheel_damping_nms_rad, 0, 0],
        armature=car.wheel_armature_kgm2,
        **dry_friction(contact),
    )
    builder.show(wheel, f"hub_{corner}", "wheel_hub", _HUB_RGBA)
    return wheel


def _add_wheel_motors(builder: MachineBuilder) -> None:
    """Add the motors of the wheels: their commands are speeds."""
    car: SmartcarParameters = builder.parameters
    for wheel in WHEELS:
        name = builder.prefix + wheel
        motor = builder.spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        motor.set_to_velocity(kv=car.wheel_gain_nms_rad)
        motor.ctrlrange = both(car.wheel_speed_rad_s)
        motor.forcerange = both(car.wheel_torque_nm)


def _add_board(builder: MachineBuilder, body: mujoco.MjsBody, contact: ContactParameters) -> None:
    """Add the board, whose frame is the upper face of its plate, and its motor."""
    car: SmartcarParameters = builder.parameters
    name = f"{builder.prefix}board"
    board = body.add_body(name=name, pos=digits((0.0, 0.0, car.board_rest_m)))
    board.add_joint(
        name=name,
        type=mujoco.mjtJoint.mjJNT_SLIDE,
        axis=[0, 0, 1],
        range=[0, car.board_travel_m],
        armature=car.board_armature_kg,
        damping=[car.board_damping_ns_m, 0, 0],
        frictionloss=car.screw_friction_n,
    )
    of_board = {"friction": friction(contact, car.board_friction), "rgba": [0.85, 0.85, 0.83, 0.4]}
    facing = builder.geoms("board", **of_board)
    half = car.board_length_m / 2, car.board_width_m / 2, car.board_thickness_m / 2
    plate = {
        "type": mujoco.mjtGeom.mjGEOM_BOX,
        "pos": [0, 0, -digits(half[2])],
        "size": digits(half),
    }
    builder.add(board, facing, "plate", mass=car.board_mass_kg, **plate)
    slips = friction(contact, car.boss_friction)
    builder.add_hull(board, facing, "boss", _boss(car), mass=0, friction=slips)
    builder.show(board, "board_visual", "board", [0.85, 0.85, 0.83, 1.0])
    builder.show(board, "board_pads", "board_pads", [0.15, 0.15, 0.15, 1.0])
    builder.show(board, "lift_post", "lift_post", [0.50, 0.52, 0.55, 1.0])
    # A lead screw.
    limits = car.board_speed_m_s, car.board_force_n, car.board_travel_m
    builder.add_drive("board", car.board_stiffness_n_m, car.board_gain_ns_m, *limits)


def looks(car: SmartcarParameters) -> dict[str, list[ClosedSolid]]:
    """Return the solids of the meshes that are only seen, by name.

    The chassis and its trim have their origin on the axle line, midway; a hub in its middle; board, pads and post in
    the middle of the plate's upper face.
    """
    makers = _chassis, _chassis_trim, _wheel_hub, _board, _board_pads, _lift_post
    return {make.__name__.removeprefix("_"): make(car) for make in makers}


def _well_radius(car: SmartcarParameters) -> float:
    return car.wheel_radius_m + _WELL_GAP_M


def _well_inner_y(car: SmartcarParameters) -> float:
    """Return where the wells begin: just inside the wheels' inner faces."""
    return car.wheel_y_m - car.wheel_width_m / 2 - 0.0025


def _chassis(car: SmartcarParameters) -> list[ClosedSolid]:
    """Body with wheel arches and a bumper at either end; origin on the axle line, midway."""
    bottom, top = car.chassis_bottom_m, car.chassis_top_m
    half, inner_y, chamfer = car.chassis_length_m / 2, _well_inner_y(car), car.chassis_chamfer_m
    bumper, bevel = 0.002, 0.004

    nose = half - bumper
    side = (
        (nose - chamfer, bottom),
        (nose, bottom + chamfer),
        (nose, top - bevel),
        (nose - bevel, top),
    )
    body = loft([rectangle((-x, x), (-inner_y, inner_y), z) for x, z in side])
    strip = half - 0.006
    strips = [
        box((x - 0.006, x + 0.006), (-0.056, 0.056), (0.004, 0.022), bumper)
        for x in (-strip, strip)
    ]
    return [body, *strips, *_arches(car)]


def _arches(car: SmartcarParameters) -> list[ClosedSolid]:
    """What is left of the chassis beside the wheels: a column between them and a corner above each."""
    bottom, top, well, axle = (
        car.chassis_bottom_m,
        car.chassis_top_m,
        _well_radius(car),
        car.wheel_x_m,
    )
    low = min(0.0, bottom)
    heights = np.array(
        [low, 0.75 * low, 0.375 * low, 0.0, 0.3 * top, 0.5 * top, 0.7 * top, 0.88 * top, top]
    )
    half_well = np.sqrt(np.maximum(well**2 - heights**2, 0.0))
    column_half = np.maximum(axle - half_well, 0.001)
    parts = []
    end = car.chassis_length_m / 2 - 0.001
    corner_z = np.array([0.37 * top, 0.52 * top, 0.7 * top, 0.88 * top, top])
    corner_start = axle + np.sqrt(np.maximum(well**2 - corner_z**2, 0.0))
    inside = corner_start < end + 0.001
    outer, inner = car.chassis_width_m / 2, _well_inner_y(car)
    for y in ((-outer, -inner), (inner, outer)):
        parts.append(
            loft([rectangle((-h, h), y, z) for h, z in zip(column_half, heights, strict=True)])
        )
        for side in (-1, 1):
            rings = [
                rectangle((start, end) if side > 0 else (-end, -start), y, z)
                for start, z in zip(corner_start[inside], corner_z[inside], strict=True)
            ]
            if len(rings) > 1:
                parts.append(loft(rings))
    return parts


def _chassis_trim(car: SmartcarParameters) -> list[ClosedSolid]:
    """Lamps at the front and a stripe on each flank: a second colour over the chassis."""
    front, half_y, top = car.chassis_length_m / 2, car.chassis_width_m / 2, car.chassis_top_m
    ahead, lamp = (front - 0.010, front - 0.0012), (top - 0.022, top - 0.010)
    lamps = [box(ahead, (y - 0.011, y + 0.011), lamp, 0.002) for y in (-0.042, 0.042)]
    stripe = top - 0.0095, top - 0.0035
    flanks = [box((-0.036, 0.036), (y - 0.0004, y + 0.0004), stripe) for y in (-half_y, half_y)]
    return [*lamps, *flanks]


def _wheel_hub(car: SmartcarParameters) -> list[ClosedSolid]:
    """Two spoked side plates and the axle boss of a mecanum wheel about the y axis."""
    half = car.wheel_width_m / 2
    rim = car.wheel_radius_m - 0.0111
    bevelled = half - 0.0015
    axle = [
        [0, -half],
        [0.010, -half],
        [0.0115, -bevelled],
        [0.0115, bevelled],
        [0.010, half],
        [0, half],
    ]
    parts = [turned(axle, 16)]
    for y in (-1, 1):
        inner, outer = between(y * (half - 0.004), y * (half - 0.0007))
        hub = rim - 0.010
        parts.append(
            turned([[hub, inner], [rim, inner], [rim, outer], [hub, outer], [hub, inner]], 30)
        )
        for angle in np.arange(5) * (2 * np.pi / 5):
            spoke = box((0.009, rim - 0.0085), (inner, outer), (-0.0035, 0.0035))
            parts.append(spoke.rolled(angle, about_y=True))
    return parts


def _board(car: SmartcarParameters) -> list[ClosedSolid]:
    """Lifting plate with the boss that seats in what it lifts; origin at the middle of the plate's top."""
    half_x, half_y, thickness = car.board_length_m / 2, car.board_width_m / 2, car.board_thickness_m
    plate = box((-half_x, half_x), (-half_y, half_y), (-thickness, 0.0), min(0.001, thickness / 3))
    foot, top = car.boss_side_m, car.boss_top_side_m
    boss = loft([square(foot, -0.001), square(foot, 0.0), square(top, car.boss_height_m)])
    return [plate, boss]


def _board_pads(car: SmartcarParameters) -> list[ClosedSolid]:
    """Rubber strips along the edges of the lifting plate and across its boss, 0.6 mm proud."""
    x_edge, y_edge = car.board_length_m / 2 - 0.017, car.board_width_m / 2 - 0.008
    y_boss = car.boss_side_m / 2 - 0.009
    edge = [
        box((x - 0.009, x + 0.009), (-y_edge, y_edge), (-0.001, 0.0006)) for x in (-x_edge, x_edge)
    ]
    height = car.boss_height_m
    on_top = height - 0.002, height + 0.0006
    boss = [box((x - 0.006, x + 0.006), (-y_boss, y_boss), on_top) for x in (-0.030, 0.0, 0.030)]
    return [*edge, *boss]


def _lift_post(car: SmartcarParameters) -> list[ClosedSolid]:
    """Column under the lifting plate that slides in the chassis, 7 mm longer than the board's travel."""
    bottom = -car.board_travel_m - 0.007
    post = box((-0.020, 0.020), (-0.020, 0.020), (bottom, -0.002))
    ribs = [box((-0.026, 0.026), (y - 0.003, y + 0.003), (bottom, -0.002)) for y in (-0.012, 0.012)]
    return [post, *ribs]
