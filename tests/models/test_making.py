"""Machines that are made a little off: each tolerance shows in measured poses, and only where it should."""

from dataclasses import fields, replace

import mujoco
import numpy as np
import pytest

from craftsim.discrete.grid import Grid, Kind
from craftsim.mjcf.parameters import NOMINAL, Drive
from craftsim.models import randomization
from craftsim.models.randomization import NONE, Making, randomize
from craftsim.models.world import PhysicsWorld

DRIVES: tuple[Drive, ...] = ("rollers", "reduced")


class Largest:
    """Draws the upper end of everything."""

    def uniform(self, low: float = 0.0, high: float = 1.0, size: object = None) -> object:
        return high if size is None else np.full(size, high)


@pytest.fixture
def largest(monkeypatch):
    """Let every figure be drawn at the upper end."""
    monkeypatch.setattr(randomization, "by_name", lambda rng: lambda machine, figure: Largest())


def _physics(
    drive: Drive, cell: tuple[int, int] = (0, 1), kind: Kind = Kind.AIR, load: Kind = Kind.AIR
) -> PhysicsWorld:
    grid = Grid.empty((5, 3, 2), 1)
    grid.cars[0, :6] = 0, 1, 1, 0, load, 0
    if kind != Kind.AIR:
        grid.kind[*cell, 1] = kind
    grid.derive_marks()
    return PhysicsWorld(grid, machines=replace(NOMINAL, drive=drive), reset=False)


def _drawn(world: PhysicsWorld, seed: int, **making: float) -> PhysicsWorld:
    randomize(world, replace(NONE, making=Making(**making)), np.random.default_rng(seed))
    return world


def _pose(physics: PhysicsWorld, body) -> np.ndarray:
    return physics.free_body_state(body)[0]


def _heading(physics: PhysicsWorld) -> float:
    _, (w, _, _, z) = physics.free_body_state(physics.cars[0].base)
    return float(2 * np.arctan2(z, w))


def _radii(physics: PhysicsWorld) -> np.ndarray:
    """Return (4,): the radius of each wheel, as its shape in the model has it."""
    model = physics.model
    if physics.machines.drive == "reduced":
        return np.array([model.geom(f"car0/wheel_{w}").size[0] for w in ("fl", "fr", "rl", "rr")])
    bodies = [model.dof_bodyid[dof] for dof in physics.cars[0].wheel_dofs]
    rollers = [np.flatnonzero(model.body_parentid == body) for body in bodies]
    thick = physics.cars[0].parameters.roller_radius_m
    return np.array([np.linalg.norm(model.body_pos[r], axis=1).mean() + thick for r in rollers])


@pytest.mark.parametrize("drive", DRIVES)
def test_a_car_with_larger_wheels_stands_higher_and_gets_further(drive, largest):
    """All four larger by 1 mm, 2.0 % of their radius: 2.0 % further."""
    world, ways, heights = _physics(drive), [], []
    for more in (0.0, 0.001):
        randomize(
            world, replace(NONE, making=Making(wheel_radius_m=max(more, 1e-12))), np.random.default_rng()
        )
        physics = world
        start = _pose(physics, physics.cars[0].base)
        physics.drive(0, [8.0] * 4)
        places = []
        for _ in range(80):
            physics.advance()
            places.append(_pose(physics, physics.cars[0].base)[0])
        ways.append(places[-1] - places[40])
        heights.append(start[2])
    assert ways[1] / ways[0] == pytest.approx(1 + 0.001 / NOMINAL.cars[0].wheel_radius_m, abs=0.003)
    assert heights[1] - heights[0] == pytest.approx(0.001, abs=1e-4)


@pytest.mark.parametrize("drive", DRIVES)
def test_unequal_wheels_turn_a_car(drive):
    world = _physics(drive)
    headings = []
    for tolerance in (1e-12, 0.0002):
        physics = _drawn(world, 0, wheel_radius_m=tolerance)
        assert abs(_radii(physics) - NOMINAL.cars[0].wheel_radius_m).max() <= tolerance
        assert len(np.unique(_radii(physics))) == 4
        physics.drive(0, [8.0] * 4)
        for _ in range(100):
            physics.advance()
        headings.append(abs(_heading(physics)))
    assert headings[1] > max(0.002, 2 * headings[0])


@pytest.mark.parametrize("drive", DRIVES)
def test_a_car_with_a_longer_wheelbase_and_track_turns_less(drive):
    world, turned, levers = _physics(drive), [], []
    for seed in range(3):
        physics = _drawn(world, seed, wheel_place_m=0.008)
        physics.drive(0, [-6.0, 6.0, -6.0, 6.0])
        for _ in range(50):
            physics.advance()
        turned.append(_heading(physics))
        model = physics.model
        if drive == "reduced":
            places = np.array([model.geom(f"car0/wheel_{wheel}").pos for wheel in ("fl", "fr", "rl", "rr")])
        else:
            places = model.body_pos[model.dof_bodyid[physics.cars[0].wheel_dofs]]
        levers.append(np.abs(places[:, :2]).sum(axis=1).mean())
    assert np.ptp(levers) > 0.001
    assert (np.argsort(levers) == np.argsort(turned)[::-1]).all()
    np.testing.assert_allclose(np.array(turned) * levers, np.mean(turned) * np.mean(levers), rtol=0.01)


def test_a_board_that_is_too_high_carries_its_load_higher(largest):
    world, heights = _physics("reduced", load=Kind.BLOCK), []
    for more in (1e-12, 0.002):
        randomize(world, replace(NONE, making=Making(board_m=more)), np.random.default_rng())
        heights.append(_pose(world, world.blocks[0])[2])
    assert heights[1] - heights[0] == pytest.approx(0.002, abs=5e-5)


def test_a_block_with_uneven_feet_leans():
    world = _physics("reduced", (2, 1), Kind.BLOCK)
    leans = []
    for seed in range(4):
        physics = _drawn(world, seed, foot_m=0.002)
        _, (_, x, y, _) = physics.free_body_state(physics.blocks[0])
        leans.append(2 * np.hypot(x, y))
        feet = [physics.model.geom(f"block0/foot_{corner}").pos[2] for corner in ("fl", "fr", "rl", "rr")]
        assert abs(np.array(feet) - NOMINAL.block.foot_radius_m).max() <= 0.002
    # Two diagonal feet of 0.44 m, each off by up to 2 mm, lean it by up to 9 mrad.
    assert 1e-3 < max(leans) < 0.01


def test_a_load_with_a_higher_pocket_rides_lower(largest):
    """By up to the 1 mm that a boss leaves below the deck."""
    world, heights = _physics("reduced", load=Kind.BLOCK), []
    for more in (1e-12, 0.0008):
        randomize(world, replace(NONE, making=Making(underside_m=more)), np.random.default_rng())
        heights.append(_pose(world, world.blocks[0])[2])
    assert heights[0] - heights[1] == pytest.approx(0.0008, abs=5e-5)


def test_a_load_sits_off_its_car_by_as_much_as_its_pocket_is_off(largest):
    """Within the play of 0.1 mm to each side, and of board and boss alike."""
    for making, sign in ((Making(pocket_m=0.003), -1), (Making(board_place_m=0.003), 1)):
        world = _physics("reduced", load=Kind.BLOCK)
        randomize(world, replace(NONE, making=making), np.random.default_rng())
        physics = world
        for _ in range(50):
            physics.advance()
        off = _pose(physics, physics.blocks[0])[:2] - _pose(physics, physics.cars[0].base)[:2]
        assert off == pytest.approx(2 * [sign * 0.003], abs=0.3e-3)


def test_every_tolerance_changes_the_shapes_that_touch_and_is_taken_back():
    for drive in DRIVES:
        for name in [field.name for field in fields(Making)]:
            grid = Grid.empty((5, 3, 2), 1)
            grid.cars[0, :3] = 0, 1, 1
            grid.kind[2, 1, 1], grid.kind[3, 1, 1], grid.kind[4, 1, 1] = Kind.BLOCK, Kind.FSLOPE, Kind.GEAR
            grid.derive_marks()
            world = PhysicsWorld(grid, machines=replace(NOMINAL, drive=drive), reset=False)
            world.reset_compiled()
            model = world.model
            before = {
                n: getattr(model, n).copy()
                for n in ("geom_pos", "geom_size", "body_pos", "actuator_gear", "bvh_aabb", "geom_rbound")
            }
            _drawn(world, 0, **{name: 0.001})
            assert any(
                not np.array_equal(getattr(model, n), before[n])
                for n in ("geom_pos", "geom_size", "body_pos")
            )
            world.reset_compiled()
            for n, array in before.items():
                np.testing.assert_array_equal(getattr(model, n), array, err_msg=n)


def test_no_shape_that_is_drawn_shares_its_frame_with_its_body():
    """MuJoCo takes the body's frame for such a shape's, whatever its place."""
    world = _physics("reduced", (2, 1), Kind.BLOCK)
    model = world.model
    same = mujoco.mjtSameFrame.mjSAMEFRAME_BODYROT
    for name in ("car0/wheel_fl", "block0/foot_fl", "block0/frame_front", "block0/frame_left"):
        assert model.geom_sameframe[model.geom(name).id] == int(same)
