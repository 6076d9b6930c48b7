"""Plans as one schedule, and actions that begin one by one: what runs when, and what happens when a car fails."""

from dataclasses import replace

import numpy as np
import pytest
from discrete.drawn import draw
from discrete.worldgen import conflict

from craftsim.checking.attempt import Attempt
from craftsim.checking.contacts import under
from craftsim.checking.judge import Judge
from craftsim.checking.recipe import Recipe, begin, in_order, perform_step, start
from craftsim.checking.setup import Setup, nominal_gains, set_up, setup_of
from craftsim.discrete.grid import Grid, Kind
from craftsim.discrete.kinds import Action
from craftsim.discrete.schedule import make_schedule
from craftsim.envs.options import Options
from craftsim.envs.physics_backend import PhysicsBackend
from craftsim.errors import InputError
from craftsim.models.sensing import EXACT
from craftsim.storage.records import from_json, to_json
from craftsim.validation.rollout import steps_of

RIGHT = Action.MOVE_RIGHT

PLAN = [
    [(0, RIGHT), (1, RIGHT), (2, Action.LIFT)],
    [(0, RIGHT), (1, Action.ROTATE_LEFT), (2, RIGHT)],
    [(2, Action.DROP)],
]
STEPS_OF = {0: [0, 3], 1: [1, 4], 2: [2, 5, 6]}
WHEELS, SETUP = (setup_of(drawn, drive="wheels") for drawn in ("none", "mild"))


def _yard() -> Grid:
    """Return a yard in which car 0 makes way for car 1, and car 2 carries a block about far away."""
    return draw((5, 4, 2), [(Kind.BLOCK, (1, 3, 1))], [(1, 0, 1, 0), (0, 0, 1, 0), (1, 3, 1, 0)])


def _run(
    disable=lambda physics: None, order="concurrent", plan=PLAN
) -> tuple[Judge, tuple[Attempt, ...]]:
    judge = set_up(_yard(), Setup())
    disable(judge.physics)
    return judge, judge.perform_plan(plan, order)


def _not_performed(attempts) -> list[int]:
    return [index for index, attempt in enumerate(attempts) if not attempt.performed]


def _unpower(car):
    """Return a fault: the wheel motors of a car give no torque."""

    def fault(physics):
        physics.model.actuator_forcerange[physics.cars[car].wheel_actuators] = 0.0

    return fault


def _polish(car):
    """Return a fault: the rollers of a car and the ground under it have next to no friction."""

    def fault(physics):
        own = physics.model.geom_bodyid
        of_car = physics.model.body_rootid[own] == physics.cars[car].base.body
        physics.model.geom_friction[of_car] = 1e-4
        physics.model.geom_priority[of_car] = 1

    return fault


def test_with_all_cars_sound_everything_runs_and_attempts_are_in_the_order_of_the_plan():
    _, attempts = _run()
    assert all(attempt.agrees for attempt in attempts)
    asked = [(tick, car, action.name) for tick, joint in enumerate(PLAN) for car, action in joint]
    assert [(a.tick, a.car, a.action) for a in attempts] == asked


def test_an_action_starts_when_those_have_ended_after_which_its_plan_has_it():
    ticks = [[(0, Action.STOP), (1, Action.ROTATE_LEFT), (2, Action.STOP)]]
    step = steps_of(ticks, "concurrent", {(0, 2): [(0, 1)]})[0]
    _, turn, late = perform_step(set_up(_yard(), WHEELS), step)
    assert late.start_s >= turn.start_s + turn.duration_s > 0
    _, turn, early = perform_step(set_up(_yard(), WHEELS), replace(step, after=()))
    assert early.start_s == turn.start_s


def test_within_a_tick_carried_out_by_itself_its_own_constraints_hold():
    ticks = [[(0, RIGHT)], [(0, RIGHT), (1, RIGHT)]]
    _, step = steps_of(ticks, "ticks", {(1, 1): [(0, 0), (1, 0)]})
    assert (step.number, step.after) == (1, (((0, 1), (0, 0)),))


def test_the_failure_of_a_car_that_nobody_waits_for_concerns_nobody_else():
    _, attempts = _run(_unpower(1))
    assert _not_performed(attempts) == [4]
    assert {index for index, attempt in enumerate(attempts) if attempt.agrees} == {0, 2, 3, 5, 6}


@pytest.mark.parametrize("fault", [_unpower, _polish])
def test_a_car_that_fails_stops_with_all_that_depends_on_it_and_the_others_finish(fault):
    judge, attempts = _run(fault(0))
    assert attempts[0].skill.startswith(("blocked", "slipped"))
    assert attempts[0].differences
    assert _not_performed(attempts) == [1, 3, 4]
    assert all(
        attempts[index].reason.endswith("waits for an action that failed") for index in (1, 3, 4)
    )
    for index in STEPS_OF[2]:
        assert attempts[index].agrees, attempts[index]
    assert not any(attempts[index].agrees for car in (0, 1) for index in STEPS_OF[car])
    assert judge.problems == ()
    assert judge.grid.kind[2, 3, 1] == Kind.BLOCK
    np.testing.assert_array_equal(judge.grid.cars[:2], _yard().cars[:2])


@pytest.mark.parametrize("force_n", [0.0, 120.0])
def test_what_moves_after_its_action_has_ended_is_held_against_the_actions_still_running(force_n):
    judge = set_up(_yard(), replace(WHEELS, assumed=EXACT))
    running, started, start = {}, set(), []

    def listen(now):
        running.clear()
        running.update(now)
        started.update(now)

    def shove(physics):
        ended = started - set(running)
        if len(ended) == 1 and running:
            base = physics.cars[next(iter(ended))].base
            x = float(physics.free_body_state(base)[0][0])
            start.append(x)
            physics.data.xfrc_applied[base.body, 0] = force_n if x < start[0] + 0.006 else 0.0

    judge.on_change = listen
    judge.executor.observers.append(shove)
    attempts = judge.perform_tick([(0, RIGHT), (2, Action.LIFT)])
    assert all(attempt.performed for attempt in attempts)
    assert len(start) > 4
    assert [attempt.agrees for attempt in attempts] == [True, force_n == 0.0]
    assert ("car 0 was moved" in attempts[1].reason) == (force_n > 0.0)


def test_an_accident_is_held_against_what_had_not_ended_before_it():
    """A car of 101 N, with a block, is pressed down with 400 N once another car has ended its first action."""
    judge, now = set_up(_yard(), WHEELS), {}

    def press(physics):
        if 0 in now and now[0].action == Action.ROTATE_LEFT:
            physics.data.xfrc_applied[physics.cars[2].base.body, 2] = -400.0

    judge.on_change = lambda running: (now.clear(), now.update(running))
    judge.executor.observers.append(press)
    turn = (0, Action.ROTATE_LEFT)
    first = [(0, Action.ROTATE_RIGHT), (2, Action.LIFT)]
    attempts = judge.perform_plan([first, [turn, (2, RIGHT)], [turn]], "concurrent")
    findings = {(a.tick, a.car): a.finding for a in attempts}
    later = dict.fromkeys([(1, 2), (2, 0)], "not executed")
    assert findings == {(0, 0): "agrees", (0, 2): "unsafe", (1, 0): "unsafe"} | later


@pytest.mark.parametrize("order", ["concurrent", "sequential", "until-wrong"])
def test_what_can_no_longer_be_read_is_held_against_what_had_not_ended_before_it(order):
    """By CraftEnv's rules a block may turn beside a car, which shoves it off its seat."""
    yard = draw((3, 3, 2), [(Kind.BLOCK, (1, 1, 1))], [(0, 1, 1, 0), (1, 2, 1, 0)])
    judge = set_up(yard, setup_of("none", rules="published", drive="wheels"))
    steps = [[(0, RIGHT)], [(0, Action.LIFT)], [(0, Action.ROTATE_LEFT)]]
    attempts = judge.perform_plan(steps, order)
    assert [a.finding for a in attempts] == ["agrees", "agrees", "unreadable"]
    assert [a.agrees for a in attempts] == [True, True, False]


def test_what_ends_while_another_car_turns_ends_well():
    """A heading between two of the grid's says nothing of what has ended meanwhile."""
    cars = [(0, 1, 1, 0), (1, 2, 1, 0), (0, 4, 1, 0)]
    yard = draw((7, 5, 2), [(Kind.BLOCK, (1, 1, 1))], cars)
    judge = set_up(yard, setup_of("none", rules="published", drive="wheels"))
    turn = Action.ROTATE_LEFT
    steps = [[(0, RIGHT), (2, turn)], [(0, Action.LIFT), (2, turn)], [(0, turn), (2, turn)]]
    found = {(a.car, a.tick): a.finding for a in judge.perform_plan(steps, "concurrent")}
    assert found.pop((0, 2)) == "unreadable"
    assert {act: finding for act, finding in found.items() if finding != "agrees"} == {}


def test_one_by_one_a_failure_ends_everything_and_what_the_rules_forbid_ends_nothing():
    _, attempts = _run(_unpower(0), "sequential")
    assert _not_performed(attempts) == [1, 2, 3, 4, 5, 6]
    _, attempts = _run(plan=[[(0, Action.LIFT)], [(0, RIGHT)]])
    assert [(a.tick, a.legal, a.performed, a.agrees) for a in attempts] == [
        (0, False, False, False),
        (1, True, True, True),
    ]


def test_the_listener_hears_every_change_of_what_runs():
    judge = set_up(_yard(), WHEELS)
    heard = []
    judge.on_change = lambda running: heard.append(
        {car: step.action for car, step in running.items()}
    )
    judge.perform_plan([[(0, RIGHT), (1, RIGHT)]], "concurrent")
    assert [one for one, last in zip(heard, [None, *heard], strict=False) if one != last] == [
        {0: RIGHT},
        {1: RIGHT},
        {},
    ]


def test_a_car_on_the_foot_of_a_slope_or_on_its_body_stands_on_that_slope():
    """An unfolded slope with its body at x = 3 and its foot at x = 2, and a car on its way up or down, or before it."""
    for first, goal, stands in ((1, 2, True), (2, 1, True), (2, 3, True), (0, 1, False)):

        def yard(x):
            levels = {2: (1, 0, 0), 3: (2, 0, 0)}.get(x, (1, 0, 0))
            return draw((5, 1, 3), [(Kind.BODY, (3, 0, 1), 2)], [(x, 0, *levels)])

        judge = set_up(yard(0), WHEELS)
        reading = replace(judge.reading, grid=yard(first))
        assert under(reading, yard(goal), 0) == ([0] if stands else [])


def _swaying_stacks():
    """Return a judge on two stacks of four blocks with a loaded car on top, and how far the last block is off."""
    stacks = [(Kind.BLOCK, (x, 0, z)) for x in (0, 1) for z in (1, 2, 3, 4)]
    grid = draw((4, 2, 5), stacks, [(0, 0, 5, 0, Kind.FSLOPE, 2), (3, 1, 1, 0)])
    gains = nominal_gains()
    drive = replace(gains.drive, rocking=9.0, max_turn_speed=3.3)
    judge = set_up(grid, Setup(gains=replace(gains, drive=drive), assumed=EXACT))
    physics = judge.physics
    start = physics.free_body_state(physics.blocks[7])[0]
    return judge, lambda: float(
        np.linalg.norm(physics.free_body_state(physics.blocks[7])[0] - start)
    )


def test_a_stack_that_sways_under_a_car_on_its_way_is_held_against_no_other_action():
    """A loaded car drives fast over two stacks, which give way by a millimetre meanwhile."""
    judge, sway_m = _swaying_stacks()
    swayed = []
    judge.executor.observers.append(lambda physics: swayed.append(sway_m()))
    drive, turn = judge.perform_tick([(0, RIGHT), (1, Action.ROTATE_LEFT)], order="concurrent")
    assert max(swayed) > 0.001 > swayed[-1]
    assert swayed[round(turn.duration_s / 0.02)] > 0.001
    assert drive.agrees
    assert turn.agrees


def test_what_sways_when_an_action_begins_is_held_against_no_action():
    """The same, and a turn that begins while the stacks give way and ends when they are back."""
    judge, sway_m = _swaying_stacks()
    begin(judge, 0, RIGHT)
    while sway_m() < 0.001:
        judge.next(judge.physics.time_s + 0.02)
    begin(judge, 1, Action.ROTATE_LEFT)
    attempts = []
    while judge.running:
        attempts += judge.next()
    assert [attempt.car for attempt in attempts] == [0, 1]
    assert sway_m() < 0.001
    assert all(attempt.agrees for attempt in attempts)


def test_what_is_displaced_for_good_while_a_stack_sways_is_reported():
    """A shove moves the block that the car has just left, and it stays there: its drive is held responsible."""
    judge, _ = _swaying_stacks()
    physics, block = judge.physics, judge.physics.blocks[3]
    start = physics.free_body_state(block)[0].copy()
    begin(judge, 0, RIGHT)
    while judge.reading.cars[0].cell[0] == 0:
        judge.next(physics.time_s + 0.02)
    begin(judge, 1, Action.ROTATE_LEFT)
    while np.linalg.norm(physics.free_body_state(block)[0] - start) < 0.003:
        physics.data.xfrc_applied[block.body, 1] = 6.0
        assert not judge.next(physics.time_s + 0.02), "nothing ends before it is displaced"
    physics.data.xfrc_applied[block.body] = 0.0
    drive, turn = (*judge.next(), *judge.next())
    assert (drive.car, drive.agrees, turn.car, turn.agrees) == (0, False, 1, True)
    assert "block 3 was moved" in drive.reason


def test_the_schedule_of_a_plan_makes_the_same_attempts_one_by_one():
    schedule = make_schedule(_yard(), PLAN, set_up(_yard(), SETUP).rules)
    whole, judge = set_up(_yard(), SETUP), set_up(_yard(), SETUP)
    waiting, done, found = dict(enumerate(schedule.steps)), set(), []
    place = {(step.tick, step.car): n for n, step in enumerate(schedule.steps)}
    while waiting or judge.running:
        for number, step in list(waiting.items()):
            if step.waits_for <= done and step.car not in judge.running:
                del waiting[number]
                begin(judge, step.car, step.action, step.tick)
        found += judge.next()
        done = {place[attempt.tick, attempt.car] for attempt in found}
    found.sort(key=lambda attempt: place[attempt.tick, attempt.car])
    assert tuple(found) == whole.perform_plan(PLAN, "concurrent")
    np.testing.assert_array_equal(judge.physics.data.qpos, whole.physics.data.qpos)


def test_what_runs_is_committed_and_only_what_has_ended_is_confirmed():
    judge = set_up(_yard(), SETUP)
    yard = judge.grid
    begin(judge, 2, Action.LIFT)
    begin(judge, 0, RIGHT)
    unreadable = False
    for _ in range(9):
        assert judge.next(until_s=judge.physics.time_s + 0.1) == ()
        assert judge.confirmed.same_visible(yard)
        assert not judge.problems
        unreadable |= bool(judge.reading.problems)
    assert unreadable
    assert not judge.grid.same_visible(yard)
    after, _ = judge.rules.tick(yard, [(2, Action.LIFT), (0, RIGHT)])
    assert judge.committed.same_visible(after)
    (first,) = judge.next()
    assert judge.committed.same_visible(after)
    assert (judge.confirmed.cars[0, 0], judge.confirmed.cars[2, 4]) == (2, 0)
    (second,) = judge.next()
    assert (first.car, second.car, first.agrees, second.agrees) == (0, 2, True, True)
    assert judge.confirmed.same_visible(after)


def test_a_failure_is_that_of_its_car_alone():
    judge = set_up(_yard(), Setup())
    _unpower(0)(judge.physics)
    begin(judge, 2, Action.LIFT)
    begin(judge, 0, RIGHT)
    found = [*judge.next(), *judge.next()]
    assert sorted((attempt.car, attempt.agrees) for attempt in found) == [(0, False), (2, True)]
    assert judge.confirmed.cars[0, 0] == 1
    begin(judge, 2, Action.DROP)
    for car, action, message in (
        (0, Action.LIFT, "LIFT is forbidden"),
        (2, RIGHT, "its DROP runs"),
    ):
        with pytest.raises(InputError, match=message):
            begin(judge, car, action)


def test_an_episode_is_run_again_bit_for_bit_from_its_recipe():
    """Random legal play that the footprints allow; cars wait at times, with something running or nothing."""
    rng, backend = np.random.default_rng(4), PhysicsBackend(SETUP, Options(check_contacts=True))
    backend.start(_yard(), np.random.default_rng(3))
    judge, n_begun = backend.judge, 0
    while n_begun < 12:
        for car in rng.permutation(3).tolist():
            legal = np.flatnonzero(judge.rules.mask(judge.committed)[car])
            step = make_schedule(
                judge.committed, [[(car, Action(rng.choice(legal)))]], judge.rules
            ).steps[0]
            claimed = any(
                conflict(other.footprint, step.footprint) for other in judge.running.values()
            )
            if car in judge.running or claimed or rng.random() < 0.3:
                continue
            row = judge.committed.cars[car]
            backend.begin(car, step.action, row, row)
            n_begun += 1
        ended = backend.advance(judge.physics.time_s + 1.0)
        assert not ended.problems
    recipe = backend.recipe
    assert len({*np.diff(recipe.steps[0].starts_s)}) > 2
    again = start(recipe)
    assert from_json(Recipe, to_json(recipe), "recipe") == recipe
    attempts = perform_step(again, recipe.steps[0])
    while judge.running:
        backend.advance()
    assert attempts == in_order(
        recipe.steps, [attempt for tick in backend.ticks for attempt in tick]
    )
    np.testing.assert_array_equal(judge.physics.data.qpos, again.physics.data.qpos)
    # Written with fewer digits, or between two control periods, a start is the same.
    period_s = recipe.setup.simulation.control_period_s
    for off_s in (1e-9, -1e-9, 0.4 * period_s, -0.4 * period_s):
        step = recipe.steps[0]
        starts_s = tuple(max(0.0, start_s + off_s) for start_s in step.starts_s)
        shifted = start(recipe)
        perform_step(shifted, replace(step, starts_s=starts_s))
        np.testing.assert_array_equal(shifted.physics.data.qpos, again.physics.data.qpos)
