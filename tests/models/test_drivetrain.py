"""Motors, gears and batteries lack what is declared, measured on a car that drives; a state holds where gears play."""

from dataclasses import replace

import numpy as np
import pytest

from craftsim.checking.setup import compile_world, set_up, setup_of
from craftsim.discrete.grid import Grid
from craftsim.discrete.kinds import Action
from craftsim.mjcf.drives import DRIVES
from craftsim.mjcf.machines import NOMINAL
from craftsim.models.effects import IDEAL, Drivetrain
from craftsim.models.randomization import NONE
from craftsim.models.world import PhysicsWorld

CAR = NOMINAL.cars[0]
MOST_NM, TOP_RAD_S = CAR.wheel_torque_nm, CAR.wheel_speed_rad_s
GRID = Grid.empty((6, 1, 1), 1)
EVERYTHING = Drivetrain(0.3, 0.1, 0.005, 0.1)


def _physics(drivetrain: Drivetrain, drive: str = "rollers") -> PhysicsWorld:
    physics = PhysicsWorld(GRID, machines=replace(NOMINAL, drive=drive))
    physics.set_drivetrain(drivetrain)
    return physics


def _driven(physics: PhysicsWorld, wheels: float, periods: int) -> tuple[np.ndarray, np.ndarray]:
    """Drive all wheels alike; return speeds and torques of one after each physics step."""
    motor, rows = physics.cars[0].wheel_actuators[0], []
    for _ in range(periods):
        physics.drive(0, [wheels] * 4)
        physics.advance(
            lambda: rows.append(
                (physics.data.actuator_velocity[motor], physics.data.actuator_force[motor])
            )
        )
    speeds, torques = np.array(rows).T
    return speeds, torques


def test_the_most_torque_of_a_motor_falls_with_its_speed_along_the_declared_line_but_when_it_brakes():
    physics = _physics(Drivetrain(torque_slope=0.4))
    speeds, torques = _driven(physics, TOP_RAD_S, 20)
    line = MOST_NM * (1 - 0.4 * speeds[:-1] / TOP_RAD_S)  # as of the step before
    saturated = speeds[1:] < 0.8 * TOP_RAD_S
    assert saturated.sum() > 10
    np.testing.assert_allclose(torques[1:][saturated], line[saturated], rtol=1e-9)
    assert _driven(physics, -TOP_RAD_S, 2)[1].min() == -MOST_NM


def test_a_battery_sags_and_a_gear_takes_a_share_by_as_much_as_declared():
    _, torques = _driven(_physics(Drivetrain(sag=0.25)), TOP_RAD_S, 4)
    # All motors give T = T_most (1 - sag T / T_most).
    assert torques[4:].mean() == pytest.approx(MOST_NM / 1.25, rel=0.01)
    physics = _physics(Drivetrain(gear_loss=0.2))
    assert _driven(physics, TOP_RAD_S, 20)[1][2:10].max() == pytest.approx(0.8 * MOST_NM, rel=1e-9)
    assert _driven(physics, -TOP_RAD_S, 2)[1].min() == pytest.approx(-1.2 * MOST_NM, rel=1e-9), (
        "it brakes, too"
    )


@pytest.mark.parametrize("drive", DRIVES)
def test_a_parked_car_rolls_through_the_play_of_its_gears_and_no_further(drive):
    """Band: 2 mrad and a tenth, one step at the speed that the car has by then; bristles give way without play too."""
    ways = []
    for backlash in (0.0, 0.02):
        physics = _physics(Drivetrain(gear_loss=0.01, backlash_rad=backlash), drive)
        physics.config = replace(physics.config, sleep=False)
        physics.model.opt.enableflags = 0
        places = [physics.data.qpos[0]]
        # Tilted by 3 degrees, first one way, then the other; gravity turns instead.
        for tilt in (0.05, -0.05):
            physics.model.opt.gravity[:2] = 9.81 * tilt, 0.0
            for _ in range(30):
                physics.advance()
            places.append(physics.data.qpos[0])
        ways.append(np.diff(places))
    free = (ways[1] - ways[0]) / CAR.wheel_radius_m
    np.testing.assert_allclose(free, (0.01, -0.02), atol=0.002, rtol=0.1)


@pytest.mark.parametrize("drive", DRIVES)
def test_a_restored_site_goes_on_to_the_bit(drive):
    physics, other = _physics(EVERYTHING, drive), _physics(EVERYTHING, drive)

    def go_on(physics: PhysicsWorld) -> np.ndarray:
        rows = []
        for wheels in np.repeat([8.0, -3.0, 0.0, 5.0], 5):
            physics.drive(0, [wheels] * 4)
            physics.advance()
            rows.append(physics.data.qpos.copy())
        return np.array(rows)

    go_on(physics)
    saved = physics.save()
    first = go_on(physics)
    for restored in (physics, other):
        restored.restore(saved)
        np.testing.assert_array_equal(go_on(restored), first)
    physics.reset()
    once = go_on(physics)
    physics.reset()
    np.testing.assert_array_equal(go_on(physics), once)


@pytest.mark.parametrize("drive", DRIVES)
def test_a_world_that_is_used_again_is_as_a_fresh_one_whatever_its_drivetrain_was(drive):
    def end(drivetrain, reuse):
        setup = setup_of("none", drive=drive)
        setup = replace(setup, randomization=replace(NONE, drivetrain=drivetrain))
        judge = set_up(GRID, setup, reuse=reuse)
        judge.perform(0, Action.MOVE_RIGHT)
        return judge.physics.data.qpos.copy()

    world = compile_world(GRID, setup_of("none", drive=drive))
    ideal = end(IDEAL, None)
    assert (end(EVERYTHING, world) != ideal).any()
    np.testing.assert_array_equal(end(IDEAL, world), ideal)
    np.testing.assert_array_equal(end(EVERYTHING, world), end(EVERYTHING, None))
