"""Dimensions, masses and limits of the machines, each with its origin: the one place of every parameter.

Each is *published* (the robot description files that accompany the CraftEnv paper; where they contradict themselves the
note says what was chosen and why), *derived* (from published ones, with the arithmetic) or *assumed* (ours, with the
reason). SI units, at the end of the name. A record raises InputError, naming the parameter, for what cannot work.
"""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import field, fields
from functools import partial
from typing import Annotated, Any, Final, Literal, get_args

from pydantic import ValidationInfo, field_validator

from craftsim.discrete.geometry import CELL_PITCH_M, INCLINE_RAD, LEVEL_HEIGHT_M
from craftsim.storage.limits import Range
from craftsim.storage.records import record

Origin = Literal["published", "derived", "assumed"]

GRAVITY: Final = 9.81
"""m/s^2: MuJoCo's default."""
REACH: Final = 1e6
"""By what factor a parameter may be larger or smaller than its nominal value, where nothing narrower is declared:
beyond it arithmetic ends before physics does."""


Positive = Annotated[float, Range(0.0, above=True)]
Impedance = Annotated[float, Range(0.0, 0.9999, above=True)]
Friction = Annotated[float, Range(0.0, 3.0, above=True)]
Pitch = Annotated[float, Range(-math.pi / 2, math.pi / 2, above=True)]


def _parameter(
    origin: Origin, value: float, note: str = "", fixed: str = "", means: str = ""
) -> Any:
    """Declare a field: where its default comes from, with a note, why nothing else is possible, and what it means where
    its name does not say so."""
    metadata = {"origin": origin, "note": note, "fixed": fixed, "means": means}
    return field(default=value, metadata=metadata)


published, derived, assumed = (partial(_parameter, origin) for origin in get_args(Origin))


class NearNominal:
    """A record of numbers, none of which may be of another order than its nominal value; fixed ones are equal to it."""

    @field_validator("*")
    @classmethod
    def _near(cls, value: float, info: ValidationInfo) -> float:
        declared = next(item for item in fields(cls) if item.name == info.field_name)  # type: ignore[arg-type]
        nominal: Any = declared.default
        reason = declared.metadata.get("fixed")
        if reason and value != nominal:
            raise ValueError(f"cannot be changed from {nominal:.6g}: {reason}")
        smallest = abs(nominal) / REACH
        largest = abs(nominal) * REACH
        if value and not smallest <= abs(value) <= largest:
            raise ValueError(f"must be from {smallest:g} to {largest:g}, not {value!r}")
        return value


def digest_of(values: dict[str, Any]) -> str:
    """Return the SHA-256, in hexadecimal, of nested values by name; an integer counts as the number that it equals."""
    plain = json.loads(json.dumps(values), parse_int=float)
    return hashlib.sha256(json.dumps(plain, sort_keys=True).encode()).hexdigest()


CLEARANCE_M: Final = 0.0005
"""What must be left between chassis and slope."""
_PLATE_GAP_M: Final = 0.0002
"""What must be left between the wheels and the plate of a lowered board."""

_SEAT: Final = "the pockets of blocks and the pads of slopes fit this board and its boss"
_GRID: Final = "the grid's cells and levels have this size"
_SHAPE: Final = "the boards and bosses of all cars fit this shape"


@record()
class SmartcarParameters(NearNominal):
    """The mecanum smartcar. Heights are above the axle line unless the name says floor.

    Example:
        >>> import craftsim
        >>> round(craftsim.SmartcarParameters().mass_kg, 1)
        10.3
    """

    wheel_radius_m: Positive = published(
        0.0496, "the mesh; the cylinder's 0.043 would ground on a crest"
    )
    wheel_width_m: Positive = published(0.043, "the mesh; the collision cylinder has 0.040")
    wheel_x_m: Positive = published(0.060, "half the wheelbase")
    wheel_y_m: Positive = published(0.083, "half the track")
    wheel_mass_kg: Positive = published(2.3, "each, rollers included")
    rollers_per_wheel: int = assumed(
        10,
        "the fewest with which the envelope's ripple stays far below 0.5 mm",
        fixed="the ellipsoids of the rollers are made for ten a wheel",
    )
    roller_radius_m: Positive = assumed(0.009, "what fits ten rollers on the published wheel")
    roller_half_length_m: Positive = derived(
        0.0302, "of least ripple, 0.063 mm, which was found numerically"
    )
    roller_mass_kg: Positive = assumed(
        0.03, "a rubber barrel of this size; part of the wheel's mass"
    )
    roller_bearing_friction_nm: Positive = assumed(
        0.004, "friction 0.1 under a quarter car (25 N), 3 mm pin"
    )
    roller_damping_nms_rad: Positive = assumed(
        0.00002, "grease: a thousandth of dry friction at 0.2 rad/s"
    )
    roller_friction: Friction = assumed(
        0.8, "rubber on plastic, wood or concrete: handbooks give 0.6 to 1.0"
    )
    tyre_time_constant_s: Annotated[float, Range(0.0, 0.1, above=True)] = assumed(
        0.02,
        "a quarter of the car presses it in by 0.095 mm, as by Hertz rollers of polyurethane of 90 MPa",
        means="softness of the tyres",
    )
    chassis_length_m: Positive = published(0.220)
    chassis_width_m: Positive = published(0.167)
    chassis_bottom_m: Annotated[float, Range(high=0.0)] = published(
        -0.040, means="lower face, above the axles"
    )
    chassis_top_m: Positive = published(0.050, means="upper face, above the axles")
    chassis_chamfer_m: Positive = assumed(
        0.025, "published without figure; keeps off the foot of a slope"
    )
    chassis_mass_kg: Positive = published(1.0)
    chassis_com_m: float = published(-0.025, "height of the chassis' centre of mass")
    chassis_friction: Friction = assumed(0.3, "painted metal against plastic")
    board_top_m: Positive = published(
        0.053,
        "read as the upper face: the plate lies on the chassis' top",
        means="upper face of the lowered board, above the axles",
    )
    board_length_m: float = published(0.194, fixed=_SEAT)
    board_width_m: float = published(0.200, fixed=_SEAT)
    board_thickness_m: Positive = published(0.003)
    board_mass_kg: Positive = published(0.1)
    board_travel_m: Positive = published(0.045, means="stroke of the lift")
    board_speed_m_s: Positive = published(0.05, means="top speed of the lift")
    board_force_n: Positive = assumed(
        80.0,
        "seven times the heaviest load; no published figure",
        means="largest force of the lift",
    )
    board_stiffness_n_m: Positive = assumed(20_000.0, "position loop: a slope's 11 N sag by 0.5 mm")
    board_gain_ns_m: Positive = assumed(
        400.0, "velocity loop: damps the load, 2 sqrt(20000 N/m x 2 kg)"
    )
    board_armature_kg: Positive = assumed(
        2.0, "the motor's rotor behind the lead screw, seen from the board"
    )
    board_damping_ns_m: Positive = assumed(20.0, "grease on the screw: 1 N at the published speed")
    screw_friction_n: Positive = assumed(
        1.0, "dry friction of screw and guide: the board's own weight"
    )
    board_friction: Friction = assumed(0.8, "rubber facing under plastic, as the rollers")
    boss_side_m: float = published(0.11, "at its foot", fixed=_SEAT)
    boss_top_side_m: float = assumed(
        0.100, "bevels are published without a figure: 45 degrees", fixed=_SEAT
    )
    boss_height_m: float = published(0.005, fixed=_SEAT)
    boss_friction: Friction = assumed(
        0.3, "bare metal, as the chassis: it guides and does not hold"
    )
    wheel_torque_nm: Positive = assumed(
        2.5,
        "three times what a loaded climb at 16 degrees needs",
        means="largest torque of a motor at its wheel",
    )
    wheel_speed_rad_s: Positive = assumed(
        20.0, "about 1 m/s; no published figure", means="top speed of a wheel"
    )
    wheel_gain_nms_rad: Positive = assumed(
        4.0,
        "droops by 0.11 rad/s; stiffer axles fight on a crest",
        means="velocity loop of a motor",
    )
    wheel_armature_kgm2: Positive = assumed(
        0.01,
        "a rotor of 4e-6 kg m^2, times its gear of 50 squared",
        means="inertia of a motor at its wheel",
    )
    wheel_damping_nms_rad: Positive = assumed(
        0.002, "oil in the gear: 0.04 Nm at full speed", means="viscous friction of a gear"
    )
    gear_friction_nm: Positive = assumed(
        0.45,
        "holds at rest: 0.38 keep a car with a slope on the incline",
        means="dry friction of motor and gear at a wheel",
    )
    line_reach_m: Annotated[float, Range(0.0, 0.06)] = assumed(
        0.020,
        "to each side, of a row of reflex sensors in the middle of each edge of the board; blocks and slopes bear a "
        "printed cross below. The published car has none: 0 is a car without",
        means="range of the line sensors",
    )
    camera_proud_m: Positive = assumed(
        0.003,
        "a lens so much before the nose; its few grams are left out",
        means="lens before the nose",
    )
    camera_z_m: float = assumed(
        0.030,
        "between board and chamfer: it sees between the legs of a block",
        means="lens above the axles",
    )
    camera_pitch_rad: Pitch = assumed(
        -0.1, "upwards; sees floor from 0.1 m, one level up from 0.2 m"
    )
    camera_fovy_rad: Annotated[float, Range(0.0, 2.8, above=True)] = assumed(
        1.17, "vertical field of view: the 67 degrees of a Raspberry Pi Camera Module 3 Wide"
    )

    def __post_init__(self) -> None:
        _check_car(self)

    @property
    def mass_kg(self) -> float:
        """Mass of the whole car."""
        return self.chassis_mass_kg + 4 * self.wheel_mass_kg + self.board_mass_kg

    @property
    def wheel_spin_inertia_kgm2(self) -> float:
        """Inertia of a wheel about its axle: a solid cylinder, m r^2 / 2; the published 6.64e-3 is another wheel's."""
        return 0.5 * self.wheel_mass_kg * self.wheel_radius_m**2

    @property
    def wheel_inertia_kgm2(self) -> float:
        """Inertia of a wheel and its motor about the axle."""
        return self.wheel_spin_inertia_kgm2 + self.wheel_armature_kgm2

    @property
    def spin_mass_kg(self) -> float:
        """What the spin of the four wheels and their motors adds to the car's inertia, as a mass."""
        return 4 * self.wheel_inertia_kgm2 / self.wheel_radius_m**2

    @property
    def friction_across(self) -> float:
        """Friction coefficient of a wheel across its roller: what the bearing takes under a quarter of the car."""
        quarter_n = self.mass_kg * GRAVITY / 4
        return self.roller_bearing_friction_nm / (self.roller_radius_m * quarter_n)

    @property
    def turn_radius_m(self) -> float:
        """Half the wheelbase plus half the track: the lever by which wheel speed turns the car."""
        return self.wheel_x_m + self.wheel_y_m

    @property
    def board_rest_m(self) -> float:
        """Height of the board's upper face above the floor when it is down."""
        return self.wheel_radius_m + self.board_top_m


def require(holds: bool, message: str) -> None:
    """Raise ValueError with a message unless a condition holds."""
    if not holds:
        raise ValueError(message)


def over_crest_m(car: SmartcarParameters) -> float:
    """Return what is left between chassis and crest: astride it each axle's ground falls by half the incline, seen from
    the car."""
    half_turn = INCLINE_RAD / 2
    below_m = car.wheel_x_m * math.tan(half_turn) - car.chassis_bottom_m
    return car.wheel_radius_m / math.cos(half_turn) - below_m


def _check_car(car: SmartcarParameters) -> None:
    """Raise ValueError, naming the parameter, for a car that does not fit together or grounds on a slope."""
    radius = car.wheel_radius_m
    bottom = car.chassis_bottom_m
    top = car.chassis_top_m
    x = car.wheel_x_m
    y = car.wheel_y_m
    com = car.chassis_com_m
    half = car.chassis_length_m / 2
    chamfer = car.chassis_chamfer_m
    require(x > radius, f"wheel_x_m must be above the wheel's radius, {radius:g}, not {x:g}")
    require(y > car.wheel_width_m / 2, f"wheel_y_m must be above half a wheel's width, not {y:g}")
    require(
        bottom < com < top, f"chassis_com_m must lie between {bottom:g} and {top:g}, not at {com:g}"
    )
    room = min(half, top - bottom)
    require(chamfer < room, f"chassis_chamfer_m must be below {room:g}, not {chamfer:g}")
    under = max(top, radius + _PLATE_GAP_M) + car.board_thickness_m
    require(
        car.board_top_m >= under - 1e-9,
        f"board_top_m is {car.board_top_m:g}; at least {under:.4f} keeps the plate above chassis and wheels",
    )
    largest = radius / 2
    require(
        car.roller_radius_m < largest,
        f"roller_radius_m must be below half the wheel's, {largest:g}",
    )
    smallest = 2 * car.rollers_per_wheel * car.roller_mass_kg
    require(
        car.wheel_mass_kg > smallest,
        f"wheel_mass_kg must be above {smallest:g}, twice its rollers'",
    )
    torque = car.wheel_torque_nm
    friction = car.gear_friction_nm
    require(
        torque > friction,
        f"wheel_torque_nm is {torque:g} and must be above gear_friction_nm, {friction:g}, to turn the wheel",
    )
    half_turn = INCLINE_RAD / 2
    smallest = (x * math.tan(half_turn) - bottom + CLEARANCE_M) * math.cos(half_turn)
    require(
        over_crest_m(car) > CLEARANCE_M,
        f"wheel_radius_m is {radius:g}: the chassis would ground on the crest of a slope; at least {smallest:.4f} with "
        f"this wheelbase and chassis_bottom_m",
    )
    # At the foot, as the front wheels touch the incline, the two lower corners of the nose are beyond it.
    touch = x + radius * math.tan(half_turn)
    for along, z in ((half - chamfer, bottom), (half, bottom + chamfer)):
        ground = max(0.0, along - touch) * math.tan(INCLINE_RAD)
        require(
            radius + z - ground > CLEARANCE_M,
            f"chassis_length_m is {car.chassis_length_m:g}: the nose would run into the foot of a slope; shorten it, "
            f"or enlarge wheel_x_m or chassis_chamfer_m",
        )


@record()
class BlockParameters(NearNominal):
    """The block: a table with a deck and four legs. Flag and wall have the same shape.

    Example:
        >>> import craftsim
        >>> craftsim.BlockParameters(deck_mass_kg=1.0).mass_kg
        1.004
    """

    side_m: Annotated[float, Range(0.32, 0.3222)] = published(
        0.32, "from the legs' outer faces to a gap of 0.3 mm between neighbours"
    )
    height_m: float = derived(
        LEVEL_HEIGHT_M, "one level; the published 0.187 and 0.1905 do not stack", fixed=_GRID
    )
    leg_side_m: float = published(0.025, fixed=_SHAPE)
    leg_offset_m: float = published(0.1475, fixed=_SHAPE)
    underside_m: float = published(
        0.1155, "top of the legs; the deck's box starts 3 mm higher", fixed=_SHAPE
    )
    deck_mass_kg: Positive = published(0.5, means="deck and frame")
    leg_mass_kg: Positive = published(0.001, means="each leg")
    pocket_side_m: float = assumed(
        0.1102, "0.1 mm of play on each side, by which a load wanders", fixed=_SHAPE
    )
    pocket_depth_m: float = assumed(0.006, "the boss' height and 1 mm", fixed=_SHAPE)
    frame_relief_m: float = assumed(
        0.0002, "the side bars, so much higher, only stop the boss", fixed=_SHAPE
    )
    foot_radius_m: float = assumed(
        0.005, "at the legs' outer corners: one point of contact each", fixed=_SHAPE
    )
    foot_proud_m: float = assumed(0.0005, "by so much the feet stand below the legs", fixed=_SHAPE)
    foot_friction: Friction = assumed(
        0.8, "rubber; with 0.4 a car on top shoves its block by millimetres"
    )
    friction: Friction = assumed(
        0.4, "moulded plastic on plastic, wood or concrete: handbooks, 0.3 to 0.5"
    )

    @property
    def mass_kg(self) -> float:
        """Mass of the whole block."""
        return self.deck_mass_kg + 4 * self.leg_mass_kg


@record()
class SlopeParameters(NearNominal):
    """The foldable slope: a hollow base wedge, and a flap on a motorised hinge.

    Example:
        >>> import craftsim
        >>> craftsim.SlopeParameters(hinge_speed_rad_s=1.0).hinge_speed_rad_s
        1.0
    """

    side_m: float = published(
        0.32, "the visual mesh; the collision meshes' 0.34 overlap", fixed=_GRID
    )
    hinge_x_m: float = derived(
        CELL_PITCH_M / 2, "on the cell's border, to cover the base", fixed=_GRID
    )
    hinge_z_m: float = derived(
        LEVEL_HEIGHT_M / 2, "half a level; the published 0.095 stands proud", fixed=_GRID
    )
    incline_rad: float = derived(INCLINE_RAD, "a level over two cells: 16.0 degrees", fixed=_GRID)
    wall_thickness_m: float = assumed(
        0.010, "side walls of the base, beside the widest car", fixed=_SHAPE
    )
    skin_m: float = assumed(
        0.004, "leaves a car below 2.8 mm of head-room at its lower corner", fixed=_SHAPE
    )
    heel_m: float = assumed(
        0.020, "cut off the flap: it would drag over the floor as it turns", fixed=_SHAPE
    )
    underside_m: float = assumed(
        0.1055, "2.9 mm above a board; raised, it clears the face", fixed=_SHAPE
    )
    pad_front_m: float = assumed(
        0.090, "as far as a rail reaches under the incline's face", fixed=_SHAPE
    )
    pad_thickness_m: float = assumed(0.005, "rails and back bar", fixed=_SHAPE)
    stop_thickness_m: float = assumed(
        0.0038, "of the front bar, where the incline is lower", fixed=_SHAPE
    )
    stop_front_rise_m: float = assumed(
        0.0002, "the bar stops the boss, carries nothing", fixed=_SHAPE
    )
    stop_back_rise_m: float = assumed(
        0.0032, "a lowered boss slides in below the bar", fixed=_SHAPE
    )
    boss_play_m: float = assumed(
        0.0002, "on each side; half of it wedges, with peaks of 650 N", fixed=_SHAPE
    )
    base_mass_kg: Positive = published(1.0)
    flap_mass_kg: Positive = published(0.1)
    friction: Friction = assumed(0.8, "rubber feet and a rubber-edged flap, as the rollers")
    gear_radius_m: float = published(0.02, fixed=_SHAPE)
    gear_width_m: float = assumed(0.012, "published without a figure", fixed=_SHAPE)
    hinge_torque_nm: Positive = published(10.0, means="largest torque of the motor at the hinge")
    hinge_speed_rad_s: Annotated[float, Range(0.0, 3.0, above=True)] = published(
        0.3, means="top speed of the hinge"
    )
    hinge_range_rad: float = published(math.pi, fixed=_GRID)
    hinge_margin_rad: float = assumed(
        0.01, "of the lower stop: the floor stops the flap", fixed=_SHAPE
    )
    hinge_stiffness_nm_rad: Positive = assumed(
        40.0, "position loop: the flap's 0.1 Nm sag by 3 mrad"
    )
    hinge_gain_nms_rad: Positive = assumed(
        2.0, "its velocity loop: damps the flap on the position loop"
    )
    hinge_armature_kgm2: Positive = assumed(
        0.01, "a small motor's rotor behind its gear, as the wheels'"
    )
    hinge_damping_nms_rad: Positive = assumed(
        0.02, "grease in the gear: 0.006 Nm at the published speed"
    )
    hinge_friction_nm: Positive = assumed(0.02, "a small gear motor")
    docking_range_m: Positive = assumed(
        0.04, "reach of the plug by which a car below turns the hinge"
    )

    @property
    def mass_kg(self) -> float:
        """Mass of the whole slope."""
        return self.base_mass_kg + self.flap_mass_kg

    @property
    def height_m(self) -> float:
        """One level: the incline ends flush with a block's deck."""
        return 2 * self.hinge_z_m


@record()
class ContactParameters(NearNominal):
    """How surfaces give way to each other, the same for all machines and the floor; in MuJoCo's terms.

    A contact is a spring and damper with a time constant and a damping ratio (solref) and an impedance between a
    smallest and a largest value that is reached at a depth (solimp); the dry friction of joints likewise.
    """

    time_constant_s: Annotated[float, Range(0.0, 0.1, above=True)] = assumed(
        0.008,
        "two physics steps, the stiffest that is stable",
        means="softness of a contact (solref)",
    )
    damping_ratio: Positive = assumed(
        1.0, "critical: nothing bounces", means="of a contact (solref)"
    )
    impedance_min: Impedance = assumed(
        0.95,
        "hard plastic, as stiff as is stable at the time constant",
        means="of a contact at its surface (solimp)",
    )
    impedance_max: Impedance = assumed(
        0.99, "as above, from a depth of 0.5 mm", means="of a contact at its depth (solimp)"
    )
    impedance_depth_m: Positive = assumed(0.0005, "depth at which the largest impedance is reached")
    foot_stiffness_ratio: Positive = assumed(
        4.0, "a round foot has one contact where a flat one has four"
    )
    joint_impedance: Impedance = assumed(
        0.9999,
        "dry friction of joints: holds rather than creeps",
        means="of dry friction in joints (solimp)",
    )
    joint_impedance_width: Positive = assumed(
        0.001,
        "without effect while smallest and largest are equal",
        means="of dry friction in joints (solimp)",
    )
    torsional_friction_m: Positive = assumed(0.005, "MuJoCo's default: a patch of 5 mm")
    rolling_friction_m: Positive = assumed(0.0001, "MuJoCo's default")
    ground_friction: Friction = assumed(
        0.4, "concrete or plywood under hard plastic; rubber brings its own"
    )


SEAT: Final = SmartcarParameters()
"""Board and boss of every car, for which blocks and slopes are made: these parameters cannot be changed."""
BEVEL: Final = (SEAT.boss_side_m - SEAT.boss_top_side_m) / 2 / SEAT.boss_height_m
"""By how much a boss narrows on each side per metre of its height."""
