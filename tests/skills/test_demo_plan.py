"""The shipped plan builds the shipped drawing: as predicted, within the bands, at any step, asleep or awake."""

from dataclasses import dataclass
from importlib.resources import as_file, files

import numpy as np
import pytest

from craftsim.checking.attempt import Attempt
from craftsim.checking.setup import Setup, set_up
from craftsim.discrete.files.blueprint import read_blueprint
from craftsim.discrete.files.design import Design, read_design
from craftsim.discrete.files.plan import read_plan
from craftsim.discrete.readback import Poses, Reading
from craftsim.models.config import SimulationConfig
from craftsim.models.measuring import read_poses

NAME = "simple_two_story"


@dataclass(frozen=True)
class Build:
    attempts: tuple[Attempt, ...]
    final: Reading
    simulated_s: float
    design: Design
    history: tuple[Poses, ...]
    """Poses at the start and after each action."""
    warnings: int


def _build(config: SimulationConfig) -> Build:
    with as_file(files("craftsim.data")) as data:
        drawing = read_blueprint(data / "blueprints" / f"{NAME}.yaml")
        design = read_design(data / "blueprints" / f"{NAME}_goal.yaml")
        plan = read_plan(data / "plans" / f"{NAME}.plan", drawing.n_cars)
    judge = set_up(drawing.grid(np.random.default_rng(0)), Setup(simulation=config))
    physics = judge.physics
    history, attempts = [read_poses(physics)], []
    for tick, joint in enumerate(plan.ticks):
        for car, action in joint:
            attempts.append(judge.perform(car, action, tick=tick))
            history.append(read_poses(physics))
    warnings = int(sum(w.number for w in physics.data.warning))
    return Build(tuple(attempts), judge.reading, physics.time_s, design, tuple(history), warnings)


NOMINAL = SimulationConfig()


@pytest.fixture(scope="module")
def nominal() -> Build:
    return _build(NOMINAL)


def _assert_in_the_bands(build: Build) -> None:
    for attempt in build.attempts:
        name = f"tick {attempt.tick}, car {attempt.car} {attempt.action}: {attempt.reason}"
        assert attempt.legal, name
        assert attempt.skill == "succeeded", name
        assert attempt.agrees, name
        assert attempt.read == attempt.predicted, name
        assert attempt.car_error_m <= 1e-3, name
        assert attempt.heading_error_rad <= 3e-3, name
        assert attempt.bystander_displacement_m <= 1e-3, name
    placed = [a for a in build.attempts if a.placed_error_m is not None]
    assert [(a.tick, a.action) for a in placed] == [(4, "DROP"), (7, "UNFOLD"), (12, "DROP")]
    assert max(a.placed_error_m for a in placed) <= 2e-3


def test_every_action_does_what_the_rules_predict_within_the_bands_and_without_a_warning(nominal):
    assert len(nominal.attempts) == 24
    _assert_in_the_bands(nominal)
    assert nominal.warnings == 0


def test_the_building_matches_its_design_and_stays_in_place_to_the_end(nominal):
    assert nominal.design.satisfied(nominal.final.grid)
    assert nominal.final.problems == ()
    for placed in nominal.final.objects:
        assert placed.offset_m <= 2e-3
        assert abs(placed.heading_rad) <= 3e-3


def _shift(history: tuple[Poses, ...], first: int, car: int | None = None, thing: int | None = None) -> float:
    """Return how far something is at most, from action ``first`` to the end, from where it was then."""
    where = [
        poses.car_positions[car] if car is not None else poses.positions[thing] for poses in history[first:]
    ]
    return float(np.linalg.norm(np.array(where) - where[0], axis=1).max())


def test_what_is_done_with_stays_within_a_millimetre_for_the_rest_of_the_plan(nominal):
    attempts, history = nominal.attempts, nominal.history
    last = {attempt.car: i + 1 for i, attempt in enumerate(attempts)}
    drops = [i + 1 for i, attempt in enumerate(attempts) if attempt.action in ("DROP", "UNFOLD")]
    first_block = int(np.argmin([p.cell[2] for p in nominal.final.objects[:2]]))
    assert _shift(history, last[0], car=0) <= 1e-3
    assert _shift(history, drops[0], thing=first_block) <= 1e-3
    assert _shift(history, drops[1], thing=2) <= 1e-3
    assert _shift(history, drops[2], thing=1 - first_block) <= 1e-3


@pytest.mark.parametrize(
    "config", [SimulationConfig(sleep=False), SimulationConfig(timestep_s=0.001)], ids=["awake", "1 ms"]
)
def test_the_plan_succeeds_alike_with_another_step_and_without_sleep(nominal, config):
    other = _build(config)
    _assert_in_the_bands(other)
    assert other.design.satisfied(other.final.grid)
    here, there = nominal.history[-1], other.history[-1]
    assert np.linalg.norm(here.car_positions - there.car_positions, axis=1).max() <= 2e-3
    assert np.linalg.norm(here.positions - there.positions, axis=1).max() <= 2e-3


def test_a_second_run_is_equal_bit_for_bit(nominal):
    again = _build(NOMINAL)
    assert again.attempts == nominal.attempts
    assert again.simulated_s == nominal.simulated_s
    for one, other in zip(again.history, nominal.history, strict=True):
        for name in ("car_positions", "car_quaternions", "positions", "quaternions"):
            assert getattr(one, name).tobytes() == getattr(other, name).tobytes()
