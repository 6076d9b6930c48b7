"""A PhysicsWorld can be saved, restored and reset to the bit; its parts sleep and wake; its settings are checked."""

import math
from dataclasses import replace

import numpy as np
import pytest
from drawn import draw
from numpy.typing import NDArray

from craftsim.discrete.grid import Grid, Kind
from craftsim.errors import InputError, StartError
from craftsim.mjcf.parameters import NOMINAL
from craftsim.models.config import SimulationConfig
from craftsim.models.world import PhysicsWorld

BLOCK, FSLOPE, BODY = Kind.BLOCK, Kind.FSLOPE, Kind.BODY


def busy_world() -> Grid:
    return draw(
        (6, 5, 3),
        [(BLOCK, (0, 2, 1), 0), (BODY, (1, 2, 1), 0), (BLOCK, (4, 4, 1), 0), (FSLOPE, (4, 0, 1), 2)],
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
            np.concatenate([physics.data.qpos, physics.data.qvel, physics.data.act, [physics.time_s]])
        )
    return states


@pytest.mark.parametrize(("sleep", "drive"), [(True, "rollers"), (False, "reduced")])
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
    for size, n_cars, message in (
        ((30, 30, 10), 1, "a world of 9000 cells: too large for physics; allowed: at most 8192"),
        ((6, 6, 1), 33, "a world of 33 cars: too large for physics; allowed: at most 32"),
    ):
        grid = Grid.empty(size, n_cars)
        grid.cars[:, 0], grid.cars[:, 1], grid.cars[:, 2] = np.arange(n_cars) % 6, np.arange(n_cars) // 6, 1
        with pytest.raises(InputError, match=message):
            PhysicsWorld(grid)
    grid = Grid.empty((16, 14, 1), 2)
    grid.cars[:, :3] = [[0, 0, 1], [1, 0, 1]]
    grid.kind.reshape(-1, 2)[28 : 28 + 190, 1] = Kind.WALL
    grid.cars[0, 4] = Kind.BLOCK
    with pytest.raises(InputError, match="a world of 193 parts"):
        PhysicsWorld(grid)
    grid.cars[0, :3] = grid.cars[1, :3]
    grid.kind[:, :, 1] = Kind.AIR
    with pytest.raises(StartError, match=r"2 cars are in one cell, \(1, 0, 1\)"):
        PhysicsWorld(grid)


def test_warnings_of_mujoco_are_counted_but_leave_no_log_in_the_working_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    physics = PhysicsWorld(Grid.empty((1, 1, 1), n_cars=1))
    physics.data.qpos[0] = np.nan
    physics.advance()
    assert physics.diverged
    assert list(tmp_path.iterdir()) == []
