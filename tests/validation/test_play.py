"""Random worlds are legal, varied and drawn from a seed; play in them is legal, prefers the rare and is judged."""

import json

import numpy as np
import pytest

from craftsim.discrete.files.blueprint import blueprint_text, parse_blueprint, read_blueprint
from craftsim.discrete.grid import CarField, Kind
from craftsim.discrete.rules import Rules
from craftsim.errors import InputError
from craftsim.planning.plan_file import read_plan
from craftsim.validation.play import play, played_action
from craftsim.validation.validation import validate
from craftsim.validation.worlds import RandomWorlds

RULES = Rules("physical")


@pytest.fixture(scope="module")
def grids():
    return [RandomWorlds().grid(np.random.default_rng(seed)) for seed in range(80)]


def test_every_random_world_is_one_that_a_blueprint_may_hold(grids):
    for grid in grids[::2]:
        text = blueprint_text(grid)
        assert "snapshot" not in text
        assert parse_blueprint(text, "random").grid(np.random.default_rng(0)).same_visible(grid)


def test_random_worlds_show_all_that_there_can_be(grids):
    sizes = {grid.size for grid in grids}
    assert {size[2] for size in sizes} == {1, 2, 3, 4, 5}
    assert all(4 <= n <= 12 for size in sizes for n in size[:2])
    cars = np.concatenate([grid.cars for grid in grids])
    assert {1, 12} <= {grid.n_cars for grid in grids} <= set(range(1, 13))
    assert set(cars[:, CarField.LOAD]) == {Kind.AIR, Kind.BLOCK, Kind.FLAG, Kind.FSLOPE}
    assert set(cars[:, CarField.SLOPE]) == {0, 1, 2}
    assert (cars[:, CarField.SLOPE].astype(bool) & (cars[:, CarField.LOAD] != Kind.AIR)).any()
    under = {grid.kind_at(tuple(row[:3])) for grid in grids for row in grid.cars.tolist()}
    assert {Kind.BLOCK, Kind.FLAG, Kind.FSLOPE, Kind.BODY} <= under
    for kind in (Kind.BODY, Kind.FSLOPE, Kind.WALL, Kind.FLAG):
        levels = {z for grid in grids for z in np.nonzero(grid.kind == kind)[2].tolist()}
        assert {1, 2, 3} <= levels, kind
    hanging = [
        g
        for g in grids
        for x, y, z in np.argwhere(g.kind == Kind.WALL)
        if g.kind[x, y, z - 1] == Kind.AIR
    ]
    assert hanging
    assert any((grid.cars[:, CarField.Z] > grid.size[2]).any() for grid in grids)


def test_a_world_is_drawn_from_the_seed_and_has_the_cars_asked_for():
    one, again, other = (
        RandomWorlds(n_cars=3).grid(np.random.default_rng(seed)) for seed in (0, 0, 1)
    )
    assert one.same_visible(again)
    assert not one.same_visible(other)
    assert one.n_cars == other.n_cars == 3


def test_figures_that_do_not_fit_are_refused():
    for figures in [{"n_cars": 0}, {"n_cars": 13}, {"n_blocks": 99}, {"max_steps": 0}]:
        with pytest.raises(InputError, match="allowed"):
            RandomWorlds(**figures)


def test_play_is_legal_in_its_turn_and_prefers_the_rare(grids):
    uniform = rare = 0
    for seed, grid in enumerate(grids[:10]):
        played = play(grid, RULES, np.random.default_rng(seed), 10)
        for joint in played:
            assert len({car for car, _ in joint}) == len(joint)
            for car, action in joint:
                assert RULES.legal(grid, car, action)
                before, grid = grid, RULES.apply(grid, car, action)
                done = played_action(before, grid, car, action)
                rare += done.on_slope or done.verb in ("FOLD", "UNFOLD", "LIFT")
                uniform += done.verb == "STOP"
    assert rare > 2 * uniform


def test_what_is_played_in_random_worlds_does_as_predicted_and_is_saved(tmp_path):
    how = {
        "seed": 4,
        "n_cars": 3,
        "max_steps": 4,
        "randomize": "none",
        "trials": 2,
        "drive": "wheels",
    }
    result = validate("random", **how, order="ticks", out=tmp_path)
    assert result.agrees, result.records
    other = validate("random", **how, order="sequential", out=tmp_path / "other", baseline=tmp_path)
    assert other.comparison.trials.both == 2, "the orders of the same play can be compared"
    assert {attempt.car for attempt in result.attempts} == {0, 1, 2}
    coverage = json.loads((tmp_path / "report.json").read_text())["figures"]["coverage"]
    assert (
        coverage["actions"]
        == len(result.attempts)
        == sum(row["all"] for row in coverage["rows"].values())
    )
    for record in result.records:
        name = record["key"].replace("/", "-")
        world = read_blueprint(tmp_path / "worlds" / f"{name}.yaml")
        plan = read_plan(tmp_path / "worlds" / f"{name}.plan", world.n_cars)
        acts = [(car, action.name) for tick in plan.ticks for car, action in tick]
        assert [(a["car"], a["action"]) for a in record["attempts"]] == acts
