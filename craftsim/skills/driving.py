"""Driving skills: move to the neighbour cell, and turn by a quarter.

Both follow a smooth path from the measured pose to the target pose. The wheels get the path's speed (feed-forward),
a correction proportional to the pose error with integral action near the goal, and on top what the velocity servos need
to overcome the gears' dry friction, gravity on an incline, and inertia. Speed and acceleration keep to the gains'
limits, and to what the car's motors can give.
"""

from __future__ import annotations

import math
from abc import abstractmethod

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.geometry import CELL_PITCH_M, DIRECTIONS, cell_position, yaw_angle
from craftsim.discrete.readback import nearest_yaw
from craftsim.models.sensing import CarMeasurement, PerWheel
from craftsim.skills.mecanum import Mecanum, Triple
from craftsim.skills.outcome import Reason
from craftsim.skills.profile import Profile
from craftsim.skills.progress import Progress
from craftsim.skills.skill import GRAVITY, Command, Skill, SkillSetup


def wrap(angle: float) -> float:
    """Return an angle in radians brought into [-pi, pi]."""
    return math.remainder(angle, math.tau)


class DrivingSkill(Skill):
    """Follow a smooth path of poses to a target pose and come to rest on it."""

    def __init__(self, setup: SkillSetup) -> None:
        """Prepare for this car, world and tuning."""
        super().__init__(setup)
        self.gains = setup.gains.drive
        self.car = car = setup.machine
        self.kinematics = Mecanum(car)
        self._lever_m = car.turn_radius_m
        self._mass_kg = car.mass_kg
        # What the spin of the four wheels and their motors adds to the car's inertia, as a mass.
        self._spin_mass_kg = (
            4 * (car.wheel_spin_inertia_kgm2 + car.wheel_armature_kgm2) / car.wheel_radius_m**2
        )
        # About the vertical axis, the spin of the wheels included.
        self._turn_inertia_kgm2 = (
            car.chassis_mass_kg * (car.chassis_length_m**2 + car.chassis_width_m**2) / 12
            + 4 * car.wheel_mass_kg * (car.wheel_x_m**2 + car.wheel_y_m**2)
            + self._spin_mass_kg * car.turn_radius_m**2
        )
        self._integral = (0.0, 0.0, 0.0)
        self._rest_periods = self._there_periods = 0
        self._at_rest = False
        self._progress = Progress(car, self.gains, setup.period_s)
        self._commanded: PerWheel = (0.0, 0.0, 0.0, 0.0)

    def _begin(self, now: CarMeasurement) -> None:
        """Lay the path from the measured pose to the target pose."""
        self._loaded = self.feels_load(now)
        self._load_kg = max(0.0, now.board_force_n) / GRAVITY if self._loaded else 0.0
        self._before = now
        self._origin = (now.x, now.y, now.heading)
        x, y, heading = self._target(now).tolist()
        self._delta = (x - now.x, y - now.y, wrap(heading - now.heading))
        self._profile = self._make_profile()
        travel = self._profile.distance(self._profile.duration_s)
        self._direction = _divided(self._delta, travel) if travel else (0.0, 0.0, 0.0)

    @abstractmethod
    def _target(self, now: CarMeasurement) -> NDArray[np.float64]:
        """Return the target pose (x, y, heading), shape (3,), in the world frame."""

    @abstractmethod
    def _make_profile(self) -> Profile:
        """Return the profile along the path, in metres or radians."""

    def _control(self, now: CarMeasurement) -> Command:
        if self._loaded:
            self._check_load(now)
        x, y, heading = self._reference(self.elapsed_s)
        error = (x - now.x, y - now.y, wrap(heading - now.heading))
        self._check_progress(now, error)
        if self.elapsed_s >= self._profile.duration_s:
            self._check_arrival(now, error)
        if self.outcome is not None or self._there_periods > self.gains.brake_periods:
            self._commanded = (0.0, 0.0, 0.0, 0.0)
        else:
            self._commanded = self._wheels(now, error)
        return Command(wheels=self._commanded)

    def _reference(self, t: float) -> Triple:
        (x, y, heading), (dx, dy, dh) = self._origin, self._direction
        way = self._profile.distance(t)
        return x + dx * way, y + dy * way, heading + dh * way

    def _wheels(self, now: CarMeasurement, error: Triple) -> PerWheel:
        # The command holds for one period, so the path's motion in the middle of that period is fed forward.
        gains, t = self.gains, self.elapsed_s + self.period_s / 2
        if self.elapsed_s > self._profile.duration_s:
            ix, iy, ih = self._integral
            x, y, heading = (gains.integral_gain * e * self.period_s for e in error)
            self._integral = (ix + x, iy + y, ih + heading)
        speed = self._profile.speed(t)
        (dx, dy, dh), (ex, ey, eh), (ix, iy, ih) = self._direction, error, self._integral
        velocity = (
            dx * speed + gains.position_gain * ex + ix,
            dy * speed + gains.position_gain * ey + iy,
            dh * speed + gains.heading_gain * eh + ih,
        )
        forward, left, turn = _to_body(velocity, now)
        fl, fr, rl, rr = self.kinematics.wheel_speeds(
            (forward, gains.sideways_slip * left, gains.turn_slip * turn)
        )
        front, rear = self._stretch(now)
        speeds = fl * front, fr * front, rl * rear, rr * rear
        mass = self._mass_kg + (max(0.0, now.board_force_n) / GRAVITY if self._loaded else 0.0)
        weight, inertia = mass * GRAVITY, mass + self._spin_mass_kg
        forward, left, turn = _to_body(_scaled(self._direction, self._profile.acceleration(t)), now)
        torques = self.kinematics.wheel_torques(
            (
                inertia * forward + weight * math.sin(now.pitch),
                inertia * left + weight * math.sin(now.roll),
                self._turn_inertia_kgm2 * turn,
            )
        )
        fl, fr, rl, rr = map(self._command, speeds, torques)
        return fl, fr, rl, rr

    def _command(self, speed: float, torque: float) -> float:
        """Return the speed to command to a wheel's servo for a speed in rad/s and a torque in Nm beyond friction's."""
        torque += self.car.gear_friction_nm * math.tanh(speed / self.gains.friction_speed)
        # A velocity servo gives a torque when it lags behind its command by that torque over its gain.
        return speed + torque / self.car.wheel_gain_nms_rad

    def _stretch(self, now: CarMeasurement) -> tuple[float, float]:
        """Return by what factors the front and the rear wheels must outrun the body's forward speed."""
        return 1.0, 1.0

    def _motor_limits(self, incline_rad: float = 0.0) -> tuple[float, float]:
        """Return the speed (m/s) and the force (N) that the wheels can give, less a reserve and what gears take."""
        car, share = self.car, self.gains.motor_share
        torque = share * car.wheel_torque_nm - car.gear_friction_nm
        weight = (self._mass_kg + self._load_kg) * GRAVITY
        force = 4 * torque / car.wheel_radius_m - weight * math.sin(abs(incline_rad))
        return share * car.wheel_speed_rad_s * car.wheel_radius_m, max(force, 1.0)

    def _check_progress(self, now: CarMeasurement, error: Triple) -> None:
        # The car rests when the wheels together say so, or when three of them do: the fourth may slip on the spot.
        # Localisations jitter, so they do not tell.
        gains = self.gains
        x, y, turn = self.kinematics.body_twist(now.wheel_speeds)
        rolled = math.sqrt(x * x + y * y + (self._lever_m * turn) ** 2)
        third = sorted(map(abs, now.wheel_speeds))[2]
        self._at_rest = rolled < gains.speed_at_rest or third < gains.wheels_at_rest
        reason = self._progress.check(
            self._before,
            now,
            self._commanded,
            _to_body(error, now),
            self._mass_kg + self._load_kg,
            self._turn_inertia_kgm2,
        )
        self._before = now
        if reason is not None:
            behind = math.hypot(error[0], error[1]) + self._lever_m * abs(error[2])
            self._fail(reason, f"{behind * 1e3:.0f} mm behind the path")

    def _check_arrival(self, now: CarMeasurement, error: Triple) -> None:
        gains = self.gains
        offset, turn = math.hypot(error[0], error[1]), abs(error[2])
        there = offset < gains.position_tolerance and turn < gains.heading_tolerance
        sure = now.position_std_m < gains.position_certainty and now.heading_std_rad < gains.heading_certainty
        self._there_periods = self._there_periods + 1 if there and sure else 0
        self._rest_periods = self._rest_periods + 1 if self._there_periods and self._at_rest else 0
        if self._rest_periods >= gains.rest_periods:
            self._succeed()
        elif self.elapsed_s > self._profile.duration_s + gains.settle_allowance:
            reason = Reason.MISALIGNED if self._at_rest else Reason.TIMEOUT
            self._fail(reason, f"{offset * 1e3:.2f} mm and {turn * 1e3:.1f} mrad from the target")


def _scaled(vector: Triple, factor: float) -> Triple:
    return vector[0] * factor, vector[1] * factor, vector[2] * factor


def _divided(vector: Triple, by: float) -> Triple:
    return vector[0] / by, vector[1] / by, vector[2] / by


def _to_body(vector: Triple, now: CarMeasurement) -> Triple:
    """Turn a horizontal world vector (x, y, rotation) into the body frame; on an incline forward is longer."""
    c, s = math.cos(now.heading), math.sin(now.heading)
    forward, left = c * vector[0] + s * vector[1], -s * vector[0] + c * vector[1]
    return forward / math.cos(now.pitch), left / math.cos(now.roll), vector[2]


class Move(DrivingSkill):
    """Drive from the cell that the car is in to its neighbour in a map direction, keeping the heading."""

    def __init__(self, setup: SkillSetup, direction: int) -> None:
        """Prepare to move in a grid direction 0..3 (+x, +y, -x, -y); a move from or onto a slope is slower."""
        super().__init__(setup)
        self.direction = direction
        self.terrain = setup.terrain

    def _target(self, now: CarMeasurement) -> NDArray[np.float64]:
        cell = np.floor(np.array([now.x, now.y]) / CELL_PITCH_M) + DIRECTIONS[self.direction]
        yaw, _ = nearest_yaw(now.heading)
        return np.array([*cell_position(cell[0], cell[1], 1)[:2], yaw_angle(yaw)])

    def _stretch(self, now: CarMeasurement) -> tuple[float, float]:
        # Where the ground bends, at the cell border, the axles roll on different inclines, but the stiff body gives
        # both the same speed along itself: an axle on ground at an angle a to the body rolls by 1 / cos(a) faster.
        if not self.terrain.sloping:
            return 1.0, 1.0
        (x, y, _), (way_x, way_y, _) = self._origin, self._delta
        step_x, step_y = DIRECTIONS[self.direction].tolist()
        past_border = (now.x - x - way_x / 2) * step_x + (now.y - y - way_y / 2) * step_y
        forward = math.cos(now.heading) * step_x + math.sin(now.heading) * step_y
        reach = self.car.wheel_x_m * forward * math.cos(now.pitch)

        def outrun(axle: float) -> float:
            ground = self.terrain.end_rad if past_border + axle > 0 else self.terrain.start_rad
            return 1 / math.cos(ground - now.pitch)

        return outrun(reach), outrun(-reach)

    def _make_profile(self) -> Profile:
        gains = self.gains
        factor = gains.load_factor if self._loaded else 1.0
        speed, acceleration = gains.max_speed, gains.max_acceleration
        if self.terrain.sloping:
            speed, acceleration = gains.max_slope_speed, gains.max_slope_acceleration
        steepest = max(abs(self.terrain.start_rad), abs(self.terrain.end_rad))
        top_speed, force = self._motor_limits(steepest)
        most = force / (self._mass_kg + self._load_kg + self._spin_mass_kg)
        if self._before.z > 0:
            most = min(most, gains.rocking / self._before.z**2)
        distance = float(np.hypot(self._delta[0], self._delta[1]))
        return Profile.within(distance, min(speed * factor, top_speed), min(acceleration * factor, most))


class Rotate(DrivingSkill):
    """Turn on the spot by a quarter, left (counter-clockwise) or right."""

    def __init__(self, setup: SkillSetup, quarter: int) -> None:
        """Prepare to turn by +1 (left) or -1 (right) quarter."""
        super().__init__(setup)
        self.quarter = quarter

    def _target(self, now: CarMeasurement) -> NDArray[np.float64]:
        cell = np.floor(np.array([now.x, now.y]) / CELL_PITCH_M)
        yaw, _ = nearest_yaw(now.heading)
        return np.array([*cell_position(cell[0], cell[1], 1)[:2], yaw_angle(yaw + self.quarter)])

    def _make_profile(self) -> Profile:
        gains = self.gains
        factor = gains.load_factor if self._loaded else 1.0
        top_speed, force = self._motor_limits()
        return Profile.within(
            abs(float(self._delta[2])),
            min(gains.max_turn_speed * factor, top_speed / self._lever_m),
            min(gains.max_turn_acceleration * factor, force * self._lever_m / self._turn_inertia_kgm2),
        )
