"""Limits of the speed and acceleration of moves and turns: one function for each cause.

The lowest limit of speed and the lowest limit of acceleration bind. To add a limit, write a function and list it in
:data:`MOVE_LIMITS` or :data:`TURN_LIMITS`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Final, NamedTuple

from craftsim.mjcf.parameters import GRAVITY
from craftsim.models.sensing import CarMeasurement
from craftsim.skills.gains import DriveGains
from craftsim.skills.laws import feels_load
from craftsim.skills.setup import SkillSetup

_SIDEWAYS_M_S: Final = 0.35
"""Highest speed to a side on an uneven floor: there rollers meet edges, at 24 degrees where wheels do at 10."""
_LEAST_FORCE_N: Final = 1.0
"""Least force that a path may use, on an incline on which the motors have none to spare."""
_SURE_SHARE: Final = 0.85
"""Share of their torque that motors give for sure: those that strong randomization draws are up to 15 % weaker. Paths
that count on all of it make a car fall behind, slip, and lose its heading."""
_CREST_M_S: Final = 0.28
"""Least limit of the speed over a crest: at 0.2 m/s a car of 13 kg with motors of 1.4 Nm shoves what it drives onto as
far as at 0.28, at 0.42 twice as far (tests/skills/test_machines.py)."""


class Limit(NamedTuple):
    """The highest speed and acceleration that a cause allows: m/s and m/s^2, for a turn rad/s and rad/s^2."""

    speed: float = math.inf
    acceleration: float = math.inf


class BindingLimits(NamedTuple):
    """The speed and acceleration of a path, and the functions whose limits they are."""

    speed: float
    acceleration: float
    speed_cause: str
    """Name of the function that limits the speed."""
    acceleration_cause: str
    """Name of the function that limits the acceleration."""


@dataclass(frozen=True)
class Motion:
    """A move or a turn, as far as its limits depend on it."""

    setup: SkillSetup
    loaded: bool
    load_kg: float
    height_m: float
    """Height of the car above the floor."""
    sideways: bool = False
    """Whether the car moves to a side."""

    @classmethod
    def of(cls, setup: SkillSetup, measurement: CarMeasurement, sideways: bool = False) -> Motion:
        """Return the motion of a car that measures this."""
        loaded, load_kg = felt_load(setup, measurement)
        return cls(setup, loaded, load_kg, measurement.z, sideways)

    @property
    def gains(self) -> DriveGains:
        """Gains of driving."""
        return self.setup.gains.drive

    @property
    def load_factor(self) -> float:
        """Factor of the limits of loaded cars; 1 without a load."""
        if self.loaded:
            return self.gains.load_factor
        return 1.0

    @property
    def wheels_m_s(self) -> float:
        """Speed that the wheels can give, less a reserve."""
        car = self.setup.machine
        return self.gains.motor_share * car.wheel_speed_rad_s * car.wheel_radius_m

    def wheels_n(self, incline_rad: float, n_wheels: int = 4) -> float:
        """Return the force that wheels can give, less a reserve, gear friction and the weight on an incline."""
        car = self.setup.machine
        sure_nm = _SURE_SHARE * car.wheel_torque_nm
        torque_nm = self.gains.motor_share * sure_nm - car.gear_friction_nm
        weight_n = self.mass_kg * GRAVITY
        force_n = n_wheels * torque_nm / car.wheel_radius_m - weight_n * math.sin(incline_rad)
        return max(force_n, _LEAST_FORCE_N)

    @property
    def mass_kg(self) -> float:
        """Mass of the car, its load included."""
        return self._constant("mass_kg") + self.load_kg

    @property
    def inertia_kg(self) -> float:
        """Mass of the car, its load included, and the inertia of its wheels."""
        return self.mass_kg + self._constant("spin_mass_kg")

    @property
    def lever_m(self) -> float:
        """Way that the wheels roll for a turn by 1 rad."""
        return self._constant("lever_m")

    @property
    def turn_inertia_kgm2(self) -> float:
        """Inertia of the empty car about the vertical axis."""
        return self._constant("turn_inertia_kgm2")

    def _constant(self, name: str) -> float:
        return float(self.setup.constants[0]["car"][name])


LimitFunction = Callable[[Motion], Limit]
"""Returns the limits that a cause sets; infinite where it sets none."""


def ground_limit(move: Motion) -> Limit:
    """Return the limits on the flat, or on slopes: wheels meet a slope's foot at an angle, and it must not shift."""
    gains = move.gains
    if move.setup.terrain.sloping:
        return Limit(
            gains.max_slope_speed * move.load_factor,
            gains.max_slope_acceleration * move.load_factor,
        )
    return Limit(gains.max_speed * move.load_factor, gains.max_acceleration * move.load_factor)


def tight_limit(move: Motion) -> Limit:
    """Return the limits under something, and of a load past something."""
    gains = move.gains
    if not move.setup.terrain.tight:
        return Limit()
    return Limit(
        gains.max_tight_speed * move.load_factor, gains.max_tight_acceleration * move.load_factor
    )


def tight_slope_limit(move: Motion) -> Limit:
    """Return the limit of a load past something on a slope: grip must suffice to climb and to keep to the path."""
    terrain = move.setup.terrain
    if not (terrain.tight and terrain.sloping and move.loaded):
        return Limit()
    return Limit(acceleration=move.gains.max_tight_slope_acceleration * move.load_factor)


def sideways_limit(move: Motion) -> Limit:
    """Return the limit to a side on an uneven floor, where rollers meet edges."""
    if not (move.setup.expects_uneven_floor and move.sideways):
        return Limit()
    return Limit(speed=_SIDEWAYS_M_S * move.load_factor)


def motor_limit(move: Motion) -> Limit:
    """Return the limits of the wheels' motors, on the steeper end of the move."""
    force_n = move.wheels_n(move.setup.terrain.steepest_rad)
    return Limit(move.wheels_m_s, force_n / move.inertia_kg)


def crest_limit(move: Motion) -> Limit:
    """Return the limit on a slope whose crest the motors of one axle do not hold with force to spare.

    Wheels that have just met what stands beyond a crest bear little: they shove it if they have to push. So the other
    axle pulls alone; the limit is the speed that it gives within a wheelbase.
    """
    terrain = move.setup.terrain
    if not terrain.sloping:
        return Limit()
    spare_m_s2 = move.wheels_n(terrain.steepest_rad, n_wheels=2) / move.mass_kg
    wheelbase_m = 2 * move.setup.machine.wheel_x_m
    return Limit(speed=max(math.sqrt(2 * spare_m_s2 * wheelbase_m), _CREST_M_S))


def rocking_limit(move: Motion) -> Limit:
    """Return the limit on a stack, which yields to the car's push in each of its joints and tips in the end."""
    if move.height_m <= 0:
        return Limit()
    return Limit(acceleration=move.gains.rocking / move.height_m**2)


def turn_limit(turn: Motion) -> Limit:
    """Return the limits of turns, whatever the motors."""
    gains = turn.gains
    return Limit(
        gains.max_turn_speed * turn.load_factor, gains.max_turn_acceleration * turn.load_factor
    )


def turn_motor_limit(turn: Motion) -> Limit:
    """Return the limits of the wheels' motors for a turn."""
    force_n = turn.wheels_n(0.0)
    return Limit(turn.wheels_m_s / turn.lever_m, force_n * turn.lever_m / turn.turn_inertia_kgm2)


MOVE_LIMITS: Final[tuple[LimitFunction, ...]] = (
    ground_limit,
    tight_limit,
    tight_slope_limit,
    sideways_limit,
    motor_limit,
    crest_limit,
    rocking_limit,
)
TURN_LIMITS: Final[tuple[LimitFunction, ...]] = (turn_limit, turn_motor_limit)


def binding_limits(motion: Motion, functions: Iterable[LimitFunction]) -> BindingLimits:
    """Return the lowest speed and acceleration, and what limits them; the first cause where several are equal."""
    limits = {function.__name__: function(motion) for function in functions}
    speed_cause = min(limits, key=lambda cause: limits[cause].speed)
    acceleration_cause = min(limits, key=lambda cause: limits[cause].acceleration)
    speed = limits[speed_cause].speed
    acceleration = limits[acceleration_cause].acceleration
    return BindingLimits(speed, acceleration, speed_cause, acceleration_cause)


def felt_load(setup: SkillSetup, measurement: CarMeasurement) -> tuple[bool, float]:
    """Return whether a car feels a load, and of how many kg."""
    felt_load_n = float(setup.constants[0]["car"]["felt_load_n"])
    if not feels_load(measurement, setup.gains.health, felt_load_n):
        return False, 0.0
    return True, max(0.0, measurement.board_force_n) / GRAVITY
