"""Blueprints: what is read, what is drawn at random, and what every mistake says."""

import re
from pathlib import Path

import numpy as np
import pytest

from craftsim.discrete.files.blueprint import parse_blueprint, read_blueprint
from craftsim.discrete.files.design import read_design
from craftsim.discrete.files.shipped import shipped_blueprint
from craftsim.discrete.grid import CarField, Kind
from craftsim.discrete.tasks import TASK_NAMES
from craftsim.errors import BlueprintError

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


@pytest.mark.parametrize("name", TASK_NAMES)
def test_the_shipped_tasks_are_sound(name, rng):
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


MISTAKES = {
    "misspelt key": (
        "slope_num: 1",
        "slop_num: 1",
        5,
        r"unknown key 'slop_num'; did you mean 'slope_num'\?; allowed: ",
    ),
    "misspelt key of an entry": (
        "{id: 0, x: 1, y: 0, z: 1}",
        "{id: 0, x: 1, yy: 0, z: 1}",
        8,
        "unknown key 'yy'.*'y'",
    ),
    "missing key": ("slope_num: 1\n", "", None, "key 'slope_num' is missing; required: area_length"),
    "missing coordinate": (
        "{id: 0, x: 1, y: 0, z: 1}",
        "{id: 0, x: 1, y: 0}",
        8,
        r"block\[0\]': needs 'z'; required",
    ),
    "key given twice": (
        "block_num: 2\n",
        "block_num: 2\nblock_num: 2\n",
        5,
        "'block_num': given twice, first in line 4",
    ),
    "cell outside": (
        "{id: 1, x: 1, y: 0, z: 2}",
        "{id: 1, x: 5, y: 0, z: 2}",
        9,
        r"block\[1\].x': 5 .*allowed: 0 to 4",
    ),
    "level outside": (
        "{id: 1, x: 1, y: 0, z: 2}",
        "{id: 1, x: 1, y: 0, z: 4}",
        9,
        "4 is out of range, allowed: 1 to 3",
    ),
    "gear outside": (
        "y: 2, z: 1, yaw: 3",
        "y: 0, z: 1, yaw: 3",
        11,
        "gear of a folded slope .*outside the area",
    ),
    "two in one cell": (
        "{id: 1, x: 1, y: 0, z: 2}",
        "{id: 1, x: 2, y: 1, z: 1}",
        11,
        r"\(2, 1, 1\), where a block is ",
    ),
    "floating": (
        "{id: 1, x: 1, y: 0, z: 2}",
        "{id: 1, x: 3, y: 0, z: 2}",
        9,
        "a block at .* floats; allowed: on the",
    ),
    "word for a number": (
        "block_num: 2",
        "block_num: two",
        4,
        "'block_num': must be an integer .* not 'two'",
    ),
    "fraction": ("block_num: 2", "block_num: 2.0", 4, "must be an integer"),
    "not a number": ("block_num: 2", "block_num: .nan", 4, "must be an integer"),
    "text for a number": ("block_num: 2", "block_num: '2'", 4, "must be an integer"),
    "list for a number": ("block_num: 2", "block_num: [2]", 4, "must be an integer .* not a list"),
    "mapping for a list": (
        "block:\n",
        "block: {}\nwall:\n",
        7,
        "'block': must be a list of entries, not a mapping",
    ),
    "number in a list": ("  - {id: 0, x: 1, y: 0, z: 1}\n", "  - 7\n", 8, r"block\[0\]': must be a mapping"),
    "count below the list": (
        "block_num: 2",
        "block_num: 1",
        None,
        "'block_num': 1, but 2 are listed; allowed: at least 2",
    ),
    "car without an id": (
        "{id: 1, x: 2, y: 0",
        "{x: 2, y: 0",
        14,
        r"smartcar\[1\]': needs 'id'; required: id, x, y, z, yaw",
    ),
    "no mapping": (
        "area_length: 5",
        "- 5\n---\narea_length: 5",
        1,
        "key 'document': must be a mapping with keys area_length, .*, not a list",
    ),
    "id taken": ("{id: 1, x: 1, y: 0, z: 2}", "{id: 0, x: 1, y: 0, z: 2}", 9, "0 is taken, see line 8"),
    "car id too high": (
        "{id: 1, x: 2",
        "{id: 2, x: 2",
        14,
        r"smartcar\[1\].id': 2 is out of range, allowed: 0 to 1",
    ),
    "car on a car": (
        "{id: 1, x: 2, y: 0",
        "{id: 1, x: 0, y: 2",
        14,
        r"car 1 is at .* where car 0 is \(line 13\)",
    ),
    "car in the air": ("x: 0, y: 2, z: 1, yaw: 0", "x: 0, y: 2, z: 2, yaw: 0", 13, "stands in the air"),
    "car across a slope": (
        "x: 0, y: 2, z: 1, yaw: 0",
        "x: 2, y: 2, z: 1, yaw: 0",
        13,
        "yaw 0 under a slope; allowed: 1",
    ),
    "no yaw 4": (
        "x: 0, y: 2, z: 1, yaw: 0",
        "x: 0, y: 2, z: 1, yaw: 4",
        13,
        "4 is out of range, allowed: 0 to 3",
    ),
    "bad YAML": ("block:\n", "block: [\n", None, "not valid YAML"),
    "alias": ("block_num: 2", "block_num: &n 2", 4, r"anchors and aliases"),
    "tag": ("block_num: 2", "block_num: !!int 2", 4, "tags"),
    "huge area": ("area_length: 5", "area_length: 1000000", 1, "out of range, allowed: 1 to 128"),
    "huge number": ("block_num: 2", f"block_num: {'9' * 5000}", 4, "must be an integer"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_told_with_file_line_and_what_is_allowed(mistake, tmp_path):
    old, new, line, message = MISTAKES[mistake]
    assert old in GOOD
    path = tmp_path / "b.yaml"
    path.write_text(GOOD.replace(old, new, 1))
    with pytest.raises(BlueprintError) as caught:
        read_blueprint(path)
    text = str(caught.value)
    if line is not None:
        assert text.startswith(f"{path}:{line}: "), text
    assert text.startswith(str(path))
    assert re.search(message, text), text
    assert "\n" not in text


def test_the_first_five_mistakes_are_told_at_once_in_the_order_of_the_file():
    text = GOOD.replace("area_length: 5", "area_length: none").replace("slope_num: 1\n", "")
    text = text.replace("x: 1, y: 0", "x: 1, y: 9").replace("yaw: 0", "yaw: 7, lod: block")
    with pytest.raises(BlueprintError) as caught:
        parse_blueprint(text, "b.yaml")
    assert [line.split("; ")[0] for line in str(caught.value).splitlines()] == [
        "b.yaml: key 'slope_num' is missing",
        "b.yaml:1: key 'area_length': must be an integer from 1 to 128, not 'none'",
        "b.yaml:7: key 'block[0].y': 9 is out of range, allowed: 0 to 3",
        "b.yaml:8: key 'block[1].y': 9 is out of range, allowed: 0 to 3",
        "b.yaml:12: key 'smartcar[0].yaw': 7 is out of range, allowed: 0 to 3",
        "b.yaml: and more",
    ]


def test_a_goal_inside_a_wall_and_cars_that_do_not_fit_slopes_are_told():
    walled = GOOD + "wall: [{id: 0, x: 4, y: 3, z: 1}]\ngoal: [{id: 0, x: 4, y: 3, z: 1}]\n"
    with pytest.raises(BlueprintError, match=r"goal .* inside a wall"):
        parse_blueprint(walled, "b.yaml")
    for slope, message in ((1, "slope 1 and"), (2, "slope 2 needs")):
        with pytest.raises(BlueprintError, match=message):
            parse_blueprint(GOOD.replace("yaw: 2}\n", f"yaw: 2, slope: {slope}}}\n"), "b.yaml")
    with pytest.raises(BlueprintError, match=r"unknown value 'blok'; did you mean 'block'"):
        parse_blueprint(GOOD.replace("yaw: 2}\n", "yaw: 2, load: blok}\n"), "b.yaml")


@pytest.mark.parametrize("content", [None, b"\xff\xfe\x00junk", b"area_length: 5\n\xc3("])
def test_files_that_cannot_be_read_are_told(tmp_path, content):
    path = tmp_path / "b.yaml"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(BlueprintError, match=re.escape(str(path))):
        read_blueprint(path)
    with pytest.raises(BlueprintError, match="not a regular file"):
        read_blueprint(tmp_path)


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


@pytest.mark.parametrize("placement", ["sane", "published"])
def test_what_is_not_listed_is_drawn_apart_and_the_same_seed_draws_the_same(placement):
    blueprint = parse_blueprint(RANDOM, "r.yaml")
    yaws = set()
    for seed in range(60):
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


def test_published_random_objects_leave_no_mark_below(rng):
    grid = parse_blueprint(RANDOM, "r.yaml").grid(rng, "published")
    blocks = np.argwhere(grid.kind == Kind.BLOCK)
    cars = {tuple(row[:2]) for row in grid.cars.tolist()}
    marks = {(x, y): int(grid.occupant[x, y, 0]) for x, y, _ in blocks.tolist() if (x, y) not in cars}
    assert marks.pop((0, 0)) == -2
    assert set(marks.values()) == {-1}


@pytest.mark.parametrize("placement", ["sane", "published"])
def test_a_full_map_is_told(placement, rng):
    text = RANDOM.replace("block_num: 6", "block_num: 36")
    with pytest.raises(BlueprintError, match="no room left for"):
        parse_blueprint(text, "r.yaml").grid(rng, placement)


def test_two_folded_slopes_may_share_a_gear_cell_face_to_face():
    text = GOOD.replace("slope_num: 1", "slope_num: 2").replace(
        "z: 1, yaw: 3}\n", "z: 1, yaw: 3}\n  - {id: 1, x: 2, y: 0, z: 1, yaw: 1}\n"
    )
    text = text.replace("{id: 1, x: 2, y: 0, z: 1, yaw: 2}", "{id: 1, x: 4, y: 0, z: 1, yaw: 2}")
    assert parse_blueprint(text, "b.yaml").n_slopes == 2


DESIGN_MISTAKES = {
    "blok:\n  - {id: 0, x: 1, y: 1, z: 1}\n": r":1: unknown key 'blok'; did you mean 'block'",
    "block:\n  - {id: 0, x: 1, y: 1, z: 0}\n": r":2: key 'block\[0\]\.z': 0 is out of range",
    "block:\n  - {id: 0, x: 1, y: 1, z: 1}\n  - {id: 1, x: 1, y: 1, z: 1}\n": r":3: .* is a target already, see line 2",
    "unfolded_body:\n  - {id: 0, x: 1, y: 1, z: 1}\n": r":2: .*no entry of 'unfolded_foot' beside",
    "block: []\n": "no targets",
    "": "no targets",
}


@pytest.mark.parametrize("text", DESIGN_MISTAKES)
def test_a_wrong_goal_file_is_told_with_its_line(text, tmp_path):
    path = tmp_path / "goal.yaml"
    path.write_text(text)
    with pytest.raises(BlueprintError, match=DESIGN_MISTAKES[text]):
        read_design(path)


def test_a_target_outside_the_area_is_told(tmp_path):
    path = tmp_path / "goal.yaml"
    path.write_text("block: [{id: 0, x: 4, y: 1, z: 1}]")
    with pytest.raises(BlueprintError, match=r"goal.yaml:1: target \(4, 1, 1\) is outside"):
        read_design(path).check_fits((4, 4, 3))


def test_a_design_is_satisfied_when_every_target_holds_its_kind_and_yaw(scene):
    design = read_design(shipped_blueprint("simple_two_story_goal"))
    done = [(Kind.BLOCK, (2, 3, 1)), (Kind.BLOCK, (2, 3, 2)), (Kind.BODY, (2, 2, 1), 3)]
    assert design.satisfied(scene(done))
    assert not design.satisfied(scene(done[1:]))
    wrong = scene(done)
    wrong.yaw[2, 2, 1] = 1
    assert not design.satisfied(wrong)
    assert Path(design.path).name == "simple_two_story_goal.yaml"


def test_a_carried_slope_whose_gear_would_be_outside_the_area_is_refused():
    drawing = "area_length: 3\narea_width: 3\narea_height: 1\nblock_num: 0\nslope_num: 1\nsmartcar_num: 1\n"
    car = "smartcar:\n  - {{id: 0, x: {x}, y: 1, z: 1, yaw: 0, load: fold_slope, load_yaw: 2}}\n"
    goal = "goal:\n  - {id: 0, x: -1, y: -2, z: 1}\n"
    assert parse_blueprint(drawing + car.format(x=1) + goal, "mine.yaml").n_cars == 1
    with pytest.raises(BlueprintError, match=r"the gear of its slope would be at \(-1, 1, 1\), outside"):
        parse_blueprint(drawing + car.format(x=0) + goal, "mine.yaml")
