"""One tick of many cars in physics, predicted from what was read and read again after it."""

import numpy as np

from craftsim.checking.joint import JointSite
from craftsim.discrete.actions import Action
from craftsim.discrete.grid import Grid, Kind
from craftsim.discrete.rules import Rules
from craftsim.models.site import Site
from craftsim.skills.executor import Executor
from craftsim.skills.outcome import Reason

RULES = Rules("physical")
RIGHT = Action.MOVE_RIGHT


def _queue(fault=lambda site: None) -> JointSite:
    """Return three cars in a row, the first under a block at the row's end."""
    grid = Grid.empty((4, 2, 2), 3)
    grid.cars[:, :4] = [(2, 0, 1, 0), (1, 0, 1, 0), (0, 0, 1, 0)]
    grid.kind[2, 0, 1] = Kind.BLOCK
    grid.derive_marks()
    site = Site(grid)
    fault(site)
    return JointSite(site, RULES, Executor(site))


def _seized(car):
    """Return a fault: the wheel motors of a car give no torque."""

    def fault(site):
        site.model.actuator_forcerange[site.cars[car].wheel_actuators] = 0.0

    return fault


def test_cars_that_follow_each_other_all_move_in_one_tick_and_later_ticks_start_from_the_reading():
    world = _queue()
    predicted, _ = RULES.tick(world.grid, [(0, RIGHT), (1, RIGHT), (2, RIGHT)])
    step = world.step([(0, RIGHT), (1, RIGHT), (2, RIGHT)])
    assert [(car.car, car.applied) for car in step.cars] == [(0, True), (1, True), (2, True)]
    assert step.verdict.agrees
    assert step.reading is world.reading
    assert world.grid.same_visible(predicted)
    assert step.duration_s > max(car.outcome.duration_s for car in step.cars), "cars wait for each other"
    assert world.step([(1, Action.LIFT)]).cars[0].applied, "car 1 is under the block now"


def test_what_the_rules_forbid_in_the_given_order_is_not_performed():
    step = _queue().step([(2, RIGHT), (1, RIGHT), (0, RIGHT)])
    assert [(car.car, car.legal, car.outcome is None) for car in step.cars] == [
        (2, False, True),
        (1, False, True),
        (0, True, False),
    ]
    assert step.verdict.agrees
    np.testing.assert_array_equal(step.reading.grid.cars[:, 0], [3, 1, 0])


def test_a_failed_action_shows_as_what_really_happened_and_what_waits_for_it_never_starts():
    step = _queue(_seized(0)).step([(0, RIGHT), (1, RIGHT)])
    failed, waiting = step.cars
    assert failed.legal
    assert not failed.applied
    assert failed.outcome.reason is Reason.BLOCKED
    assert failed.difference == "car 0: predicted 3,0,1 +x, read 2,0,1 +x"
    assert waiting.legal
    assert waiting.outcome is None
    assert not waiting.applied
    assert not step.verdict.agrees
    assert not step.predicted.same_visible(step.reading.grid)
    np.testing.assert_array_equal(step.reading.grid.cars[:, 0], [2, 1, 0])
