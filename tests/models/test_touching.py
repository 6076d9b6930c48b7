"""What stands, falls and rolls: energy, bearings, flaps, feet; and the factorisation by which contacts are solved."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from discrete.drawn import draw
from models.directions import DIRECTIONS, SPEED_RAD_S

from craftsim.discrete.geometry import LEVEL_HEIGHT_M
from craftsim.discrete.grid import Grid, Kind
from craftsim.errors import InputError
from craftsim.mjcf.drives import DRIVES, Drive
from craftsim.mjcf.machines import NOMINAL, Machines
from craftsim.mjcf.parameters import SmartcarParameters
from craftsim.models.config import SimulationConfig
from craftsim.models.effects import Bearings
from craftsim.models.randomization import DomainRandomization, randomize
from craftsim.models.world import PhysicsWorld
from craftsim.skills.mecanum import Mecanum

GRAVITY = 9.81
ENERGY = int(mujoco.mjtEnableBit.mjENBL_ENERGY)
NO_MOTORS = int(mujoco.mjtDisableBit.mjDSBL_ACTUATION)


def energies(world, seconds: float) -> np.ndarray:
    """Return the mechanical energy in joules of a PhysicsWorld before and after every step."""
    model, data = world.model, world.data
    mujoco.mj_forward(model, data)
    bearings = Bearings(world)
    found = [data.energy.sum()]
    for _ in range(round(seconds / model.opt.timestep)):
        mujoco.mj_step(model, data)
        bearings.after_step(world)
        found.append(data.energy.sum())
    return np.array(found)


def rise(energy: np.ndarray) -> float:
    """Return the furthest that the energy ever comes back above its least value so far."""
    return float((energy - np.minimum.accumulate(energy)).max())


def crowd() -> Grid:
    """Return two cars, one of them loaded on a ramp, a stack of blocks, and a folded slope."""
    grid = Grid.empty((6, 4, 3), 2)
    for cell, kind in {
        (1, 1, 1): Kind.BLOCK,
        (2, 1, 1): Kind.BODY,
        (3, 1, 1): Kind.FOOT,
        (4, 3, 1): Kind.BLOCK,
        (4, 3, 2): Kind.BLOCK,
        (1, 3, 1): Kind.FSLOPE,
        (2, 3, 1): Kind.GEAR,
    }.items():
        grid.kind[cell] = kind
    grid.cars[0] = 2, 1, 2, 2, Kind.BLOCK, 0, 2
    grid.cars[1] = 5, 2, 1, 1, 0, 0, 0
    return grid


@pytest.mark.parametrize(("drop_m", "timestep_s"), [(0.0, 0.004), (0.02, 0.004), (0.02, 0.001)])
def test_a_dropped_crowd_never_gains_energy(drop_m, timestep_s):
    """Everything falls from a small height, motors dead, one flap half open: it clatters and comes to rest.

    Bands: never above the start; rebounds below 15 % of what fell (m g drop, and 1 J of flap and settling loads), for
    tyres give back some of what they take; and in the last second, at rest, below 1 mJ, which is 4 micrometres of
    height of the whole crowd's 25 kg.
    """
    physics = PhysicsWorld(
        crowd(), SimulationConfig(sleep=False, settle_s=0, timestep_s=timestep_s)
    )
    model, data = physics.model, physics.data
    model.opt.enableflags |= ENERGY
    model.opt.disableflags |= NO_MOTORS
    free = (
        [car.base for car in physics.cars]
        + [*physics.blocks]
        + [slope.base for slope in physics.slopes]
    )
    for body in free:
        data.qpos[body.qpos + 2] += drop_m
    data.qpos[physics.slopes[1].hinge.qpos] = 1.2
    energy = energies(physics, 2.0)
    mass = float(model.body_mass.sum())
    assert energy.max() <= energy[0]
    assert rise(energy) < 0.15 * (mass * GRAVITY * drop_m + 1.0)
    assert rise(energy[-round(1.0 / timestep_s) :]) < 1e-3


@pytest.mark.parametrize(
    ("twist", "gear_nm"),
    [
        ((1.0, 0.0, 0.0), 0.0),
        ((0.0, 1.0, 0.0), 0.45),
        ((0.7, 0.3, 2.0), 0.0),
        ((0.0, 0.0, 6.0), 0.45),
    ],
)
def test_a_coasting_car_only_slows_down(lone_car, twist, gear_nm):
    """Launched at 1 m/s or 6 rad/s with 4 to 9 J, hundreds of hand-overs from roller to roller. Band: 0.05 mJ."""
    model, data = lone_car.model, lone_car.data
    model.opt.enableflags |= ENERGY
    lone_car.set_gears(gear_nm)
    lone_car.rest()
    model.opt.disableflags |= NO_MOTORS
    data.qvel[:2], data.qvel[5] = twist[:2], twist[2]
    data.qvel[lone_car.wheels] = Mecanum(NOMINAL.cars[0]).wheel_speeds(twist)
    energy = energies(lone_car.physics, 1.5)
    assert energy[0] - energy[-1] > 1.0
    assert rise(energy) < 5e-5


ROLLERS = replace(NOMINAL, drive="rollers")
BEARING_NM = NOMINAL.cars[0].roller_bearing_friction_nm


def two_cars() -> PhysicsWorld:
    """Return a car that is about to drive onto a ramp, and one that stands elsewhere."""
    slope = [(Kind.BLOCK, (3, 0, 1), 0), (Kind.BODY, (2, 0, 1), 2)]
    grid = draw((5, 4, 3), slope, [(0, 0, 1, 0, 0, 0, 0), (4, 3, 1, 0, 0, 0, 0)])
    return PhysicsWorld(grid, machines=ROLLERS)


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
def test_a_car_drives_as_with_dry_bearings_in_all_rollers(make_car, name):
    """1.6 s from rest at 10 rad/s, 0.7 m or 3 rad: within 0.2 mm and 2 mrad of where it then gets to."""
    lone_car = make_car("rollers")
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


def test_a_roller_in_the_air_is_stopped_by_its_grease_and_does_nothing_to_the_car(make_car):
    """Time constant I / d = 1e-6 kg m^2 / 2e-5 Nms = 50 ms: of 50 rad/s, the fastest there is, 1 rad/s after 0.2 s."""
    lone_car = make_car("rollers")
    lone_car.model.opt.gravity[:] = 0
    lone_car.data.qpos[2] += 0.1
    lone_car.data.qvel[:] = 0
    lone_car.data.qvel[lone_car.rollers] = 50.0
    lone_car.run(0.2)
    assert 0.3 < abs(lone_car.data.qvel[lone_car.rollers]).max() < 1.0
    assert lone_car.speed < 1e-4


def test_damping_that_a_step_cannot_take_is_refused_by_name():
    greasy = Machines((SmartcarParameters(roller_damping_nms_rad=1e-4),), drive="rollers")
    with pytest.raises(InputError, match=r"car0/roller_\w+ is damped by 0.0001: at most 6.07e-05"):
        PhysicsWorld(draw((2, 1, 1), [], [(0, 0, 1, 0, 0, 0, 0)]), machines=greasy)


def flap_on_base(physics: PhysicsWorld) -> tuple[float, float]:
    """Return the summed normal force between flap and base, and their deepest penetration in metres."""
    model, data = physics.model, physics.data
    flap, base = model.body("slope0/flap").id, model.body("slope0/slope").id
    force, total, depth = np.zeros(6), 0.0, 0.0
    for i, contact in enumerate(data.contact):
        if {model.geom_bodyid[contact.geom1], model.geom_bodyid[contact.geom2]} == {flap, base}:
            mujoco.mj_contactForce(model, data, i, force)
            total, depth = total + force[0], max(depth, -contact.dist)
    return total, depth


def slope_at(kind: Kind, settle_s: float = 0.3, cars=()) -> PhysicsWorld:
    config = SimulationConfig(sleep=False, settle_s=settle_s)
    return PhysicsWorld(draw((3, 5, 3), [(kind, (1, 1, 1), 1)], cars), config)


@pytest.mark.parametrize("settle_s", [0.0, 0.3])
def test_a_folded_flap_lies_on_the_base_with_no_more_than_its_weight_and_an_unfolded_one_does_not(
    settle_s,
):
    force, depth = flap_on_base(slope_at(Kind.FSLOPE, settle_s))
    assert 0 < force < NOMINAL.slope.flap_mass_kg * GRAVITY
    assert depth < 2e-6
    assert flap_on_base(slope_at(Kind.BODY, settle_s)) == (0, 0)


def test_the_base_bears_what_stands_on_a_folded_flap():
    """Band: the flap's tip bears half of the car, less a tenth that the hinge's stop holds."""
    physics = slope_at(Kind.FSLOPE, cars=[(1, 1, 2, 0)])
    force, depth = flap_on_base(physics)
    assert force > 0.45 * NOMINAL.cars[0].mass_kg * GRAVITY
    assert depth < 5e-4
    position, _ = physics.free_body_state(physics.cars[0].base)
    assert position[2] == pytest.approx(NOMINAL.slope.height_m, abs=5e-4)


def test_randomized_friction_reaches_the_flap():
    physics = slope_at(Kind.FSLOPE)
    randomize(physics, DomainRandomization(), np.random.default_rng(0))
    model = physics.model
    flap = model.geom("slope0/flap").friction[0]
    assert flap != NOMINAL.slope.friction
    assert (model.pair_friction[:, :2] == flap).all()


BLOCK = NOMINAL.block
STACKS = [(Kind.BLOCK, (x, y, z)) for x in range(3) for y in range(2) for z in range(1, 4)]
AWAKE = SimulationConfig(sleep=False)


def test_a_block_rests_on_one_point_a_foot_that_bear_its_weight():
    grid = Grid.empty((1, 1, 2), 0)
    grid.kind[0, 0, 1] = Kind.BLOCK
    physics = PhysicsWorld(grid, AWAKE)
    contact = physics.data.contact
    names = {physics.model.geom(geom).name for geom in contact.geom.ravel()}
    assert names == {"ground", *(f"block0/foot_{corner}" for corner in ("fl", "fr", "rl", "rr"))}
    assert physics.data.ncon == 4
    borne = physics.data.efc_force[contact.efc_address].sum()
    assert borne == pytest.approx(BLOCK.mass_kg * GRAVITY, rel=0.01)


def test_a_tower_of_two_under_a_loaded_car_sinks_by_less_than_a_fifth_of_a_millimetre():
    """Feet that touch in one point sink four times as far as flat ones, unless their contact is four times as stiff."""
    grid = Grid.empty((1, 1, 4), 1)
    grid.kind[0, 0, 1:3] = Kind.BLOCK
    grid.cars[0] = 0, 0, 3, 0, Kind.BLOCK, 0, 0
    grid.derive_marks()
    physics = PhysicsWorld(grid, AWAKE)
    for _ in range(50):
        physics.advance()
    heights = sorted(float(physics.free_body_state(block)[0][2]) for block in physics.blocks)
    assert np.abs(np.array(heights[:2]) - (0.0, LEVEL_HEIGHT_M)).max() < 2e-4


A_BLOCK = Kind.BLOCK
STACKED = [(A_BLOCK, (x, y, z)) for x in range(3) for y in range(2) for z in range(1, 4)]

WORLDS = {
    "a loaded car on a tower": (
        (2, 1, 6),
        [(A_BLOCK, (0, 0, z)) for z in (1, 2, 3)],
        [(0, 0, 4, 0, A_BLOCK)],
    ),
    "stacks side by side": ((3, 2, 5), STACKED, [(0, 0, 4, 0)]),
    "loaded cars on a ramp": (
        (5, 1, 4),
        [(A_BLOCK, (0, 0, 1)), (Kind.BODY, (1, 0, 1), 0)],
        [(1, 0, 2, 2, A_BLOCK, 0, 2), (3, 0, 1, 2, A_BLOCK)],
    ),
}


def _moving(name: str, drive: Drive) -> PhysicsWorld:
    """Return a world a quarter of a second after its cars began to drive with wheels that fight each other."""
    size, objects, cars = WORLDS[name]
    machines = replace(NOMINAL, drive=drive)
    physics = PhysicsWorld(
        draw(size, objects, cars), SimulationConfig(sleep=False), machines=machines
    )
    for _ in range(12):
        for car in range(len(physics.cars)):
            physics.drive(car, [3.0, -2.0, 1.0, 2.0])
        physics.advance()
    return physics


def _accelerations(
    physics: PhysicsWorld, jacobian: mujoco.mjtJacobian, iterations: int = 100
) -> np.ndarray:
    """Return the accelerations (nv,) of this moment, found from nothing by another factorisation."""
    model, data = physics.model, mujoco.MjData(physics.model)
    before = model.opt.jacobian, model.opt.iterations
    model.opt.jacobian, model.opt.iterations = jacobian, iterations
    mujoco.mj_copyData(data, model, physics.data)
    data.qacc_warmstart[:] = 0.0
    mujoco.mj_forward(model, data)
    model.opt.jacobian, model.opt.iterations = before
    return data.qacc.copy()


def test_worlds_are_solved_by_the_sparse_one():
    physics = PhysicsWorld(draw((1, 1, 1), [], [(0, 0, 1, 0)]))
    assert physics.model.opt.jacobian == mujoco.mjtJacobian.mjJAC_SPARSE


@pytest.mark.parametrize("drive", DRIVES)
def test_it_gives_the_accelerations_of_the_dense_one_to_a_billionth(drive):
    off = []
    for name in WORLDS:
        physics = _moving(name, drive)
        sparse = _accelerations(physics, mujoco.mjtJacobian.mjJAC_SPARSE)
        dense = _accelerations(physics, mujoco.mjtJacobian.mjJAC_DENSE)
        unsolved = _accelerations(physics, mujoco.mjtJacobian.mjJAC_DENSE, iterations=1)
        scale = np.abs(dense).max()
        assert np.abs(sparse - dense).max() < 1e-9 * scale
        off.append(np.abs(unsolved - dense).max() / scale)
    # What a solver that has not converged gives is far from both.
    assert max(off) > 1e-4


def test_stacks_stay_put_level_and_at_their_height():
    physics = PhysicsWorld(draw((3, 2, 4), STACKS, []), AWAKE)
    start = [physics.free_body_state(block) for block in physics.blocks]
    for _ in range(50):
        physics.advance()
    for (place, _), block in zip(start, physics.blocks, strict=True):
        position, (_, qx, qy, _) = physics.free_body_state(block)
        np.testing.assert_allclose(position, place, atol=1e-5)
        assert (
            abs(position[2] / LEVEL_HEIGHT_M - round(position[2] / LEVEL_HEIGHT_M)) * LEVEL_HEIGHT_M
            < 2e-4
        )
        assert 2 * np.hypot(qx, qy) < 1e-4


def test_going_back_to_a_saved_state_brings_its_bearings_back():
    physics = two_cars()
    physics.drive(0, [8.0] * 4)
    saved = physics.save()
    before = physics.model.dof_frictionloss.copy()
    for _ in range(3):
        physics.advance()
    assert (physics.model.dof_frictionloss != before).any()
    physics.restore(saved)
    np.testing.assert_array_equal(physics.model.dof_frictionloss, before)
