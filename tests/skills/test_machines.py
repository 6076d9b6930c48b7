"""Cars of other mass, torque and servos act as predicted: gains and limits follow from the machine."""

from dataclasses import replace
from pathlib import Path

import pytest

import craftsim
from craftsim.checking.recipe import Recipe, Step, perform_step, run_up
from craftsim.checking.setup import Seed, setup_of
from craftsim.errors import InputError
from craftsim.mjcf.machines import NOMINAL
from craftsim.skills.gains import FOLLOWING, SECTIONS, gains_of_car, load_gains

EXAMPLES = Path(__file__).parents[2] / "examples"
CAR = NOMINAL.cars[0]
GAP_M = 0.0025
"""Between two neighbours."""
CREST = """
area_length: 1
area_width: 5
area_height: 3
block_num: 1
slope_num: 1
smartcar_num: 1
block: [{id: 0, x: 0, y: 1, z: 1}]
unfold_slope: [{id: 0, x: 0, y: 2, z: 1, yaw: 1}]
flag: [{id: 0, x: 0, y: 1, z: 2}]
smartcar: [{id: 0, x: 0, y: 2, z: 2, yaw: 3, slope: 2}]
goal: [{id: 0, x: -1, y: -2, z: 1}]
"""


def test_the_nominal_car_has_the_nominal_gains():
    gains = load_gains()
    assert gains_of_car(gains, CAR, NOMINAL) is gains


@pytest.mark.parametrize(
    ("gain", "car", "factor"),
    [
        (("drive", "friction_speed"), {"wheel_gain_nms_rad": 1.0}, 4.0),
        (("drive", "friction_speed"), {"gear_friction_nm": 0.9}, 2.0),
        (("drive", "friction_speed"), {"wheel_gain_nms_rad": 8.0}, 1.0),
        (("board", "reached"), {"board_stiffness_n_m": 10_000.0}, 2.0),
        (("board", "reached"), {"board_mass_kg": 1.3}, 2.0),
        (("board", "reached"), {"board_stiffness_n_m": 40_000.0}, 1.0),
    ],
)
def test_a_gain_is_enlarged_with_its_figure_unless_it_was_chosen(gain, car, factor):
    section, name = gain
    car = replace(CAR, **car)
    nominal = getattr(SECTIONS[section](), name)
    gains = gains_of_car(load_gains(), car, NOMINAL)
    assert getattr(getattr(gains, section), name) == pytest.approx(factor * nominal)
    assert set(FOLLOWING) == {("drive", "friction_speed"), ("board", "reached")}
    chosen = replace(
        load_gains(), **{section: replace(getattr(load_gains(), section), **{name: 3 * nominal})}
    )
    assert gains_of_car(chosen, car, NOMINAL) == chosen


def test_a_car_whose_servos_droop_carries_its_loads_to_their_places():
    # The load on this board sags by 1.4 mm, and dry friction slows a wheel by 0.9 rad/s.
    car = replace(CAR, wheel_mass_kg=0.65, wheel_gain_nms_rad=0.5, board_stiffness_n_m=8500.0)
    machines = craftsim.Machines(cars=(car,))
    actions = craftsim.validate("block", machines=machines, randomize="mild", trials=1).to_frame()
    assert (actions.result == "as predicted").all()
    assert actions.duration_s.max() < 5.0


@pytest.mark.parametrize("name", ["light_car", "weak_car"])
def test_an_example_machine_acts_as_predicted_within_half_of_the_gap(name):
    path = EXAMPLES / f"{name}.yaml"
    result = craftsim.validate("simple_two_story", machines=path, randomize="mild", trials=1)
    actions = result.to_frame()
    assert (actions.result == "as predicted").all()
    for error in ("car_error_m", "reach_m", "bystander_displacement_m", "drift_m"):
        assert actions[error].max() < GAP_M / 2, error
    assert actions.heading_error_rad.max() < GAP_M / 0.3225


def test_a_car_with_weak_motors_does_not_shove_what_stands_beyond_a_crest():
    setup = setup_of("mild", machines=EXAMPLES / "weak_car.yaml")
    step = Step.single(0, 0, craftsim.Action.MOVE_BACK)
    for seed in (3, 5, 7):
        judge = run_up(Recipe(CREST, (step,), setup, Seed((seed,))))
        (attempt,) = perform_step(judge, step)
        assert attempt.agrees, str(attempt)
        # At 0.42 m/s, the limit of stronger motors, it is shoved by 1.0 to 1.7 mm.
        assert attempt.drift_m < GAP_M / 4


def test_a_velocity_loop_that_a_step_cannot_take_is_refused_by_name():
    car = replace(CAR, wheel_mass_kg=0.65, wheel_armature_kgm2=0.001)
    with pytest.raises(InputError, match=r"motor car0/wheel_fl has a gain of 4: below 0.9 goes"):
        craftsim.PhysicsWorld(
            craftsim.Grid.empty((2, 1, 1), n_cars=1), machines=craftsim.Machines(cars=(car,))
        )
