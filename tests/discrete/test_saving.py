"""A saved world is read back the same; a recorded episode replays the same; CraftEnv's own records are read."""

from itertools import islice
from pathlib import Path

import numpy as np

from craftsim.discrete.conformance import read_records, recorded_grid
from craftsim.discrete.files.blueprint import blueprint_text, parse_blueprint, read_blueprint
from craftsim.discrete.grid import Kind
from craftsim.discrete.tasks import TASK_NAMES, make_task

DATA = Path(__file__).parents[1] / "data"


def read_back(text):
    return parse_blueprint(text, "saved.yaml").grid(np.random.default_rng(0))


def assert_same(one, other):
    assert one.same_visible(other)
    assert one.same_marks(other)


def test_recorded_worlds_of_all_kinds_are_saved_and_read_back_the_same():
    snapshots = 0
    for _, record in islice(read_records(DATA / "traces.jsonl.gz"), None, None, 5):
        grid = recorded_grid(record["size"], record["after"])
        text = blueprint_text(grid)
        assert_same(read_back(text), grid)
        snapshots += "snapshot" in text
    assert snapshots > 20


def test_the_start_of_a_task_needs_no_snapshot_and_keeps_its_goal(rng):
    for name in TASK_NAMES:
        task = make_task(name)
        text = blueprint_text(task.draw(rng), task.starts[0].goal)
        assert "snapshot" not in text
        again = parse_blueprint(text, "again.yaml")
        assert again.goal == task.starts[0].goal
        assert_same(again.grid(rng), task.draw(rng))


def test_a_start_that_craftenv_records_is_read(tmp_path):
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
