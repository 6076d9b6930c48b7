"""The shipped plan builds the shipped drawing: as predicted, within the bands, at any step, asleep or awake."""

from dataclasses import dataclass
from functools import cache
from importlib.resources import as_file, files

import numpy as np
import pytest

from craftsim.checking.checked_run import ActionRecord, CheckedRun, CheckedSite, run_plan
from craftsim.discrete.actions import Action
from craftsim.discrete.files.blueprint import read_blueprint
from craftsim.discrete.files.design import Design, read_design
from craftsim.discrete.files.plan import read_plan
from craftsim.discrete.readback import Poses
from craftsim.discrete.rules import Rules
from craftsim.models.config import SimulationConfig
from craftsim.models.sensing import read_poses
from craftsim.models.site import Site
from craftsim.skills.executor import Executor

NAME = "simple_two_story"


@dataclass(frozen=True)
class Build:
    run: CheckedRun
    design: Design
    history: tuple[Poses, ...]
    """Poses at the start and after each action."""
    warnings: int


def _build(config: SimulationConfig) -> Build:
    with as_file(files("craftsim.data")) as data:
        drawing = read_blueprint(data / "blueprints" / f"{NAME}.yaml")
        design = read_design(data / "blueprints" / f"{NAME}_goal.yaml")
        plan = read_plan(data / "plans" / f"{NAME}.plan", drawing.n_cars)
    site = Site(drawing.grid(np.random.default_rng(0)), config)
    history = [read_poses(site)]
    run = run_plan(
        CheckedSite(site, Rules("physical"), Executor(site)),
        plan,
        lambda tick, car, action: None,
        lambda record: history.append(read_poses(site)),
    )
    return Build(run, design, tuple(history), int(sum(w.number for w in site.data.warning)))


built = cache(_build)
NOMINAL = SimulationConfig()


@pytest.fixture(scope="module")
def nominal() -> Build:
    return built(NOMINAL)


def _name(record: ActionRecord) -> str:
    return f"tick {record.tick}, car {record.car} {record.action.name}"


def test_every_action_does_what_the_rules_predict(nominal):
    assert len(nominal.run.records) == 24
    for record in nominal.run.records:
        assert record.legal, _name(record)
        assert record.outcome.succeeded, f"{_name(record)}: {record.outcome}"
        assert record.verdict.agrees, f"{_name(record)}: {record.verdict}"
        assert record.read == record.predicted, _name(record)
    assert nominal.run.agrees


def test_every_car_ends_within_a_millimetre_and_three_milliradians(nominal):
    for record in nominal.run.records:
        assert record.car_error_m <= 1e-3, _name(record)
        assert abs(record.car_heading_error_rad) <= 3e-3, _name(record)


def test_everything_is_set_down_within_two_millimetres(nominal):
    placed = {
        (record.tick, record.action): record.placed_error_m
        for record in nominal.run.records
        if record.placed_error_m is not None
    }
    assert list(placed) == [(4, Action.DROP), (7, Action.UNFOLD), (12, Action.DROP)]
    assert max(placed.values()) <= 2e-3


def test_no_action_moves_what_it_does_not_concern(nominal):
    for record in nominal.run.records:
        assert record.others_moved_m <= 1e-3, _name(record)


def test_the_building_matches_its_design_and_stays_in_place_to_the_end(nominal):
    assert nominal.design.satisfied(nominal.run.final.grid)
    assert nominal.run.final.problems == ()
    for placed in nominal.run.final.objects:
        assert placed.offset_m <= 2e-3
        assert abs(placed.heading_rad) <= 3e-3


def _shift(history: tuple[Poses, ...], first: int, car: int | None = None, thing: int | None = None) -> float:
    """Return how far something is at most, from action ``first`` to the end, from where it was then."""
    where = [
        poses.car_positions[car] if car is not None else poses.positions[thing] for poses in history[first:]
    ]
    return float(np.linalg.norm(np.array(where) - where[0], axis=1).max())


def test_what_is_done_with_stays_within_a_millimetre_for_the_rest_of_the_plan(nominal):
    records, history = nominal.run.records, nominal.history
    last = {record.car: i + 1 for i, record in enumerate(records)}
    drops = [i + 1 for i, record in enumerate(records) if record.action in (Action.DROP, Action.UNFOLD)]
    first_block = int(np.argmin([p.cell[2] for p in nominal.run.final.objects[:2]]))
    assert _shift(history, last[0], car=0) <= 1e-3
    assert _shift(history, drops[0], thing=first_block) <= 1e-3
    assert _shift(history, drops[1], thing=2) <= 1e-3
    assert _shift(history, drops[2], thing=1 - first_block) <= 1e-3


def test_mujoco_has_nothing_to_warn_of(nominal):
    assert nominal.warnings == 0


@pytest.mark.parametrize(
    "config",
    [
        SimulationConfig(timestep_s=0.001),
        SimulationConfig(sleep=False),
        SimulationConfig(timestep_s=0.001, sleep=False),
    ],
    ids=["1 ms", "awake", "1 ms, awake"],
)
def test_the_plan_succeeds_alike_with_another_step_and_without_sleep(nominal, config):
    other = built(config)
    assert other.run.agrees
    assert other.design.satisfied(other.run.final.grid)
    here, there = nominal.history[-1], other.history[-1]
    assert np.linalg.norm(here.car_positions - there.car_positions, axis=1).max() <= 2e-3
    assert np.linalg.norm(here.positions - there.positions, axis=1).max() <= 2e-3


def test_the_plan_at_one_millisecond_keeps_the_same_bands(nominal):
    for record in built(SimulationConfig(timestep_s=0.001)).run.records:
        assert record.car_error_m <= 1e-3, _name(record)
        assert abs(record.car_heading_error_rad) <= 3e-3, _name(record)
        assert (record.placed_error_m or 0.0) <= 2e-3, _name(record)
        assert record.others_moved_m <= 1e-3, _name(record)


def test_a_second_run_is_equal_bit_for_bit(nominal):
    again = _build(NOMINAL)
    assert again.run.records == nominal.run.records
    assert again.run.simulated_s == nominal.run.simulated_s
    for one, other in zip(again.history, nominal.history, strict=True):
        for name in ("car_positions", "car_quaternions", "positions", "quaternions"):
            assert getattr(one, name).tobytes() == getattr(other, name).tobytes()
