"""The sparse factorisation of the constraint solver gives the accelerations of the dense one, and is the one in use.

MuJoCo takes the dense one for small worlds unless told otherwise, and loaded cars then take three times as long. A
wrong one shows as wrong accelerations and stacks that sink. That of MuJoCo 4.0.0, which is excluded, is wrong for some
structures, but right for these.
"""

import mujoco
import numpy as np
from drawn import draw

from craftsim.discrete.grid import Kind
from craftsim.models.config import SimulationConfig
from craftsim.models.world import PhysicsWorld

BLOCK = Kind.BLOCK
STACKS = [(BLOCK, (x, y, z)) for x in range(3) for y in range(2) for z in range(1, 4)]
WORLDS = {
    "a loaded car on a tower": ((2, 1, 6), [(BLOCK, (0, 0, z)) for z in (1, 2, 3)], [(0, 0, 4, 0, BLOCK)]),
    "stacks side by side": ((3, 2, 5), STACKS, [(0, 0, 4, 0)]),
    "loaded cars on a ramp": (
        (5, 1, 4),
        [(BLOCK, (0, 0, 1)), (Kind.BODY, (1, 0, 1), 0)],
        [(1, 0, 2, 2, BLOCK, 0, 2), (3, 0, 1, 2, BLOCK)],
    ),
}


def _moving(name: str) -> PhysicsWorld:
    """Return a world a quarter of a second after its cars began to drive with wheels that fight each other."""
    size, objects, cars = WORLDS[name]
    physics = PhysicsWorld(draw(size, objects, cars), SimulationConfig(sleep=False))
    for _ in range(12):
        for car in range(len(physics.cars)):
            physics.drive(car, [3.0, -2.0, 1.0, 2.0])
        physics.advance()
    return physics


def _accelerations(physics: PhysicsWorld, jacobian: mujoco.mjtJacobian, iterations: int = 100) -> np.ndarray:
    """Return the accelerations (nv,) of this moment, found from nothing by another factorisation."""
    model, data = physics.model, mujoco.MjData(physics.model)
    before = model.opt.jacobian, model.opt.iterations
    model.opt.jacobian, model.opt.iterations = jacobian, iterations
    mujoco.mj_copyData(data, model, physics.data)
    data.qacc_warmstart[:] = 0.0
    mujoco.mj_forward(model, data)
    model.opt.jacobian, model.opt.iterations = before
    return data.qacc.copy()


def test_every_world_is_solved_by_the_sparse_one():
    physics = PhysicsWorld(draw((1, 1, 1), [], [(0, 0, 1, 0)]))
    assert physics.model.opt.jacobian == mujoco.mjtJacobian.mjJAC_SPARSE


def test_it_gives_the_accelerations_of_the_dense_one_to_a_billionth():
    for name in WORLDS:
        physics = _moving(name)
        sparse = _accelerations(physics, mujoco.mjtJacobian.mjJAC_SPARSE)
        dense = _accelerations(physics, mujoco.mjtJacobian.mjJAC_DENSE)
        unsolved = _accelerations(physics, mujoco.mjtJacobian.mjJAC_DENSE, iterations=1)
        scale = np.abs(dense).max()
        assert np.abs(sparse - dense).max() < 1e-9 * scale
        # What a solver that has not converged gives is far from both.
        assert np.abs(unsolved - dense).max() > 1e-4 * scale
