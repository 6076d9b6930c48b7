"""The shipped plan builds the shipped drawing: as predicted, within the bands, at any step, asleep or awake."""

from importlib.resources import as_file, files

import numpy as np
import pytest

from craftsim.checking.setup import Setup, set_up
from craftsim.discrete.files.blueprint import read_blueprint
from craftsim.discrete.files.design import read_design
from craftsim.models.config import SimulationConfig
from craftsim.planning.plan_file import read_plan

SHORT = 5
"""Ticks until the first block is set down."""
PLACED = [(4, "DROP"), (7, "UNFOLD"), (12, "DROP")]


def _build(config=None, ticks=None):
    """Return the judge of a build, its attempts, and the poses at the start and after each of them."""
    with as_file(files("craftsim.data")) as data:
        drawing = read_blueprint(data / "blueprints" / "simple_two_story.yaml")
        plan = read_plan(data / "plans" / "simple_two_story.plan", drawing.n_cars)
    judge = set_up(
        drawing.grid(np.random.default_rng(0)), Setup(simulation=config or SimulationConfig())
    )
    attempts, history = [], [judge.physics.poses()]
    for tick, joint in enumerate(plan.ticks[:ticks]):
        for car, action in joint:
            attempts.append(judge.perform(car, action, tick=tick))
            history.append(judge.physics.poses())
    return judge, attempts, history


@pytest.fixture(scope="module")
def nominal():
    return _build()


def _assert_in_the_bands(attempts, placed):
    """Each agrees: a car ends within 1 mm and 3 mrad, a thing within 1.25 mm, and bystanders move by less than 1 mm."""
    assert not [attempt for attempt in attempts if not attempt.agrees]
    found = [a for a in attempts if a.placed_error_m is not None]
    assert [(a.tick, a.action) for a in found] == placed


def test_every_action_does_what_the_rules_predict_and_the_building_matches_its_design(nominal):
    judge, attempts, _ = nominal
    assert len(attempts) == 24
    _assert_in_the_bands(attempts, PLACED)
    assert sum(w.number for w in judge.physics.data.warning) == 0
    with as_file(files("craftsim.data")) as data:
        assert read_design(data / "blueprints" / "simple_two_story_goal.yaml").satisfied(
            judge.reading.grid
        )
    assert judge.reading.problems == ()
    assert all(
        thing.offset_m <= 2e-3 and abs(thing.heading_rad) <= 3e-3 for thing in judge.reading.objects
    )


def test_what_is_done_with_stays_within_a_millimetre_for_the_rest_of_the_plan(nominal):
    judge, attempts, history = nominal
    last = {attempt.car: i + 1 for i, attempt in enumerate(attempts)}
    drops = [i + 1 for i, attempt in enumerate(attempts) if attempt.action in ("DROP", "UNFOLD")]
    first_block = int(np.argmin([p.cell[2] for p in judge.reading.objects[:2]]))
    parked = np.array([poses.car_positions[0] for poses in history[last[0] :]])
    assert np.linalg.norm(parked - parked[0], axis=1).max() <= 1e-3
    for first, thing in zip(drops, (first_block, 2, 1 - first_block), strict=True):
        where = np.array([poses.positions[thing] for poses in history[first:]])
        assert np.linalg.norm(where - where[0], axis=1).max() <= 1e-3


@pytest.mark.parametrize(
    ("ticks", "timestep_s"), [(SHORT, 0.0025), pytest.param(None, 0.001, marks=pytest.mark.slow)]
)
def test_the_plan_succeeds_alike_in_finer_steps_and_without_sleep(nominal, ticks, timestep_s):
    _, attempts, history = _build(SimulationConfig(sleep=False, timestep_s=timestep_s), ticks)
    _assert_in_the_bands(attempts, PLACED[: 1 if ticks else None])
    here, there = nominal[2][len(attempts)], history[-1]
    assert np.linalg.norm(here.car_positions - there.car_positions, axis=1).max() <= 2e-3
    assert np.linalg.norm(here.positions - there.positions, axis=1).max() <= 2e-3


def test_a_second_run_is_equal_bit_for_bit(nominal):
    _, attempts, history = _build(ticks=SHORT)
    assert attempts == nominal[1][: len(attempts)]
    for one, other in zip(history, nominal[2], strict=False):
        for name in ("car_positions", "car_quaternions", "positions", "quaternions"):
            assert getattr(one, name).tobytes() == getattr(other, name).tobytes()
