"""Tables stand firm on four round feet, alone, on each other, and under a loaded car."""

import numpy as np
import pytest
from drawn import draw

from craftsim.discrete.geometry import LEVEL_HEIGHT_M
from craftsim.discrete.grid import Grid, Kind
from craftsim.mjcf.parameters import NOMINAL
from craftsim.models.config import SimulationConfig
from craftsim.models.world import PhysicsWorld

BLOCK = NOMINAL.block

GRAVITY = 9.81
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


def test_stacks_stay_put_level_and_at_their_height():
    physics = PhysicsWorld(draw((3, 2, 4), STACKS, []), AWAKE)
    start = [physics.free_body_state(block) for block in physics.blocks]
    for _ in range(50):
        physics.advance()
    for (place, _), block in zip(start, physics.blocks, strict=True):
        position, (_, qx, qy, _) = physics.free_body_state(block)
        np.testing.assert_allclose(position, place, atol=1e-5)
        assert abs(position[2] / LEVEL_HEIGHT_M - round(position[2] / LEVEL_HEIGHT_M)) * LEVEL_HEIGHT_M < 2e-4
        assert 2 * np.hypot(qx, qy) < 1e-4


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
