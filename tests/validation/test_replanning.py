"""Building with re-planning, what is planted to disturb it, and the planner as a policy."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from craftsim.checking.judge import Judge
from craftsim.checking.setup import SEED_0, set_up, setup_of
from craftsim.cli import main
from craftsim.discrete.files.blueprint import write_blueprint
from craftsim.discrete.files.design import ANY_YAW, Design
from craftsim.discrete.geometry import CELL_PITCH_M
from craftsim.discrete.grid import CarField, Grid, Kind, Piece
from craftsim.discrete.kinds import Action
from craftsim.envs import parallel_env
from craftsim.envs.planner import PlannerPolicy
from craftsim.errors import InputError
from craftsim.skills.fleet import Disturbance
from craftsim.tasks import make_task
from craftsim.validation import validation
from craftsim.validation.replanning import Replanning, without_cars
from craftsim.validation.report import validation_report
from craftsim.validation.rollout import EpisodeJob, run_job
from craftsim.validation.sources import read_goal

SETUP = setup_of(drive="wheels")
STRIP = make_task("strip")


def _world(blocks, cars, size=(5, 3, 1)):
    grid = Grid.empty(size, len(cars))
    for cell in blocks:
        grid.kind[cell] = Kind.BLOCK
    grid.cars[:, [CarField.X, CarField.Y]] = cars
    grid.derive_marks()
    return grid


def _task(*cells):
    design = Design(Path("goal.yaml"), tuple(Piece(Kind.BLOCK, cell, ANY_YAW) for cell in cells))
    return replace(STRIP, design=design, success="built")


def _disturbed(grid, kind, start_s=0.0) -> Judge:
    return set_up(grid, replace(SETUP, disturbance=Disturbance(kind, start_s)))


def test_a_shoved_block_is_pushed_over_the_floor_to_the_next_cell_and_left_there():
    judge = _disturbed(_world([(2, 1, 1)], [(4, 2)], (5, 3, 1)), "shove")
    places = []
    for _ in range(150):
        judge.executor.advance()
        places.append(judge.physics.poses().positions[0].copy())
    way = places[-1][:2] - (np.array([2, 1]) + 0.5) * CELL_PITCH_M
    assert np.linalg.norm(way) == pytest.approx(CELL_PITCH_M, abs=0.02)
    # No jump: the fastest of it is what a hand does.
    steps = np.linalg.norm(np.diff(np.array(places), axis=0), axis=1)
    assert 0 < steps.max() < 0.03
    assert "is shoved from (2, 1, 1)" in judge.executor.fleet.happened
    assert not judge.physics.data.xfrc_applied.any()


def test_what_is_to_happen_at_a_time_happens_in_the_period_that_begins_then():
    """The time of a world is a sum of time steps, which is a little off for some."""
    grid = _world([], [(0, 0)])
    for n_periods in (3, 7, 15, 24, 29):
        judge = _disturbed(grid, "dead-car", round(0.3 + n_periods * 0.02, 9))
        while judge.physics.time_s < 0.3 + (n_periods - 0.5) * 0.02:
            assert not judge.executor.fleet.happened
            judge.executor.advance()
        judge.executor.advance()
        assert judge.executor.fleet.happened, n_periods


def test_a_block_is_not_shoved_while_a_car_is_near():
    judge = _disturbed(_world([(2, 1, 1)], [(2, 0)]), "shove")
    for _ in range(50):
        judge.executor.advance()
    assert not judge.executor.fleet.happened


def test_a_car_dies_when_its_second_action_begins():
    setup = replace(SETUP, disturbance=Disturbance("dead-car", 0.0, action=2))
    judge = set_up(_world([], [(0, 0), (4, 2)]), setup)
    fleet = judge.executor.fleet
    acts = ((0, Action.MOVE_RIGHT), (1, Action.MOVE_LEFT))
    assert all(judge.perform(*act).agrees for act in acts)
    assert not fleet.happened
    second = {car: judge.perform(car, action).agrees for car, action in acts}
    (dead,) = (car for car, agrees in second.items() if not agrees)
    assert fleet.happened.startswith(f"car {dead} is out of action")
    for kind, number in (("shove", 2), ("dead-car", 0)):
        with pytest.raises(InputError, match="allowed: a dead-car, and numbers from 1"):
            Disturbance(kind, 0.0, action=number)


def test_after_a_failure_nothing_begins_any_more_if_a_plan_is_followed_until_something_is_wrong():
    grid = _world([], [(0, 0), (0, 2)])
    away, back = Action.MOVE_RIGHT, Action.MOVE_LEFT
    ticks = [[(0, act), (1, act)] for act in (away, back) * 8]
    dead = _disturbed(grid, "dead-car")
    attempts = dead.perform_plan(ticks, "until-wrong")
    failed = {a.car for a in attempts if a.performed and a.skill != "succeeded"}
    (out,) = failed
    others = [attempt for attempt in attempts if attempt.car != out]
    assert others[0].agrees
    assert not others[-1].performed


def test_cars_out_of_action_are_walls_but_where_the_design_has_what_stands_there():
    for block, goal, there in (
        ((1, 1, 1), (3, 1, 1), Kind.WALL),
        ((2, 0, 1), (3, 0, 1), Kind.WALL),
        ((2, 0, 1), (2, 0, 1), Kind.BLOCK),
    ):
        judge = set_up(_world([block], [(2, 0), (4, 2)]), SETUP, SEED_0)
        seen, acting = without_cars(judge, _task(goal), [0])
        assert seen.kind[2, 0, 1] == there
        assert (seen.n_cars, acting) == (1, (1,)), "plans are for the cars of the real world"


def _build(out, start, goal, *words):
    own = ["--goal", str(goal), "--drive", "wheels", "--video", "none", "--out", str(out)]
    return main(["validate", "--plan", "auto", str(start), *own, *words])


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("building")
    write_blueprint(_world([(1, 1, 1)], [(0, 0)], (4, 2, 1)), folder / "start.yaml")
    (folder / "goal.yaml").write_text("block:\n  - {id: 0, x: 2, y: 1, z: 1}\n")
    (folder / "two.yaml").write_text(
        "block:\n  - {id: 0, x: 2, y: 1, z: 1}\n  - {id: 1, x: 3, y: 1, z: 1}\n"
    )
    return folder


@pytest.mark.parametrize(
    ("disturb", "ended"), [(None, "built"), ("fold", "built"), ("shove", "built")]
)
def test_a_design_is_planned_and_built(files, disturb, ended):
    task = read_goal(str(files / "start.yaml"), files / "goal.yaml")
    done = run_job(
        EpisodeJob(key="one", world=task, behaviour=Replanning(3, 3, disturb), seed=0, setup=SETUP)
    )
    assert (done.extra["ended"], done.extra["physics_success"]) == (ended, True), done.extra
    assert bool(done.extra["replans"]) == bool(done.extra["disturbed"])


def test_a_demonstration_with_replanning_is_built(files, tmp_path, capsys):
    words = ["demo", str(files / "start.yaml"), "--plan", "auto", "--drive", "wheels"]
    words += ["--goal", str(files / "goal.yaml"), "--no-video", "--out", str(tmp_path)]
    assert main(words) == 0
    assert "Replanning: built; 0 further plans" in capsys.readouterr().out
    figures = json.loads((tmp_path / "report.json").read_text())["figures"]
    assert 0 < figures["agree"] == figures["total"]


def _waits(observations):
    return dict.fromkeys(observations, int(Action.STOP))


def test_a_policy_is_validated_with_recovery(files):
    task = read_goal(str(files / "start.yaml"), files / "goal.yaml")
    options = {"policy": _waits, "trials": 1, "drive": "wheels", "randomize": "none"}
    alone = validation.validate(task, **options)
    assert (alone.recovery, alone.records[0]["extra"]["physics_success"]) == (None, False)
    recovers = validation.validate(task, **options, replans=2)
    needed = {"runs": 1, "planner_runs": 1, "plans": 1, "went_back": 0, "seated": 0}
    assert recovers.recovery == recovers.report_figures["recovery"] == needed
    assert recovers.records[0]["extra"]["physics_success"]
    (note,) = (text for text in validation_report(recovers, "again").notes if "went on" in text)
    assert note.startswith("With recovery: the planner went on in 1 of 1 run, with 1 plan;")


def test_further_plans_need_a_policy_and_a_goal(files):
    task = read_goal(str(files / "start.yaml"), files / "goal.yaml")
    with pytest.raises(InputError, match="does not go with planner; it goes with --plan auto"):
        validation.validate(task, replans=2)
    with pytest.raises(InputError, match="has no goal to plan for; leave out --replans"):
        validation.validate(files / "start.yaml", policy=_waits, replans=2)


def test_a_building_whose_only_car_is_out_of_action_ends_as_given_up(files, tmp_path):
    words = ("--attempts", "3", "--disturb", "dead-car", "--trials", "1")
    assert _build(tmp_path, files / "start.yaml", files / "goal.yaml", *words) == 1
    (record,) = map(json.loads, (tmp_path / "trials.jsonl").read_text().splitlines())
    assert (record["error"], record["extra"]["ended"]) == (None, "gave up")
    assert "car 0 is out of action" in record["extra"]["disturbed"]
    assert json.loads((tmp_path / "report.json").read_text())["figures"]["builds"]["endings"] == {
        "gave up": 1
    }
    assert "Not all built" in (tmp_path / "report.html").read_text()


def test_a_design_that_cannot_be_built_is_wrong_input(files, tmp_path, capsys):
    assert _build(tmp_path, files / "start.yaml", files / "two.yaml", "--attempts", "3") == 2
    assert "not enough blocks" in capsys.readouterr().err


def test_a_run_to_compare_with_is_read_before_anything_is_planned(
    files, tmp_path, capsys, monkeypatch
):
    monkeypatch.setattr(
        validation, "plan_building", lambda *args, **kwargs: pytest.fail("is planned")
    )
    assert _build(tmp_path, files / "start.yaml", files / "goal.yaml", "--baseline", "gone") == 2
    assert "gone" in capsys.readouterr().err


def test_the_planner_plans_again_where_the_world_is_not_as_it_predicts():
    env = parallel_env("strip", "grid")
    policy = PlannerPolicy(env, rounds=5)
    seen, _ = env.reset(seed=0)
    for _ in range(3):
        seen, *_ = env.step(policy(seen))
    # Another world, of which nobody tells the policy.
    seen, _ = env.reset(seed=0)
    infos = {}
    while env.agents:
        seen, _, _, _, infos = env.step(policy(seen))
    assert all(info["success"] for info in infos.values())


def test_the_planner_refuses_a_task_without_a_goal(files):
    with pytest.raises(InputError, match="no goal to plan for"):
        PlannerPolicy(parallel_env(str(files / "start.yaml"), "grid"))


@pytest.mark.parametrize("task", ["strip", "simple_two_story"])
def test_the_planner_builds_asynchronously_while_actions_fail(task):
    # Where waits ended after a second, a car that waits for a slope to fold would use up the decisions.
    options = {"jitter": 0.2, "failures": 0.02, "wait_s": 20.0}
    env = parallel_env(task, "grid", execution="asynchronous", **options)
    policy = PlannerPolicy(env, rounds=5)
    seen, _ = env.reset(seed=1)
    infos = {}
    while env.agents:
        seen, _, _, _, infos = env.step(policy(seen))
    assert all(info["success"] for info in infos.values())


@pytest.mark.parametrize("execution", ["synchronous", "asynchronous"])
@pytest.mark.parametrize(
    ("actions", "why"),
    [
        ((Action.ROTATE_LEFT, Action.ROTATE_RIGHT), "the world was the same 3 times"),
        ((Action.STOP,), "nothing was gained in"),
    ],
)
def test_the_planner_goes_on_where_a_policy_gets_no_further(execution, actions, why):
    env = parallel_env("strip", "grid", execution=execution)
    asked = []

    def loops(observations):
        asked.append(actions[len(asked) % len(actions)])
        return dict.fromkeys(observations, int(asked[-1]))

    policy = PlannerPolicy(env, rounds=5, policy=loops)
    for seed in range(2):
        seen, _ = env.reset(seed=seed)
        asked.clear()
        assert policy(seen)
        assert not policy.replaces
        infos = {}
        while env.agents:
            seen, _, _, _, infos = env.step(policy(seen))
        assert all(info["success"] for info in infos.values())
        assert policy.replaces.startswith(why)
        assert policy.n_plans >= 1
        assert len(asked) < env.core.task.max_steps
