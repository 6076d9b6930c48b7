"""A saved world is read back the same; a recorded episode replays the same; CraftEnv's own records are read."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from craftsim.discrete.actions import Action
from craftsim.discrete.errors import BlueprintError
from craftsim.discrete.files.blueprint import parse_blueprint, read_blueprint
from craftsim.discrete.files.design import read_design
from craftsim.discrete.files.saving import blueprint_text, design_text
from craftsim.discrete.grid import Kind
from craftsim.discrete.records.recording import Recording, read_published_actions, read_recording
from craftsim.discrete.records.traces import read_records, recorded_grid
from craftsim.discrete.rules import Rules
from craftsim.discrete.tasks import TASK_NAMES, make_task
from craftsim.discrete.tasks.episodes import Episode

from .worldgen import play, random_world

DATA = Path(__file__).parents[1] / "data"


def read_back(text):
    return parse_blueprint(text, "saved.yaml").grid(np.random.default_rng(0))


def assert_same(one, other):
    assert one.same_visible(other)
    assert one.same_marks(other)


def test_recorded_worlds_of_all_kinds_are_saved_and_read_back_the_same():
    snapshots = 0
    for _, record in read_records(DATA / "traces.jsonl.gz"):
        grid = recorded_grid(record["size"], record["after"])
        text = blueprint_text(grid)
        assert_same(read_back(text), grid)
        snapshots += "snapshot" in text
    assert snapshots > 100


@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck), derandomize=True)
@given(st.integers(0, 2**32 - 1))
def test_a_running_world_is_saved_and_read_back_the_same(seed):
    rng = np.random.default_rng(seed)
    for _, grid in play(Rules("published"), random_world(rng), rng, 20):
        assert_same(read_back(blueprint_text(grid)), grid)


@pytest.mark.parametrize("name", TASK_NAMES)
def test_the_start_of_a_task_needs_no_snapshot_and_keeps_its_goal(name, rng):
    task = make_task(name)
    text = blueprint_text(task.draw(rng), task.starts[0].goal)
    assert "snapshot" not in text
    again = parse_blueprint(text, "again.yaml")
    assert again.goal == task.starts[0].goal
    assert_same(again.grid(rng), task.draw(rng))


def test_a_building_is_saved_as_a_goal_file_that_it_satisfies(scene, tmp_path):
    blocks = [(Kind.BLOCK, (0, 0, 1)), (Kind.BLOCK, (0, 0, 2))]
    grid = scene([*blocks, (Kind.BODY, (2, 2, 1), 1), (Kind.FSLOPE, (4, 4, 1), 0)])
    (tmp_path / "goal.yaml").write_text(design_text(grid))
    design = read_design(tmp_path / "goal.yaml")
    assert len(design.targets) == 5
    assert design.satisfied(grid)
    assert not design.satisfied(scene(blocks))


@pytest.mark.parametrize("depth", [None, 10])
@pytest.mark.parametrize("rule_set", ["published", "physical"])
def test_a_recorded_episode_replays_the_same_from_its_file(depth, rule_set, tmp_path, rng):
    episode = Episode(make_task("complex_two_story"), rng, rule_set, depth)
    recording = Recording(episode.grid, rule_set, depth, seed=7)
    seen = []
    for _ in range(30):
        mask = episode.legal() if depth is None else episode.reachable()
        actions = (rng.random(mask.shape) * mask).argmax(-1)
        step = episode.step(actions)
        recording.add(actions, step.order)
        seen.append(episode.grid)
    recording.save(tmp_path / "episode.yaml")
    again = read_recording(tmp_path / "episode.yaml")
    assert (again.rule_set, again.helper_depth, again.seed) == (rule_set, depth, 7)
    assert again.ticks == recording.ticks
    replayed = list(again.replay())
    assert len(replayed) == 30
    assert not replayed[-1].same_visible(again.start)
    for one, other in zip(replayed, seen, strict=True):
        assert one.same_visible(other)
        if rule_set == "published":
            assert one.same_marks(other)


RECORD = """\
rules: published
helper_depth: none
seed: 3
blueprint: |
  area_length: 3
  area_width: 3
  area_height: 1
  block_num: 0
  slope_num: 0
  smartcar_num: 2
  smartcar:
    - {id: 0, x: 0, y: 0, z: 1, yaw: 0}
    - {id: 1, x: 2, y: 2, z: 1, yaw: 0}
ticks:
  - 1 MOVE_LEFT, 0 STOP
"""
MISTAKES = {
    "unknown action": (
        "MOVE_LEFT",
        "MOVE_LEFTT",
        ":15: unknown action 'MOVE_LEFTT'; did you mean 'MOVE_LEFT'",
    ),
    "no such car": ("1 MOVE_LEFT", "2 MOVE_LEFT", ":15: no car 2; there are cars 0 to 1"),
    "car twice": ("1 MOVE_LEFT", "0 MOVE_LEFT", ":15: a car acts twice"),
    "no action": ("1 MOVE_LEFT", "1", ":15: '1': must be a car's number and an action"),
    "not a list": ("  - 1 MOVE_LEFT, 0 STOP", "  7", "'ticks': must be a list"),
    "unknown rules": (
        "published",
        "publish",
        ":1: unknown value of 'rules' 'publish'; did you mean 'published'",
    ),
    "left to chance": ("block_num: 0", "block_num: 1", ":4: key 'blueprint': leaves something to chance"),
    "wrong blueprint": ("area_length: 3", "area_length: x", r"\(blueprint\):1: key 'area_length'"),
    "missing": ("seed: 3\n", "", "'seed' is missing"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_wrong_recording_is_told_with_its_line(mistake, tmp_path):
    old, new, message = MISTAKES[mistake]
    path = tmp_path / "record.yaml"
    path.write_text(RECORD)
    assert len(list(read_recording(path).replay())) == 1
    assert old in RECORD
    path.write_text(RECORD.replace(old, new, 1))
    with pytest.raises(BlueprintError, match=message):
        read_recording(path)


def test_the_published_record_format_is_read(tmp_path):
    header = "yaml_generated_time: 2023-01-01 10:00:00\narea_length: 4\narea_width: 4\narea_height: 3\nblock_num: 1\n"
    counts = "slope_num: 1\nsmartcar_num: 2\nlegged_robot_num: 0\nwall_num: 0\n"
    lists = [
        "block:\n- {id: 0, x: 1, y: 0, z: 1}\n",
        "fold_slope:\n- {id: 0, x: 2, y: 2, z: 1, yaw: 3}\n",
        "unfold_slope: []\n",
        "smartcar:\n- {id: 0, x: 0, y: 2, z: 1, yaw: 0}\n- {id: 1, x: 2, y: 0, z: 1, yaw: 0}\n",
        "flag:\n- {id: 0, x: -1, y: -2, z: 1}\n",
        "goal:\n- {id: 0, x: -1, y: -2, z: 1}\n",
        "legged_robot: []\n",
        "wall: []\n",
    ]
    (tmp_path / "0-00001.yaml").write_text(header + counts + "".join(f"---\n{part}" for part in lists))
    grid = read_blueprint(tmp_path / "0-00001.yaml").grid(np.random.default_rng(0))
    assert grid.kind[1, 0, 1] == Kind.BLOCK
    (tmp_path / "0_record_action.yaml").write_text("9 8 1 0\n10 4 0 1\n")
    assert read_published_actions(tmp_path / "0_record_action.yaml", 2) == [
        ((1, Action.MOVE_LEFT), (0, Action.MOVE_RIGHT)),
        ((0, Action.STOP), (1, Action.ROTATE_LEFT)),
    ]


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ("9 8 1", "must be 4"),
        ("9 x 1 0", "must be 4"),
        ("9 15 1 0", "15 is unknown"),
        ("9 8 1 1", "each of the cars"),
    ],
)
def test_a_wrong_published_action_file_is_told_with_its_line(row, message, tmp_path):
    (tmp_path / "record.yaml").write_text(f"9 8 1 0\n{row}\n")
    with pytest.raises(BlueprintError, match=f"record.yaml:2: .*{message}"):
        read_published_actions(tmp_path / "record.yaml", 2)
