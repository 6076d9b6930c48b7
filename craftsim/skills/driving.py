"""Driving skills: move to the neighbour cell, and turn by a quarter.

Both follow a smooth path from the measured pose to the target pose (:mod:`craftsim.skills.driving_law`). Speed and
acceleration keep to the gains' limits, and to what the car's motors can give.
"""

from __future__ import annotations

import math
from abc import abstractmethod

import numpy as np

from craftsim.discrete.geometry import CELL_PITCH_M, DIRECTIONS, yaw_angle
from craftsim.discrete.readback import nearest_yaw
from craftsim.models.measuring import CarMeasurement
from craftsim.skills.driving_law import drive_law
from craftsim.skills.mecanum import Triple
from craftsim.skills.profile import Profile
from craftsim.skills.skill import CompiledSkill, SkillSetup
from craftsim.skills.state import DRIVE, GRAVITY


class DrivingSkill(CompiledSkill):
    """Follow a smooth path of poses to a target pose and come to rest on it."""

    def __init__(self, setup: SkillSetup) -> None:
        """Prepare for this car, world and tuning."""
        super().__init__(setup, drive_law, DRIVE)
        self.gains = setup.gains.drive
        self.car = setup.machine
        known = setup.constants[0]["car"]
        self._lever_m, self._mass_kg = float(known["lever_m"]), float(known["mass_kg"])
        self._spin_mass_kg = float(known["spin_mass_kg"])
        self._turn_inertia_kgm2 = float(known["turn_inertia_kgm2"])

    def _begin(self, now: CarMeasurement) -> None:
        """Lay the path from the measured pose to the target pose."""
        self._start = now
        self._loaded = self.feels_load(now)
        self._load_kg = max(0.0, now.board_force_n) / GRAVITY if self._loaded else 0.0
        x, y, heading = self._target(now)
        self._delta = (x - now.x, y - now.y, math.remainder(heading - now.heading, math.tau))
        profile = self._make_profile()
        travel = profile.distance(profile.duration_s)
        drive = self.task[0]["drive"]
        drive["origin"] = now.x, now.y, now.heading
        drive["delta"] = self._delta
        drive["direction"] = tuple(d / travel for d in self._delta) if travel else (0.0, 0.0, 0.0)
        drive["profile"] = profile.cruise_speed, profile.ramp_s, profile.duration_s
        drive["path"] = now.x, now.y, now.heading
        drive["load_kg"], drive["loaded"] = self._load_kg, self._loaded
        drive["before"], drive["wheels_before"] = drive["origin"], now.wheel_speeds

    @abstractmethod
    def _target(self, now: CarMeasurement) -> Triple:
        """Return the target pose (x, y, heading) in the world frame."""

    @abstractmethod
    def _make_profile(self) -> Profile:
        """Return the profile along the path, in metres or radians."""

    def _motor_limits(self, incline_rad: float = 0.0) -> tuple[float, float]:
        """Return the speed (m/s) and the force (N) that the wheels can give, less a reserve and what gears take."""
        car, share = self.car, self.gains.motor_share
        torque = share * car.wheel_torque_nm - car.gear_friction_nm
        weight = (self._mass_kg + self._load_kg) * GRAVITY
        force = 4 * torque / car.wheel_radius_m - weight * math.sin(abs(incline_rad))
        return share * car.wheel_speed_rad_s * car.wheel_radius_m, max(force, 1.0)


def cell_middle(now: CarMeasurement, yaw: int, along_x: int = 0, along_y: int = 0) -> Triple:
    """Return the middle of the cell so many away from the one that a car is in, and the heading of a yaw."""
    x, y = math.floor(now.x / CELL_PITCH_M) + along_x, math.floor(now.y / CELL_PITCH_M) + along_y
    return (x + 0.5) * CELL_PITCH_M, (y + 0.5) * CELL_PITCH_M, yaw_angle(yaw)


class Move(DrivingSkill):
    """Drive from the cell that the car is in to its neighbour in a map direction, keeping the heading."""

    def __init__(self, setup: SkillSetup, direction: int) -> None:
        """Prepare to move in a grid direction 0..3 (+x, +y, -x, -y); a move from or onto a slope is slower."""
        super().__init__(setup)
        self.direction = direction
        self.terrain = terrain = setup.terrain
        drive = self.task[0]["drive"]
        drive["step_x"], drive["step_y"] = DIRECTIONS[direction]
        drive["sloping"], drive["start_rad"], drive["end_rad"] = (
            *(terrain.sloping, terrain.start_rad, terrain.end_rad),
        )

    def _target(self, now: CarMeasurement) -> Triple:
        yaw, _ = nearest_yaw(now.heading)
        return cell_middle(now, yaw, *DIRECTIONS[self.direction].tolist())

    def _make_profile(self) -> Profile:
        gains = self.gains
        factor = gains.load_factor if self._loaded else 1.0
        speed, acceleration = gains.max_speed, gains.max_acceleration
        if self.terrain.sloping:
            speed, acceleration = gains.max_slope_speed, gains.max_slope_acceleration
        if self.terrain.tight:
            speed = min(speed, gains.max_tight_speed)
            acceleration = min(acceleration, gains.max_tight_acceleration)
            if self.terrain.sloping and self._loaded:
                acceleration = min(acceleration, gains.max_tight_slope_acceleration)
        steepest = max(abs(self.terrain.start_rad), abs(self.terrain.end_rad))
        top_speed, force = self._motor_limits(steepest)
        most = force / (self._mass_kg + self._load_kg + self._spin_mass_kg)
        if self._start.z > 0:
            most = min(most, gains.rocking / self._start.z**2)
        distance = float(np.hypot(self._delta[0], self._delta[1]))
        return Profile.within(distance, min(speed * factor, top_speed), min(acceleration * factor, most))


class Rotate(DrivingSkill):
    """Turn on the spot by a quarter, left (counter-clockwise) or right."""

    def __init__(self, setup: SkillSetup, quarter: int) -> None:
        """Prepare to turn by +1 (left) or -1 (right) quarter."""
        super().__init__(setup)
        self.quarter = quarter

    def _target(self, now: CarMeasurement) -> Triple:
        yaw, _ = nearest_yaw(now.heading)
        return cell_middle(now, yaw + self.quarter)

    def _make_profile(self) -> Profile:
        gains = self.gains
        factor = gains.load_factor if self._loaded else 1.0
        top_speed, force = self._motor_limits()
        return Profile.within(
            abs(float(self._delta[2])),
            min(gains.max_turn_speed * factor, top_speed / self._lever_m),
            min(gains.max_turn_acceleration * factor, force * self._lever_m / self._turn_inertia_kgm2),
        )
