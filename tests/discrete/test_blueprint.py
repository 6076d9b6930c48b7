"""Blueprints: what is read, what is drawn at random, what mistakes say, and worlds that are saved and read back."""

from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from craftsim.audit.conformance import read_records, recorded_grid
from craftsim.discrete.files.blueprint import blueprint_text, parse_blueprint, read_blueprint
from craftsim.discrete.files.design import read_design
from craftsim.discrete.files.shipped import shipped_blueprint
from craftsim.discrete.grid import CarField, Kind
from craftsim.errors import BlueprintError
from craftsim.tasks import TASK_NAMES, make_task

GOOD = """\
area_length: 5
area_width: 4
area_height: 3
block_num: 2
slope_num: 1
smartcar_num: 2
block:
  - {id: 0, x: 1, y: 0, z: 1}
  - {id: 1, x: 1, y: 0, z: 2}
fold_slope:
  - {id: 0, x: 2, y: 2, z: 1, yaw: 3}
smartcar:
  - {id: 0, x: 0, y: 2, z: 1, yaw: 0}
  - {id: 1, x: 2, y: 0, z: 1, yaw: 2}
"""


def test_a_blueprint_gives_its_world(rng):
    grid = parse_blueprint(GOOD, "good.yaml").grid(rng)
    assert grid.size == (5, 4, 3)
    assert [int(grid.kind[c]) for c in ((1, 0, 1), (1, 0, 2), (2, 2, 1), (2, 1, 1))] == [
        Kind.BLOCK,
        Kind.BLOCK,
        Kind.FSLOPE,
        Kind.GEAR,
    ]
    assert grid.yaw[2, 2, 1] == grid.yaw[2, 1, 1] == 3
    assert grid.cars[:, : CarField.YAW + 1].tolist() == [[0, 2, 1, 0], [2, 0, 1, 2]]
    derived = grid.copy()
    derived.derive_marks()
    assert grid.same_marks(derived)


def test_the_shipped_tasks_are_sound(rng):
    for name in TASK_NAMES:
        blueprint = read_blueprint(shipped_blueprint(name))
        assert blueprint.is_fixed
        assert blueprint.notes == ()
        design = read_design(shipped_blueprint(f"{name}_goal"))
        design.check_fits(blueprint.size)
        assert not design.satisfied(blueprint.grid(rng))


def test_legged_robots_are_accepted_with_a_note_and_no_cell_means_none():
    text = GOOD + "legged_robot_num: 1\nlegged_robot:\n  - {id: 0, x: -1, y: 0, z: 0.335, yaw: 1}\n"
    text += "flag: [{id: 0, x: -1, y: -2, z: 1}]\ngoal: [{id: 0, x: -1, y: -2, z: 1}]\n"
    blueprint = parse_blueprint(text, "b.yaml")
    assert len(blueprint.notes) == 1
    assert "legged" in blueprint.notes[0]
    assert blueprint.goal is None
    assert blueprint.listed(Kind.FLAG) == 0


def test_documents_are_merged():
    first, second = GOOD.split("block:\n", 1)
    assert parse_blueprint(f"{first}---\nblock:\n{second}", "b.yaml").listed(Kind.BLOCK) == 2


CAR, OTHER, BLOCK = "x: 0, y: 2, z: 1, yaw: 0", "id: 1, x: 2, y: 0", "{id: 1, x: 1, y: 0, z: 2}"
SLOPE = "fold_slope:\n  - {id: 0, x: 2, y: 2, z: 1, yaw: 3}\n"
WALLED = "{id: 0, x: 4, y: 3, z: 1}"
ALONE = ":14: .*load_yaw has an effect with 'load: fold_slope' alone; leave it out"
MISTAKES = (
    ("slope_num: 1\n", "", "b.yaml: key 'slope_num' is missing; required: area_length"),
    (
        "slope_num: 1",
        "slop_num: 1",
        r":5: unknown key 'slop_num'; did you mean 'slope_num'\?; allowed: ",
    ),
    (BLOCK, "{id: 1, x: 5, y: 0, z: 2}", r":9: key 'block\[1\].x': 5 .*allowed: 0 to 4"),
    (BLOCK, "{id: 1, x: 2, y: 1, z: 1}", r":11: .*\(2, 1, 1\), where a block is "),
    (BLOCK, "{id: 1, x: 3, y: 0, z: 2}", ":9: .*a block at .* floats; allowed: on the"),
    (BLOCK, "{id: 0, x: 1, y: 0, z: 2}", ":9: .*0 is taken, see line 8"),
    (
        "y: 2, z: 1, yaw: 3",
        "y: 0, z: 1, yaw: 3",
        ":11: .*gear of a folded slope .*outside the area",
    ),
    ("block_num: 2", "block_num: 1", "'block_num': 1, but 2 are listed; allowed: at least 2"),
    (OTHER, "x: 2, y: 0", r":14: .*smartcar\[1\]': needs 'id'; required: id, x, y, z, yaw"),
    (OTHER, "id: 1, x: 0, y: 2", r":14: .*car 1 is at .* where car 0 is \(line 13\)"),
    (CAR, "x: 0, y: 2, z: 2, yaw: 0", ":13: .*stands in the air"),
    (CAR, "x: 2, y: 2, z: 1, yaw: 0", ":13: .*yaw 0 under a slope; allowed: 1"),
    ("yaw: 2}\n", "yaw: 2, slope: 1}\n", "slope 1 and"),
    ("yaw: 2}\n", "yaw: 2, slope: 2}\n", "slope 2 needs"),
    ("yaw: 2}\n", "yaw: 2, load_yaw: 1}\n", ALONE),
    ("yaw: 2}\n", "yaw: 2, load: block, load_yaw: 1}\n", ALONE),
    ("yaw: 2}\n", "yaw: 2, load: blok}\n", "unknown value 'blok'; did you mean 'block'"),
    (
        f"{SLOPE}smartcar:\n  - {{id: 0, {CAR}}}",
        f"smartcar:\n  - {{id: 0, {CAR}, load: fold_slope}}",
        r"the gear of its slope would be at \(-1, 2, 1\), outside",
    ),
    ("smartcar:", f"wall: [{WALLED}]\ngoal: [{WALLED}]\nsmartcar:", "goal .* inside a wall"),
)


def test_a_mistake_is_told_with_file_line_and_what_is_allowed():
    for old, new, message in MISTAKES:
        assert old in GOOD
        with pytest.raises(BlueprintError, match=message):
            parse_blueprint(GOOD.replace(old, new, 1), "b.yaml")


RANDOM = """\
area_length: 6
area_width: 6
area_height: 2
block_num: 6
slope_num: 2
smartcar_num: 3
smartcar: [{id: 1, x: 3, y: 3, z: 1, yaw: 1}]
block: [{id: 0, x: 0, y: 0, z: 1}]
"""


def test_what_is_not_listed_is_drawn_apart_and_the_same_seed_draws_the_same():
    for placement in ("sane", "published"):
        blueprint = parse_blueprint(RANDOM, "r.yaml")
        yaws = set()
        for seed in range(25):
            grid = blueprint.grid(np.random.default_rng(seed), placement)
            assert grid.same_visible(blueprint.grid(np.random.default_rng(seed), placement))
            assert (grid.kind == Kind.BLOCK).sum() == 6
            assert (grid.kind == Kind.FSLOPE).sum() == (grid.kind == Kind.GEAR).sum() == 2
            assert grid.kind[0, 0, 1] == Kind.BLOCK
            assert grid.cars[1].tolist() == [3, 3, 1, 1, 0, 0, 0]
            assert len({tuple(row[:3]) for row in grid.cars.tolist()}) == 3
            assert all(grid.kind[tuple(grid.cars[car, :3])] == Kind.AIR for car in (0, 2))
            if placement == "sane":
                assert grid.kind[3, 3, 1] == Kind.AIR
            yaws |= set(grid.cars[[0, 2], CarField.YAW].tolist())
        assert yaws == ({0, 1, 2, 3} if placement == "sane" else {0, 1, 2})


def test_a_full_map_is_told(rng):
    for placement in ("sane", "published"):
        text = RANDOM.replace("block_num: 6", "block_num: 36")
        with pytest.raises(BlueprintError, match="no room left for"):
            parse_blueprint(text, "r.yaml").grid(rng, placement)


def test_two_folded_slopes_may_share_a_gear_cell_face_to_face():
    text = GOOD.replace("slope_num: 1", "slope_num: 2").replace(
        "z: 1, yaw: 3}\n", "z: 1, yaw: 3}\n  - {id: 1, x: 2, y: 0, z: 1, yaw: 1}\n"
    )
    text = text.replace("{id: 1, x: 2, y: 0, z: 1, yaw: 2}", "{id: 1, x: 4, y: 0, z: 1, yaw: 2}")
    assert parse_blueprint(text, "b.yaml").n_slopes == 2


def test_a_wrong_goal_file_is_told_with_its_line(tmp_path):
    path, cell = tmp_path / "goal.yaml", "{id: 0, x: 1, y: 1, z: 1}"
    for text, message in (
        (f"block: [{cell}, {cell.replace('0', '1')}]", ":1: .* is a target already, see line 1"),
        (f"unfolded_body: [{cell}]", ":1: .*no entry of 'unfolded_foot' beside"),
        ("block: []\n", "no targets"),
        ("block: [{id: 0, x: 4, y: 1, z: 1}]", r":1: target \(4, 1, 1\) is outside"),
    ):
        path.write_text(text)
        with pytest.raises(
            BlueprintError, match=f"goal.yaml{message}" if message[0] == ":" else message
        ):
            read_design(path).check_fits((4, 4, 3))


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
    (tmp_path / "0-00001.yaml").write_text(
        header + counts + "".join(f"---\n{part}" for part in lists)
    )
    grid = read_blueprint(tmp_path / "0-00001.yaml").grid(np.random.default_rng(0))
    assert grid.kind[1, 0, 1] == Kind.BLOCK
