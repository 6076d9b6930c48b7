"""When the actions of a plan start and end at nominal physics."""

import numpy as np
import pytest

from craftsim.discrete.files.plan import read_plan
from craftsim.discrete.files.shipped import shipped_plan
from craftsim.discrete.kinds import Action
from craftsim.discrete.rules import Rules
from craftsim.discrete.schedule import make_schedule, nominal_durations
from craftsim.discrete.tasks import make_task
from craftsim.errors import InputError

RULES = Rules("physical")


def test_cars_far_from_each_other_start_together_and_each_car_acts_without_pause(scene, car):
    grid = scene([], [car(0, 0), car(4, 4)])
    ticks = [[(0, Action.MOVE_RIGHT), (1, Action.ROTATE_LEFT)], [(1, Action.MOVE_LEFT)]]
    move, turn = nominal_durations()[[Action.MOVE_RIGHT, Action.ROTATE_LEFT], 0]
    schedule = make_schedule(grid, ticks, RULES)
    np.testing.assert_allclose(schedule.times(), [(0, move), (0, turn), (turn, turn + move)])
    assert schedule.makespan() == turn + move


def test_a_step_starts_when_the_last_it_waits_for_ends(rng):
    for order in ("sequential", "concurrent", "at-once"):
        grid = make_task("complex_two_story").draw(rng)
        schedule = make_schedule(
            grid, read_plan(shipped_plan("complex_two_story"), grid.n_cars).ticks, RULES, order
        )
        times = schedule.times()
        assert times.shape == (len(schedule.steps), 2)
        assert (times[:, 1] > times[:, 0]).all()
        for (start, _), step in zip(times, schedule.steps, strict=True):
            assert start == max((times[other, 1] for other in step.waits_for), default=0.0)
        if order == "sequential":
            assert schedule.makespan() == pytest.approx(np.diff(times).sum())


def test_a_constraint_delays_who_has_it_and_nobody_else(scene, car):
    grid = scene([], [car(0, 0), car(4, 4), car(0, 4)])
    ticks = [[(car, Action.ROTATE_LEFT) for car in range(3)]]
    free = make_schedule(grid, ticks, RULES).times()
    bound = make_schedule(grid, ticks, RULES, after={(0, 2): [(0, 0)]}).times()
    assert (bound[:2] == free[:2]).all()
    assert bound[2, 0] == free[0, 1] > free[2, 0]


def test_nothing_takes_no_time(scene, car):
    schedule = make_schedule(scene([], [car(0, 0)]), [], RULES)
    assert schedule.times().shape == (0, 2)
    assert schedule.makespan() == 0.0


@pytest.mark.parametrize("order", ["ticks", None])
def test_an_unknown_order_is_named_with_those_that_there_are(scene, car, order):
    with pytest.raises(InputError, match=f"no order {order!r}.*orders: sequential, concurrent"):
        make_schedule(scene([], [car(0, 0)]), [[(0, Action.ROTATE_LEFT)]], RULES, order)
