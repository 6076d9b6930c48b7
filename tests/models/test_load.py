"""A load stands on the board by friction alone; the boss under it stops what slides, and centres what is lifted.

The boss has 0.1 mm of play on each side in the pocket. What is said of friction is tested with its contact taken away.
"""

import math
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from craftsim.discrete.geometry import CELL_PITCH_M, INCLINE_RAD
from craftsim.discrete.grid import Grid, Kind
from craftsim.discrete.kernel.rotation import body_axes
from craftsim.discrete.kinds import Action
from craftsim.discrete.schedule import incline_under
from craftsim.mjcf.machines import NOMINAL
from craftsim.models.config import SimulationConfig
from craftsim.models.world import PhysicsWorld
from craftsim.skills.executor import Executor
from craftsim.skills.setup import Terrain

BLOCK, SMARTCAR = NOMINAL.block, NOMINAL.cars[0]
PLAY_M = (BLOCK.pocket_side_m - SMARTCAR.boss_side_m) / 2
STILL_M = 1e-4
"""A load that has moved less than this has not slipped."""
STOPPED_M = PLAY_M + 1e-4
"""Where the boss stops a load, 0.1 mm of contact and bevel included."""
GRAVITY = 9.81


def place(physics: PhysicsWorld) -> NDArray[np.float64]:
    """Return the first block's place in the first car's frame, shape (3,), in metres."""
    car, quaternion = physics.free_body_state(physics.cars[0].base)
    block, _ = physics.free_body_state(physics.blocks[0])
    return np.array(body_axes(*quaternion.tolist())) @ (block - car)


def set_board_friction(physics: PhysicsWorld, mu: float) -> None:
    """Give both sides of the contact, board with boss and the load, one coefficient."""
    for geom in range(physics.model.ngeom):
        name = physics.model.geom(geom).name
        if name in ("car0/plate", "car0/boss") or name.startswith("block0/"):
            physics.model.geom_friction[geom, 0] = mu


def take_boss_away(physics: PhysicsWorld) -> None:
    """Let nothing but friction hold the load."""
    boss = physics.model.geom("car0/boss").id
    physics.model.geom_contype[boss] = physics.model.geom_conaffinity[boss] = 0


def ride(physics: PhysicsWorld, grid: Grid, after: Grid) -> NDArray[np.float64]:
    """Drive uphill by one cell; return the load's place (n, 3) at every control period."""
    places: list[NDArray[np.float64]] = []
    ground = Terrain(incline_under(grid, grid.cars[0]), incline_under(grid, after.cars[0]))
    executor = Executor(physics, observer=lambda physics: places.append(place(physics)))
    outcome = executor.run({0: Action.MOVE_LEFT}, {0: ground})[0]
    assert outcome.succeeded, str(outcome)
    return np.array(places)


def test_a_load_rides_up_the_incline_without_slipping(ramp):
    """From the lower half to the upper: 0.34 m at 16 degrees; friction is 0.8 where tan(16 deg) = 0.287 would do."""
    grid = ramp(1, Kind.BLOCK)
    physics = PhysicsWorld(grid)
    take_boss_away(physics)
    start = place(physics)
    places = ride(physics, grid, ramp(2, Kind.BLOCK))
    assert np.abs(places - start)[:, :2].max() < 1.5e-4
    assert physics.free_body_state(physics.cars[0].base)[0][2] > 0.13


def test_a_load_does_not_slip_when_the_car_sets_off_on_the_flat(ramp):
    """Up to the edge of the flap, which the front wheels reach 0.1 m before the cell's border."""
    grid = ramp(0, Kind.BLOCK)
    physics = PhysicsWorld(grid)
    take_boss_away(physics)
    start, x = place(physics), []
    executor = Executor(
        physics, observer=lambda s: x.append((s.data.qpos[s.cars[0].base.qpos], *place(s)))
    )
    executor.run({0: Action.MOVE_LEFT}, {0: Terrain(0.0, INCLINE_RAD)})
    track = np.array(x)
    edge = 4 * CELL_PITCH_M + SMARTCAR.wheel_x_m + 0.02
    flat = track[track[:, 0] > edge]
    assert len(flat) > 10
    assert np.abs(flat[:, 1:3] - start[:2]).max() < STILL_M


def test_the_boss_holds_a_load_over_the_bends(ramp):
    """Where the ground bends the board tips under the load while the car drives, and the load shifts, to the boss."""
    stages = [ramp(state, Kind.BLOCK) for state in range(4)]
    physics = PhysicsWorld(stages[0])
    start = place(physics)
    places = [ride(physics, *pair) for pair in pairwise(stages)]
    moved = np.abs(np.concatenate(places) - start)
    assert moved[:, 0].max() < STOPPED_M
    assert moved[:, 1].max() < STILL_M
    assert physics.free_body_state(physics.cars[0].base)[0][2] == pytest.approx(0.185, abs=1e-3)


def test_on_a_smoother_board_than_statics_asks_the_load_slips_to_the_boss(ramp):
    """Friction of 0.25, below tan(16 deg) = 0.287: parked on the slope the load slides back until the boss stops it.

    And there it stays while the car climbs on.
    """
    grid = ramp(1, Kind.BLOCK)
    physics = PhysicsWorld(grid, SimulationConfig(sleep=False))
    set_board_friction(physics, 0.25)
    for _ in range(50):
        physics.advance()
    assert -STOPPED_M < place(physics)[0] < -0.8 * PLAY_M
    places = ride(physics, grid, ramp(2, Kind.BLOCK))
    assert np.abs(places[:, 0]).max() < STOPPED_M
    assert places[-1, 0] < -0.8 * PLAY_M


@pytest.mark.parametrize("mu", [0.25, 0.4])
def test_without_the_boss_a_load_slides_at_the_friction_angle(threshold, mu):
    """Coulomb: on a board tilted by atan(mu). Band: 2 %.

    The wheels are braked. A load slides when it has gone 5 mm in a second, which
    1 % of excess makes it do; short of that it creeps by some tenths of a millimetre.
    """
    grid = Grid.empty((3, 3, 2), 1)
    grid.cars[0] = 1, 1, 1, 0, Kind.BLOCK, 0, 0
    physics = PhysicsWorld(grid, SimulationConfig(sleep=False))
    set_board_friction(physics, mu)
    take_boss_away(physics)
    physics.model.dof_frictionloss[physics.cars[0].wheel_dofs] = 50.0
    start = physics.save()
    before = place(physics)

    def slides(angle: float) -> bool:
        physics.restore(start)
        physics.model.opt.gravity[:] = -GRAVITY * math.sin(angle), 0.0, -GRAVITY * math.cos(angle)
        for _ in range(50):
            physics.advance()
        return (place(physics) - before)[0] < -0.005

    assert threshold(slides, 0.1, 0.6) == pytest.approx(math.atan(mu), rel=0.02)


def test_the_boss_centres_a_load():
    """A block that stands up to 3 mm beside the car's middle is centred by the bevel to the boss' play."""
    for offset_mm in ((-3.0, 0.0), (0.0, 3.0), (3.0, 3.0)):
        grid = Grid.empty((3, 3, 2), 1)
        grid.cars[0] = 1, 1, 1, 0, Kind.AIR, 0, 0
        grid.kind[1, 1, 1] = Kind.BLOCK
        physics = PhysicsWorld(grid)
        address = physics.blocks[0].qpos
        physics.data.qpos[address : address + 2] += 1e-3 * np.array(offset_mm)
        outcome = Executor(physics).run({0: Action.LIFT})[0]
        assert outcome.succeeded
        assert np.abs(place(physics)[:2]).max() < STOPPED_M
        assert place(physics)[2] > 0.03
