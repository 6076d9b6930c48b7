"""The contact log knows what touches what, how hard, and what leans and falls."""

import csv
from dataclasses import replace

import numpy as np
import pytest
from discrete.drawn import draw

from craftsim.checking.contacts import ContactLog
from craftsim.checking.thresholds import impact_limit_n
from craftsim.discrete.grid import Kind
from craftsim.discrete.kinds import Action
from craftsim.mjcf.machines import NOMINAL
from craftsim.models.config import SimulationConfig
from craftsim.models.world import PhysicsWorld
from craftsim.skills.executor import Executor
from craftsim.skills.state import GRAVITY

BLOCK, SMARTCAR = NOMINAL.block, NOMINAL.cars[0]


def _physics(*objects, config: SimulationConfig | None = None) -> PhysicsWorld:
    """Return a car at (0, 1) that faces +x, and objects as :func:`draw` takes them."""
    return PhysicsWorld(draw((4, 3, 3), objects, [(0, 1, 1, 0)]), config)


BLOCK_AHEAD, BLOCK_BEYOND, BLOCK_ABOVE = (
    (Kind.BLOCK, cell) for cell in ((1, 1, 1), (2, 1, 1), (2, 1, 2))
)


def _pairs(log: ContactLog) -> dict[tuple[str, str], float]:
    return {(c.first, c.second): c.peak_n for c in log.contacts}


def test_what_stands_on_what_at_the_start_is_known_with_its_weight_though_all_of_it_sleeps():
    physics = _physics(BLOCK_BEYOND, BLOCK_ABOVE)
    assert physics.data.ncon == 0, "MuJoCo leaves out contacts of sleeping things"
    log = ContactLog(physics)
    block, car = BLOCK.mass_kg * GRAVITY, SMARTCAR.mass_kg * GRAVITY
    assert _pairs(log) == {
        ("ground", "car 0"): pytest.approx(car, rel=0.01),
        ("ground", "block 0"): pytest.approx(2 * block, rel=0.01),
        ("block 0", "block 1"): pytest.approx(block, rel=0.01),
    }
    assert all(contact.at_start for contact in log.contacts)
    assert log.peak_n == pytest.approx(car, rel=0.01)


def test_watching_leaves_the_simulation_as_it_is():
    ends = []
    for watched in (False, True):
        physics = _physics(BLOCK_AHEAD)
        executor = Executor(physics)
        log = ContactLog(physics) if watched else None
        if log is not None:
            executor.observers.append(log.sample)
        executor.run({0: Action.MOVE_RIGHT})
        if log is not None:
            log.begin()
        executor.run({0: Action.LIFT})
        ends.append(
            (
                physics.data.qpos.copy(),
                physics.data.qvel.copy(),
                physics.model.tree_sleep_policy.copy(),
            )
        )
    for alone, seen in zip(*ends, strict=True):
        np.testing.assert_array_equal(alone, seen)


def test_a_lift_touches_the_load_and_parts_it_from_the_ground():
    physics = _physics(BLOCK_AHEAD)
    executor = Executor(physics)
    executor.run({0: Action.MOVE_RIGHT})
    log = ContactLog(physics)
    executor.observers.append(log.sample)
    began_s = physics.time_s
    executor.run({0: Action.LIFT})
    (lift,) = [contact for contact in log.contacts if not contact.at_start]
    assert (lift.first, lift.second) == ("car 0", "block 0")
    assert lift.since_s > began_s
    assert lift.peak_n == pytest.approx(BLOCK.mass_kg * GRAVITY, rel=0.3)
    log.begin()
    assert ("ground", "block 0") not in _pairs(log)
    assert not log.hazards()
    assert not log.is_unsafe()


def test_a_car_that_runs_into_a_wall_presses_on_it():
    physics = _physics((Kind.WALL, (1, 1, 1)))
    log = ContactLog(physics)
    physics.drive(0, [10.0, 0.0, 0.0, 10.0])  # askew: between its legs a wall can be driven under
    for _ in range(40):
        physics.advance()
        log.sample()
    assert _pairs(log)["wall", "car 0"] > 20


AWAKE = SimulationConfig(sleep=False)


def _strike(physics: PhysicsWorld, log: ContactLog, force_n: float) -> None:
    """Strike a block down for one physics step of 4 ms, as a declared disturbance, and look as a judge does."""
    push = physics.data.xfrc_applied[physics.blocks[0].body]
    push[2] = -force_n

    def look() -> None:
        push[2] = 0.0
        log.look()

    physics.advance(look)
    log.sample()


def test_a_blow_that_is_over_within_a_control_period_is_seen():
    physics = _physics(BLOCK_BEYOND, config=AWAKE)
    log, periods = ContactLog(physics), ContactLog(physics)
    _strike(physics, log, 500.0)
    periods.sample()
    assert _pairs(log)["ground", "block 0"] == pytest.approx(
        500 + BLOCK.mass_kg * GRAVITY, rel=0.05
    )
    assert _pairs(periods)["ground", "block 0"] < 20, (
        "looked at from period to period it does not show"
    )


def test_a_force_that_nothing_here_could_have_produced_is_no_hazard_but_impossible():
    """A resting block of 0.5 kg presses with twice its weight at most; a disturbance knows no such limit."""
    physics = _physics(BLOCK_BEYOND, config=AWAKE)
    log = ContactLog(physics)
    _strike(physics, log, 20_000.0)
    (line,) = log.impossible
    assert line.startswith("ground and block 0 press on each other with 199")
    log.begin()
    assert log.impossible == ()


def test_the_weight_of_a_stack_at_rest_is_no_hit_and_a_blow_onto_it_is():
    heavy = replace(NOMINAL, block=replace(BLOCK, deck_mass_kg=40.0))
    stack = [(Kind.BLOCK, (2, 1, level)) for level in (1, 2, 3)]
    grid = draw((4, 3, 3), stack, [(0, 1, 1, 0)])
    physics = PhysicsWorld(grid, AWAKE, machines=heavy)
    log = ContactLog(physics)
    limit_n = impact_limit_n(heavy)
    weight_n = len(stack) * heavy.block.mass_kg * GRAVITY
    assert weight_n > limit_n
    _strike(physics, log, 100.0)
    assert log.peak_n == pytest.approx(weight_n + 100, rel=0.05)
    assert not log.hazards()
    assert not log.is_unsafe()
    _strike(physics, log, 1.2 * limit_n)
    assert log.is_unsafe()
    ((names, text),) = log.hazards()
    assert names == ("ground", "block 0")
    assert f"allowed {limit_n + weight_n:.0f}" in text


def test_a_hard_landing_is_a_hazard_and_not_impossible():
    """A car that is that lands at 1.5 m/s stops within some steps: 15 kg m/s in 12 ms are a kilonewton and more."""
    physics = _physics(config=AWAKE)
    log = ContactLog(physics)
    push = physics.data.xfrc_applied[physics.cars[0].base.body]
    for period in range(40):
        push[2] = 300.0 if period < 5 else 0.0  # a declared disturbance: somebody throws it up
        physics.advance(log.look)
        log.sample()
    assert log.fall_m_s > 1.5
    assert log.peak_n > 1000
    assert log.impossible == ()


def test_a_fall_and_a_tip_are_hazards_with_the_name_of_what_fell():
    physics = _physics(BLOCK_BEYOND, BLOCK_ABOVE)
    log = ContactLog(physics)
    top = physics.blocks[1]
    push = physics.data.xfrc_applied[top.body]
    for _ in range(100):
        # A declared disturbance: somebody shoves the upper block off.
        push[0] = 5.0 if physics.free_body_state(top)[0][0] < 3.2 * 0.3225 else 0.0
        physics.advance()
        log.sample()
    assert {machines for machines, _ in log.hazards()} == {("block 1",)}
    assert [text.split(" (")[0] for _, text in log.hazards()] == ["block 1 tipped", "block 1 fell"]
    assert log.is_unsafe()
    assert ("ground", "block 1") in _pairs(log)
    log.begin()
    assert log.fall_m_s == 0 == len(log.hazards())


def test_the_file_has_a_line_for_each_contact(tmp_path):
    log = ContactLog(_physics(BLOCK_BEYOND))
    log.write(tmp_path / "contacts.csv")
    with (tmp_path / "contacts.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(row["first"], row["second"], row["at_start"]) for row in rows] == [
        ("ground", "car 0", "True"),
        ("ground", "block 0", "True"),
    ]
    assert float(rows[1]["peak_n"]) == log.contacts[1].peak_n
