"""Without motors a world only loses energy: kinetic plus potential, as MuJoCo sums it.

The elastic energy of soft contacts is not in that sum, so a rebound shows as a small rise after an impact; each test
states how much of it there may be. The contacts are critically damped (solref damping ratio 1) and give little back.
"""

import mujoco
import numpy as np
import pytest

from craftsim.discrete.grid import Grid, Kind
from craftsim.mjcf.parameters import NOMINAL
from craftsim.models.config import SimulationConfig
from craftsim.models.effects import Bearings
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

    Bands: never above the start; rebounds below 10 % of what fell (m g drop, and 1 J of flap and settling loads); and
    in the last second, at rest, below 1 mJ, which is 4 micrometres of height of the whole crowd's 25 kg.
    """
    physics = PhysicsWorld(crowd(), SimulationConfig(sleep=False, settle_s=0, timestep_s=timestep_s))
    model, data = physics.model, physics.data
    model.opt.enableflags |= ENERGY
    model.opt.disableflags |= NO_MOTORS
    free = [car.base for car in physics.cars] + [*physics.blocks] + [slope.base for slope in physics.slopes]
    for body in free:
        data.qpos[body.qpos + 2] += drop_m
    data.qpos[physics.slopes[1].hinge.qpos] = 1.2
    energy = energies(physics, 2.0)
    mass = float(model.body_mass.sum())
    assert energy.max() <= energy[0]
    assert rise(energy) < 0.1 * (mass * GRAVITY * drop_m + 1.0)
    assert rise(energy[-round(1.0 / timestep_s) :]) < 1e-3


@pytest.mark.parametrize(
    ("twist", "gear_nm"),
    [((1.0, 0.0, 0.0), 0.0), ((0.0, 1.0, 0.0), 0.45), ((0.7, 0.3, 2.0), 0.0), ((0.0, 0.0, 6.0), 0.45)],
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
