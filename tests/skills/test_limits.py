"""Each limit of motion binds where it should; paths of moves and turns, the board and hinges keep to theirs."""

import math
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from craftsim.compiled.jit import records
from craftsim.mjcf.machines import NOMINAL
from craftsim.mjcf.parameters import GRAVITY, SmartcarParameters
from craftsim.models.sensing import measurement_of
from craftsim.skills.gains import careful, load_gains
from craftsim.skills.laws import step_task
from craftsim.skills.limits import MOVE_LIMITS, TURN_LIMITS, Motion, binding_limits
from craftsim.skills.setup import SkillSetup, Terrain
from craftsim.skills.skill import begin_hinge, begin_lift, begin_move, begin_turn
from craftsim.skills.state import CAR

LOAD_KG = 4.0
FAR_M = 5.0
"""Length of a path on which every speed limit is reached."""
FLAT = Terrain()
SLOPE = Terrain(end_rad=0.28)
TIGHT = Terrain(tight=True)
TIGHT_SLOPE = Terrain(end_rad=0.28, tight=True)
FREE = {
    "max_speed": 0.80,
    "max_acceleration": 3.0,
    "max_slope_speed": 0.40,
    "max_slope_acceleration": 2.0,
    "max_tight_speed": 0.60,
    "max_tight_acceleration": 2.5,
    "max_tight_slope_acceleration": 1.0,
    "load_factor": 0.5,
    "max_turn_speed": 4.0,
    "max_turn_acceleration": 20.0,
}
SLOW = replace(NOMINAL.cars[0], wheel_speed_rad_s=10.0)
WEAK = replace(NOMINAL.cars[0], wheel_torque_nm=1.3, wheel_speed_rad_s=10.0)
MEDIUM = replace(NOMINAL.cars[0], wheel_torque_nm=1.67)


@dataclass
class Case:
    """A motion, and what limits its speed and its acceleration."""

    speed: tuple[str, float]
    acceleration: tuple[str, float]
    terrain: Terrain = FLAT
    loaded: bool = False
    uneven: bool = False
    direction: int = 0
    height_m: float = 0.0
    machine: SmartcarParameters = NOMINAL.cars[0]
    gains: dict = field(default_factory=dict)
    turning: bool = False


def _push_n(machine, incline_rad, mass_kg, n_wheels=4):
    """Return the force of wheels at 90 % of their sure torque, less gear friction and the weight on an incline."""
    torque_nm = 0.9 * 0.85 * machine.wheel_torque_nm - machine.gear_friction_nm
    return n_wheels * torque_nm / machine.wheel_radius_m - mass_kg * GRAVITY * math.sin(incline_rad)


WEAK_M_S = 0.9 * WEAK.wheel_speed_rad_s * WEAK.wheel_radius_m
LOADED_KG = WEAK.mass_kg + LOAD_KG
CLIMB_M_S2 = _push_n(WEAK, 0.28, LOADED_KG) / (LOADED_KG + WEAK.spin_mass_kg)
CHASSIS_KGM2 = WEAK.chassis_mass_kg * (WEAK.chassis_length_m**2 + WEAK.chassis_width_m**2) / 12
WHEELS_KGM2 = 4 * WEAK.wheel_mass_kg * (WEAK.wheel_x_m**2 + WEAK.wheel_y_m**2)
LEVER_M = WEAK.wheel_x_m + WEAK.wheel_y_m
TURN_KGM2 = CHASSIS_KGM2 + WHEELS_KGM2 + WEAK.spin_mass_kg * LEVER_M**2
CREST_M_S = math.sqrt(2 * _push_n(MEDIUM, 0.28, MEDIUM.mass_kg, 2) / MEDIUM.mass_kg * 0.12)
MEDIUM_M_S2 = _push_n(MEDIUM, 0.28, MEDIUM.mass_kg) / (MEDIUM.mass_kg + MEDIUM.spin_mass_kg)
QUICK = {"max_turn_speed": 8.0, "max_turn_acceleration": 80.0}

CASES = {
    "on the flat": Case(("ground_limit", 0.80), ("ground_limit", 3.0)),
    "on the flat with a load": Case(("ground_limit", 0.40), ("ground_limit", 1.5), loaded=True),
    "on a slope": Case(("ground_limit", 0.40), ("ground_limit", 2.0), SLOPE),
    "down a slope": Case(("ground_limit", 0.40), ("ground_limit", 2.0), Terrain(start_rad=-0.28)),
    "under something": Case(("tight_limit", 0.60), ("tight_limit", 2.5), TIGHT),
    "past something": Case(("tight_limit", 0.30), ("tight_limit", 1.25), TIGHT, loaded=True),
    "empty under something on a slope": Case(
        ("ground_limit", 0.40), ("ground_limit", 2.0), TIGHT_SLOPE
    ),
    "past something on a slope": Case(
        ("ground_limit", 0.20), ("tight_slope_limit", 0.5), TIGHT_SLOPE, loaded=True
    ),
    "to a side where the floor is uneven": Case(
        ("sideways_limit", 0.35), ("ground_limit", 3.0), uneven=True, direction=1
    ),
    "to a side with a load where the floor is uneven": Case(
        ("sideways_limit", 0.175), ("ground_limit", 1.5), uneven=True, direction=3, loaded=True
    ),
    "to a side where the floor is even": Case(
        ("ground_limit", 0.80), ("ground_limit", 3.0), direction=1
    ),
    "forward where the floor is uneven": Case(
        ("ground_limit", 0.80), ("ground_limit", 3.0), uneven=True
    ),
    "with slow motors": Case(("motor_limit", WEAK_M_S), ("ground_limit", 3.0), machine=SLOW),
    "up with a load and weak motors": Case(
        ("crest_limit", 0.28),
        ("motor_limit", CLIMB_M_S2),
        SLOPE,
        loaded=True,
        machine=WEAK,
        gains={"load_factor": 1.0, "max_slope_acceleration": 6.0},
    ),
    "up with motors of medium strength": Case(
        ("crest_limit", CREST_M_S), ("motor_limit", MEDIUM_M_S2), SLOPE, machine=MEDIUM
    ),
    "on a stack": Case(("ground_limit", 0.80), ("rocking_limit", 0.11 / 0.64**2), height_m=0.64),
    "a turn": Case(("turn_limit", 4.0), ("turn_limit", 20.0), turning=True),
    "a turn with a load": Case(
        ("turn_limit", 2.0), ("turn_limit", 10.0), loaded=True, turning=True
    ),
    "a turn with weak motors": Case(
        ("turn_motor_limit", WEAK_M_S / LEVER_M),
        ("turn_motor_limit", _push_n(WEAK, 0.0, WEAK.mass_kg) * LEVER_M / TURN_KGM2),
        machine=WEAK,
        gains=QUICK,
        turning=True,
    ),
}


def _begin(case):
    """Return the setup and the measurement of a case, and the profile of its path."""
    gains = load_gains()
    drive = replace(gains.drive, **(FREE | case.gains))
    if case.uneven:
        drive = replace(drive, astray=careful(gains).drive.astray)
    setup = SkillSetup(case.machine, NOMINAL, replace(gains, drive=drive), 0.02, case.terrain)
    car = records(1, CAR)[0]
    reading = car["now"]
    reading["z"] = case.height_m
    if case.loaded:
        reading["board_m"] = setup.machine.board_travel_m
        reading["board_force_n"] = LOAD_KG * GRAVITY
    measurement = measurement_of(reading)
    if case.turning:
        begin_turn(setup, measurement, car["task"], 2, target=(0.0, 0.0, 3.0))
    else:
        begin_move(setup, measurement, car["task"], case.direction, target=(FAR_M, 0.0, 0.0))
    return setup, measurement, car["task"]["drive"]["profile"]


@pytest.mark.parametrize("name", CASES)
def test_a_path_keeps_to_the_lowest_limit_of_speed_and_of_acceleration(name):
    case = CASES[name]
    _, _, profile = _begin(case)
    # Ramps follow a cubic, whose steepest slope is 3/2 of the mean.
    assert 1.5 * profile["cruise_speed"] / profile["ramp_s"] == pytest.approx(case.acceleration[1])
    if not case.turning or case.machine is not WEAK:
        assert profile["cruise_speed"] == pytest.approx(case.speed[1])


@pytest.mark.parametrize("name", CASES)
def test_the_cause_that_binds_is_named(name):
    case = CASES[name]
    setup, measurement, _ = _begin(case)
    if case.turning:
        functions = TURN_LIMITS
    else:
        functions = MOVE_LIMITS
    limits = binding_limits(
        Motion.of(setup, measurement, sideways=case.direction in (1, 3)), functions
    )
    assert (limits.speed_cause, limits.speed) == (case.speed[0], pytest.approx(case.speed[1]))
    assert (limits.acceleration_cause, limits.acceleration) == (
        case.acceleration[0],
        pytest.approx(case.acceleration[1]),
    )


def test_every_limit_binds_somewhere():
    causes = {case.speed[0] for case in CASES.values()} | {
        case.acceleration[0] for case in CASES.values()
    }
    assert causes == {function.__name__ for function in (*MOVE_LIMITS, *TURN_LIMITS)}


@pytest.mark.parametrize("terrain", [FLAT, SLOPE, TIGHT_SLOPE])
@pytest.mark.parametrize("load_kg", [0.0, NOMINAL.slope.mass_kg])
def test_neither_crests_nor_motors_limit_the_nominal_car(terrain, load_kg):
    setup = SkillSetup(NOMINAL.cars[0], NOMINAL, load_gains(), 0.02, terrain)
    limits = binding_limits(Motion(setup, load_kg > 0, load_kg, 0.0), MOVE_LIMITS)
    assert limits.speed_cause not in ("crest_limit", "motor_limit")
    assert limits.acceleration_cause != "motor_limit"


def test_motors_that_cannot_climb_still_move_a_car_slowly():
    case = Case(("", 0), ("", 0), SLOPE, loaded=True, machine=replace(WEAK, wheel_torque_nm=0.8))
    _, _, profile = _begin(case)
    assert 1.5 * profile["cruise_speed"] / profile["ramp_s"] == pytest.approx(
        1.0 / (LOADED_KG + WEAK.spin_mass_kg)
    )


PERIOD_S = 0.02
JOINTS = {
    "board": (begin_lift, NOMINAL.cars[0].board_speed_m_s, load_gains().board.acceleration),
    "hinge": (
        lambda *arguments: begin_hinge(*arguments, folds=True),
        NOMINAL.slope.hinge_speed_rad_s,
        load_gains().hinge.acceleration,
    ),
}
"""By motor: what commands it, and the limits of its speed and acceleration."""


@pytest.mark.parametrize("motor", JOINTS)
def test_a_joint_speeds_up_by_its_acceleration_to_the_speed_of_its_motor(motor):
    begin, speed, acceleration = JOINTS[motor]
    setup = SkillSetup(NOMINAL.cars[0], NOMINAL, load_gains(), PERIOD_S, FLAT)
    cars = records(1, CAR)
    cars["known"] = setup.constants
    car = cars[0]
    reading = car["now"]
    begin(setup, measurement_of(reading), car["task"])
    past_angles = np.zeros(4)
    speeds = []
    for _ in range(40):
        step_task(car, past_angles)
        speeds.append(float(car["command"][motor]))
        reading["board_m" if motor == "board" else "hinge_rad"] += PERIOD_S * speeds[-1]
    expected = np.minimum(speed, acceleration * PERIOD_S * np.arange(1, 41))
    np.testing.assert_allclose(speeds, expected)
