"""Machines that are made a little off: each tolerance shows in measured poses, and only where it should."""

from dataclasses import fields, replace

import mujoco
import numpy as np
import pytest
from drawn import draw

from craftsim.discrete.grid import Kind
from craftsim.mjcf.parameters import DRIVES, NOMINAL
from craftsim.models import randomization
from craftsim.models.randomization import NONE, Making, randomize
from craftsim.models.world import PhysicsWorld

CAR = NOMINAL.cars[0]
WHEELS, NOTHING = ("fl", "fr", "rl", "rr"), 1e-12


class Largest:
    """Draws the upper end of everything."""

    def uniform(self, low: float = 0.0, high: float = 1.0, size: object = None) -> object:
        return high if size is None else np.full(size, high)


@pytest.fixture
def largest(monkeypatch):
    """Let every figure be drawn at the upper end."""
    monkeypatch.setattr(randomization, "by_name", lambda rng: lambda machine, figure: Largest())


def _world(drive="reduced", objects=(), load=Kind.AIR) -> PhysicsWorld:
    grid = draw((5, 3, 2), objects, [(0, 1, 1, 0, load, 0, 0)])
    return PhysicsWorld(grid, machines=replace(NOMINAL, drive=drive), reset=False)


def _made(world: PhysicsWorld, seed: int = 0, **making: float) -> PhysicsWorld:
    randomize(world, replace(NONE, making=Making(**making)), np.random.default_rng(seed))
    return world


def _driven(world: PhysicsWorld, wheels, periods: int) -> tuple[np.ndarray, float]:
    """Return the place and the heading of the car at the end."""
    world.drive(0, wheels)
    for _ in range(periods):
        world.advance()
    place, (w, _, _, z) = world.free_body_state(world.cars[0].base)
    return place, float(2 * np.arctan2(z, w))


def _wheels(world: PhysicsWorld) -> tuple[np.ndarray, np.ndarray]:
    """Return radii (4,) and places (4, 2) of the wheels, as their shapes in the model have them."""
    model = world.model
    if world.machines.drive == "reduced":
        geoms = [model.geom(f"car0/wheel_{wheel}").id for wheel in WHEELS]
        return model.geom_size[geoms, 0], model.geom_pos[geoms, :2]
    bodies = model.dof_bodyid[world.cars[0].wheel_dofs]
    rollers = [np.linalg.norm(model.body_pos[model.body_parentid == body], axis=1).mean() for body in bodies]
    return np.array(rollers) + CAR.roller_radius_m, model.body_pos[bodies, :2]


@pytest.mark.parametrize("drive", DRIVES)
def test_a_car_with_larger_wheels_stands_higher_and_gets_further(drive, largest):
    """All four larger by 1 mm, 2.0 % of their radius: 2.0 % further."""
    world, ways, heights = _world(drive), [], []
    for more in (NOTHING, 0.001):
        _made(world, wheel_radius_m=more)
        heights.append(world.free_body_state(world.cars[0].base)[0][2])
        begun = _driven(world, [8.0] * 4, 40)[0][0]
        ways.append(_driven(world, [8.0] * 4, 40)[0][0] - begun)
    assert ways[1] / ways[0] == pytest.approx(1 + 0.001 / CAR.wheel_radius_m, abs=0.003)
    assert heights[1] - heights[0] == pytest.approx(0.001, abs=1e-4)


@pytest.mark.parametrize("drive", DRIVES)
def test_unequal_wheels_turn_a_car(drive):
    world, headings = _world(drive), []
    for tolerance in (NOTHING, 0.0002):
        radii, _ = _wheels(_made(world, wheel_radius_m=tolerance))
        assert abs(radii - CAR.wheel_radius_m).max() <= tolerance
        assert len(np.unique(radii)) == 4
        headings.append(abs(_driven(world, [8.0] * 4, 100)[1]))
    assert headings[1] > max(0.002, 2 * headings[0])


@pytest.mark.parametrize("drive", DRIVES)
def test_a_car_with_a_longer_wheelbase_and_track_turns_less(drive):
    world, turned, levers = _world(drive), [], []
    for seed in range(3):
        _, places = _wheels(_made(world, seed, wheel_place_m=0.008))
        levers.append(np.abs(places).sum(axis=1).mean())
        turned.append(_driven(world, [-6.0, 6.0, -6.0, 6.0], 50)[1])
    assert np.ptp(levers) > 0.001
    assert (np.argsort(levers) == np.argsort(turned)[::-1]).all()
    np.testing.assert_allclose(np.array(turned) * levers, np.mean(turned) * np.mean(levers), rtol=0.01)


def test_a_board_that_is_too_high_carries_its_load_higher_and_a_higher_pocket_lower(largest):
    """By up to the 1 mm that a boss leaves below the deck."""
    world = _world(load=Kind.BLOCK)
    for name, more, sign in (("board_m", 0.002, 1), ("underside_m", 0.0008, -1)):
        both = (_made(world, **{name: size}) for size in (NOTHING, more))
        heights = [made.free_body_state(made.blocks[0])[0][2] for made in both]
        assert heights[1] - heights[0] == pytest.approx(sign * more, abs=5e-5)


def test_a_load_sits_off_its_car_by_as_much_as_its_pocket_is_off(largest):
    """Within the play of 0.1 mm to each side, and of board and boss alike."""
    for name, sign in (("pocket_m", -1), ("board_place_m", 1)):
        world = _made(_world(load=Kind.BLOCK), **{name: 0.003})
        place, _ = _driven(world, [0.0] * 4, 50)
        off = world.free_body_state(world.blocks[0])[0] - place
        assert off[:2] == pytest.approx(2 * [sign * 0.003], abs=0.3e-3)


def test_a_block_with_uneven_feet_leans():
    world, leans = _world(objects=[(Kind.BLOCK, (2, 1, 1))]), []
    for seed in range(4):
        _, (_, x, y, _) = _made(world, seed, foot_m=0.002).free_body_state(world.blocks[0])
        leans.append(2 * np.hypot(x, y))
        feet = [world.model.geom(f"block0/foot_{corner}").pos[2] for corner in WHEELS]
        assert abs(np.array(feet) - NOMINAL.block.foot_radius_m).max() <= 0.002
    # Two diagonal feet of 0.44 m, each off by up to 2 mm, lean it by up to 9 mrad.
    assert 1e-3 < max(leans) < 0.01


@pytest.mark.parametrize("drive", DRIVES)
def test_every_tolerance_changes_the_shapes_that_touch_and_is_taken_back(drive):
    """None of these shapes shares its frame with its body: MuJoCo would take the body's for it, whatever its place."""
    world = _world(drive, [(Kind.BLOCK, (2, 1, 1)), (Kind.FSLOPE, (3, 1, 1), 0)])
    world.reset_compiled()
    model, shapes = world.model, ("geom_pos", "geom_size", "body_pos")
    drawn = ["block0/foot_fl", "block0/frame_front", "block0/frame_left"]
    for name in drawn + (["car0/wheel_fl"] if drive == "reduced" else []):
        assert model.geom_sameframe[model.geom(name).id] == int(mujoco.mjtSameFrame.mjSAMEFRAME_BODYROT)
    before = {n: getattr(model, n).copy() for n in (*shapes, "actuator_gear", "bvh_aabb", "geom_rbound")}
    for name in [field.name for field in fields(Making)]:
        _made(world, **{name: 0.001})
        assert any(not np.array_equal(getattr(model, n), before[n]) for n in shapes)
        world.reset_compiled()
        for n, array in before.items():
            np.testing.assert_array_equal(getattr(model, n), array, err_msg=n)
