"""The control law of driving, compiled: follow a smooth path of poses, and come to rest at its end.

The wheels get the path's speed (feed-forward), a correction proportional to the pose error with integral action near
the goal, and on top what the velocity servos need to overcome the gears' dry friction, gravity on an incline, and
inertia.
"""

from __future__ import annotations

import math

from craftsim.discrete.kernel.jit import Record, compiled
from craftsim.discrete.kernel.rotation import wrap
from craftsim.models.measuring import Floats, Records
from craftsim.skills.health import end
from craftsim.skills.mecanum import Triple, on_wheels
from craftsim.skills.profile import distance_at, motion_at
from craftsim.skills.progress import check_progress
from craftsim.skills.state import GRAVITY, LOAD_MISSED, MOVES_OFF_TARGET, RESTS_OFF_TARGET, RUNNING, SUCCEEDED


@compiled
def drive_law(
    readings: Records, tasks: Records, past: Floats, constants: Records, commands: Records, car: int
) -> None:
    """Command the wheels of a car on its path, or end its task."""
    now, task, known = readings[car], tasks[car], constants[car]
    drive, gains = task.drive, known.drive
    if drive.loaded:
        # Shorter dips of what the board feels come from bumps and acceleration.
        drive.unloaded_s = 0.0 if task.feels_load else drive.unloaded_s + known.period_s
        if drive.unloaded_s > known.health.load_lost:
            end(task, LOAD_MISSED, now.board_force_n, 0.0)
    error = drive.path[0] - now.x, drive.path[1] - now.y, wrap(drive.path[2] - now.heading)
    check_progress(now, task, known, error, _to_body(error, now))
    if task.elapsed_s >= drive.profile.duration_s:
        # There it has to rest, and to be sure that it is there.
        offset, turn = math.hypot(error[0], error[1]), abs(error[2])
        there = offset < gains.position_tolerance and turn < gains.heading_tolerance
        sure = now.position_std_m < gains.position_certainty and now.heading_std_rad < gains.heading_certainty
        drive.there_periods = drive.there_periods + 1 if there and sure else 0
        drive.rest_periods = drive.rest_periods + 1 if drive.there_periods and drive.at_rest else 0
        if drive.rest_periods >= gains.rest_periods:
            end(task, SUCCEEDED, 0.0, 0.0)
        elif task.elapsed_s > drive.profile.duration_s + gains.settle_allowance:
            end(task, RESTS_OFF_TARGET if drive.at_rest else MOVES_OFF_TARGET, offset * 1e3, turn * 1e3)
    commanded = commands[car].wheels
    if task.status == RUNNING and drive.there_periods <= gains.brake_periods:
        _command_wheels(now, drive, known, error, task.elapsed_s, commanded)
    else:
        commanded[0] = commanded[1] = commanded[2] = commanded[3] = 0.0
    for wheel in range(4):
        drive.commanded[wheel] = commanded[wheel]
    start, step = drive.origin, drive.direction
    way = distance_at(drive.profile, task.elapsed_s + known.period_s)
    drive.path[0], drive.path[1] = start.x + step.x * way, start.y + step.y * way
    drive.path[2] = start.heading + step.heading * way


@compiled
def _command_wheels(
    now: Record, drive: Record, known: Record, error: Triple, elapsed_s: float, wheels: Floats
) -> None:
    """Write into ``wheels`` what speeds in rad/s to command."""
    gains, car, step, integral = known.drive, known.car, drive.direction, drive.integral
    profile, period_s = drive.profile, known.period_s
    # The command holds for one period, so the path's motion in the middle of that period is fed forward.
    t = elapsed_s + period_s / 2
    # What shaking is to cure no push cures: the integral would only wind up.
    if profile.duration_s < elapsed_s <= profile.duration_s + gains.shake_after:
        integral.x += gains.integral_gain * error[0] * period_s
        integral.y += gains.integral_gain * error[1] * period_s
        integral.heading += gains.integral_gain * error[2] * period_s
    speed, pull = motion_at(profile, t)
    velocity = (
        step.x * speed + gains.position_gain * error[0] + integral.x,
        step.y * speed + gains.position_gain * error[1] + integral.y,
        step.heading * speed + gains.heading_gain * error[2] + integral.heading,
    )
    shake_x, shake_y = _shake(drive, gains, error, elapsed_s)
    velocity = velocity[0] + shake_x, velocity[1] + shake_y, velocity[2]
    forward, left, turn = _to_body(velocity, now)
    left, turn = gains.sideways_slip * left, gains.turn_slip * turn
    speeds = on_wheels(forward / car.radius_m, left / car.radius_m, car.lever_m * turn / car.radius_m)
    # By what factors the front and the rear wheels must outrun the body's forward speed: where the ground bends, at the
    # cell border, the axles roll on different inclines, but the stiff body gives both the same speed along itself. An
    # axle on ground at an angle a to the body rolls by 1 / cos(a) faster.
    front = rear = 1.0
    if drive.sloping:
        origin, delta = drive.origin, drive.delta
        past_x, past_y = now.x - origin.x - delta.x / 2, now.y - origin.y - delta.y / 2
        past_border = past_x * drive.step_x + past_y * drive.step_y
        ahead = math.cos(now.heading) * drive.step_x + math.sin(now.heading) * drive.step_y
        reach = car.wheel_x_m * ahead * math.cos(now.pitch)
        front = 1 / math.cos((drive.end_rad if past_border + reach > 0 else drive.start_rad) - now.pitch)
        rear = 1 / math.cos((drive.end_rad if past_border - reach > 0 else drive.start_rad) - now.pitch)
    load_kg = max(0.0, now.board_force_n) / GRAVITY if drive.loaded else 0.0
    mass = car.mass_kg + load_kg
    weight, inertia = mass * GRAVITY, mass + car.spin_mass_kg
    forward, left, turn = _to_body((step.x * pull, step.y * pull, step.heading * pull), now)
    quarter = car.radius_m / 4
    torques = on_wheels(
        quarter * (inertia * forward + weight * math.sin(now.pitch)),
        quarter * (inertia * left + weight * math.sin(now.roll)),
        quarter * (car.turn_inertia_kgm2 * turn) / car.lever_m,
    )
    for wheel in range(4):
        turning = speeds[wheel] * (front if wheel < 2 else rear)
        torque = torques[wheel] + car.gear_friction_nm * math.tanh(turning / gains.friction_speed)
        # A velocity servo gives a torque when it lags behind its command by that torque over its gain.
        wheels[wheel] = turning + torque / car.wheel_gain_nms_rad


@compiled
def _shake(drive: Record, gains: Record, error: Triple, elapsed_s: float) -> tuple[float, float]:
    """Return the velocity by which a car that does not get to its goal is shaken, across the way that is left.

    On an uneven floor a car without springs rocks on two wheels of a diagonal, which cannot push across their rollers;
    what they can do, speeding up the other way, tips it onto the other two. It shakes for two cycles out of four, and
    settles in between.
    """
    cycles = (elapsed_s - drive.profile.duration_s - gains.shake_after) * gains.shake_rate
    left_over = math.hypot(error[0], error[1])
    # A car that is there and not yet sure of it has to rest.
    if cycles <= 0 or left_over < gains.position_tolerance or math.floor(cycles) % 4 >= 2:
        return 0.0, 0.0
    speed = gains.shake_speed * math.cos(2 * math.pi * cycles) / left_over
    return -speed * error[1], speed * error[0]


@compiled
def _to_body(vector: Triple, now: Record) -> Triple:
    """Turn a horizontal world vector (x, y, rotation) into the body frame; on an incline forward is longer."""
    c, s = math.cos(now.heading), math.sin(now.heading)
    forward, left = c * vector[0] + s * vector[1], -s * vector[0] + c * vector[1]
    return forward / math.cos(now.pitch), left / math.cos(now.roll), vector[2]
