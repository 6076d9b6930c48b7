"""A Site stands where its Grid says, stays there, and can be saved and restored to the bit."""

from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from craftsim.discrete.errors import InputError
from craftsim.discrete.geometry import DIRECTIONS
from craftsim.discrete.grid import SECOND_PART, CarField, Grid, Kind, beside
from craftsim.discrete.readback import read_grid
from craftsim.models.config import SimulationConfig
from craftsim.models.sensing import read_poses
from craftsim.models.site import Site

AIR, BLOCK, FLAG, WALL, FSLOPE, BODY = (Kind[n] for n in ("AIR", "BLOCK", "FLAG", "WALL", "FSLOPE", "BODY"))
Cell = tuple[int, int, int]


def world(
    size: Cell,
    objects: Sequence[tuple[Kind, Cell, int]] = (),
    cars: Sequence[tuple[int, ...]] = (),
) -> Grid:
    """Return a Grid of objects (kind, cell, yaw), a slope given by its first cell, and cars (rows of Grid.cars)."""
    grid = Grid.empty(size, len(cars))
    for kind, cell, yaw in objects:
        grid.kind[cell], grid.yaw[cell] = kind, yaw
        if kind in SECOND_PART:
            second = beside(cell, yaw)
            grid.kind[second], grid.yaw[second] = SECOND_PART[kind], yaw
    for i, row in enumerate(cars):
        grid.cars[i] = row
    grid.derive_marks()
    return grid


def lone_slope(yaw: int, folded: bool) -> Grid:
    """Return a slope in the middle of a place, facing yaw."""
    return world((5, 5, 2), [(FSLOPE if folded else BODY, (2, 2, 1), yaw)])


def slope_car(yaw: int, state: int, uphill: bool, load: Kind) -> Grid:
    """Return a car on the low (1) or high (2) half of a ramp that falls in direction yaw."""
    cell = (2, 2, 1) if state == 2 else beside((2, 2, 1), yaw)
    heading = (yaw + 2) % 4 if uphill else yaw
    row = (cell[0], cell[1], state, heading, load, (heading + 2) % 4 if load == FSLOPE else 0, state)
    landing = beside((2, 2, 1), yaw + 2)
    return world((5, 5, 3), [(BLOCK, landing, 0), (BODY, (2, 2, 1), yaw)], [row])


def loaded_car(load: Kind, level: int, yaw: int) -> Grid:
    """Return a loaded car on the floor, or on a platform of one or two levels of blocks."""
    tower = [(BLOCK, (x, y, z), 0) for z in range(1, level) for x in (1, 2, 3) for y in (1, 2, 3)]
    load_yaw = (yaw + 2) % 4 if load == FSLOPE else 0
    return world((5, 5, 4), tower, [(2, 2, level, yaw, load, load_yaw, 0)])


HAND_MADE = {
    "empty": world((2, 2, 1)),
    "stack of three": world((3, 3, 3), [(BLOCK, (1, 1, z), 0) for z in (1, 2, 3)]),
    "blocks side by side": world((4, 4, 2), [(BLOCK, (x, y, 1), 0) for x in range(4) for y in range(4)]),
    "flag on a block": world((3, 3, 3), [(BLOCK, (1, 1, 1), 0), (FLAG, (1, 1, 2), 0)]),
    "walls": world((3, 3, 2), [(WALL, (0, 0, 1), 0), (WALL, (1, 0, 1), 0), (BLOCK, (2, 0, 1), 0)]),
    "slope on blocks": world((4, 3, 3), [(BLOCK, (1, 1, 1), 0), (BLOCK, (2, 1, 1), 0), (BODY, (1, 1, 2), 0)]),
    "two slopes side by side": world((4, 4, 2), [(BODY, (1, 1, 1), 0), (BODY, (1, 2, 1), 0)]),
    "car under a block": world((3, 3, 2), [(BLOCK, (1, 1, 1), 0)], [(1, 1, 1, 1, 0, 0, 0)]),
    "car under a folded slope": world((4, 3, 2), [(FSLOPE, (1, 1, 1), 0)], [(1, 1, 1, 2, 0, 0, 0)]),
    "car under an unfolded slope": world((4, 3, 2), [(BODY, (1, 1, 1), 0)], [(1, 1, 1, 2, 0, 0, 0)]),
    "car on level 2 under level 3": world(
        (3, 3, 3), [(BLOCK, (1, 1, 1), 0), (BLOCK, (1, 1, 2), 0)], [(1, 1, 2, 3, 0, 0, 0)]
    ),
    "car on level 3": world(
        (3, 3, 3), [(BLOCK, (1, 1, 1), 0), (BLOCK, (1, 1, 2), 0)], [(1, 1, 3, 3, 0, 0, 0)]
    ),
    "one car above another": world(
        (3, 3, 2), [(BLOCK, (1, 1, 1), 0)], [(1, 1, 1, 0, 0, 0, 0), (1, 1, 2, 1, 0, 0, 0)]
    ),
}
HAND_MADE |= {
    f"{'folded' if f else 'unfolded'} slope yaw {yaw}": lone_slope(yaw, f) for yaw in range(4) for f in (1, 0)
}
HAND_MADE |= {
    f"{load.name.lower()} carried on level {level} yaw {yaw}": loaded_car(load, level, yaw)
    for load in (BLOCK, FLAG, FSLOPE)
    for level, yaw in ((1, 0), (1, 1), (1, 3), (2, 2), (3, 1))
}
HAND_MADE |= {
    f"car {'up' if uphill else 'down'} state {state} yaw {yaw} load {load.name.lower()}": slope_car(
        yaw, state, uphill, load
    )
    for load in (AIR, BLOCK, FLAG, FSLOPE)
    for state in (1, 2)
    for uphill, yaw in ((True, 0), (True, 1), (True, 2), (True, 3), (False, 0), (False, 3))
}


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


def everything(site: Site) -> NDArray[np.float64]:
    poses = read_poses(site)
    return np.concatenate([poses.car_positions, poses.positions])


def assert_round_trip(grid: Grid) -> None:
    """Compose, settle and read: the same Grid, within 1 mm; a second later nothing has moved by more than 0.2 mm."""
    site = Site(grid)
    for _ in range(2):
        reading = read_grid(read_poses(site), site.size, site.walls)
        assert reading.problems == ()
        assert reading.grid.same_visible(grid)
        assert reading.grid.same_marks(grid)
        assert all(placed.offset_m < 1e-3 for placed in (*reading.cars, *reading.objects))
        before = everything(site)
        for _ in range(50):
            site.advance()
        moved = np.linalg.norm(everything(site) - before, axis=1)
        assert moved.max(initial=0.0) < 2e-4


@pytest.mark.parametrize("name", HAND_MADE)
def test_a_drawn_world_reads_back_as_itself(name):
    assert_round_trip(HAND_MADE[name])


@pytest.mark.parametrize("seed", range(30))
def test_a_random_world_reads_back_as_itself(seed):
    assert_round_trip(Builder(np.random.default_rng(seed)).draw())


def test_random_worlds_are_varied():
    """The draws above cover every kind, every slope state with and without load, and every level."""
    grids = [Builder(np.random.default_rng(seed)).draw() for seed in range(30)]
    kinds = np.concatenate([g.kind.ravel() for g in grids])
    cars = np.concatenate([g.cars for g in grids])
    assert set(np.unique(kinds)) == {int(k) for k in Kind}
    assert len(cars) > 60
    assert set(cars[:, CarField.SLOPE]) == {0, 1, 2}
    assert set(cars[:, CarField.LOAD]) == {AIR, BLOCK, FLAG, FSLOPE}
    assert set(cars[:, CarField.Z]) == {1, 2, 3}
    assert (cars[cars[:, CarField.SLOPE] > 0][:, CarField.LOAD] > 0).sum() > 3


# Saving, sleeping, settings ------------------------------------------------------------------------------------------


def busy_world() -> Grid:
    return world(
        (6, 5, 3),
        [(BLOCK, (0, 2, 1), 0), (BODY, (1, 2, 1), 0), (BLOCK, (4, 4, 1), 0), (FSLOPE, (4, 0, 1), 2)],
        [(2, 2, 1, 2, BLOCK, 0, 1), (4, 4, 1, 0, 0, 0, 0), (5, 2, 1, 1, 0, 0, 0)],
    )


def drive_randomly(site: Site, seed: int, periods: int) -> list[NDArray[np.float64]]:
    """Command now one machine, now another, some of them asleep by then; return the state after every period."""
    rng, states = np.random.default_rng(seed), []
    for i in range(periods):
        if i % 20 == 0:
            for car in range(len(site.cars)):
                site.drive(car, rng.uniform(-3, 3, 4) * rng.integers(2))
                site.move_board(car, 0.05 * rng.integers(-1, 2))
            for slope in range(len(site.slopes)):
                site.turn_hinge(slope, 0.3 * rng.integers(-1, 2))
        site.advance()
        states.append(np.concatenate([site.data.qpos, site.data.qvel, site.data.act, [site.time_s]]))
    return states


@pytest.mark.parametrize("sleep", [True, False])
def test_a_restored_site_goes_on_to_the_bit(sleep):
    """In the same Site after a detour, and in another one of an equal grid."""
    config = SimulationConfig(sleep=sleep)
    site, other = Site(busy_world(), config), Site(busy_world(), config)
    drive_randomly(site, 1, 100)
    saved = site.save()
    first = drive_randomly(site, 2, 100)
    drive_randomly(site, 3, 50)
    site.restore(saved)
    second = drive_randomly(site, 2, 100)
    drive_randomly(other, 4, 30)
    other.restore(saved)
    third = drive_randomly(other, 2, 100)
    for a, b, c in zip(first, second, third, strict=True):
        assert a.tobytes() == b.tobytes() == c.tobytes()


def test_a_reset_site_starts_over_to_the_bit():
    site = Site(busy_world())
    first = drive_randomly(site, 5, 60)
    site.reset()
    assert [s.tobytes() for s in drive_randomly(site, 5, 60)] == [s.tobytes() for s in first]


def test_a_saved_state_does_not_change_while_the_site_goes_on():
    site = Site(busy_world())
    saved = site.save()
    before = saved.data.qpos.tobytes()
    drive_randomly(site, 6, 20)
    assert saved.data.qpos.tobytes() == before


def test_a_state_of_another_world_is_refused():
    saved = Site(world((3, 3, 1), [(BLOCK, (1, 1, 1), 0)])).save()
    with pytest.raises(InputError, match="other parts"):
        Site(world((3, 3, 1))).restore(saved)


def sleeper(**settings: float) -> Site:
    """Return a car that has rested for 2 s beside a block."""
    site = Site(
        world((4, 4, 1), [(BLOCK, (3, 3, 1), 0)], [(1, 1, 1, 0, 0, 0, 0)]), SimulationConfig(**settings)
    )
    for _ in range(100):
        site.advance()
    return site


def asleep(site: Site) -> bool:
    return bool(site.data.tree_asleep[site.cars[0].base.tree] >= 0)


@pytest.mark.parametrize(
    "command", [lambda s: s.drive(0, [5.0] * 4), lambda s: s.move_board(0, 0.05)], ids=["wheels", "board"]
)
def test_a_command_wakes_a_sleeping_car(command):
    site = sleeper()
    assert asleep(site)
    before = site.data.qpos.copy()
    command(site)
    site.advance()
    assert not asleep(site)
    for _ in range(24):
        site.advance()
    assert np.abs(site.data.qpos - before).max() > 0.01


def test_a_woken_car_drives_as_one_that_never_slept():
    """Half a second at 5 rad/s: within 0.1 mm of the same drive with sleep off."""
    ends = []
    for sleep in (True, False):
        site = sleeper(sleep=sleep)
        site.drive(0, [5.0] * 4)
        for _ in range(25):
            site.advance()
        ends.append(site.free_body_state(site.cars[0].base)[0])
    assert np.linalg.norm(ends[0] - ends[1]) < 1e-4


def test_without_sleep_nothing_sleeps():
    assert not asleep(sleeper(sleep=False))


def test_a_sleeping_slopes_hinge_wakes_on_command():
    site = Site(lone_slope(0, folded=True))
    for _ in range(100):
        site.advance()
    assert site.data.tree_asleep[site.slopes[0].base.tree] >= 0
    site.turn_hinge(0, -0.3)
    for _ in range(50):
        site.advance()
    assert site.data.qpos[site.slopes[0].hinge.qpos] < np.pi - 0.2


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("timestep_s", 0.0),
        ("timestep_s", -0.004),
        ("timestep_s", float("nan")),
        ("timestep_s", float("inf")),
        ("timestep_s", 0.01),
        ("control_period_s", 0.0),
        ("control_period_s", 0.021),
        ("control_period_s", 0.002),
        ("control_period_s", float("nan")),
        ("control_period_s", float("inf")),
        ("friction_impedance_ratio", 0.0),
        ("friction_impedance_ratio", float("nan")),
        ("friction_impedance_ratio", float("inf")),
        ("sleep_tolerance_m_s", 0.0),
        ("sleep_tolerance_m_s", float("nan")),
        ("settle_s", -0.1),
        ("settle_s", float("nan")),
        ("settle_s", float("inf")),
    ],
)
def test_a_setting_that_cannot_work_is_refused_by_name(field, value):
    with pytest.raises(InputError, match=f"SimulationConfig.{field}"):
        SimulationConfig(**{field: value})


def test_the_default_settings_are_the_mjcfs_own(open_part):
    """A part opened in the viewer obeys the physics of a Site."""
    option, config = open_part("smartcar").opt, SimulationConfig()
    assert option.timestep == config.timestep_s
    assert option.impratio == config.friction_impedance_ratio


def test_directions_and_yaws_agree():
    assert [beside((0, 0, 1), yaw)[:2] for yaw in range(4)] == [tuple(d) for d in DIRECTIONS.tolist()]
