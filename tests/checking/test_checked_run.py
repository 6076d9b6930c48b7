"""A checked run predicts, performs, reads and compares each action, and says when any of these went apart."""

from pathlib import Path

import numpy as np
import pytest
from craftsim.checking.checked_run import CheckedSite, run_plan

from craftsim.discrete.actions import Action
from craftsim.discrete.files.plan import Plan
from craftsim.discrete.grid import Grid, Kind
from craftsim.discrete.rules import Rules
from craftsim.discrete.verdict import Finding
from craftsim.models.site import Site
from craftsim.skills.executor import Executor
from craftsim.skills.outcome import Reason

SIZE = (4, 1, 2)


def _checked(*, block_at: int | None = None, load: Kind = Kind.AIR) -> CheckedSite:
    """Return a corridor with a car in each of its end cells; the first may carry something."""
    grid = Grid.empty(SIZE, 2)
    grid.cars[0, :5] = 0, 0, 1, 0, load
    grid.cars[1, :4] = 3, 0, 1, 2
    if block_at is not None:
        grid.kind[block_at, 0, 1] = Kind.BLOCK
    grid.derive_marks()
    site = Site(grid)
    return CheckedSite(site, Rules("physical"), Executor(site))


def _weaken(checked: CheckedSite) -> None:
    site = checked.site
    site.model.actuator_forcerange[site.cars[0].wheel_actuators] = 0.0


def test_a_record_says_what_was_asked_predicted_done_and_read():
    record = _checked().perform(5, 0, Action.MOVE_RIGHT)
    assert (record.tick, record.car, record.action, record.legal) == (5, 0, Action.MOVE_RIGHT, True)
    assert (record.predicted, record.read) == ("1,0,1 +x", "1,0,1 +x")
    assert record.outcome.succeeded
    assert record.verdict.finding is Finding.AGREES
    assert record.placed_error_m is None


def test_an_illegal_action_is_not_performed():
    checked = _checked()
    before = checked.site.data.qpos.copy()
    record = checked.perform(0, 0, Action.LIFT)
    assert not record.legal
    assert record.verdict.finding is Finding.NOT_EXECUTED
    assert record.verdict.differences == ("the rules forbid LIFT to car 0 here",)
    np.testing.assert_array_equal(checked.site.data.qpos, before)


def test_a_car_that_does_not_get_away_is_not_executed():
    checked = _checked()
    _weaken(checked)
    record = checked.perform(0, 0, Action.MOVE_RIGHT)
    assert record.outcome.reason is Reason.BLOCKED
    assert record.verdict.finding is Finding.NOT_EXECUTED
    assert (record.predicted, record.read) == ("1,0,1 +x", "0,0,1 +x")


def test_the_verdict_does_not_believe_the_skill():
    checked = _checked()
    stuck = checked.executor.run

    def boasting(actions, terrain=None):
        outcomes = stuck(dict.fromkeys(actions, Action.STOP), None)
        assert all(outcome.succeeded for outcome in outcomes.values())
        return outcomes

    checked.executor.run = boasting
    record = checked.perform(0, 0, Action.MOVE_RIGHT)
    assert record.outcome.succeeded
    assert record.verdict.finding is Finding.NOT_EXECUTED


def test_a_thing_that_somebody_else_moves_is_a_side_effect_and_measured():
    checked = _checked(block_at=2)

    def hand(site):
        # A declared disturbance: somebody pushes the block along.
        block = site.blocks[0]
        pushing = site.free_body_state(block)[0][0] < 3.4 * 0.3225
        site.data.xfrc_applied[block.body, 0] = 4.2 if pushing else 0.0

    checked.executor.observers.append(hand)
    record = checked.perform(0, 0, Action.MOVE_RIGHT)
    assert record.verdict.finding in (Finding.SIDE_EFFECT, Finding.UNREADABLE)
    assert record.bystander_displacement_m > 0.025


def test_what_a_car_carries_is_no_bystander_and_what_it_drops_is_measured():
    checked = _checked(load=Kind.BLOCK)
    moved = checked.perform(0, 0, Action.MOVE_RIGHT)
    assert moved.bystander_displacement_m < 1e-3
    dropped = checked.perform(1, 0, Action.DROP)
    assert dropped.placed_error_m == pytest.approx(checked.reading.objects[0].offset_m)
    assert checked.reading.grid.kind[1, 0, 1] == Kind.BLOCK


def test_a_plan_is_run_line_by_line_and_each_action_is_announced():
    plan = Plan(Path("own.plan"), (((1, Action.MOVE_LEFT), (0, Action.STOP)), (), ((0, Action.MOVE_RIGHT),)))
    heard: list[tuple] = []
    run = run_plan(
        _checked(),
        plan,
        lambda tick, car, action: heard.append(("begin", tick, car, action)),
        lambda record: heard.append(("done", record.tick, record.car, record.action)),
    )
    asked = [(0, 1, Action.MOVE_LEFT), (0, 0, Action.STOP), (2, 0, Action.MOVE_RIGHT)]
    assert heard == [(when, *what) for what in asked for when in ("begin", "done")]
    assert [(record.tick, record.car, record.action) for record in run.records] == asked
    assert run.agrees
    assert run.simulated_s > 2.0
    np.testing.assert_array_equal(run.final.grid.cars[:, 0], [1, 2])


def test_a_plan_with_an_illegal_action_goes_on_and_does_not_agree():
    plan = Plan(Path("own.plan"), (((0, Action.LIFT),), ((0, Action.MOVE_RIGHT),)))
    run = run_plan(_checked(), plan, lambda tick, car, action: None, lambda record: None)
    assert [record.legal for record in run.records] == [False, True]
    assert [record.verdict.agrees for record in run.records] == [False, True]
    assert not run.agrees


def test_what_turns_unsafe_ends_at_once_with_all_motors_stopped():
    """A car drives off a block, which the rules forbid: it tips long before it is where it was to go."""
    grid = Grid.empty((3, 1, 3), 2)
    grid.cars[0, :4], grid.cars[1, :4] = (0, 0, 2, 0), (2, 0, 1, 0)
    grid.kind[0, 0, 1] = Kind.BLOCK
    grid.derive_marks()
    site = Site(grid)
    checked = CheckedSite(site, Rules("physical"), Executor(site))
    goal = grid.copy()
    goal.cars[0, 0] = 1
    record = checked.perform(0, 0, Action.MOVE_RIGHT, intended=goal)
    assert record.verdict.finding is Finding.UNSAFE
    assert record.outcome.reason is Reason.STOPPED
    assert record.outcome.duration_s == pytest.approx(site.time_s - site.config.settle_s)
    assert 0.45 < checked.log.tilt_rad < 0.8 or 0.45 < checked.log.fall_m_s < 0.9
    assert not site.data.ctrl.any()
    assert not checked.executor.busy
