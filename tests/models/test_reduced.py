"""The reduced drive against analysis: load transfer, inertia, grip, and its motors that turn with the car.

Speeds, climbing torque, sliding angles and creep are tested with those of the rollers.
"""

import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from directions import DIRECTIONS

from craftsim.discrete.grid import Grid
from craftsim.mjcf.parameters import NOMINAL
from craftsim.models.composition import compile_world, world_spec
from craftsim.models.config import SimulationConfig
from craftsim.models.world import PhysicsWorld

GRAVITY = 9.81
CAR = NOMINAL.cars[0]
REDUCED = replace(NOMINAL, drive="reduced")
AWAKE = SimulationConfig(sleep=False)


@pytest.fixture
def car(make_car):
    found = make_car("reduced")
    found.spheres = [found.model.geom(f"car0/wheel_{w}").id for w in ("fl", "fr", "rl", "rr")]
    return found


def loads(car) -> np.ndarray:
    """Return what each wheel carries, in newtons."""
    carried = np.zeros(4)
    for contact in car.data.contact:
        for geom in contact.geom:
            if geom in car.spheres:
                carried[car.spheres.index(geom)] += car.data.efc_force[contact.efc_address]
    return carried


@pytest.mark.parametrize("name", ["forward", "backward", "left", "right"])
def test_speeding_up_shifts_the_load_as_statics_says_and_no_wheel_leaves_the_floor(car, name):
    """m a h / (2 d) an axle or side, with h the height of the centre of mass and d its distance from it. Band: 5 %."""
    signs, axis = np.array(DIRECTIONS[name][0]), DIRECTIONS[name][1]
    mass, height = car.model.body_subtreemass[1], car.data.subtree_com[1][2] - car.position[2]
    for i in range(20):
        car.run(0.02, 0.5 * i * signs)
        assert loads(car).min() > 0
    carried = loads(car)
    shifted = (carried @ [1, 1, -1, -1], carried @ [1, -1, 1, -1])[axis]
    lever = (CAR.wheel_x_m, CAR.wheel_y_m)[axis]
    assert shifted == pytest.approx(-mass * car.data.qacc[axis] * height / lever, rel=0.05)
    assert carried.sum() == pytest.approx(mass * GRAVITY, rel=0.001)


def test_the_wheels_spin_is_part_of_what_the_motors_speed_up(car):
    """With all motors at a torque tau: 4 tau / R = (m + 4 I / R^2) a. Band: 1 %."""
    car.unpower()
    car.baseline.actuator_biasprm[car.motors, 0] = 0.3
    car.rest()
    car.run(0.1)
    spin, radius = CAR.wheel_spin_inertia_kgm2 + CAR.wheel_armature_kgm2, CAR.wheel_radius_m
    expected = 4 * 0.3 / radius / (CAR.mass_kg + 4 * spin / radius**2)
    assert car.data.qacc[0] == pytest.approx(expected, rel=0.01)


def test_grip_limits_how_fast_a_car_speeds_up(car):
    """Four wheels at full torque: m a = mu m g cos 45 deg, however strong the motors. Band: 3 %."""
    car.baseline.geom_friction[car.spheres, 0] = 0.3
    car.rest()
    car.run(0.3)
    car.run(0.4, [20.0] * 4)
    assert car.data.qacc[0] == pytest.approx(0.3 * GRAVITY * math.cos(math.pi / 4), rel=0.03)


def test_wheels_in_the_air_push_nothing_and_a_reset_forgets_the_limits_of_the_grip(car):
    """But for what they still do in the control period in which they lose the ground."""
    car.data.qpos[2] += 2.0
    car.run(0.5, [20.0] * 4)
    assert abs(car.data.qacc[0]) < 0.01
    assert abs(car.data.qvel[0]) < 0.3
    assert (np.abs(car.model.actuator_forcerange[car.motors]) < CAR.wheel_torque_nm).any()
    car.physics.reset()
    assert (np.abs(car.model.actuator_forcerange[car.motors]) == CAR.wheel_torque_nm).all()


def test_motors_turned_with_the_car_push_as_those_of_its_own_frame():
    """The stepped model's motors act on the free joint; MJCF's on a site of the car. MuJoCo itself is the reference."""
    grid = Grid.empty((3, 3, 1), n_cars=2)
    grid.cars[1, :2] = 2, 2
    physics = PhysicsWorld(grid, AWAKE, machines=REDUCED)
    model, rng = compile_world(world_spec(grid, AWAKE, REDUCED)), np.random.default_rng(0)
    assert mujoco.mjtTrn.mjTRN_SITE in model.actuator_trntype
    assert mujoco.mjtTrn.mjTRN_SITE not in physics.model.actuator_trntype
    model.actuator_forcerange[:] = physics.model.actuator_forcerange
    data = mujoco.MjData(model)
    for car in physics.cars:
        turn = rng.normal(size=4)
        physics.data.qpos[car.base.qpos + 3 : car.base.qpos + 7] = turn / np.linalg.norm(turn)
        physics.data.qvel[car.base.dof : car.base.dof + 6] = rng.normal(size=6)
    physics.data.ctrl[:] = rng.normal(size=model.nu)
    for name in ("qpos", "qvel", "ctrl", "act"):
        getattr(data, name)[:] = getattr(physics.data, name)
    physics.awake_copy()  # turns the motors as the cars stand
    mujoco.mj_forward(model, data)
    mujoco.mj_forward(physics.model, physics.data)
    assert np.abs(data.qfrc_actuator).max() > 1.0
    np.testing.assert_allclose(physics.data.actuator_velocity, data.actuator_velocity, atol=1e-9)
    np.testing.assert_allclose(physics.data.qfrc_actuator, data.qfrc_actuator, atol=1e-9)
