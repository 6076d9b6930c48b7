"""Starts: what a design takes is there, and cars get at all of it."""

import numpy as np
import pytest
from designs.building import build
from planning.tiny_worlds import tiny_world

from craftsim.designs.drawn import random_start, random_structure
from craftsim.designs.library import BUILDINGS, make_design, sizes_of
from craftsim.designs.starts import FreeFloor, make_start
from craftsim.discrete.files.blueprint import blueprint_text, parse_blueprint
from craftsim.discrete.grid import Kind, beside, check_grid
from craftsim.errors import InputError

SEEDS = range(2)


def _pieces(free):
    """Return the pieces of a floor by a search of our own."""
    left, pieces = {(int(x), int(y)) for x, y in np.argwhere(free)}, []
    while left:
        waiting, piece = [left.pop()], set()
        while waiting:
            x, y = waiting.pop()
            piece.add((x, y))
            for near in ((x + 1, y), (x - 1, y), (x, y + 1), (x, y - 1)):
                if near in left:
                    left.remove(near)
                    waiting.append(near)
        pieces.append(piece)
    return pieces


def _counts(grid):
    return [int((grid.kind == kind).sum()) for kind in (Kind.BLOCK, Kind.FSLOPE, Kind.GEAR)]


@pytest.mark.parametrize(("seed", "name"), [*enumerate(["pyramid", "house", "stair", "ring"])])
def test_all_things_touch_a_free_floor_in_one_piece_outside_of_the_design(seed, name):
    design = make_design(name)
    start = make_start(design, 3, np.random.default_rng(seed), spare_blocks=2, spare_slopes=2)
    grid, slopes = start.grid, len(design.of_kind(Kind.BODY)) + 2
    assert _counts(grid) == [len(design.of_kind(Kind.BLOCK)) + 2, slopes, slopes]
    own = {target.cell[:2] for target in start.design.targets}
    things = {(int(x), int(y)) for x, y in np.argwhere(grid.kind[:, :, 1] != Kind.AIR)}
    assert not own & things
    free = np.ones(grid.size[:2], np.bool_)
    free[tuple(np.array(sorted(own | things)).T)] = False
    pieces = _pieces(free)
    # A court inside of the design is a piece of its own.
    assert len(pieces) == 1 + (name == "ring")
    largest = max(pieces, key=len)
    for thing in grid.pieces(Kind.BLOCK, Kind.FSLOPE):
        assert any(beside(thing.cell, yaw)[:2] in largest for yaw in range(4))
        assert thing.kind == Kind.BLOCK or beside(thing.cell, thing.yaw + 2)[:2] in largest
    cars = {tuple(car[:2]) for car in grid.cars.tolist()}
    assert cars <= largest
    assert len(cars) == 3


@pytest.mark.parametrize("seed", SEEDS)
def test_a_cell_is_taken_only_where_the_floor_stays_in_one_piece(seed):
    rng = np.random.default_rng(seed)
    free = rng.random((7, 7)) < 0.8
    free = np.isin(np.arange(49), [x * 7 + y for x, y in max(_pieces(free), key=len)]).reshape(7, 7)
    floor, taken = FreeFloor(free), 0
    for x, y in rng.permutation(np.argwhere(free)).tolist():
        taken += floor.take((x, y))
        assert len(_pieces(floor.free)) == 1
    assert taken == (free & ~floor.free).sum() > 5


def _same(one, other):
    return (
        blueprint_text(one.grid) == blueprint_text(other.grid)
        and one.design.targets == other.design.targets
    )


@pytest.mark.parametrize(
    "draw",
    [
        lambda rng: make_start(make_design("bridge"), 2, rng, barrier=True),
        lambda rng: random_start(rng, 0.0),
        tiny_world,
    ],
    ids=["bridge", "random", "tiny"],
)
def test_a_start_is_a_sound_world_that_a_blueprint_says_and_a_seed_decides(draw):
    first, again, other = (draw(np.random.default_rng(seed)) for seed in (5, 5, 6))
    assert _same(first, again)
    assert not _same(first, other)
    for start in (first, other):
        check_grid(start.grid)
        text = blueprint_text(start.grid)
        assert "snapshot" not in text
        read = parse_blueprint(text, "again.yaml").grid(np.random.default_rng(0))
        assert read.same_visible(start.grid)
        assert read.same_marks(start.grid)
        start.design.check_fits(start.grid.size)
        assert not start.design.satisfied(start.grid)


def test_a_barrier_leaves_a_gap_where_the_design_is_and_no_other():
    start = make_start(make_design("bridge", (3, 2)), 2, np.random.default_rng(0), barrier=True)
    walls = np.argwhere(start.grid.kind == Kind.WALL)
    assert len({x for x, _, _ in walls.tolist()}) == 1
    assert len(walls) == start.grid.size[1] - 2
    assert not start.grid.kind[
        tuple(np.array([target.cell for target in start.design.targets]).T)
    ].any()


@pytest.mark.parametrize("name", BUILDINGS)
def test_an_area_that_is_not_given_has_room_for_all_on_one_side_of_a_barrier(name):
    rng = np.random.default_rng(len(name))
    for _ in range(8):
        sizes = rng.integers(3, 7, len(sizes_of(name))).tolist()
        design = make_design(name, sizes, "CAR" if name == "letters" else None)
        start = make_start(design, 4, rng, barrier=True)
        assert (start.grid.kind == Kind.WALL).any()
        assert (start.grid.kind == Kind.BLOCK).sum() >= len(design.of_kind(Kind.BLOCK))


def test_what_has_no_room_is_refused_with_what_would_do():
    for options, message in (
        ({"size": (6, 6, 4)}, "too small for a design of"),
        ({"size": (12, 12, 2)}, "too small for a design of"),
        ({"size": (200, 12, 4)}, "allowed: 1 to 128 each way"),
        ({"size": (11, 11, 4), "spare_blocks": 60}, "no room for 95 blocks, 2 slopes and 2 cars"),
        ({"spare_blocks": 100_000}, "allowed: 4000 together"),
        ({"n_cars": 257}, "257 cars; allowed: at most 256"),
        ({"n_cars": 100, "size": (11, 11, 4)}, "and 100 cars beside the design"),
    ):
        options = {"n_cars": 2, "rng": np.random.default_rng(0), **options}
        with pytest.raises(InputError, match=message):
            make_start(make_design("pyramid"), **options)


def test_random_designs_stay_within_what_difficulty_allows_and_use_it():
    found = [random_start(np.random.default_rng(seed), seed / 9) for seed in range(10)]
    blocks = [len(start.design.of_kind(Kind.BLOCK)) for start in found]
    ramps = [sum(step.kind == Kind.BODY for step in start.steps) for start in found]
    assert min(blocks) >= 4
    assert 13 <= max(blocks) <= 16
    assert {0, 1, 2} <= {*ramps} <= {0, 1, 2, 3, 4}
    assert {2, 6} <= {start.grid.n_cars for start in found} <= {2, 3, 4, 5, 6}
    assert {start.design.size[2] for start in found} == {1, 2, 3}
    assert all(start.grid.size <= (8, 8, 3) for start in found)
    assert not any(start.design.floating() for start in found)
    kept = [len(start.design.of_kind(Kind.BODY)) for start in found]
    assert 0 < sum(kept) < sum(ramps), "some belong to designs, some serve for building alone"
    assert all(
        _counts(start.grid)[:2] == [n, m] for start, n, m in zip(found, blocks, ramps, strict=True)
    )
    assert np.mean(blocks[:5]) < np.mean(blocks[5:])


def test_random_structures_fill_their_height_within_their_box_and_are_all_different():
    size = (7, 7, 3)
    found = [random_structure(size, np.random.default_rng(seed)) for seed in range(3)]
    for design in found:
        assert design.size[2] == 3
        assert design.size <= size
        assert not design.floating()
        assert 0.1 <= len(design.targets) / 147 <= 0.26
    assert len({design.targets for design in found}) == 3


def test_a_difficulty_out_of_range_and_too_many_cars_are_refused():
    with pytest.raises(InputError, match=r"the difficulty is 1\.5; allowed: 0 to 1"):
        random_start(np.random.default_rng(0), 1.5)
    with pytest.raises(InputError, match="256 cars have no room"):
        random_start(np.random.default_rng(0), 0.5, n_cars=256)


@pytest.mark.parametrize("difficulty", [0.0, 0.5])
def test_one_car_builds_a_random_design_in_its_own_order_by_the_rules(difficulty):
    start = random_start(np.random.default_rng(3), difficulty)
    grid, done = build(start.grid, start.steps)
    assert done == len(start.steps)
    assert start.design.satisfied(grid)
