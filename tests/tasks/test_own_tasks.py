"""Tasks that users bring: registered, from files, from factories, with other numbers of cars and blocks."""

import re
import sys

import numpy as np
import pytest
from registered import forget

from craftsim.discrete.files.blueprint import parse_blueprint, read_blueprint, write_blueprint
from craftsim.discrete.files.shipped import shipped_names
from craftsim.discrete.grid import Kind
from craftsim.discrete.kinds import Action
from craftsim.errors import BlueprintError, InputError, PlanError
from craftsim.planning.plan_file import read_plan, write_plan
from craftsim.tasks import TASK_NAMES, Task, as_task, make_task, register_task
from craftsim.tasks.rewards import REWARDS, Reward, make_reward, register_term

START = """\
area_length: 5
area_width: 4
area_height: 2
block_num: 2
slope_num: 0
smartcar_num: 1
"""
GOAL = "block: [{id: 0, x: 1, y: 1, z: 1}]\n"
MODULE = """\
from craftsim.discrete.files.blueprint import parse_blueprint
from craftsim.tasks import Task
from craftsim.tasks.rewards import Reward

def corner():
    start = parse_blueprint('''START''', "corner")
    return Task("corner", (start,), Reward({"tick": -1.0}), lambda grid: False)

def broken():
    return 1 / 0

wrong = dict
nothing = 3
""".replace("START", START)


def own(name="corner"):
    start = parse_blueprint(START, "corner")
    return Task(name, (start,), Reward({"tick": -1.0}), lambda grid: False)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    (tmp_path / "mine.yaml").write_text(START)
    (tmp_path / "own_tasks_module.py").write_text(MODULE)
    yield tmp_path
    sys.modules.pop("own_tasks_module", None)


@pytest.fixture
def free_names():
    yield
    forget()


def test_a_registered_task_is_found_by_its_name(monkeypatch):
    monkeypatch.setattr("craftsim.tasks.registry._REGISTERED", {})
    task = own()
    assert register_task(task) is as_task("corner") is task
    again = own()
    assert register_task(again) is as_task("corner") is again
    for wrong, message in (
        (own("strip"), "a task of craftsim's own"),
        (own("a/b"), "letters, digits"),
        (own(""), "letters, digits"),
        ("corner", "only a Task"),
    ):
        with pytest.raises(InputError, match=message):
            register_task(wrong)
    with pytest.raises(InputError, match="its own area and numbers of cars"):
        as_task("corner", n_cars=2)
    with pytest.raises(
        InputError,
        match=r"unknown task 'korner'; did you mean 'corner'\?; there are strip, .*corner",
    ):
        as_task("korner")


def test_a_blueprint_is_a_task_with_the_goal_file_beside_it(folder):
    bare = as_task("mine.yaml")
    assert (bare.name, bare.design) == ("mine", None)
    assert not bare.has_goal
    (folder / "platform.yaml").write_text("start: mine.yaml\ngoal: platform\n")
    assert as_task("platform.yaml").success == "one_platform"
    (folder / "mine_goal.yaml").write_text(GOAL)
    assert [target.cell for target in as_task(str(folder / "mine.yaml")).design.targets] == [
        (1, 1, 1)
    ]
    (folder / "flag.yaml").write_text(
        START + "flag: [{x: 0, y: 0, z: 1}]\ngoal: [{x: 3, y: 3, z: 1}]\n"
    )
    assert as_task("flag.yaml").success == "flag_at_goal"
    assert as_task("flag.yaml").shows_flag
    (folder / "mine.plan").write_text("0 0 LIFT\n")
    with pytest.raises(BlueprintError, match=r"mine\.plan is a plan; give the world first"):
        as_task("mine.plan")
    with pytest.raises(BlueprintError, match=r"nothere\.yaml: no such file"):
        as_task("nothere.yaml")


def test_a_task_file_names_starts_goal_reward_and_counts(folder):
    (folder / "goal.yaml").write_text(GOAL)
    (folder / "task.yaml").write_text(
        "start: [mine.yaml, mine.yaml]\ngoal: goal.yaml\nreward: complexity\nmax_steps: 30\ncars: 3\nblocks: 4\n"
    )
    task = as_task("task.yaml")
    assert (task.name, task.max_steps, len(task.starts)) == ("task", 30, 2)
    grid = task.draw(np.random.default_rng(0))
    assert (grid.n_cars, int((grid.kind == Kind.BLOCK).sum())) == (3, 4)
    assert task.design is not None
    (folder / "task.yaml").write_text("start: strip\ngoal: strip_goal\n")
    assert as_task("task.yaml").design == make_task("strip").design


def test_no_key_of_a_task_file_is_without_effect(folder):
    path = folder / "task.yaml"

    def task_of(text, **counts):
        path.write_text(text)
        return as_task("task.yaml", **counts)

    without_goal = task_of("start: mine.yaml\nreward: complexity\nmax_steps: 0\n")
    assert not without_goal.has_goal
    assert without_goal.reward.terms == {"complexity": 1.0}
    assert without_goal.max_steps == 0
    for reward in ("paper", "published_code"):
        with pytest.raises(
            BlueprintError, match=f":2: key 'reward': {reward} is of a goal, and there is none"
        ):
            task_of(f"start: mine.yaml\nreward: {reward}\n")
        assert (
            task_of(f"start: mine.yaml\nreward: {reward}\ngoal: platform\n").success
            == "one_platform"
        )
    (folder / "flag.yaml").write_text(
        START + "flag: [{x: 0, y: 0, z: 1}]\ngoal: [{x: 3, y: 3, z: 1}]\n"
    )
    assert task_of("start: flag.yaml\nmax_steps: 5\n").success == "flag_at_goal"
    assert task_of("start: flag.yaml\ngoal: platform\n").success == "one_platform"
    assert task_of("start: mine.yaml\ncars: 3\n", n_cars=3).layout.n_cars == 3
    with pytest.raises(
        BlueprintError, match=":2: key 'cars': 3, but 2 asked for; give it in one place"
    ):
        task_of("start: mine.yaml\ncars: 3\n", n_cars=2)
    with pytest.raises(
        BlueprintError, match=":2: key 'blocks': 4, but 5 asked for; give it in one place"
    ):
        task_of("start: mine.yaml\nblocks: 4\n", n_blocks=5)


@pytest.mark.parametrize("reward", REWARDS)
@pytest.mark.parametrize("goal", ["built", "flag_at_goal", "one_platform"])
def test_every_reward_has_terms_for_every_goal(goal, reward):
    assert make_reward(reward, goal).terms


def test_a_task_file_adds_weighted_terms_to_a_shipped_reward(folder, free_names):
    path = folder / "task.yaml"

    def terms_of(text):
        path.write_text(f"start: strip\ngoal: strip_goal\nreward: {text}\n")
        return as_task("task.yaml").reward.terms

    assert terms_of("{paper: 1, illegal_actions: -0.5}") == {
        "building": 1.0,
        "illegal_actions": -0.5,
    }
    assert terms_of("{paper: 2, building: -0.5}") == {"building": 1.5}
    assert terms_of("published_platform") == {"published_platform": 1.0}
    path.write_text("start: breaking_barrier\nreward: {paper: 1, seconds: -2}\n")
    assert as_task("task.yaml").reward.terms == {
        "flag_nearness": 1.0,
        "flag_at_goal": 10.0,
        "tick": -1.0,
        "seconds": -2.0,
    }
    path.write_text("start: mine.yaml\nreward:\n  tick: -1\n  structure: 2\n")
    assert as_task("task.yaml").reward.terms == {"tick": -1.0, "structure": 2.0}
    path.write_text("start: mine.yaml\nreward: {waiting_cars: -1}\n")
    with pytest.raises(BlueprintError, match=":2: key 'reward': unknown value 'waiting_cars'"):
        as_task("task.yaml")
    register_term("waiting_cars", lambda tick: (tick.durations_s == 0).sum(axis=1))
    assert as_task("task.yaml").reward.terms == {"waiting_cars": -1.0}
    for text, message in (
        ("{papr: 1}", "key 'reward': unknown value 'papr'; did you mean 'paper'"),
        ("{paper: much}", "key 'reward.paper': must be a number"),
        ("{paper: .nan}", "key 'reward.paper': must be a number"),
        ("{paper: true}", "key 'reward.paper': must be a number"),
        ("{}", "key 'reward': must be a name, or names with their weights"),
        ("[paper]", "key 'reward': must be a name, or names with their weights"),
        ("2", "key 'reward': must be a name, or names with their weights"),
    ):
        with pytest.raises(BlueprintError, match=f":3: .*{re.escape(message)}"):
            terms_of(text)


def test_a_wrong_task_file_is_told_with_what_is_allowed(folder):
    for text, message in (
        ("start: strop\n", "strop: no such file; did you mean 'strip'"),
        (
            "start: mine.yaml\nreward: papr\n",
            ":2: key 'reward': unknown value 'papr'; did you mean 'paper'",
        ),
        ("start: {}\n", "'start': must be a file"),
        ("start: []\n", ":1: key .start.: needs at least one start file"),
        (f"start: {'x' * 300}\n", "File name too long"),
    ):
        (folder / "task.yaml").write_text(text)
        with pytest.raises(InputError, match=message):
            as_task("task.yaml")


def test_a_factory_makes_a_task(folder):
    assert as_task("own_tasks_module:corner").name == "corner"


def test_a_wrong_factory_is_told_by_name(folder):
    for text, message in (
        (":corner", "must be module:factory"),
        ("own_tasks_module:corner()", "must be module:factory"),
        (
            "nowhere_at_all:corner",
            "module 'nowhere_at_all' cannot be imported: ModuleNotFoundError",
        ),
        ("own_tasks_module:korner", "has no 'korner'; did you mean 'corner'"),
        ("own_tasks_module:nothing", "neither a Task nor callable, but int"),
        ("own_tasks_module:wrong", "returned dict; it must return a Task"),
        ("own_tasks_module:broken", "the factory raised ZeroDivisionError: division by zero"),
    ):
        with pytest.raises(InputError, match=f"task '{re.escape(text)}'.*{message}"):
            as_task(text)


def test_other_numbers_of_cars_and_blocks_are_drawn_at_random():
    task = make_task("free_building", n_cars=4, n_blocks=12)
    grid = task.draw(np.random.default_rng(0))
    assert (grid.n_cars, int((grid.kind == Kind.BLOCK).sum())) == (4, 12)
    assert task.layout.n_cars == 4
    listed = len(read_blueprint("strip").cars)
    with pytest.raises(
        InputError, match=f"0 cars asked for; it lists {listed}, allowed: {listed} to 256"
    ):
        make_task("strip", n_cars=0)


def test_shipped_files_are_read_by_name_and_missing_names_are_listed():
    assert shipped_names("blueprints") == sorted(TASK_NAMES)
    assert read_blueprint("strip").n_cars == make_task("strip").starts[0].n_cars
    with pytest.raises(
        BlueprintError, match="nothere: no such file; shipped blueprints are block, breaking"
    ):
        read_blueprint("nothere")
    with pytest.raises(
        PlanError, match=r"strop: no such file; did you mean 'strip'\?; shipped plans are block"
    ):
        read_plan("strop", 2)


def test_worlds_and_plans_are_written_whole_and_read_back(tmp_path):
    grid = make_task("simple_two_story").draw(np.random.default_rng(0))
    write_blueprint(grid, tmp_path / "mine.yaml")
    assert read_blueprint(tmp_path / "mine.yaml").grid(np.random.default_rng(1)).same_visible(grid)
    ticks = (((0, Action.STOP),), (), ((0, Action.MOVE_LEFT),))
    write_plan(ticks, tmp_path / "mine.plan")
    assert read_plan(tmp_path / "mine.plan", 1).ticks == ticks
    assert sorted(path.name for path in tmp_path.iterdir()) == ["mine.plan", "mine.yaml"]
    for write in (lambda path: write_blueprint(grid, path), lambda path: write_plan(ticks, path)):
        with pytest.raises(InputError, match="cannot be written"):
            write(tmp_path / "nowhere" / "file")
    with pytest.raises(InputError, match="no actions"):
        write_plan([], tmp_path / "empty.plan")
