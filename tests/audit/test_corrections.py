"""What only published allows goes wrong in physics; its twin, which physical allows as well, does not."""

from typing import Final

import numpy as np
import pytest
from discrete.drawn import draw

from craftsim.checking.setup import Seed, Setup, compile_world, set_up, setup_of
from craftsim.discrete.grid import Grid, Kind
from craftsim.discrete.kinds import Action, Correction
from craftsim.discrete.rules import RULE_SETS, Rules

PUBLISHED: Final = "published"
PHYSICAL: Final = "physical"
BLOCK = Kind.BLOCK
FOLDED, OPEN = (Kind.FSLOPE, (3, 1, 1), 2), (Kind.BODY, (3, 1, 1), 2)
RAMP = [(BLOCK, (0, 1, 1)), (Kind.BODY, (1, 1, 1), 0)]
TURN, UNFOLD, FOLD = Action.ROTATE_LEFT, Action.UNFOLD, Action.FOLD
BACK, ON = Action.MOVE_LEFT, Action.MOVE_RIGHT
CLIMBER, FALLER = (2, 1, 1, 2, BLOCK, 0, 1), (1, 1, 2, 0, BLOCK, 0, 2)
LIGHT, HOME = (2, 1, 1, 2, 0, 0, 1), (3, 1, 1, 0)
OVER = [(3, 1, 2, 2, 0, 0, 2)]
CRESTED = [(Kind.BODY, (3, 1, 1), 0)]
GEARED = [*RAMP, (BLOCK, (1, 2, 1)), (Kind.FSLOPE, (1, 2, 2), 3)]
SLOPED = [OPEN, (BLOCK, (2, 2, 1))]
CASES = {
    # name: cars and objects of the world, those of its twin, the acting car, its action
    "a load turns beside a car": ([(1, 1, 1, 0, BLOCK), (2, 1, 1, 0)], [], [(1, 1, 1, 0, BLOCK), HOME], [], 0, TURN),
    "a slope turns beside a car": (
        *([(1, 1, 1, 2, Kind.FSLOPE), (2, 1, 1, 0)], [], [(1, 1, 1, 2, Kind.FSLOPE), HOME], [], 0, TURN),
    ),
    "a flap rises before a block": ([HOME], [OPEN, (BLOCK, (1, 1, 1))], [HOME], [OPEN, (BLOCK, (0, 1, 1))], 0, FOLD),
    "a flap comes down on a car": ([HOME, (2, 1, 1, 0)], [FOLDED], [HOME, (1, 1, 1, 0)], [FOLDED], 0, UNFOLD),
    "a load comes behind a leaning one": (
        *([CLIMBER, (4, 1, 1, 2, BLOCK)], RAMP, [CLIMBER, (4, 1, 1, 2)], RAMP, 1, BACK),
    ),
    "a leaning load comes down to one": (
        *([FALLER, (3, 1, 1, 2, BLOCK)], RAMP, [FALLER, (4, 1, 1, 2, BLOCK)], RAMP, 0, ON),
    ),
    "a load turns beside a leaning one": (
        *([CLIMBER, (3, 2, 1, 0, BLOCK)], RAMP, [LIGHT, (3, 2, 1, 0, BLOCK)], RAMP, 1, TURN),
    ),
    "a load comes down before a block": (
        *([FALLER], [*RAMP, (BLOCK, (3, 1, 1))], [FALLER], [*RAMP, (BLOCK, (4, 1, 1))], 0, ON),
    ),
    "a flap meets a gear from the side": (
        *([HOME], [*SLOPED, (Kind.FSLOPE, (2, 2, 2), 3)], [HOME], [*SLOPED, (Kind.FSLOPE, (2, 2, 2), 0)], 0, FOLD),
    ),
    "a load climbs below a gear from the side": ([CLIMBER], GEARED, [LIGHT], GEARED, 0, BACK),
    "a car drives over a crest": (
        *(OVER, [*CRESTED, (Kind.BODY, (2, 1, 1), 2)], OVER, [*CRESTED, (BLOCK, (2, 1, 1))], 0, BACK),
    ),
    "a car drives onto a top from the side": (
        *([(1, 0, 2, 1)], [*GEARED, (BLOCK, (1, 0, 1))], [(0, 1, 2, 0)], [*GEARED, (BLOCK, (1, 0, 1))]),
        *(0, (Action.MOVE_FORWARD, ON)),
    ),
}  # fmt: skip


def _world(cars, objects) -> Grid:
    return draw((6, 4, 3), objects, cars)


def _run(world, car, action, rules) -> tuple[bool, float]:
    """Return whether the action did what the rules predict, and how far it shifted what it should not."""
    grid = _world(*world)
    judge = set_up(grid, Setup(rules))
    assert judge.reading.grid.same_visible(grid)
    attempt = judge.perform(car, action)
    assert attempt.legal
    own_load = max((p.offset_m for p in judge.reading.objects if p.carrier == car), default=0.0)
    reads_as_predicted = attempt.skill == "succeeded" and attempt.finding == "agrees"
    return reads_as_predicted, max(attempt.bystander_displacement_m, own_load)


@pytest.mark.parametrize("name", CASES)
def test_what_only_published_allows_goes_wrong_and_its_twin_disturbs_nothing(name):
    *worlds, car, action = CASES[name]
    first, second = action if isinstance(action, tuple) else (action, action)
    assert not Rules(PHYSICAL).legal(_world(*worlds[:2]), car, first)
    agrees, shifted_m = _run(worlds[:2], car, first, PUBLISHED)
    assert not agrees or shifted_m > 5e-3
    agrees, shifted_m = _run(worlds[2:], car, second, PHYSICAL)
    assert agrees
    assert shifted_m < 1e-3


def test_from_a_top_onto_a_second_foot_a_car_is_where_physical_says():
    stairs = [
        (Kind.BODY, (4, 1, 1), 0),
        *[(BLOCK, (x, 1, 1)) for x in (1, 2, 3)],
        (Kind.BODY, (2, 1, 2), 0),
    ]
    world = [(4, 1, 2, 2, 0, 0, 2)], [*stairs, (BLOCK, (1, 1, 2))]
    assert _run(world, 0, Action.MOVE_LEFT, PUBLISHED)[0] is False
    assert _run(world, 0, Action.MOVE_LEFT, PHYSICAL)[0] is True


def test_two_gears_in_one_cell_are_what_physical_says():
    world = [(3, 1, 1, 0)], [(Kind.FSLOPE, (1, 1, 1), 0), (Kind.FSLOPE, (3, 1, 1), 2)]
    grid = _world(*world)
    grid.yaw[2, 1, 1] = 0
    for rules, agrees in ((PUBLISHED, False), (PHYSICAL, True)):
        attempt = set_up(grid, Setup(rules)).perform(0, Action.LIFT)
        assert (attempt.finding == "agrees") is agrees


OFF_THE_FOOT = [(2, 1, 1, 0, 0, 0, 1)], [*RAMP, (BLOCK, (3, 1, 1))]
ONE_CELL_FURTHER = [(2, 1, 1, 0, 0, 0, 1)], [*RAMP, (BLOCK, (4, 1, 1))]
FROM_THE_FLAT = [(3, 1, 1, 0)], [*RAMP, (BLOCK, (4, 1, 1))]


def test_run_out_alone_forbids_to_drive_off_a_foot_right_under_a_block():
    flags = RULE_SETS[PHYSICAL]
    for world in (OFF_THE_FOOT, ONE_CELL_FURTHER, FROM_THE_FLAT):
        grid = _world(*world)
        assert Rules(PHYSICAL, flags & ~Correction.run_out).legal(grid, 0, Action.MOVE_RIGHT)
        assert Rules(PHYSICAL).legal(grid, 0, Action.MOVE_RIGHT) is (world is not OFF_THE_FOOT)


def test_a_block_right_behind_a_foot_is_shoved_by_who_comes_off_it_and_no_other_is():
    setup = setup_of("mild", PUBLISHED)

    def shoves_m(world, seeds):
        grid = _world(*world)
        physics = compile_world(grid, setup)
        tried = [
            set_up(grid, setup, Seed((seed,)), reuse=physics).perform(0, ON)
            for seed in range(seeds)
        ]
        assert all(attempt.finding == "agrees" for attempt in tried)
        return [attempt.bystander_displacement_m for attempt in tried]

    shoved = shoves_m(OFF_THE_FOOT, 8)
    assert np.median(shoved) > 2e-4
    assert max(shoved) > 6e-4
    assert max(shoves_m(ONE_CELL_FURTHER, 2) + shoves_m(FROM_THE_FLAT, 2)) < 1e-4
