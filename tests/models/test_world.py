"""A PhysicsWorld is saved, restored, reset and stepped to the bit; its parts sleep and wake."""

import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from discrete.drawn import draw
from numpy.typing import NDArray

import craftsim
from craftsim.audit.audit import AuditTrial, run_trial
from craftsim.audit.situation import Row, Situation
from craftsim.checking.setup import Setup, set_up
from craftsim.discrete.files.blueprint import blueprint_text
from craftsim.discrete.grid import Grid, Kind
from craftsim.discrete.kinds import Action
from craftsim.errors import InputError, StartError
from craftsim.mjcf.drives import DRIVES
from craftsim.mjcf.machines import NOMINAL, Machines
from craftsim.models import stepping
from craftsim.models.config import SimulationConfig
from craftsim.models.world import PhysicsWorld

BLOCK, FSLOPE, BODY = Kind.BLOCK, Kind.FSLOPE, Kind.BODY


def busy_world() -> Grid:
    return draw(
        (6, 5, 3),
        [
            (BLOCK, (0, 2, 1), 0),
            (BODY, (1, 2, 1), 0),
            (BLOCK, (4, 4, 1), 0),
            (FSLOPE, (4, 0, 1), 2),
        ],
        [(2, 2, 1, 2, BLOCK, 0, 1), (4, 4, 1, 0, 0, 0, 0), (5, 2, 1, 1, 0, 0, 0)],
    )


def drive_randomly(physics: PhysicsWorld, seed: int, periods: int) -> list[NDArray[np.float64]]:
    """Command now one machine, now another, some of them asleep by then; return the state after every period."""
    rng, states = np.random.default_rng(seed), []
    for i in range(periods):
        if i % 20 == 0:
            for car in range(len(physics.cars)):
                physics.drive(car, rng.uniform(-3, 3, 4) * rng.integers(2))
                physics.move_board(car, 0.05 * rng.integers(-1, 2))
            for slope in range(len(physics.slopes)):
                physics.turn_hinge(slope, 0.3 * rng.integers(-1, 2))
        physics.advance()
        states.append(
            np.concatenate(
                [physics.data.qpos, physics.data.qvel, physics.data.act, [physics.time_s]]
            )
        )
    return states


@pytest.mark.parametrize(("sleep", "drive"), [(True, "rollers"), (False, "wheels")])
def test_a_restored_or_reset_world_goes_on_to_the_bit(sleep, drive):
    """In the same PhysicsWorld after a detour, and in another one of an equal grid."""
    config, machines = SimulationConfig(sleep=sleep), replace(NOMINAL, drive=drive)
    physics, other = (PhysicsWorld(busy_world(), config, machines=machines) for _ in range(2))
    begun = drive_randomly(physics, 1, 50)
    saved = physics.save()
    first = drive_randomly(physics, 2, 50)
    drive_randomly(other, 4, 15)
    for restored in (physics, other):
        restored.restore(saved)
        again = drive_randomly(restored, 2, 50)
        assert [state.tobytes() for state in again] == [state.tobytes() for state in first]
    physics.reset()
    assert [s.tobytes() for s in drive_randomly(physics, 1, 50)] == [s.tobytes() for s in begun]


def test_a_state_of_another_world_is_refused():
    saved = PhysicsWorld(draw((3, 3, 1), [(BLOCK, (1, 1, 1), 0)])).save()
    with pytest.raises(InputError, match="other parts"):
        PhysicsWorld(draw((3, 3, 1))).restore(saved)


def sleeper(**settings: float) -> PhysicsWorld:
    """Return a car that has rested for 2 s beside a folded slope."""
    grid = draw((5, 4, 2), [(FSLOPE, (2, 2, 1), 0)], [(0, 0, 1, 0, 0, 0, 0)])
    physics = PhysicsWorld(grid, SimulationConfig(**settings))
    for _ in range(100):
        physics.advance()
    return physics


@pytest.mark.parametrize("drive", ["wheels", "board", "hinge"])
def test_a_command_wakes_what_sleeps(drive):
    physics = sleeper()
    tree = (physics.slopes if drive == "hinge" else physics.cars)[0].base.tree
    assert physics.data.tree_asleep[tree] >= 0
    before = physics.data.qpos.copy()
    {
        "wheels": lambda: physics.drive(0, [5.0] * 4),
        "board": lambda: physics.move_board(0, 0.05),
        "hinge": lambda: physics.turn_hinge(0, -0.3),
    }[drive]()
    physics.advance()
    assert physics.data.tree_asleep[tree] < 0
    for _ in range(24):
        physics.advance()
    assert np.abs(physics.data.qpos - before).max() > 0.01


def test_a_woken_car_drives_as_one_that_never_slept():
    """Half a second at 5 rad/s: within 0.1 mm of the same drive with sleep off."""
    ends = []
    for sleep in (True, False):
        physics = sleeper(sleep=sleep)
        physics.drive(0, [5.0] * 4)
        for _ in range(25):
            physics.advance()
        ends.append(physics.free_body_state(physics.cars[0].base)[0])
    assert np.linalg.norm(ends[0] - ends[1]) < 1e-4


def test_a_setting_that_cannot_work_is_refused_by_name():
    for field, values in {
        "timestep_s": (0.0, -0.004, math.nan, math.inf, 0.01),
        "control_period_s": (0.0, 0.021, 0.002, math.nan, math.inf),
        "friction_impedance_ratio": (0.0, math.nan, math.inf),
        "sleep_tolerance_m_s": (0.0, math.nan),
        "settle_s": (-0.1, math.nan, math.inf),
    }.items():
        for value in values:
            with pytest.raises(InputError, match=rf"SimulationConfig(\.|: ){field}"):
                SimulationConfig(**{field: value})


def test_a_world_that_is_too_large_for_physics_or_has_two_cars_in_a_cell_is_refused_at_once():
    grid = Grid.empty((12, 12, 1), 129)
    grid.cars[:, 0] = np.arange(129) % 12
    grid.cars[:, 1] = np.arange(129) // 12
    grid.cars[:, 2] = 1
    with pytest.raises(
        InputError, match="of 129 cars: too large for physics; allowed: at most 128"
    ):
        PhysicsWorld(grid)
    with pytest.raises(InputError, match="made of a Grid, not of a str"):
        PhysicsWorld("strip")
    grid = Grid.empty((40, 30, 1), 2)
    grid.cars[:, :3] = [[0, 0, 1], [1, 0, 1]]
    grid.kind.reshape(-1, 2)[60 : 60 + 1022, 1] = Kind.WALL
    grid.cars[0, 4] = Kind.BLOCK
    with pytest.raises(InputError, match="a world of 1025 parts"):
        PhysicsWorld(grid)
    grid.cars[0, :3] = grid.cars[1, :3]
    grid.kind[:, :, 1] = Kind.AIR
    with pytest.raises(StartError, match=r"2 cars are in one cell, \(1, 0, 1\)"):
        PhysicsWorld(grid)


def test_warnings_of_mujoco_are_counted_but_leave_no_log_in_the_working_folder(
    tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    physics = PhysicsWorld(Grid.empty((1, 1, 1), n_cars=1))
    physics.data.qpos[0] = np.nan
    physics.advance()
    assert physics.diverged
    assert list(tmp_path.iterdir()) == []


def _world() -> PhysicsWorld:
    return PhysicsWorld(Grid.empty((2, 1, 1), n_cars=1), SimulationConfig(sleep=False))


@pytest.mark.parametrize("drive", DRIVES)
def test_many_are_those_of_the_bindings_one_after_the_other(drive):
    grid, config = Grid.empty((3, 1, 1), n_cars=1), replace(SimulationConfig(), sleep=False)
    many, single = (PhysicsWorld(grid, config, machines=Machines(drive=drive)) for _ in range(2))
    for world in (many, single):
        world.drive(0, [5.0, 4.0, 5.0, 4.0])
    many.run(200)
    for _ in range(200):
        mujoco.mj_step(single.model, single.data)
        for effect in single.effects:
            effect.after_step(single)
    assert abs(many.data.qpos - many.model.qpos0).max() > 0.01
    np.testing.assert_array_equal(many.data.qpos, single.data.qpos)
    np.testing.assert_array_equal(many.data.qvel, single.data.qvel)


def test_without_batches_the_steps_are_the_same(monkeypatch):
    """As before MuJoCo 3.17."""
    grid, machines = Grid.empty((3, 1, 1), n_cars=1), Machines(drive="wheels")
    compiled = PhysicsWorld(grid, machines=machines)
    monkeypatch.setattr(stepping, "_HAS_BATCHES", False)
    plain = PhysicsWorld(grid, machines=machines)
    for world in (compiled, plain):
        world.drive(0, [5.0, 4.0, 5.0, 4.0])
        world.run(100)
    np.testing.assert_array_equal(compiled.data.qpos, plain.data.qpos)
    assert compiled.capped_steps == plain.capped_steps


def test_an_error_in_a_step_is_an_exception_and_the_world_can_go_on():
    physics = _world()
    integrator, physics.model.opt.integrator = physics.model.opt.integrator, 99
    with pytest.raises(mujoco.FatalError, match="integrator"):
        physics.run(3)
    physics.model.opt.integrator = integrator
    before = physics.time_s
    physics.run(2)
    assert physics.time_s == pytest.approx(before + 2 * physics.config.timestep_s)


IN_THE_GEAR = draw((5, 3, 2), [(Kind.FSLOPE, (2, 1, 1), 2)], [(1, 1, 1, 0, Kind.BLOCK, 0, 0)])
"""A carried block where a folded slope has its gear."""

BESIDE = draw((5, 3, 2), [(Kind.FSLOPE, (2, 1, 1), 2)], [(0, 1, 1, 0, Kind.BLOCK, 0, 0)])


def test_a_start_names_what_stands_in_what_and_how_deep():
    (overlap,) = PhysicsWorld(IN_THE_GEAR).overlaps
    assert overlap.startswith("block 0 and slope 0 stand ")
    assert float(overlap.split()[6]) == pytest.approx(16, abs=1)
    assert PhysicsWorld(BESIDE).overlaps == ()


def test_no_judge_takes_such_a_world(tmp_path):
    with pytest.raises(
        StartError, match=r"block 0 and slope 0 stand 16\.\d mm in each other \(allowed 1 mm\)"
    ):
        set_up(IN_THE_GEAR, Setup())
    with pytest.raises(StartError):
        craftsim.perform(PhysicsWorld(IN_THE_GEAR), 0, "DROP")
    world = tmp_path / "world.yaml"
    world.write_text(blueprint_text(IN_THE_GEAR), encoding="utf-8")
    (tmp_path / "its.actions").write_text("0 DROP\n", encoding="utf-8")
    with pytest.raises(StartError):
        craftsim.validate(world, actions=tmp_path / "its.actions")


def test_an_audit_tries_nothing_there_and_says_why():
    scene = Situation(Row("DROP", scene="in the gear"), IN_THE_GEAR, (Action.DROP,))
    done = run_trial(AuditTrial(scene, True, 0, 0, Setup()))
    assert not done.attempts
    assert "block 0 and slope 0 stand" in done.extra["does_not_stand"][0]
