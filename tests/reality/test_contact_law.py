"""A hidden friction is found, errors are what they are called, and a toss flies as it should."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from reality.made import CUBE, ROWS, toss_arrays, written
from scipy.spatial.transform import Rotation

from craftsim.mjcf.parameters import GRAVITY, ContactParameters
from craftsim.reality import contact_law
from craftsim.reality.contact_law import (
    ContactLaw,
    assumed_laws,
    cube_model,
    evaluate_tosses,
    flight_starts,
    heights,
    law_errors,
    recorded_starts,
    resting_height_m,
    simulate_tosses,
    steps_per_row,
    toss_errors,
)
from craftsim.reality.recordings import read_recording


@pytest.fixture
def short_search(monkeypatch):
    """Let a search try few laws."""
    monkeypatch.setattr(contact_law, "_FIRST_LOOK", 32)
    monkeypatch.setattr(contact_law, "_STEPS", 40)


def _tosses(folder, **options):
    return read_recording(written(folder / "tosses.npz", toss_arrays(**options)))


@pytest.mark.parametrize(("friction", "differs"), [(0.18, False), (0.09, True)])
def test_a_halved_friction_is_found_and_the_declared_one_is_not_doubted(
    friction, differs, tmp_path, short_search
):
    figures = evaluate_tosses(_tosses(tmp_path, friction=friction), 0, lambda *_: None)
    assert figures["friction"]["differs"] is differs
    assert figures["friction"]["fitted"].value == pytest.approx(friction, rel=0.08)
    assert (figures["fitted_to"], figures["tested_on"]) == (12, 12)
    errors = [row["position_widths"].value for row in figures["laws"]]
    if differs:
        assert errors[-1] < 0.3 * errors[1]
        assert figures["laws"][-1]["more_than_measured"].high < 0
    else:
        assert errors[1] < 1e-3  # it is the law that made them
        assert errors[0] > 0.3  # of the assumed friction


def test_errors_are_in_widths_and_radians():
    states = np.zeros((5, 13))
    states[:, 3] = 1.0
    moved = states[:, :7].copy()
    moved[1:, 0] = 0.2
    moved[1:, 3:7] = Rotation.from_rotvec([0, 0, 0.3]).as_quat(scalar_first=True)
    (error,) = toss_errors([states], [moved], 0.1)
    assert error == pytest.approx([2.0, 0.3])


def test_a_cube_falls_and_turns_about_its_own_axes_until_it_touches():
    rng = np.random.default_rng(1)
    start = np.zeros((1, 13))
    start[0, 2] = 10.0
    start[0, 3:7] = Rotation.random(rng=rng).as_quat(scalar_first=True)
    start[0, 7:] = (1.0, 2.0, 3.0, 4.0, -5.0, 6.0)
    model = cube_model(CUBE, ContactLaw("", ContactParameters()), step_share=0.1)
    steps = steps_per_row(CUBE, 0.1)
    (poses,) = simulate_tosses(model, start, [ROWS], steps)
    time_s = np.arange(ROWS) / CUBE.rate_hz
    assert poses[:, :2] == pytest.approx(time_s[:, None] * [1.0, 2.0], abs=1e-9)
    assert poses[:, 2] == pytest.approx(10 + 3 * time_s - GRAVITY * time_s**2 / 2, abs=2e-3)
    first = Rotation.from_quat(start[0, 3:7], scalar_first=True)
    turned = first * Rotation.from_rotvec(time_s[-1] * start[0, 10:])
    last = Rotation.from_quat(poses[-1, 3:7], scalar_first=True)
    assert (last.inv() * turned).magnitude() < 1e-6


def test_the_lowest_corner_of_a_cube_on_its_tip_is_half_a_diagonal_below_its_centre():
    states = np.zeros((2, 13))
    states[0, 3] = 1.0
    tip = Rotation.align_vectors([0, 0, -1], [1, 1, 1])[0]
    states[1, 3:7] = tip.as_quat(scalar_first=True)
    below = -heights(CUBE, states) / CUBE.half_width_m
    assert below == pytest.approx([1.0, np.sqrt(3)])


def test_the_velocities_of_a_flight_say_more_than_those_of_a_disturbed_first_row(tmp_path):
    exact = _tosses(tmp_path, friction=0.18)
    noisy = _tosses(tmp_path, friction=0.18, noise=0.25)
    wrong = np.abs(recorded_starts(noisy) - recorded_starts(exact))[:, 7:9].mean()
    right = np.abs(flight_starts(noisy) - recorded_starts(exact))[:, 7:9].mean()
    assert right < 0.3 * wrong
    law = assumed_laws(noisy.cube)[1]
    recorded = law_errors(noisy, law)[:, 0].mean()
    flown = flight_starts(noisy)
    flown[:, 9] += GRAVITY / CUBE.rate_hz / steps_per_row(CUBE) / 2
    assert law_errors(noisy, law, flown)[:, 0].mean() < 0.5 * recorded


def test_laws_of_mujoco_are_its_defaults():
    plain = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><geom type='plane' size='1 1 1'/></worldbody></mujoco>"
    )
    law = assumed_laws(CUBE)[3]
    model = cube_model(CUBE, law)
    for name in ("geom_solref", "geom_solimp"):
        assert getattr(model, name)[0] == pytest.approx(getattr(plain, name)[0]), name
    assert (model.opt.cone, model.opt.impratio) == (plain.opt.cone, plain.opt.impratio)
    ours = cube_model(CUBE, assumed_laws(CUBE)[2])
    assert ours.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC
    assert (model.geom_friction[:, 0] == CUBE.friction).all()


def test_steps_are_whole_parts_of_a_row_and_no_longer_than_those_of_worlds():
    assert steps_per_row(CUBE) == 2
    assert steps_per_row(replace(CUBE, rate_hz=250.0)) == 1
    assert steps_per_row(CUBE, 0.25) == 7


def test_cubes_that_came_to_rest_lie_on_the_board(tmp_path):
    arrays = toss_arrays(0.6, n=4)
    arrays["states"][:, 2] -= 0.1
    tosses = read_recording(written(tmp_path / "low.npz", arrays))
    assert resting_height_m(tosses) / CUBE.half_width_m == pytest.approx(-0.1, abs=0.01)
