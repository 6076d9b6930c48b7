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
from craftsim.skills.health import end
from craftsim.skills.mecanum import Triple, body_twist, wrench_of
from craftsim.skills.state import BLOCKED, GRAVITY, SLIPPED


@compiled
def check_progress(now: Record, task: Record, known: Record, error: Triple, ahead: Triple) -> None:
    """End the task of a car that does not get on, unless it is too early to say, and note whether it rests.

    Args:
        now: what it measures.
        task: of driving; its ``before`` and ``wheels_before`` are what it measured a period ago, ``commanded`` the
            speeds that its wheels were told in between.
        known: its constants.
        error: (m, m, rad) from the car to where it should be.
        ahead: the same in its own frame.
    """
    drive, gains, car, period_s = task.drive, known.drive, known.car, known.period_s
    wheels, torques, lever_m = now.wheel_speeds, drive.torques, car.lever_m
    behind, before = drive.behind, drive.before
    rolled = length(lever_m, body_twist(lever_m, car.radius_m, wheels[0], wheels[1], wheels[2], wheels[3]))
    # The car rests when the wheels together say so, or when three of them do: the fourth may slip on the spot.
    # Localisations jitter, so they do not tell.
    fl, fr, rl, rr = abs(wheels[0]), abs(wheels[1]), abs(wheels[2]), abs(wheels[3])
    second_fastest = max(min(max(fl, fr), max(rl, rr)), min(fl, fr), min(rl, rr))
    drive.at_rest = rolled < gains.speed_at_rest or second_fastest < gains.wheels_at_rest
    if math.hypot(ahead[0], ahead[1]) + lever_m * abs(ahead[2]) <= gains.blocked_error:
        behind.stuck_s = behind.rolled_m = behind.moved_m = behind.free_m_s = behind.free_m = 0.0
    else:
        behind.stuck_s += period_s
        moved = (now.x - before.x, now.y - before.y, wrap(now.heading - before.heading))
        behind.moved_m += length(lever_m, moved)
        behind.rolled_m += rolled * period_s
        # With what wrench (N, N, Nm), in its own frame, the wheels push the car beyond its weight.
        for wheel in range(4):
            told = max(-car.wheel_speed_rad_s, min(car.wheel_speed_rad_s, drive.commanded[wheel]))
            lag = car.wheel_gain_nms_rad * (told - wheels[wheel])
            given = max(-car.wheel_torque_nm, min(car.wheel_torque_nm, lag))
            lost = car.gear_friction_nm * math.tanh(wheels[wheel] / gains.friction_speed)
            spun_up = car.wheel_inertia_kgm2 * (wheels[wheel] - drive.wheels_before[wheel]) / period_s
            torques[wheel] = given - lost - spun_up
        x, y, turn = wrench_of(lever_m, car.radius_m, torques[0], torques[1], torques[2], torques[3])
        mass_kg = car.mass_kg + drive.load_kg
        weight = mass_kg * GRAVITY
        x, y = x - weight * math.sin(now.pitch), y - weight * math.sin(now.roll)
        # How a free car would speed up towards where it should be.
        turning = turn / car.turn_inertia_kgm2 * lever_m**2
        towards = x / mass_kg * ahead[0] + y / mass_kg * ahead[1] + turning * ahead[2]
        behind.free_m_s += towards / length(lever_m, ahead) * period_s
        behind.free_m += behind.free_m_s * period_s
        if behind.stuck_s > gains.blocked_time:
            enough = gains.slip_ratio * behind.moved_m + gains.slip_distance
            slips = behind.rolled_m > enough and enough >= behind.free_m
            behind_m = math.hypot(error[0], error[1]) + lever_m * abs(error[2])
            end(task, SLIPPED if slips else BLOCKED, behind_m * 1e3, 0.0)
    before.x, before.y, before.heading = now.x, now.y, now.heading
    for wheel in range(4):
        drive.wheels_before[wheel] = wheels[wheel]


@compiled
def length(lever_m: float, way: Triple) -> float:
    """Return the length of a way (m, m, rad) in metres, a turn by what the wheels roll for it."""
    return math.sqrt(way[0] * way[0] + way[1] * way[1] + (lever_m * way[2]) ** 2)
