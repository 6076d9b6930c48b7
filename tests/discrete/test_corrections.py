"""Each correction of the physical rules: what published allows and physical forbids, and what both still allow.

The worlds were drawn by hand, each for the law that stands beside it in tests/data/corrections.jsonl.
"""

import json
from collections import defaultdict
from pathlib import Path

from craftsim.discrete.grid import CarField, Kind
from craftsim.discrete.kinds import Action, Correction
from craftsim.discrete.rules import Rules

from .conftest import recorded_world

PUBLISHED, PHYSICAL = Rules("published"), Rules("physical")
BLOCK, FSLOPE, GEAR, BODY, FOOT = Kind.BLOCK, Kind.FSLOPE, Kind.GEAR, Kind.BODY, Kind.FOOT
RAMP = [(BLOCK, (1, 3, 1)), (BODY, (2, 3, 1), 0)]
"""A ramp that falls in +x from the block at (1, 3) to its foot at (3, 3)."""
LAWS = defaultdict(list)
"""Worlds by the law that they show: an action, whether each rule set allows it, and the correction that forbids it."""
for line in (Path(__file__).parents[1] / "data" / "corrections.jsonl").read_text().splitlines():
    LAWS[json.loads(line)["law"]].append(json.loads(line))


def test_physical_forbids_what_published_allows_because_of_one_correction_alone():
    for law in LAWS:
        for example in LAWS[law]:
            grid, car, action = recorded_world(example), example["car"], Action[example["action"]]
            assert PUBLISHED.legal(grid, car, action) == example["published"], example
            assert PHYSICAL.legal(grid, car, action) == example["physical"], example
            if "correction" in example:
                without = Rules("physical", ~Correction[example["correction"]])
                assert without.legal(grid, car, action), example


def test_every_correction_that_forbids_something_has_a_law_and_its_bounds():
    shown = {example.get("correction") for examples in LAWS.values() for example in examples}
    effects = {"derived_marks", "second_ramp", "lasting_gears"}
    assert shown == {*Correction.__members__, None} - effects
    assert sum(example["physical"] for examples in LAWS.values() for example in examples) > 80


def test_from_a_top_onto_a_second_foot_a_car_is_on_the_second_ramp(scene, car):
    stairs = [(BODY, (4, 3, 1), 0), *[(BLOCK, (x, 3, 1)) for x in (1, 2, 3)], (BODY, (2, 3, 2), 0)]
    grid = scene([*stairs, (BLOCK, (1, 3, 2))], [car(4, 3, 2, yaw=2, slope=2)])
    for rules, slope in ((PUBLISHED, 0), (PHYSICAL, 1)):
        after = rules.apply(grid, 0, Action.MOVE_LEFT)
        assert after.cars[0, [CarField.X, CarField.Z, CarField.SLOPE]].tolist() == [3, 2, slope]


def test_a_gear_lasts_as_long_as_its_slope_and_gives_way_to_what_stands(scene, car):
    facing = [(FSLOPE, (1, 3, 1), 0), (FSLOPE, (3, 3, 1), 2)]
    grid = scene(facing, [car(3, 3)])
    lifted = {rules.rule_set: rules.apply(grid, 0, Action.LIFT) for rules in (PUBLISHED, PHYSICAL)}
    assert lifted["published"].kind[2, 3, 1] == Kind.AIR
    assert (lifted["physical"].kind[2, 3, 1], lifted["physical"].yaw[2, 3, 1]) == (GEAR, 0)
    for yaw, rules in ((2, PUBLISHED), (0, PHYSICAL)):
        assert rules.apply(lifted["physical"], 0, Action.DROP).yaw[2, 3, 1] == yaw
    alone = PHYSICAL.apply(scene([(FSLOPE, (3, 3, 1), 2)], [car(3, 3)]), 0, Action.LIFT)
    assert not (alone.kind == GEAR).any()
    behind_ramp = scene(RAMP, [car(4, 3, yaw=0, load=FSLOPE)])
    assert PUBLISHED.apply(behind_ramp, 0, Action.DROP).kind[3, 3, 1] == GEAR
    assert PHYSICAL.apply(behind_ramp, 0, Action.DROP).kind[3, 3, 1] == FOOT
