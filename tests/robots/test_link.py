"""Laws of driving robots through messages, in lock-step and in memory."""

import itertools

import numpy as np
import pytest
from discrete.drawn import draw

from craftsim.checking.setup import Seed, set_up, setup_of
from craftsim.discrete.grid import Kind
from craftsim.discrete.kinds import Action
from craftsim.models.sensing import SensorNoise
from craftsim.robots.fleet import RobotFleet
from craftsim.robots.messages import (
    Bye,
    Commands,
    Hello,
    MessageError,
    Refused,
    TruePoses,
    Welcome,
    pack,
)
from craftsim.robots.server import LEASE_S, Network
from craftsim.robots.simulated import simulated_network, simulated_robots
from craftsim.skills.executor import Executor
from craftsim.skills.outcome import Reason
from craftsim.skills.skill import Command

SIZE, CARS = (4, 4, 2), [(0, 0, 1, 0), (3, 3, 1, 2)]
OBJECTS = [(Kind.BLOCK, (1, 0, 1)), (Kind.BLOCK, (1, 2, 1))]
BUSY = Network(0.03, 0.01, 0.02)
ACTIONS = [{0: Action.MOVE_RIGHT, 1: Action.ROTATE_LEFT}, {0: Action.LIFT, 1: Action.MOVE_LEFT}]
"""Of each time, by car; the first car ends under the first block."""


def perform(executor: Executor) -> list:
    return [executor.run(joint) for joint in ACTIONS]


def attempts(robots):
    return [robots.judge.perform_tick(tuple(joint.items())) for joint in ACTIONS]


@pytest.fixture(scope="module")
def on_site():
    judge = set_up(draw(SIZE, OBJECTS, CARS), setup_of(drive="wheels"))
    return perform(judge.executor), judge.physics.data.qpos.copy()


def test_robots_of_ones_own_class_do_what_a_sites_cars_do(on_site):
    setup = setup_of(drive="wheels")
    fleet = set_up(draw(SIZE, OBJECTS, CARS), setup, watch_contacts=False).executor.fleet
    physics, robots = fleet.physics, RobotFleet(simulated_robots(fleet), fleet.advance)
    assert (
        perform(Executor(physics, setup.gains, assumed=setup.assumed, fleet=robots)) == on_site[0]
    )
    np.testing.assert_array_equal(physics.data.qpos, on_site[1])


def test_a_network_that_takes_no_time_changes_nothing(make_robots, on_site):
    robots = make_robots(SIZE, CARS, OBJECTS)
    outcomes = perform(robots.judge.executor)
    assert outcomes[0] == on_site[0][0]  # what follows begins a control period later
    assert all(outcome.succeeded for outcome in outcomes[1].values())
    assert robots.link.late_periods == 1


def test_actions_agree_through_delay_jitter_and_loss_and_are_the_same_again(
    make_robots, monkeypatch
):
    first, second = (make_robots(SIZE, CARS, OBJECTS, BUSY, seed=3) for _ in range(2))
    done = attempts(first)
    assert [attempt.reason for tick in done for attempt in tick] == [""] * 4
    # On a machine that is so slow that a minute passes whenever it looks at its clock.
    minutes = itertools.count()
    monkeypatch.setattr("time.monotonic", lambda: 60.0 * next(minutes))
    assert attempts(second) == done
    np.testing.assert_array_equal(second.physics.data.qpos, first.physics.data.qpos)


def test_the_skills_see_nothing_of_what_the_referee_says(make_robots):
    robots = make_robots(SIZE, CARS, OBJECTS)
    take = robots.mirror.take

    def lie(poses: TruePoses) -> None:
        cars = tuple((x + 0.05, *rest) for x, *rest in poses.cars)
        take(TruePoses(poses.time_s, cars, poses.things, poses.hinges))

    robots.mirror.take = lie
    attempt = robots.judge.perform(0, Action.MOVE_RIGHT)
    assert attempt.skill == "succeeded"
    assert not attempt.agrees
    assert attempt.car_error_m == pytest.approx(0.05, abs=0.001)


def test_behind_a_network_on_a_rough_floor_a_car_finds_out_how_late_its_localisations_are():
    # From poses that were extrapolated before they were estimated it found 129 ms: what jolts it then, and not when it
    # was localised, was taken for the delay.
    late = SensorNoise(0.001, 0.003, min_delay_s=0.1, max_delay_s=0.1)
    setup = setup_of("workshop_floor", noise=late, drive="wheels")
    judge = simulated_network(BUSY)(draw(SIZE, [], CARS), setup, Seed((0,)), ())
    judge.perform(0, Action.MOVE_RIGHT)
    estimate = judge.executor._estimator._estimates[0]
    assert 0.02 * estimate["delay"] == pytest.approx(0.1, abs=0.02)


def fastest_m_s(robots) -> float:
    return max(
        float(np.linalg.norm(robots.physics.data.qvel[car.base.dof :][:3]))
        for car in robots.physics.cars
    )


def test_robots_that_hear_nothing_stop_by_themselves(make_robots):
    robots = make_robots(SIZE, CARS, OBJECTS, BUSY)
    for car, action in ACTIONS[0].items():
        robots.judge.executor.begin(car, action)
    for _ in range(24):
        robots.judge.executor.advance()
    assert fastest_m_s(robots) > 0.3
    robots.driver.cut = True
    robots.pass_time(0.06)
    heard_s = robots.service.inbox.heard_s
    robots.pass_time(heard_s + 0.15 - robots.service.now_s)
    (stopped_s,) = robots.service.stopped_at_s
    assert 0.1 <= stopped_s - heard_s < 0.12 + 1e-6
    motors = robots.physics.data.ctrl[
        np.concatenate([car.wheel_actuators for car in robots.physics.cars])
    ]
    assert not motors.any()
    robots.pass_time(0.2)  # a car that brakes from 0.8 m/s needs that long with this drive
    assert fastest_m_s(robots) < 0.01


@pytest.mark.parametrize("ends", [False, True])
def test_a_lost_connection_is_an_outcome_at_once(make_robots, ends):
    robots = make_robots(SIZE, CARS, OBJECTS)
    robots.judge.executor.begin(0, Action.MOVE_RIGHT)
    if ends:
        robots.driver.inbox.append(pack(Bye("they were told to")))
    else:
        robots.judge.executor.advance()
        robots.driver.cut = True
    why = (
        "the robots have ended: they were told to"
        if ends
        else "nothing has come from the robots for 1 s"
    )
    assert str(robots.judge.executor.advance()[0]) == f"disconnected: {why}"
    assert robots.judge.executor.run({1: Action.ROTATE_LEFT})[1].reason is Reason.DISCONNECTED


def test_who_is_away_too_long_finds_the_robots_stopped_and_may_go_on(make_robots):
    robots = make_robots(SIZE, CARS, OBJECTS)
    executor = robots.judge.executor
    executor.begin(0, Action.MOVE_RIGHT)
    for _ in range(5):
        executor.advance()
    robots.pass_time(0.2)
    ended = {}
    while not ended:
        ended = executor.advance()
    assert str(ended[0]) == "disconnected: the robots had no command for 100 ms, and stopped"
    assert executor.run({1: Action.ROTATE_LEFT})[1].succeeded
    robots.pass_time(3.0)  # between two actions it is no loss
    assert executor.run({1: Action.ROTATE_RIGHT})[1].succeeded


def test_a_slope_folds_and_is_held_through_a_network(make_robots):
    robots = make_robots((3, 3, 2), [(1, 1, 1, 0)], [(Kind.FSLOPE, (1, 1, 1), 2)], BUSY)
    assert robots.judge.perform(0, Action.UNFOLD).reason == ""


def test_robots_refuse_whom_they_do_not_fit_and_obey_one_at_a_time(make_robots):
    robots = make_robots(SIZE, CARS, OBJECTS)
    service = robots.service
    service.world = "a"

    def ask(hello: Hello, now_s: float = robots.service.now_s):
        return service.greet(b"other", hello, now_s)

    assert ask(Hello(2, "a")) == Refused(
        "the robots obey somebody else; try again when that has ended", True
    )
    late_s = robots.service.now_s + LEASE_S + 0.1
    assert ask(Hello(3, "a"), late_s) == Refused("there are 2 robots, not 3")
    assert isinstance(ask(Hello(2, "b"), late_s), Refused)
    assert isinstance(ask(Hello(2, "a"), late_s), Welcome)
    with pytest.raises(MessageError, match="does not drive"):
        service.check(b"driver", Commands(1, 0.0, (Command(), Command())))
