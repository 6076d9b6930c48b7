"""All compiled controllers: one control period of all cars, and the law of each kind of task.

A law reads a car's record, writes its command, and ends the task with a status. Driving follows a smooth path of poses
and comes to rest at its end: the wheels get the path's speed (feed-forward), a correction proportional to the pose
error with integral action near the goal, and what their velocity servos need against dry friction, gravity and inertia.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from craftsim.compiled.arrays import Floats, Records
from craftsim.compiled.jit import Record, compiled
from craftsim.discrete.geometry import CELL_PITCH_M
from craftsim.discrete.kernel.rotation import wrap
from craftsim.mjcf.parameters import GRAVITY
from craftsim.skills import state
from craftsim.skills.estimator import delay_of, lean_of, update_floor
from craftsim.skills.mecanum import Triple, body_twist, on_wheels, wrench_of

LAG_STEP_S: Final = 0.01
"""Step between candidate time constants of the motors' lag."""
_BRAKES: Final = 5.0
_RECOVERS: Final = 2.0
"""1/s: rates at which the pace of a path that waits for its car falls and rises."""
_ASIDE: Final = 3.0
"""Factor of the position gain across a path that waits. On two wheels of a diagonal, which push along one direction at
45 degrees to the path, a correction along it moves the car aside by as much: so that is slow, and this is firm."""
_CATCHES_UP: Final = 20.0
"""1/s: ``astray`` times this is the highest speed of corrections along such a path..."""
_BEHIND: Final = 4.0
"""...and a car that is behind by this times ``astray`` counts as astray."""
_START_M: Final = 0.02
"""A path to a side starts with moving to and fro, less and less from half of this on."""
_GROWS: Final = 0.5
_GROWS_BESIDE: Final = 0.15
"""By how much of its first amplitude shaking grows with each four cycles; that of a load past something..."""
_MOST_GROWN: Final = 3.0
"""...and to how many times that, at most."""
_MOST_GROWN_UNDER: Final = 1.3
"""The same for the amplitude of a car under something."""
_AMID: Final = 0.5
_NEAR: Final = 0.8
"""Shares of the tolerances of a path's end: on an uneven floor a car stops below the first, and goes on beyond the
second..."""
_NEAR_PERIODS: Final = 4
"""...once it has been there for more periods than this."""
_CENTRING_S: Final = 1.0
"""Longest time at the end of the path of a car that centres itself below what it lifts."""
_HARMLESS_M: Final = 0.0025
_HARMLESS_LOADED_M: Final = 0.00125
"""Distances from its target at which a car without a load is in nobody's way, the gap between two loads, and with one,
half of that."""
_RESTS_RAD: Final = 0.03
"""A flap that rests on an uneven floor is so far from its lower end at most: its heel is 20 mm from the hinge."""
_CERTAIN_M: Final = 0.0002
"""``position_certainty`` on an uneven floor: there a car slips to all sides."""
_UPRIGHT_M: Final = 0.08
"""Height above the floor of what a car that leans brings to the middle of its cell: loads reach from 0.03 to 0.22 m,
and the car, and what it sets down, stand on the floor."""
_LEAN_PERIODS: Final = 15
"""Readings of a lean that are averaged, over which its correction grows."""
_EARLY_S: Final = 0.003
"""A car is ahead of its commands: a physics step moves it by the speed at its end, half a step early. Of 2, 3 and 4 ms
this lets it come to rest soonest."""
_UNSURE_RAD_S: Final = 0.3
"""Standard deviation of a wheel's speed from its servo's: the feed-forward of friction and inertia is not exact."""


@dataclass(frozen=True)
class Profile:
    """Distance, speed and acceleration over time, for a travel from rest to rest with continuous acceleration.

    Both speed ramps follow the cubic smoothstep 3u^2 - 2u^3, whose steepest slope is 3/2 of the mean: a ramp to speed v
    under the acceleration limit a lasts 1.5 v / a and covers half of what cruising would.
    """

    cruise_speed: float
    ramp_s: float
    duration_s: float

    @classmethod
    def within(cls, distance: float, max_speed: float, max_acceleration: float) -> Profile:
        """Return the quickest profile over a distance >= 0 that keeps to a speed and an acceleration limit."""
        speed = min(max_speed, math.sqrt(max_acceleration * distance / 1.5))
        if speed <= 0:
            return cls(0.0, 0.0, 0.0)
        ramp = 1.5 * speed / max_acceleration
        return cls(speed, ramp, ramp + distance / speed)

    def distance(self, t: float) -> float:
        """Return the distance covered at time t; it holds the end afterwards."""
        v = self.cruise_speed
        ramp_s = self.ramp_s
        if self.duration_s == 0:
            return 0.0
        t = min(max(t, 0.0), self.duration_s)
        cruised = max(0.0, min(t, self.duration_s - ramp_s) - ramp_s)
        # How far up the first ramp it is, and how far the last ramp still is from its end.
        u = min(t, ramp_s) / ramp_s
        w = min(self.duration_s - t, ramp_s) / ramp_s
        first = v * ramp_s * (u**3.0 - u**4.0 / 2)
        full_ramp = v * ramp_s * (1.0 - 1.0 / 2)
        last = v * ramp_s * (w**3.0 - w**4.0 / 2)
        return v * cruised + first + full_ramp - last

    def motion(self, t: float) -> tuple[float, float]:
        """Return the speed and the acceleration at time t."""
        if self.ramp_s == 0:
            return 0.0, 0.0
        # How far the nearer ramp is climbed, 0 at rest and 1 when cruising.
        u = min(max(min(t, self.duration_s - t) / self.ramp_s, 0.0), 1.0)
        speed = self.cruise_speed * u * u * (3 - 2 * u)
        if not 0 < u < 1:
            return speed, 0.0
        rise = 6 * u * (1 - u) * self.cruise_speed / self.ramp_s
        return speed, rise if t < self.duration_s / 2 else -rise


_distance_at = compiled(Profile.distance)
"""The same for a record with the fields of a Profile, in compiled code."""
_motion_at = compiled(Profile.motion)


def health_of(reading: Record, limits: Record) -> int:
    """Return state.RUNNING, or the status of a car whose readings are not finite, or that tipped by HealthGains."""
    # A sum is finite only if all its terms are.
    pose = reading.x + reading.y + reading.z + reading.heading + reading.pitch + reading.roll
    wheels = (
        reading.wheel_speeds[0]
        + reading.wheel_speeds[1]
        + reading.wheel_speeds[2]
        + reading.wheel_speeds[3]
    )
    if not math.isfinite(
        pose + reading.board_m + reading.board_force_n + reading.hinge_rad + wheels
    ):
        return state.NOT_FINITE
    if max(abs(reading.pitch), abs(reading.roll)) > limits.tipped:
        return state.LEANS
    return state.RUNNING


def feels_load(reading: Record, limits: Record, felt_load_n: float) -> bool:
    """Return whether a raised board feels a good share of the lightest load's weight beyond its own."""
    raised: bool = reading.board_m > limits.board_raised
    return raised and reading.board_force_n > felt_load_n


_health_of = compiled(health_of)
_feels_load = compiled(feels_load)


@compiled
def step_cars(cars: Records, angles: Floats, readings: Records) -> int:
    """Write the commands of all cars that are not idle, (n,) of CAR; return how many compiled tasks have ended.

    ``angles`` (n, m) are of hinges over the last periods, as :func:`_hinge_law` remembers them, ``readings`` (n,) of
    READING what the cars believe to measure.
    """
    ended = 0
    for i in range(len(cars)):
        car = cars[i]
        car.now = readings[i]
        level = update_floor(car)
        if car.task.law == state.IDLE:
            continue
        if car.task.law != state.OWN:
            ended += step_task(car, angles[i])
        compensate_lag(car, level)
    return ended


@compiled
def step_task(car: Record, angles: Floats) -> int:
    """Write the command of a car for the next control period; return 1, with a zero command, if its task has ended."""
    task = car.task
    _clear(car.command)
    if task.law == state.HOLD:
        _hold_law(car)
        return 0
    if task.status == state.RUNNING:
        status = _health_of(car.now, car.known.health)
        if status != state.RUNNING:
            _end(task, status, car.now.pitch, car.now.roll)
    if task.status == state.RUNNING:
        task.feels_load = _feels_load(car.now, car.known.health, car.known.car.felt_load_n)
        if task.law == state.DRIVE:
            _drive_law(car)
        elif task.law == state.BOARD:
            _board_law(car)
        elif task.law == state.HINGE:
            _hinge_law(car, angles)
        elif task.law == state.STOP:
            _stop_law(car)
        task.elapsed_s += car.known.period_s
    if task.status == state.RUNNING:
        return 0
    _clear(car.command)
    return 1


@compiled
def _clear(command: Record) -> None:
    for wheel in range(4):
        command.wheels[wheel] = 0.0
    command.board = command.hinge = 0.0


@compiled
def _end(task: Record, status: int, detail: float, second_detail: float) -> None:
    """End a task with a status and two numbers for its text, 0.0 for none; a second call overrides the first."""
    task.status = status
    task.ended_s = task.elapsed_s
    task.detail = detail
    task.second_detail = second_detail


@compiled
def compensate_lag(car: Record, level: bool) -> None:
    """Change the commands of wheels so that their lagging servos have these speeds after one control period.

    Four zeros brake at once. The lag is that of the candidate whose simulated servos are closest to the measured wheel
    speeds (least squares). ``level``: on a slope wheels follow their servos only as far as they have grip.
    """
    lag = car.lag
    wheels = car.command.wheels
    turning = car.now.wheel_speeds
    constants = car.known.car
    if level:
        for wheel in range(4):
            servo = _servo_speed(lag, wheel)
            # A wheel that is further behind its servo lacks torque or grip, which says nothing of the lag.
            most_behind = constants.wheel_torque_nm / constants.wheel_gain_nms_rad
            if lag.sent[wheel] != 0.0 and abs(servo - turning[wheel]) < most_behind:
                for k in range(state.N_LAGS):
                    off = turning[wheel] - lag.servos[k, wheel]
                    lag.mismatches[k] += (off / _UNSURE_RAD_S) ** 2
        lag.steps, _ = delay_of(lag.mismatches[:])
    lag_s = lag.steps * LAG_STEP_S
    share = 1 - math.exp(-car.known.period_s / lag_s) if lag_s > 0 else 1.0
    stopped = wheels[0] == 0.0 and wheels[1] == 0.0 and wheels[2] == 0.0 and wheels[3] == 0.0
    limit = constants.wheel_speed_rad_s
    for wheel in range(4):
        servo = _servo_speed(lag, wheel)
        if not stopped:
            wheels[wheel] = max(-limit, min(limit, servo + (wheels[wheel] - servo) / share))
        lag.sent[wheel] = wheels[wheel]
        for k in range(state.N_LAGS):
            approach = 1.0 if stopped else lag.shares[k]
            lag.servos[k, wheel] += approach * (wheels[wheel] - lag.servos[k, wheel])


@compiled
def _servo_speed(lag: Record, wheel: int) -> float:
    """Return the present speed of a wheel's servo, interpolated between two candidates for its lag."""
    below = min(math.floor(lag.steps), state.N_LAGS - 2)
    fraction = lag.steps - below
    speed: float = (
        lag.servos[below, wheel] * (1 - fraction) + lag.servos[below + 1, wheel] * fraction
    )
    return speed


@compiled
def _hold_law(car: Record) -> None:
    """Command the wheels of a car that is parked on an incline, so that it stays there.

    A drive at zero speed yields slowly to torque: the wheels turn back as far. A car on two wheels of a diagonal also
    creeps along their rollers: it drives back when its pose shows that for long enough.
    """
    reading = car.now
    task = car.task
    constants = car.known
    hold = constants.hold
    drive = constants.drive
    if not task.sure:
        # A car that starts on an incline has seen a single localisation: what that is off by is no creep.
        task.held.x = reading.x
        task.held.y = reading.y
        task.held.heading = reading.heading
        task.sure = reading.position_std_m < drive.position_certainty
    error = (
        task.held.x - reading.x,
        task.held.y - reading.y,
        wrap(task.held.heading - reading.heading),
    )
    offset = math.hypot(error[0], error[1])
    turn = abs(error[2])
    task.crept_s = (
        task.crept_s + constants.period_s
        if offset > hold.crept or turn > hold.crept_heading
        else 0.0
    )
    if not task.returning and task.crept_s > hold.crept_time:
        task.returning = 1
        task.elapsed_s = 0.0
        task.drive.integral.x = task.drive.integral.y = task.drive.integral.heading = 0.0
    elif task.returning and offset < drive.position_tolerance and turn < drive.heading_tolerance:
        task.returning = 0
        for wheel in range(4):
            task.turned[wheel] = 0.0
    if task.returning:
        task.drive.loaded = _feels_load(reading, constants.health, constants.car.felt_load_n)
        _command_wheels(car, error)
        task.elapsed_s += constants.period_s
        return
    for wheel in range(4):
        task.turned[wheel] += reading.wheel_speeds[wheel] * constants.period_s
        if abs(task.turned[wheel]) > hold.dead_band:
            car.command.wheels[wheel] = -hold.gain * task.turned[wheel]


@compiled
def _stop_law(car: Record) -> None:
    task = car.task
    wheels = car.now.wheel_speeds
    gains = car.known.stop
    fastest = 0.0
    for wheel in range(4):
        fastest = max(fastest, abs(wheels[wheel]))
    if task.elapsed_s > 0 and fastest < gains.wheels_at_rest:
        _end(task, state.SUCCEEDED, 0.0, 0.0)
    elif task.elapsed_s > gains.allowance:
        _end(task, state.WHEELS_TURN, 0.0, 0.0)


@compiled
def _board_law(car: Record) -> None:
    reading = car.now
    task = car.task
    gains = car.known.board
    period_s = car.known.period_s
    board = task.board
    remaining = board.target_m - reading.board_m
    still = abs(reading.board_m - board.last_m) < gains.still * period_s
    board.last_m = reading.board_m
    if abs(remaining) < gains.reached and still and task.elapsed_s > 0:
        missing = board.needs_load and not task.feels_load
        _end(task, state.NO_LOAD if missing else state.SUCCEEDED, reading.board_force_n, 0.0)
    elif task.elapsed_s > board.deadline_s:
        _end(task, state.BOARD_SHORT, remaining * 1e3, 0.0)
    limit = min(car.known.car.board_speed_m_s, abs(board.speed) + gains.acceleration * period_s)
    board.speed = max(-limit, min(limit, gains.gain * remaining))
    car.command.board = board.speed


@compiled
def _hinge_law(car: Record, angles: Floats) -> None:
    """Command a hinge's speed towards its end, or end the task; ``angles`` are those over which it must be still."""
    reading = car.now
    task = car.task
    gains = car.known.hinge
    period_s = car.known.period_s
    hinge = task.hinge
    remaining = hinge.target_rad - reading.hinge_rad
    if hinge.slope < 0 and reading.slope >= 0:
        # The first slope that a reading shows.
        hinge.slope = reading.slope
        travel = abs(remaining)
        hinge.deadline_s = (
            task.elapsed_s + travel / car.known.car.hinge_speed_rad_s + gains.allowance
        )
    if reading.slope < 0 or reading.slope != hinge.slope:
        # A plug may chatter.
        hinge.undocked_s += period_s
        if hinge.undocked_s > gains.undocked:
            _end(task, state.UNDOCKED, 0.0, 0.0)
        return
    hinge.undocked_s = 0.0
    # The angle of some periods ago stands where the one after this will be noted.
    angles[hinge.n_past % len(angles)] = reading.hinge_rad
    hinge.n_past += 1
    moved = abs(reading.hinge_rad - angles[hinge.n_past % len(angles)])
    still = hinge.n_past >= len(angles) and moved < gains.still * gains.still_time
    reached = gains.reached
    if hinge.target_rad == 0.0 and car.known.drive.astray < CELL_PITCH_M:
        reached = max(reached, _RESTS_RAD)
    if abs(remaining) < reached and still:
        _end(task, state.SUCCEEDED, 0.0, 0.0)
    elif task.elapsed_s > hinge.deadline_s:
        _end(task, state.HINGE_SHORT, remaining, 0.0)
    limit = min(car.known.car.hinge_speed_rad_s, abs(hinge.speed) + gains.acceleration * period_s)
    hinge.speed = max(-limit, min(limit, gains.gain * remaining))
    car.command.hinge = hinge.speed


@compiled
def _drive_law(car: Record) -> None:
    reading = car.now
    task = car.task
    constants = car.known
    drive = task.drive
    gains = constants.drive
    period_s = constants.period_s
    if drive.loaded:
        # Shorter dips of what the board feels come from bumps and acceleration.
        drive.unloaded_s = 0.0 if task.feels_load else drive.unloaded_s + period_s
        if drive.unloaded_s > constants.health.load_lost:
            _end(task, state.LOAD_MISSED, reading.board_force_n, 0.0)
    error = (
        drive.path[0] - reading.x,
        drive.path[1] - reading.y,
        wrap(drive.path[2] - reading.heading),
    )
    _check_progress(car, error)
    elapsed_s = task.elapsed_s - drive.waited_s
    if elapsed_s >= drive.ends_s:
        # There it has to rest, and to be sure that it is there.
        offset = math.hypot(error[0], error[1])
        turn = abs(error[2])
        factor = grown(drive, gains, elapsed_s)
        is_uneven = gains.astray < CELL_PITCH_M
        if is_uneven and not drive.loaded:
            factor = 1.0
        on_target = (
            offset < factor * gains.position_tolerance and turn < factor * gains.heading_tolerance
        )
        certainty_m = factor * gains.position_certainty
        if is_uneven:
            certainty_m = min(certainty_m, _CERTAIN_M)
        certain = reading.position_std_m < certainty_m
        certain = certain and reading.heading_std_rad < factor * gains.heading_certainty
        # A car that is shaken stops to look: wheels that touch nothing turn, which odometry takes for motion.
        share = _NEAR if drive.near_periods else _AMID
        near = offset < share * factor * gains.position_tolerance
        near = near and turn < share * factor * gains.heading_tolerance
        is_shaken = elapsed_s > drive.ends_s + gains.shake_after
        if is_uneven and near and (is_shaken or not drive.loaded):
            drive.near_periods += 1
        else:
            drive.near_periods = 0
        if on_target and certain:
            drive.there_periods += 1
        else:
            drive.there_periods = 0
        if drive.there_periods and drive.at_rest:
            drive.rest_periods += 1
        else:
            drive.rest_periods = 0
        if drive.centres:
            stands = drive.rest_periods >= gains.rest_periods and drive.n_lean >= _LEAN_PERIODS
            if stands or elapsed_s > drive.ends_s + _CENTRING_S:
                task.law = state.BOARD
                task.board.deadline_s += task.elapsed_s
                task.board.last_m = reading.board_m
                return
        elif drive.rest_periods >= gains.rest_periods:
            _end(task, state.SUCCEEDED, 0.0, 0.0)
        elif elapsed_s > drive.ends_s + gains.settle_allowance:
            status = state.RESTS_OFF_TARGET if drive.at_rest else state.MOVES_OFF_TARGET
            # Where a wheel rolls into a joint between tiles, a further try ends there, too.
            beside_m = offset + constants.car.lever_m * turn
            harmless_m = _HARMLESS_M
            if drive.loaded:
                harmless_m = _HARMLESS_LOADED_M
            if is_uneven and beside_m < harmless_m:
                status = state.SUCCEEDED
            _end(task, status, offset * 1e3, turn * 1e3)
    brakes = drive.near_periods > _NEAR_PERIODS or drive.there_periods > gains.brake_periods
    if task.status == state.RUNNING and not brakes:
        _command_wheels(car, error)
    if drive.waits:
        # A car on two wheels of a diagonal drifts aside until the others touch the floor: the further it is beside the
        # path, the slower the path goes on, until it stops. The pace changes gradually, because hard braking makes the
        # car rock. The total wait is limited; the car then corrects its position at the end.
        beside_m = abs(drive.step_x * error[1] - drive.step_y * error[0])
        on_its_way = elapsed_s < drive.ends_s and drive.waited_s <= gains.settle_allowance
        behind_m = drive.step_x * error[0] + drive.step_y * error[1]
        astray_m = max(beside_m, behind_m / _BEHIND)
        pace = max(0.0, min(1.0, 2.0 - astray_m / gains.astray)) if on_its_way else 1.0
        drive.pace += max(-_BRAKES * period_s, min(_RECOVERS * period_s, pace - drive.pace))
        drive.waited_s += (1.0 - drive.pace) * period_s
        elapsed_s = task.elapsed_s - drive.waited_s
    for wheel in range(4):
        drive.commanded[wheel] = car.command.wheels[wheel]
    start = drive.origin
    step = drive.direction
    distance = _distance_at(drive.profile, elapsed_s + period_s - drive.begins_s)
    share_aside, _ = _share_aside(drive, elapsed_s + period_s)
    drive.path[0] = start.x + step.x * distance + share_aside * drive.aside_x
    drive.path[1] = start.y + step.y * distance + share_aside * drive.aside_y
    drive.path[2] = start.heading + step.heading * distance
    if elapsed_s >= drive.ends_s - _LEAN_PERIODS * period_s:
        _stand_upright(car)


@compiled
def _share_aside(drive: Record, elapsed_s: float) -> tuple[float, float]:
    """Return by which share of its way aside a path leads beside the straight one, and how fast that grows, in 1/s."""
    if drive.begins_s == 0.0:
        return 0.0, 0.0
    # How far it has gone aside, or how far it is from being back.
    u = min(elapsed_s, drive.ends_s - elapsed_s) / drive.begins_s
    if not 0.0 < u < 1.0:
        return max(0.0, min(1.0, u)), 0.0
    rate = 6 * u * (1 - u) / drive.begins_s
    return u * u * (3 - 2 * u), rate if elapsed_s < drive.ends_s / 2 else -rate


@compiled
def _stand_upright(car: Record) -> None:
    """Move the end of a path where the floor leans.

    A load, or what is above and may be lifted, is then beside its cell's middle as much at its foot as at its top.
    """
    drive = car.task.drive
    reading = car.now
    is_above = False
    for k in range(4):
        is_above = is_above or math.isfinite(reading.lines[k])
    if car.known.drive.astray >= CELL_PITCH_M or not (drive.loaded or is_above):
        return
    pitch, roll = lean_of(car, drive.end_rad)
    c = math.cos(reading.heading)
    s = math.sin(reading.heading)
    drive.n_lean += 1
    share = 1.0 / min(drive.n_lean, _LEAN_PERIODS)
    drive.lean_x += share * (c * pitch - s * roll - drive.lean_x)
    drive.lean_y += share * (s * pitch + c * roll - drive.lean_y)
    height_m = _UPRIGHT_M * min(1.0, drive.n_lean / _LEAN_PERIODS)
    drive.path[0] += height_m * drive.lean_x
    drive.path[1] += height_m * drive.lean_y


@compiled
def _command_wheels(car: Record, error: Triple) -> None:
    """Command what wheel speeds follow the path, for an error of pose in the world frame."""
    reading = car.now
    drive = car.task.drive
    constants = car.known
    elapsed_s = car.task.elapsed_s - drive.waited_s
    gains = constants.drive
    machine = constants.car
    step = drive.direction
    integral = drive.integral
    profile = drive.profile
    period_s = constants.period_s
    radius_m = machine.radius_m
    lever_m = machine.lever_m
    if drive.ends_s < elapsed_s <= drive.ends_s + gains.shake_after:
        integral.x += gains.integral_gain * error[0] * period_s
        integral.y += gains.integral_gain * error[1] * period_s
        integral.heading += gains.integral_gain * error[2] * period_s
    elif elapsed_s > drive.ends_s:
        # A car that is shaken would wind it up; and what is left of its arrival would keep it beside the target.
        integral.x = integral.y = integral.heading = 0.0
    # The command holds for one period, so the path's motion in the middle of that period is fed forward.
    middle_s = elapsed_s + period_s / 2 - _EARLY_S
    speed, pull = _motion_at(profile, middle_s - drive.begins_s)
    _, aside_rate = _share_aside(drive, middle_s)
    if drive.waits:
        speed = drive.pace * speed
        pull = drive.pace * pull
        aside_rate = drive.pace * aside_rate
        # Speeding up and slowing down loads a third wheel, which can push to the side, but on two wheels leads aside.
        # So only while the path waits, and where one to a side starts: at rest on a diagonal a car goes askew.
        if elapsed_s < drive.ends_s:
            beside_m = abs(drive.step_x * error[1] - drive.step_y * error[0])
            share = (1.0 - drive.pace) * max(0.0, min(1.0, beside_m / gains.astray - 0.5))
            way_m = drive.step_x * (reading.x - drive.origin.x) + drive.step_y * (
                reading.y - drive.origin.y
            )
            sideways = abs(
                drive.step_x * math.sin(reading.heading) - drive.step_y * math.cos(reading.heading)
            )
            share = max(share, sideways * max(0.0, min(1.0, 1.5 - way_m / _START_M)))
            speed += (
                share
                * gains.shake_speed
                * math.sin(2 * math.pi * gains.shake_rate * car.task.elapsed_s)
            )
    shake_x, shake_y = shake(drive, gains, error, elapsed_s)
    correct_x = gains.position_gain * error[0]
    correct_y = gains.position_gain * error[1]
    if drive.waits:
        fastest = _CATCHES_UP * gains.astray
        along = max(-fastest, min(fastest, drive.step_x * correct_x + drive.step_y * correct_y))
        aside = drive.step_x * correct_y - drive.step_y * correct_x
        aside *= _ASIDE if elapsed_s < drive.ends_s else 1.0
        correct_x = drive.step_x * along - drive.step_y * aside
        correct_y = drive.step_y * along + drive.step_x * aside
    velocity = (
        step.x * speed + drive.aside_x * aside_rate + correct_x + integral.x + shake_x,
        step.y * speed + drive.aside_y * aside_rate + correct_y + integral.y + shake_y,
        step.heading * speed + gains.heading_gain * error[2] + integral.heading,
    )
    forward, leftward, turn = _to_body(velocity, reading)
    speeds = on_wheels(forward / radius_m, leftward / radius_m, lever_m * turn / radius_m)
    # Where the ground bends, at the cell border, the axles roll on different inclines, with the same speed along the
    # stiff body. An axle on ground at an angle a to the body rolls faster by 1 / cos(a).
    front = rear = 1.0
    if drive.sloping:
        origin = drive.origin
        delta = drive.delta
        past_x = reading.x - origin.x - delta.x / 2
        past_y = reading.y - origin.y - delta.y / 2
        past_border = past_x * drive.step_x + past_y * drive.step_y
        nose_along = (
            math.cos(reading.heading) * drive.step_x + math.sin(reading.heading) * drive.step_y
        )
        reach = machine.wheel_x_m * nose_along * math.cos(reading.pitch)
        front_rad = drive.end_rad if past_border + reach > 0 else drive.start_rad
        rear_rad = drive.end_rad if past_border - reach > 0 else drive.start_rad
        front = 1 / math.cos(front_rad - reading.pitch)
        rear = 1 / math.cos(rear_rad - reading.pitch)
    load_kg = max(0.0, reading.board_force_n) / GRAVITY if drive.loaded else 0.0
    mass = machine.mass_kg + load_kg
    weight = mass * GRAVITY
    inertia = mass + machine.spin_mass_kg
    forward, leftward, turn = _to_body((step.x * pull, step.y * pull, step.heading * pull), reading)
    quarter = radius_m / 4
    torques = on_wheels(
        quarter * (inertia * forward + weight * math.sin(reading.pitch)),
        quarter * (inertia * leftward + weight * math.sin(reading.roll)),
        quarter * (machine.turn_inertia_kgm2 * turn) / lever_m,
    )
    for wheel in range(4):
        turning = speeds[wheel] * (front if wheel < 2 else rear)
        torque = torques[wheel] + machine.gear_friction_nm * math.tanh(
            turning / gains.friction_speed
        )
        # A velocity servo gives a torque when it lags behind its command by that torque over its gain.
        car.command.wheels[wheel] = turning + torque / machine.wheel_gain_nms_rad


@compiled
def grown(drive: Record, gains: Record, elapsed_s: float) -> float:
    """Return the factor of the amplitude of shaking, and of all tolerances, for a car whose wheels rest in joints; 1
    for one that is not shaken."""
    cycles = max(0.0, (elapsed_s - drive.ends_s - gains.shake_after) * gains.shake_rate)
    return min(
        _MOST_GROWN, 1.0 + (_GROWS_BESIDE if drive.waits else _GROWS) * math.floor(cycles / 4)
    )


@compiled
def shake(drive: Record, gains: Record, error: Triple, elapsed_s: float) -> tuple[float, float]:
    """Return the velocity (m/s, world frame) that shakes a car which does not arrive, across the remaining way.

    A car without springs that rocks on two wheels of a diagonal cannot push across their rollers; accelerating the
    other way tips it onto the other two. It shakes for two cycles out of four, and settles in between; the longer it
    takes, the harder.
    """
    cycles = (elapsed_s - drive.ends_s - gains.shake_after) * gains.shake_rate
    left_over = math.hypot(error[0], error[1])
    factor = grown(drive, gains, elapsed_s)
    amplitude = factor
    if drive.under:
        # Its boss would shove what stands above.
        amplitude = min(factor, _MOST_GROWN_UNDER)
    # A car that is there and not yet sure of it has to rest.
    if (
        drive.centres
        or cycles <= 0
        or left_over < factor * gains.position_tolerance
        or math.floor(cycles) % 4 >= 2
    ):
        return 0.0, 0.0
    speed = amplitude * gains.shake_speed * math.cos(2 * math.pi * cycles) / left_over
    return -speed * error[1], speed * error[0]


@compiled
def _to_body(vector: Triple, reading: Record) -> Triple:
    """Turn a horizontal world vector (x, y, rotation) into the body frame; on an incline forward is longer."""
    c = math.cos(reading.heading)
    s = math.sin(reading.heading)
    forward = c * vector[0] + s * vector[1]
    leftward = -s * vector[0] + c * vector[1]
    return forward / math.cos(reading.pitch), leftward / math.cos(reading.roll), vector[2]


@compiled
def _check_progress(car: Record, error: Triple) -> None:
    """End the task of a driving car that is blocked or slips, and note whether it rests.

    Wheels that turn although the car does not follow either slip or spin at an obstacle. Their force tells: the torques
    less friction, the wheels' inertia and the weight on an incline would have moved a free car some way. If the car
    stays far behind that way, too, there is an obstacle.
    """
    reading = car.now
    drive = car.task.drive
    constants = car.known
    gains = constants.drive
    machine = constants.car
    period_s = constants.period_s
    wheels = reading.wheel_speeds
    torques = drive.torques
    lever_m = machine.lever_m
    lag_record = drive.behind
    before = drive.before
    radius_m = machine.radius_m
    rolled = _length(
        lever_m, body_twist(lever_m, radius_m, wheels[0], wheels[1], wheels[2], wheels[3])
    )
    # The car rests when the wheels together say so, or when three of them do: the fourth may slip on the spot.
    # Localisations jitter, so they do not tell.
    fl = abs(wheels[0])
    fr = abs(wheels[1])
    rl = abs(wheels[2])
    rr = abs(wheels[3])
    second_fastest = max(min(max(fl, fr), max(rl, rr)), max(min(fl, fr), min(rl, rr)))
    drive.at_rest = rolled < gains.speed_at_rest or second_fastest < gains.wheels_at_rest
    body_error = _to_body(error, reading)
    if (
        math.hypot(body_error[0], body_error[1]) + lever_m * abs(body_error[2])
        <= gains.blocked_error
    ):
        lag_record.stuck_s = lag_record.rolled_m = lag_record.moved_m = lag_record.free_m_s = (
            lag_record.free_m
        ) = 0.0
    else:
        lag_record.stuck_s += period_s
        moved = (reading.x - before.x, reading.y - before.y, wrap(reading.heading - before.heading))
        lag_record.moved_m += _length(lever_m, moved)
        lag_record.rolled_m += rolled * period_s
        # With what wrench (N, N, Nm), in its own frame, the wheels push the car beyond its weight.
        for wheel in range(4):
            limit = machine.wheel_speed_rad_s
            commanded = max(-limit, min(limit, drive.commanded[wheel]))
            lag = machine.wheel_gain_nms_rad * (commanded - wheels[wheel])
            applied = max(-machine.wheel_torque_nm, min(machine.wheel_torque_nm, lag))
            lost = machine.gear_friction_nm * math.tanh(wheels[wheel] / gains.friction_speed)
            spun_up = (
                machine.wheel_inertia_kgm2 * (wheels[wheel] - drive.wheels_before[wheel]) / period_s
            )
            torques[wheel] = applied - lost - spun_up
        x, y, turn = wrench_of(lever_m, radius_m, torques[0], torques[1], torques[2], torques[3])
        mass_kg = machine.mass_kg + drive.load_kg
        weight = mass_kg * GRAVITY
        x = x - weight * math.sin(reading.pitch)
        y = y - weight * math.sin(reading.roll)
        # How a free car would speed up towards where it should be.
        turning = turn / machine.turn_inertia_kgm2 * lever_m**2
        towards = (
            x / mass_kg * body_error[0] + y / mass_kg * body_error[1] + turning * body_error[2]
        )
        lag_record.free_m_s += towards / _length(lever_m, body_error) * period_s
        lag_record.free_m += lag_record.free_m_s * period_s
        if lag_record.stuck_s > gains.blocked_time:
            enough = gains.slip_ratio * lag_record.moved_m + gains.slip_distance
            slips = lag_record.rolled_m > enough and enough >= lag_record.free_m
            behind_m = math.hypot(error[0], error[1]) + lever_m * abs(error[2])
            _end(car.task, state.SLIPPED if slips else state.BLOCKED, behind_m * 1e3, 0.0)
    before.x = reading.x
    before.y = reading.y
    before.heading = reading.heading
    for wheel in range(4):
        drive.wheels_before[wheel] = wheels[wheel]


@compiled
def _length(lever_m: float, displacement: Triple) -> float:
    """Return the length of a way (m, m, rad) in metres, a turn by what the wheels roll for it."""
    return math.sqrt(
        displacement[0] * displacement[0]
        + displacement[1] * displacement[1]
        + (lever_m * displacement[2]) ** 2
    )
