"""Whether a car keeps up with its path, and if not, whether its wheels slip or something is in the way.

Wheels that stand say that something is in the way. Wheels that turn although the car does not follow may slip on a
ground without grip, or spin at an obstacle, because the motors are stronger than the grip. What tells the two apart is
with how much force they turn: the drives' torques less what friction, the wheels' own inertia and the weight on an
incline take would have moved a free car a certain way, by Newton's second law. An obstacle is there where the car stays
far behind that way, too.
"""

from __future__ import annotations

import math

from craftsim.discrete.kernel.jit import Record, compiled
from craftsim.discrete.rotation import wrap
from craftsim.models.sensing import PerWheel
from craftsim.skills.mecanum import Triple, body_twist, wrench_of
from craftsim.skills.state import BLOCKED, GRAVITY, RUNNING, SLIPPED


@compiled
def progress(now: Record, drive: Record, known: Record, error: Triple, mass_kg: float) -> int:
    """Return BLOCKED or SLIPPED for a car that does not get on, RUNNING while it does or it is too early to say.

    Args:
        now: what it measures.
        drive: its task; ``before`` and ``wheels_before`` are what it measured a period ago, ``commanded`` the speeds
            that its wheels were told in between.
        known: its constants.
        error: (m, m, rad) from the car to where it should be, in its own frame.
        mass_kg: of car and load.
    """
    behind, gains, car, period_s = drive.behind, known.drive, known.car, known.period_s
    lever_m = car.lever_m
    if math.hypot(error[0], error[1]) + lever_m * abs(error[2]) <= gains.blocked_error:
        behind.stuck_s = behind.rolled_m = behind.moved_m = behind.free_m_s = behind.free_m = 0.0
        return RUNNING
    turned = wrap(now.heading - drive.before.heading)
    wheels = now.wheel_speeds
    rolled = body_twist(lever_m, car.radius_m, wheels[0], wheels[1], wheels[2], wheels[3])
    behind.stuck_s += period_s
    behind.moved_m += length(lever_m, (now.x - drive.before.x, now.y - drive.before.y, turned))
    behind.rolled_m += length(lever_m, rolled) * period_s
    x, y, turn = _push(now, drive, known, mass_kg)
    towards = (
        x / mass_kg * error[0] + y / mass_kg * error[1] + turn / car.turn_inertia_kgm2 * lever_m**2 * error[2]
    )
    behind.free_m_s += towards / length(lever_m, error) * period_s
    behind.free_m += behind.free_m_s * period_s
    if behind.stuck_s <= gains.blocked_time:
        return RUNNING
    enough = gains.slip_ratio * behind.moved_m + gains.slip_distance
    return SLIPPED if behind.rolled_m > enough and enough >= behind.free_m else BLOCKED


@compiled
def length(lever_m: float, way: Triple) -> float:
    """Return the length of a way (m, m, rad) in metres, a turn by what the wheels roll for it."""
    return math.sqrt(way[0] * way[0] + way[1] * way[1] + (lever_m * way[2]) ** 2)


@compiled
def _push(now: Record, drive: Record, known: Record, mass_kg: float) -> Triple:
    """Return with what wrench (N, N, Nm), in its own frame, the wheels push the car beyond its weight."""
    fl, fr, rl, rr = _torques(now, drive, known)
    x, y, turn = wrench_of(known.car.lever_m, known.car.radius_m, fl, fr, rl, rr)
    weight = mass_kg * GRAVITY
    return x - weight * math.sin(now.pitch), y - weight * math.sin(now.roll), turn


@compiled
def _torques(now: Record, drive: Record, known: Record) -> PerWheel:
    """Return with what torques the wheels push on the ground."""
    return (
        _torque(drive.commanded[0], drive.wheels_before[0], now.wheel_speeds[0], known),
        _torque(drive.commanded[1], drive.wheels_before[1], now.wheel_speeds[1], known),
        _torque(drive.commanded[2], drive.wheels_before[2], now.wheel_speeds[2], known),
        _torque(drive.commanded[3], drive.wheels_before[3], now.wheel_speeds[3], known),
    )


@compiled
def _torque(told: float, was: float, speed: float, known: Record) -> float:
    car = known.car
    told = _within(car.wheel_speed_rad_s, told)
    given = _within(car.wheel_torque_nm, car.wheel_gain_nms_rad * (told - speed))
    lost = car.gear_friction_nm * math.tanh(speed / known.drive.friction_speed)
    return given - lost - car.wheel_inertia_kgm2 * (speed - was) / known.period_s


@compiled
def _within(limit: float, value: float) -> float:
    return max(-limit, min(limit, value))
