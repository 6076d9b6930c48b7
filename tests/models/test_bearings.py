"""Rollers in the air turn on their grease alone; to the car this is the same as dry bearings in all of them."""

import mujoco
import numpy as np
import pytest
from directions import DIRECTIONS, SPEED_RAD_S
from drawn import draw

from craftsim.discrete.grid import Kind
from craftsim.errors import InputError
from craftsim.mjcf.parameters import NOMINAL, Machines, SmartcarParameters
from craftsim.models.world import PhysicsWorld

BEARING_NM = NOMINAL.cars[0].roller_bearing_friction_nm


def two_cars() -> PhysicsWorld:
    """Return a car that is about to drive onto a ramp, and one that stands elsewhere."""
    slope = [(Kind.BLOCK, (3, 0, 1), 0), (Kind.BODY, (2, 0, 1), 2)]
    return PhysicsWorld(draw((5, 4, 3), slope, [(0, 0, 1, 0, 0, 0, 0), (4, 3, 1, 0, 0, 0, 0)]))


def rollers(model: mujoco.MjModel) -> dict[int, int]:
    """Return the joint's address of each roller by its geom, found by name."""
    geoms = [g for g in range(model.ngeom) if "/roller_" in model.geom(g).name]
    return {geom: int(model.body_dofadr[model.geom_bodyid[geom]]) for geom in geoms}


def test_rollers_that_touch_and_those_of_sleeping_cars_have_dry_bearings_and_no_others():
    physics = two_cars()
    by_geom = rollers(physics.model)
    all_dofs = np.array(list(by_geom.values()))
    assert len(all_dofs) == 80
    physics.drive(0, [8.0] * 4)
    counts = []

    def look() -> None:
        friction = physics.model.dof_frictionloss[all_dofs]
        near = {by_geom[g] for g in physics.data.contact.geom.ravel().tolist() if g in by_geom}
        asleep = physics.data.tree_asleep[physics.model.dof_treeid[all_dofs]] >= 0
        dry = np.isin(all_dofs, list(near)) | asleep
        np.testing.assert_array_equal(friction, np.where(dry, BEARING_NM, 0.0))
        counts.append((dry & ~asleep).sum())
        assert asleep.sum() in (0, 40)

    for _ in range(75):
        physics.advance(look)
    assert physics.data.tree_asleep[physics.cars[1].base.tree] >= 0
    assert min(counts) >= 2
    assert 3 < np.mean(counts) < 10


@pytest.mark.parametrize("name", ["forward", "left", "turning left"])
def test_a_car_drives_as_with_dry_bearings_in_all_rollers(lone_car, name):
    """1.6 s from rest at 10 rad/s, 0.7 m or 3 rad: within 0.2 mm and 2 mrad of where it then gets to."""
    speeds, ends = SPEED_RAD_S * np.array(DIRECTIONS[name][0]), []
    for dry in (False, True):
        lone_car.rest()
        lone_car.data.ctrl[lone_car.motors] = speeds
        if dry:
            lone_car.model.dof_frictionloss[lone_car.rollers] = BEARING_NM
            mujoco.mj_step(lone_car.model, lone_car.data, 400)
        else:
            lone_car.run(1.6)
        ends.append((lone_car.position, lone_car.heading))
    (one, turned), (other, turned_then) = ends
    assert np.linalg.norm(one - other) < 0.2e-3
    assert abs(turned - turned_then) < 2e-3


def test_a_roller_in_the_air_is_stopped_by_its_grease_and_does_nothing_to_the_car(lone_car):
    """Time constant I / d = 1e-6 kg m^2 / 2e-5 Nms = 50 ms: of 50 rad/s, the fastest there is, 1 rad/s after 0.2 s."""
    lone_car.model.opt.gravity[:] = 0
    lone_car.data.qpos[2] += 0.1
    lone_car.data.qvel[:] = 0
    lone_car.data.qvel[lone_car.rollers] = 50.0
    lone_car.run(0.2)
    assert 0.3 < abs(lone_car.data.qvel[lone_car.rollers]).max() < 1.0
    assert lone_car.speed < 1e-4


def test_damping_that_a_step_cannot_take_is_refused_by_name():
    greasy = Machines((SmartcarParameters(roller_damping_nms_rad=1e-4),))
    with pytest.raises(InputError, match=r"car0/roller_\w+ is damped by 0.0001: at most 6.07e-05"):
        PhysicsWorld(draw((2, 1, 1), [], [(0, 0, 1, 0, 0, 0, 0)]), machines=greasy)
