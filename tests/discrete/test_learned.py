"""Learned rules: files, what their patterns forbid, and who takes them."""

import dataclasses
import json

import numpy as np
import pytest

import craftsim
from craftsim.checking.recipe import Recipe
from craftsim.checking.setup import setup_of
from craftsim.discrete.files.blueprint import blueprint_text
from craftsim.discrete.grid import CarField, Kind
from craftsim.discrete.kernel import patterns as bits
from craftsim.discrete.kinds import MOVE_DIRECTION, Action
from craftsim.discrete.learned import (
    CELL_WORDS,
    LearnedRule,
    LearnedRules,
    PatternCell,
    RulesOrigin,
    as_rule_set,
    cell_words,
    read_rules,
    rules_text,
)
from craftsim.discrete.rules import Rules
from craftsim.errors import InputError
from craftsim.learning.config import TrainConfig
from craftsim.storage.records import from_json, to_json
from craftsim.tasks import make_task
from craftsim.tasks.episodes import Episodes
from craftsim.validation.play import play
from craftsim.validation.worlds import RandomWorlds

LOADED = {"load": ("block", "flag", "fslope")}
TURN = LearnedRule("turn", "ROTATE_LEFT", (PatternCell((1, 0, 0), ("car",)),), LOADED)
FILE = """\
name: "my car"
base: published
rules:
  - name: turn
    action: ROTATE_LEFT
    car: {load: [block, flag, fslope]}
    cells:
      - {at: [1, 0, 0], has: [car]}
"""


def _two_cars(yaw=0):
    grid = craftsim.Grid.empty((4, 4, 2), n_cars=2)
    grid.cars[0] = (1, 1, 1, yaw, Kind.BLOCK, 0, 0)
    grid.cars[1, :3] = (2, 1, 1)
    return grid


def _random_rules(rng, n):
    words = [word for word in CELL_WORDS if word not in ("air", "ground")]
    rules = []
    for number in range(n):
        cells = []
        for _ in range(int(rng.integers(1, 3))):
            at = (int(rng.integers(-2, 4)), int(rng.integers(-2, 3)), int(rng.integers(-1, 2)))
            has = tuple(rng.choice(words, 3, replace=False).tolist())
            cells.append(PatternCell(at, has))
        verb = bits.VERBS[int(rng.integers(len(bits.VERBS)))]
        rules.append(
            LearnedRule(f"rule-{number}", verb, tuple(cells), sides=("both", "one")[number % 2])
        )
    return LearnedRules("random", rules=tuple(rules))


def test_a_file_is_read_as_it_was_written(tmp_path):
    path = tmp_path / "mycar.yaml"
    path.write_text(FILE)
    rules = read_rules(path)
    assert rules == LearnedRules("my car", rules=(TURN,))
    path.write_text(rules_text(rules))
    assert read_rules(path) == rules
    many = _random_rules(np.random.default_rng(0), 40)
    path.write_text(rules_text(many))
    assert read_rules(path) == many


@pytest.mark.parametrize("name", ["1", "null", "1e5"])
@pytest.mark.parametrize(
    "text", ["a: b", "[x", "#c", "a\nb", "a\x85b", "a\0b", " 'a' \\", "x " * 40]
)
def test_texts_in_a_file_come_back_whatever_they_are(name, text, tmp_path):
    rule = LearnedRule(name, "MOVE", car={"load": ("none",)}, like=text)
    rules = LearnedRules(
        text, origin=RulesOrigin(machines=text, versions={text: text}), rules=(rule,)
    )
    path = tmp_path / "mycar.yaml"
    path.write_text(rules_text(rules))
    assert read_rules(path) == rules


def test_a_rule_has_no_more_failures_than_trials():
    with pytest.raises(InputError, match="5 failures of 1 trials; allowed: at most all"):
        LearnedRule("turn", "MOVE", car={"load": ("none",)}, trials=1, failures=5)


def _nested(depth):
    nested = {}
    for _ in range(depth):
        nested = {"name": nested}
    return nested


@pytest.mark.parametrize(
    "rules", [{"name": object()}, {"name": "\ud800"}, {"rules": [object()]}, _nested(3000)]
)
def test_a_mapping_that_is_no_json_is_refused(rules):
    with pytest.raises(InputError, match=r"learned rules: .*; allowed: texts, numbers, lists"):
        craftsim.Rules(rules)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "has: [car]",
            "has: [cra]",
            ":8: key 'rules[0].cells[0].*unknown thing 'cra'; did you mean 'car'",
        ),
        ("at: [1,", "at: [9,", ":8: key 'rules[0].cells[0].at[0]'"),
        ("ROTATE_LEFT", "TURN", ":5: key 'rules[0].action'"),
        ("load:", "weight:", "unknown property of a car 'weight'"),
        ("base: published", "base: mine", ":2: key 'base'"),
        ("name: turn", "name: ''", ":4: key 'rules[0].name'"),
        ("rules:", "corrections: [none]\nrules:", "unknown correction 'none'"),
    ],
)
def test_a_wrong_file_is_refused_with_file_line_and_key(tmp_path, old, new, message):
    path = tmp_path / "mycar.yaml"
    path.write_text(FILE.replace(old, new, 1))
    with pytest.raises(InputError) as error:
        read_rules(path)
    first, _, last = message.partition(".*")
    text = str(error.value)
    assert text.startswith(str(path))
    assert first in text
    assert last in text


def test_a_pattern_without_anything_and_too_many_are_refused():
    with pytest.raises(InputError, match="would forbid every LIFT"):
        LearnedRule("all", "LIFT")
    many = [dataclasses.replace(TURN, name=f"r{number}") for number in range(600)]
    with pytest.raises(InputError, match="512"):
        LearnedRules("many", rules=tuple(many))
    with pytest.raises(InputError, match="two rules"):
        LearnedRules("twice", rules=(TURN, TURN))
    with pytest.raises(InputError, match="did you mean 'physical'"):
        as_rule_set("phsical")


def test_words_name_all_bits_of_a_cell():
    for number in range(bits.N_BITS):
        (word,) = cell_words(1 << number)
        assert CELL_WORDS[word] == 1 << number
    assert cell_words(CELL_WORDS["body"] | CELL_WORDS["gear-left"]) == ("body", "gear-left")


def test_a_rule_forbids_where_its_pattern_is_and_says_so():
    rules = Rules(LearnedRules("my car", rules=(TURN,)))
    grid = _two_cars()
    published = Rules("published").mask(grid)
    forbidden = published & ~rules.mask(grid)
    assert np.argwhere(forbidden).tolist() == [[0, Action.ROTATE_LEFT], [0, Action.ROTATE_RIGHT]]
    explanation = rules.explain(grid, 0, Action.ROTATE_RIGHT)
    assert explanation.learned == "turn"
    assert explanation.cells == ((1, 1, 1), (2, 1, 1))
    assert "the learned rule 'turn' forbids it: ROTATE_LEFT, load block or flag" in str(explanation)
    assert rules.legal(_two_cars(yaw=1), 0, Action.ROTATE_LEFT)


def _plainly(rules, grid, car, action):
    """Return whether a pattern forbids an action, looked up cell by cell."""
    x, y, z, yaw = grid.cars[car, : CarField.LOAD].tolist()
    verb = action.name
    frame = yaw
    if action in MOVE_DIRECTION:
        verb = "MOVE"
        frame = MOVE_DIRECTION[action]
    world = grid.world()
    turn = {"ROTATE_LEFT": "ROTATE_RIGHT", "ROTATE_RIGHT": "ROTATE_LEFT"}
    for rule in rules.rules:
        for side in (1, -1):
            named = rule.action
            if side == -1:
                named = turn.get(named, named)
            if named != verb or (side == -1 and rule.sides == "one"):
                continue
            if all(_shows(world, (x, y, z), car, frame, side, cell) for cell in rule.cells):
                return True
    return False


def _shows(world, at, car, frame, side, cell):
    ahead, left, up = cell.at
    left *= side
    dx, dy = ((1, 0), (0, 1), (-1, 0), (0, -1))[frame]
    place = (at[0] + ahead * dx - left * dy, at[1] + ahead * dy + left * dx, at[2] + up)
    words = cell_words(bits.cell_bits(world, car, *place, frame))
    if side == -1:
        swap = {"left": "right", "right": "left"}
        words = ["-".join(swap.get(part, part) for part in word.split("-")) for word in words]
    shown = 0
    for word in words:
        shown |= CELL_WORDS[word]
    return shown & cell.allowed != 0


def test_compiled_patterns_forbid_what_a_plain_look_at_each_cell_does():
    rng = np.random.default_rng(5)
    base = Rules("published")
    n_forbidden = 0
    for seed in range(12):
        learned = _random_rules(rng, 30)
        rules = Rules(learned)
        grid = RandomWorlds().grid(np.random.default_rng(seed))
        for tick in play(grid, base, rng, 6):
            mask = rules.mask(grid)
            expected = base.mask(grid)
            for car, number in np.argwhere(expected).tolist():
                if _plainly(learned, grid, car, Action(number)):
                    expected[car, number] = False
                    n_forbidden += 1
                    assert rules.explain(grid, car, number).learned
            assert np.array_equal(mask, expected)
            grid, _ = base.tick(grid, tick)
    assert n_forbidden > 100


def test_environments_training_and_recipes_take_a_file(tmp_path):
    path = tmp_path / "mycar.yaml"
    path.write_text(FILE)
    learned = read_rules(path)
    task = make_task("strip")
    episodes = Episodes(task, np.random.default_rng(0), 2, str(path))
    assert np.array_equal(episodes.patterns, learned.patterns)
    env = craftsim.parallel_env("strip", backend="grid", rule_set=str(path))
    assert env.unwrapped.core.rules.learned == learned
    config = TrainConfig("strip", rules=str(path))
    assert config.rules == learned
    assert from_json(TrainConfig, to_json(config), "config") == config
    setup = setup_of(rules=path)
    recipe = Recipe(blueprint_text(_two_cars()), (), setup)
    assert from_json(Recipe, to_json(recipe), "recipe") == recipe
    assert json.loads(to_json(recipe))["setup"]["rules"]["rules"][0]["name"] == "turn"


@pytest.mark.parametrize("kind", [TrainConfig, Recipe])
def test_a_stored_record_opens_no_file_of_rules_that_it_names(kind, tmp_path):
    """A bundle or a policy may come from anybody; it holds the rules whole."""
    path = tmp_path / "mycar.yaml"
    path.write_text(FILE)
    record = TrainConfig("strip", rules=str(path))
    if kind is Recipe:
        record = Recipe(blueprint_text(_two_cars()), (), setup_of(rules=path))
    values = json.loads(to_json(record))
    values.get("setup", values)["rules"] = str(path)
    with pytest.raises(
        InputError, match=r"rules'?: unknown rule set '.*mycar.yaml'; there are publ"
    ):
        from_json(kind, json.dumps(values).encode(), "record")
