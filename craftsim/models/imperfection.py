"""What is imperfect about a floor, about motors and about how machines are made: from 0, which is ideal, to below 1."""

from __future__ import annotations

from typing import Annotated, Final

from craftsim.storage.limits import Range
from craftsim.storage.records import record

Amount = Annotated[float, Range(0.0, 1.0, below=True)]
"""From 0, which is ideal, to below 1, in whatever unit."""
Length = Annotated[float, Range(0.0, 1.0, above=True, below=True)]
"""In metres."""


@record()
class Floor:
    """How uneven a floor is; hashable. Raises InputError for a figure outside [0, 1).

    Example:
        >>> from craftsim.models.imperfection import Floor
        >>> Floor(lippage_m=0.001).flat
        False
    """

    lippage_m: Amount = 0.0
    """Largest difference in height between two tiles; each tile's height is drawn uniformly."""
    tile_m: Length = 0.3
    """Side of a square tile. Where their joints run, and in which direction, is drawn."""
    joint_m: Amount = 0.0
    """Width of the joints between tiles..."""
    joint_depth_m: Amount = 0.0
    """...and by how much their bottom lies below the lowest tile."""
    unevenness_m: Amount = 0.0
    """Height from the lowest to the highest point of the smooth undulation of the whole floor..."""
    wavelength_m: Length = 0.6
    """...and its shortest wavelength."""

    def __post_init__(self) -> None:
        if self.joint_m >= self.tile_m:
            raise ValueError(f"joint_m must be below tile_m, {self.tile_m:g}, not {self.joint_m:g}")

    @property
    def flat(self) -> bool:
        """Whether it is a plane."""
        return not (self.lippage_m or self.unevenness_m or (self.joint_m and self.joint_depth_m))

    @property
    def relief_m(self) -> float:
        """Height from the lowest to the highest place on which something can stand."""
        return self.lippage_m + self.unevenness_m


@record()
class Drivetrain:
    """What wheel motors and gears lack; hashable. Raises InputError for a figure outside [0, 1).

    Example:
        >>> from craftsim.models.imperfection import Drivetrain
        >>> Drivetrain(gear_loss=0.1).ideal
        False
    """

    torque_slope: Amount = 0.0
    """Share of a driving motor's largest torque that is lost at its top speed, in proportion to the speed."""
    gear_loss: Amount = 0.0
    """Share of a driving motor's torque that the gear takes, on top of its dry friction; it helps a brake as much."""
    backlash_rad: Amount = 0.0
    """Angle by which the gear leaves the wheel free when the torque changes its sign."""
    sag: Amount = 0.0
    """Share of the largest torque, of that at standstill, that is lost at any speed when all motors of a car drive with
    all they have: the battery's voltage drops."""

    @property
    def ideal(self) -> bool:
        """Whether motors and gears lack nothing."""
        return self == IDEAL


@record()
class Making:
    """Tolerances of making: half-widths of uniform distributions, drawn for each machine; hashable.

    Raises InputError for a figure outside [0, 1).

    Example:
        >>> from craftsim.models.imperfection import Making
        >>> Making(wheel_radius_m=0.0001).exact
        False
    """

    wheel_radius_m: Amount = 0.0
    """Of each wheel by itself."""
    wheel_place_m: Amount = 0.0
    """Of each axle's distance from the car's middle, forward and sideways: wheelbase and track."""
    board_m: Amount = 0.0
    """Of the height of a lowered board and its boss."""
    board_place_m: Amount = 0.0
    """Of the place of board and boss on the car, forward and sideways."""
    foot_m: Amount = 0.0
    """Of the height of each foot of a block or a flag."""
    underside_m: Amount = 0.0
    """Of the height of a block's pocket and of a slope's pads above the floor."""
    pocket_m: Amount = 0.0
    """Of the place of a block's pocket and of a slope's pads, forward and sideways."""

    @property
    def exact(self) -> bool:
        """Whether every machine is as it is drawn."""
        return self == AS_DRAWN


FLAT: Final = Floor()
IDEAL: Final = Drivetrain()
AS_DRAWN: Final = Making()
