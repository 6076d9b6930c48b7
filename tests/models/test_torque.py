"""Torque limits against statics: what a wheel needs to climb the slope, and the hinge to lift the flap."""

import math

import mujoco
import pytest

from craftsim.discrete.geometry import INCLINE_RAD
from craftsim.mjcf.parameters import NOMINAL
from craftsim.models.world import PhysicsWorld

SLOPE, SMARTCAR = NOMINAL.slope, NOMINAL.cars[0]

GRAVITY = 9.81
CLIMB_NM = (
    SMARTCAR.mass_kg * GRAVITY * math.sin(INCLINE_RAD) * SMARTCAR.wheel_radius_m / 4
    + SMARTCAR.gear_friction_nm
)
"""Four wheels share the weight's part along the incline, and each turns its own gear: 0.795 Nm."""
START_M = 0.005
"""A car that has come this far in a second climbs; one that has not holds, by its gears."""


@pytest.mark.parametrize(
    ("forward", "drive"), [(1, "rollers"), (-1, "rollers"), (1, "reduced"), (-1, "reduced")]
)
def test_below_the_statics_limit_a_car_cannot_climb(make_car, threshold, forward, drive):
    """The least torque limit with which the car starts uphill, nose or tail first. Band: 2 %.

    The test allows 1 s from rest, in which 1 % of excess torque moves the car by 7 mm.
    """
    car = make_car(drive)

    def climbs(torque: float) -> bool:
        car.limit(torque)
        car.rest()
        car.tilt(INCLINE_RAD, math.pi if forward > 0 else 0.0)
        start = car.position[0]
        car.run(1.0, [10.0 * forward] * 4)
        return forward * (car.position[0] - start) > START_M

    assert threshold(climbs, 0.3, 2.0) == pytest.approx(CLIMB_NM, rel=0.02)


def test_below_the_statics_limit_a_car_cannot_climb_the_real_slope(ramp, threshold):
    """The same on the compiled slope, from the middle of the flap. Band: 2 %."""
    physics = PhysicsWorld(ramp(1))
    start = physics.save()
    here = physics.free_body_state(physics.cars[0].base)[0][0]

    def climbs(torque: float) -> bool:
        physics.restore(start)
        physics.model.actuator_forcerange[physics.cars[0].wheel_actuators] = [-torque, torque]
        physics.drive(0, [10.0] * 4)
        for _ in range(50):
            physics.advance()
        return here - physics.free_body_state(physics.cars[0].base)[0][0] > START_M

    assert threshold(climbs, 0.3, 2.0) == pytest.approx(CLIMB_NM, rel=0.02)


class Flap:
    """A slope alone on the floor, and its hinge."""

    def __init__(self, open_part) -> None:
        self.model = open_part("slope")
        self.data = mujoco.MjData(self.model)
        self.hinge = self.model.joint("hinge")
        self.motor = self.model.actuator("hinge").id

    def rest(self, angle: float) -> None:
        mujoco.mj_resetData(self.model, self.data)
        self.model.actuator_forcerange[self.motor] = [-SLOPE.hinge_torque_nm, SLOPE.hinge_torque_nm]
        self.data.qpos[self.hinge.qposadr[0]] = angle
        self.data.act[0] = angle
        mujoco.mj_step(self.model, self.data, 100)

    def lever(self) -> float:
        """Return the horizontal distance of the flap's centre of mass from the hinge."""
        com = self.data.body("flap").xipos
        return float(com[0] - self.data.xanchor[self.hinge.id][0])

    def lifts(self, torque: float, angle: float) -> bool:
        self.rest(angle)
        self.model.actuator_forcerange[self.motor] = [-torque, torque]
        before = float(self.data.qpos[self.hinge.qposadr[0]])
        self.data.ctrl[self.motor] = SLOPE.hinge_speed_rad_s
        mujoco.mj_step(self.model, self.data, 250)
        return self.data.qpos[self.hinge.qposadr[0]] - before > 0.01


def lifting_torque(lever: float) -> float:
    return SLOPE.flap_mass_kg * GRAVITY * lever + SLOPE.hinge_friction_nm


@pytest.mark.parametrize("angle", [0.0, 0.3, 1.0])
def test_the_hinge_needs_the_flaps_moment_and_its_own_friction(open_part, threshold, angle):
    """In the air, and off a floor without friction: m g x_com + hinge friction. Band: 2 %."""
    flap = Flap(open_part)
    flap.model.geom_friction[:, 0] = 1e-6
    flap.rest(angle)
    expected = lifting_torque(flap.lever())
    found = threshold(lambda torque: flap.lifts(torque, angle), 0.5 * expected, 2 * expected)
    assert found == pytest.approx(expected, rel=0.02)


def test_a_rough_floor_holds_the_flaps_inner_edge_by_friction(open_part, threshold):
    """The inner edge lies under the hinge, so it scrapes over the floor before it rises.

    It bears a share N of the slope's front end, at most all of it, and costs up to mu N h more: above the smooth
    floor's torque, and below that with the whole front end's weight on the edge.
    """
    flap = Flap(open_part)
    flap.rest(0.0)
    smooth = lifting_torque(flap.lever())
    parts = ("slope", SLOPE.base_mass_kg), ("flap", SLOPE.flap_mass_kg)
    com = sum(mass * flap.data.body(body).xipos[0] for body, mass in parts) / SLOPE.mass_kg
    front = SLOPE.mass_kg * GRAVITY * (com + SLOPE.side_m / 2) / (SLOPE.hinge_x_m + SLOPE.side_m / 2)
    mu = float(flap.model.geom("flap").friction[0])
    found = threshold(lambda torque: flap.lifts(torque, 0.0), 0.5 * smooth, 10 * smooth)
    assert smooth < found < smooth + mu * front * SLOPE.hinge_z_m
    assert found < SLOPE.hinge_torque_nm / 20
