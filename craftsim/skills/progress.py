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
from craftsim.discrete.kernel.rotation import wrap
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
    car, torques = known.car, drive.torques
    for wheel in range(4):
        told = max(-car.wheel_speed_rad_s, min(car.wheel_speed_rad_s, drive.commanded[wheel]))
        speed = now.wheel_speeds[wheel]
        given = max(-car.wheel_torque_nm, min(car.wheel_torque_nm, car.wheel_gain_nms_rad * (told - speed)))
        lost = car.gear_friction_nm * math.tanh(speed / known.drive.friction_speed)
        spun_up = car.wheel_inertia_kgm2 * (speed - drive.wheels_before[wheel]) / known.period_s
        torques[wheel] = given - lost - spun_up
    x, y, turn = wrench_of(car.lever_m, car.radius_m, torques[0], torques[1], torques[2], torques[3])
    weight = mass_kg * GRAVITY
    return x - weight * math.sin(now.pitch), y - weight * math.sin(now.roll), turn
