"""What is called not clear disturbs something in physics, and its twin without the neighbour does not."""

import pytest

from craftsim.discrete.actions import Action
from craftsim.discrete.footprint import is_clear
from craftsim.discrete.grid import KINDS_WITH_YAW, SECOND_PART, Grid, Kind, beside
from craftsim.discrete.rules import Rules
from craftsim.models.site import Site
from craftsim.skills.executor import Executor
from craftsim.validation.checked_run import CheckedSite

RULES = Rules("physical")
BLOCK = Kind.BLOCK
FOLDED, OPEN = (Kind.FSLOPE, (3, 1, 1), 2), (Kind.BODY, (3, 1, 1), 2)
RAMP = [(BLOCK, (0, 1, 1)), (Kind.BODY, (1, 1, 1), 0)]
TURN, UNFOLD, FOLD = Action.ROTATE_LEFT, Action.UNFOLD, Action.FOLD
CLIMBER, FALLER = (2, 1, 1, 2, BLOCK, 0, 1), (1, 1, 2, 0, BLOCK, 0, 2)
CASES = {
    # name: cars and objects of the unclear world, those of its clear twin, the acting car, its action
    "a load turns beside a car": (
        ([(1, 1, 1, 0, BLOCK), (2, 1, 1, 0)], []),
        ([(1, 1, 1, 0, BLOCK), (3, 1, 1, 0)], []),
        0,
        TURN,
    ),
    "a slope turns beside a car": (
        ([(1, 1, 1, 2, Kind.FSLOPE), (2, 1, 1, 0)], []),
        ([(1, 1, 1, 2, Kind.FSLOPE), (3, 1, 1, 0)], []),
        0,
        TURN,
    ),
    "a flap rises before a block": (
        ([(3, 1, 1, 0)], [OPEN, (BLOCK, (1, 1, 1))]),
        ([(3, 1, 1, 0)], [OPEN, (BLOCK, (0, 1, 1))]),
        0,
        FOLD,
    ),
    "a flap comes down on a car": (
        ([(3, 1, 1, 0), (2, 1, 1, 0)], [FOLDED]),
        ([(3, 1, 1, 0), (1, 1, 1, 0)], [FOLDED]),
        0,
        UNFOLD,
    ),
    "a load comes behind a leaning one": (
        ([CLIMBER, (4, 1, 1, 2, BLOCK)], RAMP),
        ([CLIMBER, (4, 1, 1, 2)], RAMP),
        1,
        Action.MOVE_LEFT,
    ),
    "a leaning load comes down to one": (
        ([FALLER, (3, 1, 1, 2, BLOCK)], RAMP),
        ([FALLER, (4, 1, 1, 2, BLOCK)], RAMP),
        0,
        Action.MOVE_RIGHT,
    ),
}


def _draw(cars, objects) -> Grid:
    grid = Grid.empty((6, 3, 3), len(cars))
    for row, values in zip(grid.cars, cars, strict=True):
        row[: len(values)] = values
    for kind, cell, *yaw in objects:
        parts = [(kind, cell)]
        if kind in SECOND_PART:
            parts.append((SECOND_PART[kind], beside(cell, *yaw)))
        for part, where in parts:
            grid.kind[where] = part
            grid.yaw[where] = yaw[0] if kind in KINDS_WITH_YAW else 0
    grid.derive_marks()
    return grid


def _run(world, car, action) -> tuple[bool, bool, float]:
    """Return whether the action is clear, whether it did what the rules predict, and how far it shifted anything."""
    grid = _draw(*world)
    assert RULES.legal(grid, car, action)
    clear = is_clear(grid, RULES.apply(grid, car, action), car, action)
    site = Site(grid)
    checked = CheckedSite(site, RULES, Executor(site))
    assert checked.reading.grid.same_visible(grid)
    record = checked.perform(0, car, action)
    own_load = max((p.offset_m for p in checked.reading.objects if p.carrier == car), default=0.0)
    return clear, record.outcome.succeeded and record.verdict.agrees, max(record.others_moved_m, own_load)


@pytest.mark.parametrize("name", CASES)
def test_what_is_not_clear_disturbs_something(name):
    world, _, car, action = CASES[name]
    clear, agrees, shifted_m = _run(world, car, action)
    assert not clear
    assert not agrees or shifted_m > 5e-3


@pytest.mark.parametrize("name", CASES)
def test_its_clear_twin_disturbs_nothing(name):
    _, twin, car, action = CASES[name]
    clear, agrees, shifted_m = _run(twin, car, action)
    assert clear
    assert agrees
    assert shifted_m < 1e-3


def test_a_flap_that_comes_down_beside_a_block_pushes_it_less_than_one_that_rises_but_pushes_it():
    beside_block, apart = ([(3, 1, 1, 0)], [FOLDED, (BLOCK, (1, 1, 1))]), ([(3, 1, 1, 0)], [FOLDED])
    assert _run(beside_block, 0, UNFOLD)[0] is False
    assert 1e-3 < _run(beside_block, 0, UNFOLD)[2] < 5e-3
    assert _run(apart, 0, UNFOLD)[2] < 1e-4
