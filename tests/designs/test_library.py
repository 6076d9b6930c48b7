"""The library of designs: nothing floats, nothing twice, files say the same."""

import numpy as np
import pytest

from craftsim.designs.library import BUILDINGS, WRITABLE_SIGNS, cells_of, make_design, sizes_of
from craftsim.designs.starts import make_start
from craftsim.discrete.files.design import Design, design_in, design_text, read_design
from craftsim.discrete.grid import Kind
from craftsim.discrete.rules import Rules
from craftsim.discrete.schedule import make_schedule
from craftsim.errors import InputError
from craftsim.planning import plan_building

RULES = Rules("physical")


def _cells(design):
    return sorted((target.kind, target.cell, target.yaw) for target in design.targets)


def _designs():
    """Yield each building as it is unless said otherwise, and in other sizes."""
    for name in BUILDINGS:
        for size in ((), (3,), (5, 4), (4, 5, 2), (7, 3, 3)):
            if len(size) <= len(sizes_of(name)):
                yield make_design(name, size, "CAR 54" if name == "letters" else None)


def test_designs_are_tight_do_not_float_and_are_written_as_what_satisfies_them(tmp_path):
    for design in _designs():
        assert design.floating() == []
        cells = [target.cell for target in design.targets]
        assert len(set(cells)) == len(cells)
        assert [min(axis) for axis in zip(*cells, strict=True)] == [0, 0, 1]
        design.check_fits(design.size)
        for axis in range(3):
            smaller = [side - (i == axis) for i, side in enumerate(design.size)]
            with pytest.raises(InputError, match="is outside the area"):
                design.check_fits(tuple(smaller))
        (tmp_path / "goal.yaml").write_text(design_text(design))
        grid = design.finished()
        assert design.satisfied(grid)
        assert (
            _cells(read_design(tmp_path / "goal.yaml")) == _cells(design_in(grid)) == _cells(design)
        )
        grid.kind[design.targets[-1].cell] = Kind.AIR
        assert not design.satisfied(grid)


def test_known_counts_and_letters():
    assert len(make_design("pyramid").targets) == 35
    assert len(make_design("wall", (10, 2, 5)).targets) == 100
    house = make_design("house").of_kind(Kind.BLOCK)
    assert len(house) == 30
    assert not {(2, 0, 1), (2, 0, 2)} & {*house}
    assert make_design("letters", (), "I").targets == make_design("letters", (), "i").targets
    shapes = {sign: frozenset(cells_of(sign)) for sign in WRITABLE_SIGNS}
    same = {frozenset(a + b) for a in shapes for b in shapes if a != b and shapes[a] == shapes[b]}
    assert len(WRITABLE_SIGNS) == 37
    assert same == {frozenset("O0"), frozenset("S5")}


def test_what_cannot_be_is_refused_with_what_can():
    for words, message in (
        (("wal",), "no design 'wal'; did you mean 'wall'?"),
        (("wall", (1, 2, 3, 4)), "wall: 4 sizes; it has 3: length, height, thickness"),
        (("wall", (0,)), "wall: length is 0; allowed: 1 to 128"),
        (("platform", (128, 128)), "16384 blocks; allowed: at most 4000"),
        (("stair", (128, 128)), "more than 4000 cells"),
        (("ring", (2,)), "ring: length is 2; allowed: at least 3"),
        (("stair", (2, 1)), "stair: width is 1; allowed: at least 2"),
        (("letters",), "letters: needs a --text"),
        (("wall", (), "A"), "wall: has no --text"),
        (("letters", (), "A?"), "letters: there is no '\\?'"),
        (("letters", (), " "), "letters: there is no text"),
        (("letters", (), "A" * 33), "33 letters; allowed: at most 32"),
    ):
        with pytest.raises(InputError, match=message):
            make_design(*words)


def test_a_design_in_no_file_is_held_to_what_a_file_is():
    for blocks, message in (
        ([(0, 0, 1), (0, 0, 1)], "two things in the cell"),
        ([(-1, 0, 1)], "outside of the largest area"),
        ([], "no cells"),
    ):
        with pytest.raises(InputError, match=message):
            Design.of("mine", blocks)
    with pytest.raises(InputError, match="another slope's foot beside it"):
        Design.of("mine", [], [((1, 1, 1), 1), ((3, 1, 1), 2)])


@pytest.mark.parametrize("name", ["house", "bridge", "stair", "tower"])
def test_one_car_builds_it_by_the_rules(name):
    start = make_start(make_design(name), 1, np.random.default_rng(0), margin=4)
    planned = plan_building(start.grid, start.design, RULES, rounds=1)
    schedule = make_schedule(start.grid, planned.ticks, RULES)
    assert not schedule.forbidden
    assert start.design.satisfied(schedule.final)
