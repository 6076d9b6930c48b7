"""Dimensions, masses and limits of the machines, each with its origin.

Every figure is *published* (the robot description files that accompany the CraftEnv paper), *derived* (from
published figures, with the arithmetic) or *assumed* (ours, with the reason). The MJCF files hold the same nominal
figures so that a person can read and open them alone; ``tests/models/test_parameters.py`` holds the two against
each other. Where the published files contradict themselves the note says what was chosen and why.

Units: metres, kilograms, seconds, radians, newtons, newton metres.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from typing import Any, Literal

from craftsim.discrete.geometry import CELL_PITCH_M, INCLINE_RAD, LEVEL_HEIGHT_M

Origin = Literal["published", "derived", "assumed"]


@dataclass(frozen=True)
class Provenance:
    """Where a figure comes from: its origin and, where there is something to say, a note."""

    origin: Origin
    note: str


def _figure(value: float, origin: Origin, note: str = "") -> Any:
    return field(default=value, metadata={"provenance": Provenance(origin, note)})


def published(value: float, note: str = "") -> Any:
    """Declare a dataclass field whose default is a published figure."""
    return _figure(value, "published", note)


def derived(value: float, note: str) -> Any:
    """Declare a dataclass field whose default follows from published figures as the note says."""
    return _figure(value, "derived", note)


def assumed(value: float, note: str) -> Any:
    """Declare a dataclass field whose default is our assumption, for the reason in the note."""
    return _figure(value, "assumed", note)


def provenance(parameters: object) -> dict[str, Provenance]:
    """Return the provenance of every figure of a parameter dataclass or instance, by field name."""
    return {f.name: f.metadata["provenance"] for f in fields(parameters)}  # type: ignore[arg-type]


@dataclass(frozen=True)
class SmartcarParameters:
    """The mecanum smartcar. Heights are above the axle line unless the name says floor."""

    wheel_radius_m: float = published(
        0.0496, "the mesh; the collision cylinder's 0.043 would ground the car on the crest of the slope"
    )
    wheel_width_m: float = published(0.043, "the mesh; the collision cylinder has 0.040")
    wheel_x_m: float = published(0.060, "half the wheelbase")
    wheel_y_m: float = published(0.083, "half the track")
    wheel_mass_kg: float = published(2.3, "each, rollers included")
    wheel_spin_inertia_kgm2: float = derived(
        0.5 * 2.3 * 0.0496**2, "solid cylinder m r^2 / 2; the published 6.64e-3 belongs to another wheel"
    )
    rollers_per_wheel: int = assumed(10, "the fewest with which the envelope's ripple stays far below 0.5 mm")
    roller_radius_m: float = assumed(0.009, "what fits ten rollers on the published wheel")
    roller_half_length_m: float = derived(
        0.0302, "the ellipsoid that flattens the wheel's envelope: 0.063 mm of ripple, found numerically"
    )
    roller_mass_kg: float = assumed(0.03, "a rubber barrel of this size; part of the wheel's published mass")
    roller_bearing_friction_nm: float = assumed(
        0.004, "plain bearing: friction 0.1 under a quarter of the weight (25 N) on a pin of 3 mm"
    )
    chassis_length_m: float = published(0.220)
    chassis_width_m: float = published(0.167)
    chassis_bottom_m: float = published(-0.040)
    chassis_top_m: float = published(0.050)
    chassis_chamfer_m: float = assumed(
        0.025, "published without a figure; keeps the nose off the foot of the slope"
    )
    chassis_mass_kg: float = published(1.0)
    chassis_com_m: float = published(-0.025, "height of the chassis' centre of mass")
    board_top_m: float = published(
        0.053, "read as the upper face, so that the plate lies on the chassis' top"
    )
    board_length_m: float = published(0.194)
    board_width_m: float = published(0.200)
    board_thickness_m: float = published(0.003)
    board_mass_kg: float = published(0.1)
    board_travel_m: float = published(0.045)
    board_speed_m_s: float = published(0.05)
    board_force_n: float = assumed(80.0, "seven times the heaviest load; no published figure")
    boss_side_m: float = published(0.11, "at its foot")
    boss_top_side_m: float = assumed(0.100, "bevelled edges are published without a figure: 45 degrees")
    boss_height_m: float = published(0.005)
    wheel_torque_nm: float = assumed(
        2.5, "a wheel motor; three times what a loaded climb at 16 degrees needs"
    )
    wheel_speed_rad_s: float = assumed(20.0, "about 1 m/s; no published figure")
    wheel_gain_nms_rad: float = assumed(
        4.0,
        "velocity servo: 0.11 rad/s of droop at the gear's friction; stiffer axles fight each other on a crest",
    )
    wheel_armature_kgm2: float = assumed(
        0.01, "a motor's rotor seen from the wheel: 4e-6 kg m^2 behind a self-locking gear of 50, squared"
    )
    gear_friction_nm: float = assumed(
        0.45, "self-locking gear: a car carrying a slope needs 0.39 Nm a wheel to stand on the incline"
    )
    roller_friction: float = assumed(0.8, "rubber on plastic, plywood or concrete: handbooks give 0.6 to 1.0")
    board_friction: float = assumed(0.8, "rubber facing under plastic, as above")
    chassis_friction: float = assumed(0.3, "painted metal against plastic")

    @property
    def mass_kg(self) -> float:
        """Mass of the whole car."""
        return self.chassis_mass_kg + 4 * self.wheel_mass_kg + self.board_mass_kg

    @property
    def turn_radius_m(self) -> float:
        """Half the wheelbase plus half the track: the lever by which wheel speed turns the car."""
        return self.wheel_x_m + self.wheel_y_m

    @property
    def board_rest_m(self) -> float:
        """Height of the board's upper face above the floor when it is down."""
        return self.wheel_radius_m + self.board_top_m


@dataclass(frozen=True)
class BlockParameters:
    """The block: a table with a deck and four legs. Flag and wall have the same shape."""

    side_m: float = published(0.32)
    height_m: float = derived(
        LEVEL_HEIGHT_M,
        "one level; the mesh has 0.187 and the collision box 0.1905, which do not stack at the pitch",
    )
    leg_side_m: float = published(0.025)
    leg_offset_m: float = published(0.1475)
    underside_m: float = published(
        0.1155, "top of the legs; the deck's box starts 3 mm higher, a gap no table has"
    )
    deck_mass_kg: float = published(0.5)
    leg_mass_kg: float = published(0.001)
    pocket_side_m: float = assumed(
        0.1102,
        "the boss' foot and 0.1 mm of play on each side: a load wanders by it; the bevel centres what is off by more",
    )
    pocket_depth_m: float = assumed(0.006, "the boss' height and 1 mm")
    foot_radius_m: float = assumed(
        0.005,
        "round feet 0.5 mm proud at the legs' outer corners: one point of contact each, and as wide a stand",
    )
    foot_friction: float = assumed(
        0.8, "rubber feet; on bare plastic (0.4) a car that drives on top shoves its block by millimetres"
    )
    friction: float = assumed(
        0.4, "moulded plastic on plastic, plywood or concrete: handbooks give 0.3 to 0.5"
    )

    @property
    def mass_kg(self) -> float:
        """Mass of the whole block."""
        return self.deck_mass_kg + 4 * self.leg_mass_kg


@dataclass(frozen=True)
class SlopeParameters:
    """The foldable slope: a hollow base wedge, and a flap on a motorised hinge."""

    side_m: float = published(0.32, "the visual mesh; the collision meshes' 0.34 overlap at the grid's pitch")
    height_m: float = derived(LEVEL_HEIGHT_M, "one level, so that the incline ends flush with a block's deck")
    hinge_x_m: float = derived(
        CELL_PITCH_M / 2, "on the cell's border, so that the folded flap covers the base"
    )
    hinge_z_m: float = derived(
        LEVEL_HEIGHT_M / 2,
        "half a level, so that the folded top is level; published 0.095 would stand 5 mm proud",
    )
    incline_rad: float = derived(INCLINE_RAD, "a level over two cells: 16.0 degrees")
    skin_m: float = assumed(0.004, "leaves a car below 2.8 mm of head-room at its lower corner")
    underside_m: float = assumed(
        0.1055,
        "of the pads: 2.9 mm above a lowered board, and low enough that a raised one clears the incline",
    )
    boss_play_m: float = assumed(
        0.0002,
        "beside the boss on each side; at half of it the bevelled stop wedges, with contact peaks of 650 N",
    )
    base_mass_kg: float = published(1.0)
    flap_mass_kg: float = published(0.1)
    gear_radius_m: float = published(0.02)
    hinge_torque_nm: float = published(10.0)
    hinge_speed_rad_s: float = published(0.3)
    hinge_range_rad: float = published(math.pi)
    hinge_friction_nm: float = assumed(0.02, "a small gear motor")

    @property
    def mass_kg(self) -> float:
        """Mass of the whole slope."""
        return self.base_mass_kg + self.flap_mass_kg


SMARTCAR = SmartcarParameters()
BLOCK = BlockParameters()
SLOPE = SlopeParameters()
