"""A robot that stops answering is waited for, named, and built around; a policy drives the others on."""

import re
from dataclasses import replace

import numpy as np

import craftsim
from craftsim.checking.setup import set_up, setup_of
from craftsim.discrete.files.blueprint import write_blueprint
from craftsim.discrete.grid import CarField, Grid, Kind
from craftsim.discrete.kinds import Action
from craftsim.robots.fleet import RobotFleet
from craftsim.robots.server import Network
from craftsim.robots.simulated import simulated_network, simulated_robots
from craftsim.skills.outcome import Reason
from craftsim.validation.replanning import Replanning
from craftsim.validation.rollout import EpisodeJob, roll_out
from craftsim.validation.sources import read_goal

BUSY = Network(0.03, 0.01, 0.02)
WHY = r"car {} has not answered since [.\d]+ s of its clock"


def test_a_policy_goes_on_with_the_cars_that_answer_outside_the_claims_of_one_that_does_not():
    policy = craftsim.load_policy("random_strip")
    robots = simulated_network(replace(BUSY, silent=((1, 2.0),)))
    env = craftsim.parallel_env(
        "random_strip", drive="wheels", execution="asynchronous", robots=robots
    )
    seen, _ = env.reset(seed=0)
    found, claims, n_acts = [], [], 0
    for _ in range(24):
        seen, _, _, _, infos = env.step(policy(seen))
        found += [one for one in infos.values() if "disconnected" in one.get("outcome", "")]
        if "lost" not in infos["car_1"]:
            continue
        assert env.agents_to_act == ["car_0"]
        n_acts += infos["car_0"].get("outcome") == "succeeded"
        claims.append(seen["car_0"]["claimed"])
        assert not claims[-1][tuple(env.grid.cars[0, : CarField.YAW])]
    (one,) = found
    assert re.fullmatch(f"disconnected: {WHY.format(1)}", one["outcome"])
    assert re.fullmatch(WHY.format(1), infos["car_1"]["lost"])
    assert n_acts > 3
    assert claims[0].any()
    assert all((claimed == claims[0]).all() for claimed in claims)


def test_an_episode_without_a_car_that_answers_ends():
    robots = simulated_network(replace(BUSY, silent=((0, 1.0), (1, 1.0))))
    env = craftsim.parallel_env("block", drive="wheels", execution="asynchronous", robots=robots)
    env.reset(seed=0)
    while env.agents:
        moves = {agent: int(np.argmax(env.core.masks[car])) for car, agent in enumerate(env.agents)}
        *_, truncated, infos = env.step(moves)
    assert truncated["car_0"]
    assert infos["car_0"]["deadlock"].words == "car 0 does not answer; car 1 does not answer"


def test_a_plan_is_made_anew_without_a_car_that_does_not_answer(tmp_path):
    grid = Grid.empty((5, 3, 1), n_cars=2)
    grid.kind[1, 1, 1] = Kind.BLOCK
    grid.cars[:, [CarField.X, CarField.Y]] = (0, 1), (4, 1)
    grid.derive_marks()
    write_blueprint(grid, tmp_path / "start.yaml")
    (tmp_path / "goal.yaml").write_text("block:\n  - {id: 0, x: 3, y: 1, z: 1}\n")
    task = read_goal(str(tmp_path / "start.yaml"), tmp_path / "goal.yaml")
    where, setup = simulated_network(replace(BUSY, silent=((0, 1.0),))), setup_of(drive="wheels")
    job = EpisodeJob(
        key="one", world=task, behaviour=Replanning(3, 3), seed=0, setup=setup, set_up=where
    )
    done = roll_out(job)
    assert done.ending["ended"] == "built", done.ending
    assert done.ending["replans"] >= 1
    failed = [
        attempt for attempt in done.attempts if attempt.performed and attempt.skill != "succeeded"
    ]
    assert failed
    assert all(attempt.car == 0 and re.search(WHY.format(0), attempt.skill) for attempt in failed)


def test_robots_of_this_process_are_lost_one_by_one_too():
    grid = Grid.empty((4, 2, 1), n_cars=2)
    grid.cars[1, CarField.Y] = 1
    judge = set_up(grid, setup_of(drive="wheels"))
    world = judge.executor.fleet
    fleet = RobotFleet(simulated_robots(world, [(0, 0.3)]), world.advance, patience=10)
    executor = craftsim.Executor(judge.physics, fleet=fleet)
    ended = executor.run({0: Action.MOVE_FORWARD, 1: Action.ROTATE_LEFT})
    assert ended[0].reason is Reason.DISCONNECTED
    assert ended[1].succeeded
    assert [*fleet.lost_cars] == [0]
