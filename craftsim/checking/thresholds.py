"""The limits of what counts as predicted: the same for every preset, drive and floor, derived from geometry.

What a limit follows from stands in :func:`thresholds_of`. Noise, biases and floors do not widen it.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Final

from craftsim.discrete.geometry import CELL_PITCH_M, INCLINE_RAD
from craftsim.mjcf.machines import NOMINAL, Machines
from craftsim.skills.state import GRAVITY
from craftsim.storage.records import record

_LONGEST: Final = 10.0
"""Largest duration of an action, as a multiple of the nominal one. Gains for uneven floors allow a sixth of the speed
of those for flat ones; an action that takes longer has been stuck."""


@record()
class Thresholds:
    """Limits of the errors of an action that agrees with its prediction (:func:`thresholds_of`)."""

    place_m: float
    """Half of the gap between two neighbours: distance of a car from its cell's centre; reach of what is set down,
    carried or stands by; height errors; height of a lowered board; displacement of bystanders in an action, and since
    they were last put."""
    turn_rad: float
    """The angle that uses up half of the gap over half a cell: heading, lean and hinge of cars and things; rotation of
    bystanders."""
    seat_m: float
    """Distance of a load from its seat on the board."""
    way_m: float
    """Distance of a car, at any time, from the line between the cells of its action."""
    way_lean_rad: float
    """Lean of a car, at any time, beyond the steepest ground of its action."""
    contact_n: float
    """Force between machines that should not touch."""
    impact_n: float
    """Force between any two machines, beyond what a stack bears at rest; a larger one is unsafe."""
    duration_ratio: float
    """Duration as a multiple of the nominal one."""


@lru_cache(maxsize=64)
def thresholds_of(machines: Machines = NOMINAL) -> Thresholds:
    """Return the limits for these machines. With the nominal ones:

    - Things in neighbouring cells are 2.5 mm apart: a cell is 322.5 mm wide, a block or slope 320. Each may use half,
      1.25 mm. Decks of neighbours at their limits differ by the gap in height, too; a car drives over such a step.
    - 1.25 mm over half a cell, 161.25 mm, are 7.75 mrad.
    - A boss has 0.1 mm of play on each side in the pocket of a block, 0.2 mm between the bars of a slope: 0.28 mm along
      the diagonal. As much again is for how parts are made.
    - A car, 220 mm long, keeps within its cells: (322.5 - 220) / 2 = 51 mm.
    - A car that leans by more than half of the incline, 140 mrad, reads as a car on a slope.
    - A push forward or to a side slides an empty car whose wheels are braked from 57 N on. Each of its four rollers
      holds at 45 degrees to that: 0.8 x 10.3 kg x 9.81 m/s^2 / sqrt(2). The gears of an idle car turn from 36 N on, by
      a few mm/s: what that moves is a displaced bystander.
    - :func:`impact_limit_n` is 461 N.
    """
    widest_m = max(machines.block.side_m, machines.slope.side_m)
    place_m = (CELL_PITCH_M - widest_m) / 2
    pocket_play_m = (
        machines.block.pocket_side_m - max(car.boss_side_m for car in machines.cars)
    ) / 2
    seat_play_m = max(pocket_play_m, machines.slope.boss_play_m)
    longest_m = 0.0
    grips_n = []
    for car in machines.cars:
        width_m = 2 * car.wheel_y_m + car.wheel_width_m
        longest_m = max(longest_m, car.chassis_length_m, car.chassis_width_m, width_m)
        grips_n.append(car.roller_friction * car.mass_kg * GRAVITY / math.sqrt(2))
    return Thresholds(
        place_m=place_m,
        turn_rad=place_m / (CELL_PITCH_M / 2),
        seat_m=2 * math.sqrt(2) * seat_play_m,
        way_m=(CELL_PITCH_M - longest_m) / 2,
        way_lean_rad=INCLINE_RAD / 2,
        contact_n=min(grips_n),
        impact_n=impact_limit_n(machines),
        duration_ratio=_LONGEST,
    )


def impact_limit_n(machines: Machines = NOMINAL) -> float:
    """Return the largest force between two machines without an impact, in newtons; 461 N for the nominal ones.

    The heaviest loaded car weighs W = 112 N, and its wheel motors push with F = 202 N at most, at right angles to the
    weight: sqrt(W^2 + F^2) = 231 N. Applied at once, it loads a stiff contact up to twice as much as at rest: 461 N.
    What a stack bears at rest comes on top of that, see :class:`craftsim.checking.contacts.ContactLog`.
    """
    load_kg = max(machines.block.mass_kg, machines.slope.mass_kg)
    limits_n = []
    for car in machines.cars:
        weight_n = (car.mass_kg + load_kg) * GRAVITY
        push_n = 4 * car.wheel_torque_nm / car.wheel_radius_m
        limits_n.append(2 * math.hypot(weight_n, push_n))
    return max(limits_n)
