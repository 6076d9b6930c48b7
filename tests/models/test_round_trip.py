"""A PhysicsWorld stands where its Grid says: what is drawn, by hand or at random, is read back from the poses."""

from dataclasses import replace

import numpy as np
import pytest
from drawn import draw

from craftsim.discrete.geometry import DIRECTIONS
from craftsim.discrete.grid import SECOND_PART, CarField, Grid, Kind, beside
from craftsim.discrete.readback import read_grid
from craftsim.mjcf.parameters import DRIVES, NOMINAL, Drive
from craftsim.models.world import PhysicsWorld

AIR, BLOCK, FLAG, WALL, FSLOPE, BODY = (Kind[n] for n in ("AIR", "BLOCK", "FLAG", "WALL", "FSLOPE", "BODY"))
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


class Builder:
    """Draws sane worlds: everything stands on something, and nothing reaches into anything else."""

    def __init__(self, rng: np.random.Generator, size: Cell = (7, 7, 3)) -> None:
        self.rng, self.size = rng, size
        self.grid = Grid.empty(size)
        self.taken = np.zeros(self.grid.kind.shape, bool)
        """Cells that nothing more may stand in or reach into."""
        self.rows: list[tuple[int, ...]] = []

    def draw(self) -> Grid:
        for kind in self.rng.permutation([WALL] * 2 + [BLOCK] * 12 + [FLAG] * 2 + [FSLOPE] * 2 + [BODY] * 3):
            self.put(Kind(kind))
        for _ in range(5):
            self.park()
        self.grid.cars = np.array(self.rows, np.int64).reshape(-1, len(CarField))
        self.grid.derive_marks()
        return self.grid

    def free(self, *cells: Cell) -> bool:
        """Return whether cells are in the area, empty, and not reached into."""
        inside = all(0 <= c < s for cell in cells for c, s in zip(cell[:2], self.size[:2], strict=True))
        return (
            inside
            and all(1 <= z <= self.size[2] for _, _, z in cells)
            and not any(self.taken[c] for c in cells)
        )

    def floor(self, cell: Cell) -> bool:
        return self.grid.kind[cell[0], cell[1], cell[2] - 1] in (Kind.GROUND, BLOCK)

    def spot(self) -> Cell:
        """Return a random cell that is the lowest open one of its column."""
        x, y = (int(self.rng.integers(n)) for n in self.size[:2])
        z = next((z for z in range(1, self.size[2] + 1) if not self.taken[x, y, z]), 1)
        return x, y, z

    def put(self, kind: Kind) -> None:
        cell, yaw = self.spot(), int(self.rng.integers(4)) if kind in SECOND_PART else 0
        cells = [cell, beside(cell, yaw)] if kind in SECOND_PART else [cell]
        if not self.free(*cells) or not all(self.floor(c) for c in cells) or (kind == WALL and cell[2] > 1):
            return
        for c, k in zip(cells, (kind, SECOND_PART.get(kind)), strict=False):
            self.grid.kind[c], self.grid.yaw[c], self.taken[c] = k, yaw, True
            if kind != BLOCK:
                self.taken[c[0], c[1], c[2] :] = True

    def park(self) -> None:
        slopes = np.argwhere(self.grid.kind == BODY)
        choice = self.rng.integers(3)
        if choice == 0 and len(slopes):
            self.park_on_slope(tuple(int(c) for c in self.rng.choice(slopes)))
        elif choice == 1:
            self.park_below()
        else:
            self.park_in_the_open()

    def heading_and_load(self, yaw: int) -> tuple[int, int, int]:
        load = Kind(self.rng.choice([AIR, BLOCK, FLAG, FSLOPE]))
        return yaw, load, (yaw + 2) % 4 if load == FSLOPE else 0

    def add(self, cell: Cell, yaw: int, load: int, load_yaw: int, slope: int, reach: list[Cell]) -> None:
        self.rows.append((*cell, yaw, load, load_yaw, slope))
        for x, y, z in [cell, *reach]:
            if 0 <= x < self.size[0] and 0 <= y < self.size[1]:
                self.taken[x, y, z:] = True

    def park_in_the_open(self) -> None:
        cell = self.spot()
        if not self.free(cell) or not self.floor(cell):
            return
        yaw, load, load_yaw = self.heading_and_load(int(self.rng.integers(4)))
        gear = beside(cell, load_yaw)
        if load == FSLOPE and not self.free(gear):
            return
        self.add(cell, yaw, load, load_yaw, 0, [gear] if load == FSLOPE else [])

    def park_below(self) -> None:
        for x, y, z in self.rng.permutation(
            np.argwhere(np.isin(self.grid.kind, (BLOCK, FLAG, FSLOPE, BODY)))
        ):
            cell = int(x), int(y), int(z)
            if all(row[:3] != cell for row in self.rows):
                slope = self.grid.kind[cell] in (FSLOPE, BODY)
                yaw = (int(self.grid.yaw[cell]) + 2) % 4 if slope else int(self.rng.integers(4))
                self.rows.append((*cell, yaw, AIR, 0, 0))
                return

    def park_on_slope(self, body: Cell) -> None:
        """Park on a ramp with nobody else on it, and nothing that a leaning load could touch before or behind."""
        down = int(self.grid.yaw[body])
        foot, back = beside(body, down), beside(body, down + 2)
        beyond = beside(foot, down)
        around = [(c[0], c[1], c[2] + 1) for c in (body, foot, back)]
        if not all(self.inside_and_airy(c) for c in [*around, beyond]):
            return
        state = int(self.rng.integers(1, 3))
        if any(row[:3] in (foot, around[0]) for row in self.rows):
            return
        yaw, load, load_yaw = self.heading_and_load(down if self.rng.random() < 0.5 else (down + 2) % 4)
        self.add(foot if state == 1 else around[0], yaw, load, load_yaw, state, [*around, beyond])

    def inside_and_airy(self, cell: Cell) -> bool:
        x, y, z = cell
        if not (0 <= x < self.size[0] and 0 <= y < self.size[1] and z <= self.size[2]):
            return True
        near = any(row[:2] == (x, y) for row in self.rows)
        return self.grid.kind[cell] == AIR and not near


SEEDS = range(40)


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
        assert_round_trip(Builder(np.random.default_rng(seed)).draw(), drive)


def test_random_worlds_are_varied():
    """The draws above cover every kind, every slope state with and without load, every level and every yaw."""
    grids = [Builder(np.random.default_rng(seed)).draw() for seed in SEEDS]
    cars = np.concatenate([g.cars for g in grids])
    assert set(np.unique([g.kind for g in grids])) == {int(k) for k in Kind}
    assert len(cars) > 60
    for on_slope in (0, 1, 2):
        own = cars[cars[:, CarField.SLOPE] == on_slope]
        assert set(own[:, CarField.LOAD]) == {AIR, BLOCK, FLAG, FSLOPE}
    for own in (cars[cars[:, CarField.SLOPE] > 0], cars[cars[:, CarField.LOAD] > 0]):
        assert set(own[:, CarField.YAW]) == set(range(4))
    assert set(cars[cars[:, CarField.LOAD] > 0][:, CarField.Z]) == {1, 2, 3}
    at = [(g, cell) for g in grids for cell in map(tuple, np.argwhere(np.isin(g.kind, (FSLOPE, BODY))))]
    slopes = {(int(g.kind[cell]), int(g.yaw[cell])) for g, cell in at}
    assert slopes == {(kind, yaw) for kind in (FSLOPE, BODY) for yaw in range(4)}


def test_directions_and_yaws_agree():
    assert [beside((0, 0, 1), yaw)[:2] for yaw in range(4)] == [tuple(d) for d in DIRECTIONS.tolist()]
