"""A PhysicsWorld stands where its Grid says: what is drawn, by hand or at random, is read back from the poses."""

from dataclasses import replace

import numpy as np
import pytest
from discrete.drawn import draw
from discrete.worldgen import play, random_world, turned

from craftsim.discrete.geometry import DIRECTIONS
from craftsim.discrete.grid import CarField, Grid, Kind, beside
from craftsim.discrete.readback import read_grid
from craftsim.discrete.rules import Rules
from craftsim.mjcf.drives import DRIVES, Drive
from craftsim.mjcf.machines import NOMINAL
from craftsim.models.world import PhysicsWorld

AIR, BLOCK, FLAG, WALL, FSLOPE, BODY = (
    Kind[n] for n in ("AIR", "BLOCK", "FLAG", "WALL", "FSLOPE", "BODY")
)
Cell = tuple[int, int, int]

HAND_MADE = (
    draw((2, 2, 1)),
    draw((4, 4, 2), [(BLOCK, (x, y, 1), 0) for x in range(4) for y in range(4)]),
    draw((3, 3, 2), [(WALL, (0, 0, 1), 0), (WALL, (1, 0, 1), 0), (BLOCK, (2, 0, 1), 0)]),
    draw((4, 3, 3), [(BLOCK, (1, 1, 1), 0), (BLOCK, (2, 1, 1), 0), (BODY, (1, 1, 2), 0)]),
    draw((4, 4, 2), [(BODY, (1, 1, 1), 0), (BODY, (1, 2, 1), 0)]),
    draw((3, 3, 3), [(BLOCK, (1, 1, z), 0) for z in (1, 2, 3)], [(1, 1, 2, 3, 0, 0, 0)]),
    draw((3, 3, 2), [(BLOCK, (1, 1, 1), 0)], [(1, 1, 1, 0, 0, 0, 0), (1, 1, 2, 1, 0, 0, 0)]),
)
"""Nothing; blocks and walls side by side; slopes on blocks and side by side; cars below and above blocks."""

SEEDS = range(40)
YARD = draw(
    (6, 6, 3),
    [
        *(
            (WALL, (0, 0, 1)),
            (FLAG, (5, 0, 1)),
            (FSLOPE, (4, 2, 1), 0),
            (BLOCK, (0, 1, 1)),
            (BLOCK, (0, 4, 1)),
        ),
        *((BODY, (1, 1, 1), 0), (BODY, (1, 4, 1), 0)),
    ],
    [(3, 1, 1, 2, BLOCK), (3, 4, 1, 2, FSLOPE, 0), (5, 4, 1, 1, FLAG), (3, 5, 1, 3)],
)
"""Two ramps with loaded cars before them."""


def _played(seed: int) -> Grid:
    """Return the world of random legal play in which the most cars carry something, or are on a slope or above it."""
    rng = np.random.default_rng(seed)
    start = YARD if seed % 5 else random_world(rng)
    for _ in range(seed // 2 % 4):
        start = turned(start)
    wanted = (CarField.LOAD, CarField.SLOPE, CarField.SLOPE, CarField.Z)
    worlds = [grid for _, grid in play(Rules("physical"), start, rng, 60)]
    return max(worlds, key=lambda grid: (grid.cars[:, wanted] > (0, 0, 0, 1)).sum())


def assert_round_trip(grid: Grid, drive: Drive = "rollers") -> None:
    """Compose, settle and read: the same Grid, within 1 mm; half a second later nothing has moved by over 0.2 mm."""
    physics, before = PhysicsWorld(grid, machines=replace(NOMINAL, drive=drive)), None
    for _ in range(2):
        poses = physics.poses()
        reading = read_grid(poses, physics.size, physics.walls)
        assert reading.problems == ()
        assert reading.grid.same_visible(grid)
        assert reading.grid.same_marks(grid)
        assert all(placed.offset_m < 1e-3 for placed in (*reading.cars, *reading.objects))
        places = np.concatenate([poses.car_positions, poses.positions])
        moved = np.linalg.norm(places - (places if before is None else before), axis=1)
        assert moved.max(initial=0.0) < 2e-4
        before = places
        for _ in range(25):
            physics.advance()


def test_a_drawn_world_reads_back_as_itself():
    for grid in HAND_MADE:
        assert_round_trip(grid)


@pytest.mark.parametrize("drive", DRIVES)
def test_a_random_world_reads_back_as_itself(drive):
    for seed in SEEDS[DRIVES.index(drive) :: 2]:
        assert_round_trip(_played(seed), drive)


def test_random_worlds_are_varied():
    """The draws above cover every slope state with and without load, levels and yaws, and both states of a slope."""
    grids = [_played(seed) for seed in SEEDS]
    cars = np.concatenate([grid.cars for grid in grids])
    for state in range(3):
        loads = set(cars[cars[:, CarField.SLOPE] == state][:, CarField.LOAD])
        assert AIR in loads
        assert len(loads) > 1
    assert set(cars[cars[:, CarField.LOAD] > 0][:, CarField.YAW]) == set(range(4))
    assert set(cars[:, CarField.Z]) >= {1, 2}
    assert set(np.unique([kind for grid in grids for kind in np.unique(grid.kind)])) == set(
        map(int, Kind)
    )
    yaws = np.concatenate([grid.yaw[grid.kind == BODY] for grid in grids])
    assert set(yaws) == set(range(4))


def test_directions_and_yaws_agree():
    assert [beside((0, 0, 1), yaw)[:2] for yaw in range(4)] == [
        tuple(d) for d in DIRECTIONS.tolist()
    ]
