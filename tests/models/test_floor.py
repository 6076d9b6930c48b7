"""A floor that is not flat: as uneven as declared, drawn in place, and what stands on it stands still."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from craftsim.discrete.grid import Grid, Kind
from craftsim.errors import InputError
from craftsim.mjcf.drives import DRIVES, Drive
from craftsim.mjcf.machines import NOMINAL
from craftsim.models.floor import FLAT, Floor
from craftsim.models.randomization import NONE, DomainRandomization, randomize
from craftsim.models.world import PhysicsWorld

LIPPAGE = Floor(lippage_m=0.001)
SMOOTH = Floor(unevenness_m=0.002)
TILED = Floor(lippage_m=0.0008, joint_m=0.003, joint_depth_m=0.001, unevenness_m=0.001)
CLOSE_M = 3e-5
"""What touches is no further from the floor, and no deeper in it."""


def _grid() -> Grid:
    grid = Grid.empty((5, 4, 2), 1)
    grid.cars[0, :3] = 0, 1, 1
    grid.kind[3, 3, 1] = grid.kind[0, 3, 1] = Kind.BLOCK
    grid.kind[3, 1, 1], grid.kind[4, 1, 1] = Kind.FSLOPE, Kind.GEAR
    grid.derive_marks()
    return grid


def _world(floor: Floor, drive: Drive = "wheels") -> PhysicsWorld:
    return PhysicsWorld(_grid(), machines=replace(NOMINAL, drive=drive), floor=floor, reset=False)


def _drawn(floor: Floor, seed: int = 0, drive: Drive = "wheels") -> PhysicsWorld:
    world = _world(floor, drive)
    randomize(world, replace(NONE, floor=floor), np.random.default_rng(seed))
    return world


def _height(physics: PhysicsWorld, x: float, y: float) -> tuple[float, int]:
    """Return the height of the floor at a place, as a ray sees it, and the geom that it meets."""
    groups = np.array([1, 0, 0, 0, 0, 0], np.uint8)
    geom = np.zeros(1, np.int32)
    above = np.array([x, y, 0.05])
    way = mujoco.mj_ray(
        physics.model, physics.data, above, np.array([0.0, 0.0, -1.0]), groups, 1, -1, geom
    )
    return 0.05 - way, int(geom[0])


def _sampled(physics: PhysicsWorld, count: int = 1500) -> tuple[np.ndarray, np.ndarray]:
    """Return heights and geoms at random places of the area."""
    places = np.random.default_rng(1).uniform(0, [5 * 0.3225, 4 * 0.3225], (count, 2))
    heights, geoms = zip(*(_height(physics, x, y) for x, y in places), strict=True)
    return np.array(heights), np.array(geoms)


def test_tiles_are_level_until_they_are_drawn_and_differ_by_the_lippage_at_most():
    world = _world(LIPPAGE)
    world.reset_compiled()
    assert abs(_sampled(world, 300)[0]).max() < 1e-9
    levels = []
    for seed in range(4):
        randomize(world, replace(NONE, floor=LIPPAGE), np.random.default_rng(seed))
        heights, tiles = _sampled(world)
        for tile in set(tiles.tolist()):
            assert np.ptp(heights[tiles == tile]) < 1e-9, "a tile is flat"
        assert len(set(tiles.tolist())) > 20
        assert 0.0005 < np.ptp(heights) <= 0.001
        assert abs(heights).max() <= 0.0005
        assert world.lift_m >= heights.max() - 1e-9
        levels.append(heights[:5])
    assert len(np.unique(np.round(levels, 9))) > 10, "each seed has its own"


def test_a_smooth_floor_is_as_uneven_as_declared_and_has_no_steps():
    for seed in range(3):
        physics = _drawn(SMOOTH, seed)
        heights, _ = _sampled(physics)
        assert 0.0012 < np.ptp(heights) <= 0.002
        x = np.linspace(0, 1.6, 2000)
        along = np.array([_height(physics, value, 0.6)[0] for value in x])
        # Six waves of equal size in line are steeper than any that are drawn.
        assert abs(np.diff(along)).max() < 0.002 * np.pi / SMOOTH.wavelength_m * (x[1] - x[0]) * 1.5


def test_joints_run_between_tiles_and_have_a_bottom():
    heights, geoms = _sampled(_drawn(TILED), 4000)
    joint = geoms == 0
    assert joint.mean() == pytest.approx(2 * TILED.joint_m / TILED.tile_m, rel=0.4)
    assert heights[joint] == pytest.approx(-TILED.relief_m / 2 - TILED.joint_depth_m)
    assert heights[~joint].min() > -TILED.relief_m / 2 - 1e-9


@pytest.mark.parametrize("floor", [LIPPAGE, TILED])
def test_a_reset_throws_nothing_aside(floor):
    grid = Grid.empty((8, 8, 1), 1)
    grid.kind[::2, 1:, 1] = Kind.FSLOPE
    grid.kind[1::2, 1:, 1] = Kind.GEAR
    grid.derive_marks()
    world = PhysicsWorld(grid, floor=floor, reset=False)
    places = world.pose_places[1:, :2]
    placed = world.data.qpos[places].copy()
    for seed in range(4):
        randomize(world, replace(NONE, floor=floor), np.random.default_rng(seed))
        assert abs(world.data.qpos[places] - placed).max() < 0.0005


@pytest.mark.parametrize("drive", DRIVES)
@pytest.mark.parametrize("floor", [LIPPAGE, SMOOTH, TILED])
def test_everything_stands_still_after_a_reset(floor, drive):
    physics = _drawn(floor, 1, drive)
    assert physics.overlaps == ()
    assert physics.data.warning.number.sum() == 0
    for body in (*physics.blocks, *(slope.base for slope in physics.slopes), physics.cars[0].base):
        assert abs(physics.data.qvel[body.dof : body.dof + 3]).max() < 0.002
    for number, _ in enumerate(physics.blocks):
        feet = [
            physics.data.geom(f"block{number}/foot_{corner}") for corner in ("fl", "fr", "rl", "rr")
        ]
        gaps = [foot.xpos[2] - 0.005 - _height(physics, *foot.xpos[:2])[0] for foot in feet]
        touching = [gap < CLOSE_M for gap in gaps]
        # Its centre of mass lies over the diagonals: on two feet it is in balance until it is touched.
        assert sum(touching) >= 3 or touching in (
            [True, False, False, True],
            [False, True, True, False],
        )
        assert min(gaps) > -CLOSE_M or floor.joint_m


def test_the_tiles_are_the_ground_and_of_one_material():
    world = _world(TILED)
    randomize(world, DomainRandomization(floor=TILED), np.random.default_rng(0))
    physics = world
    tiles = [i for i in range(physics.model.ngeom) if physics.model.geom(i).name.startswith("tile")]
    assert {physics.machine_names.names[physics.machine_names.of_geom[i]] for i in tiles} == {
        "ground"
    }
    ground = physics.model.geom("ground").id
    for name in ("geom_friction", "geom_solref", "geom_solimp", "geom_contype", "geom_conaffinity"):
        figures = getattr(physics.model, name)
        assert (figures[tiles] == figures[ground]).all(), name
    assert physics.model.geom_friction[ground, 0] != NOMINAL.contact.ground_friction


def test_equal_seeds_give_equal_floors_whose_draws_and_those_of_the_rest_do_not_depend_on_each_other():
    again = [_drawn(TILED, 3), _world(TILED)]
    for seed in (4, 3):
        randomize(again[1], replace(NONE, floor=TILED), np.random.default_rng(seed))
    np.testing.assert_array_equal(*(world.data.qpos for world in again))
    np.testing.assert_array_equal(*(world.model.hfield_data for world in again))
    masses, floors = [], []
    for floor, mass in (
        (FLAT, 0.2),
        (LIPPAGE, 0.2),
        (LIPPAGE, 0.0),
        (replace(LIPPAGE, lippage_m=0.002), 0.0),
    ):
        world = _world(floor)
        randomize(world, replace(NONE, floor=floor, mass=mass), np.random.default_rng(5))
        masses.append(world.model.body_mass[:7].copy())
        floors.append(world.model.hfield_data.copy())
    np.testing.assert_array_equal(masses[0], masses[1])
    for other in floors[2:]:
        np.testing.assert_allclose(floors[1], other, atol=1e-6, err_msg="a share of the lippage")


@pytest.mark.parametrize("drive", DRIVES)
def test_a_car_drives_on_level_tiles_as_on_the_plane_and_keeps_its_line_on_a_smooth_floor(drive):
    """Level tiles: within 1 % of the way. On 1 mm: sideways by less than 15 mm in 0.9 m without any control."""
    ends = []
    for floor in (FLAT, Floor(lippage_m=1e-7), Floor(unevenness_m=0.001)):
        grid = Grid.empty((5, 3, 1), 1)
        grid.cars[0, :3] = 0, 1, 1
        world = PhysicsWorld(grid, machines=replace(NOMINAL, drive=drive), floor=floor, reset=False)
        randomize(world, replace(NONE, floor=floor), np.random.default_rng(0))
        for period in range(60):
            world.drive(0, [min(15.0, 1.0 * period)] * 4)
            world.advance()
        ends.append(world.free_body_state(world.cars[0].base)[0])
    way = ends[0][0]
    assert way > 0.5
    assert ends[1] == pytest.approx(ends[0], abs=0.01 * way)
    assert abs(ends[2][1] - ends[0][1]) < 0.015
    assert ends[2][0] == pytest.approx(way, rel=0.03)


def test_a_floor_that_cannot_be_is_refused():
    with pytest.raises(InputError, match="joint_m must be below"):
        Floor(tile_m=0.1, joint_m=0.1)
    for floor in (
        Floor(lippage_m=0.001, tile_m=0.01),
        Floor(unevenness_m=0.001, wavelength_m=0.001),
    ):
        with pytest.raises(InputError, match="too fine"):
            PhysicsWorld(_grid(), floor=floor)
    randomize(_world(FLAT), replace(NONE, floor=Floor(tile_m=0.6)), np.random.default_rng(0))
    with pytest.raises(InputError, match="floor"):
        randomize(_world(FLAT), replace(NONE, floor=LIPPAGE), np.random.default_rng(0))
