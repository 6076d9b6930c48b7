"""Identification finds what was hidden, says what it cannot find, and is not moved by what it should not be."""

import copy
from dataclasses import replace

import numpy as np
import pytest
from tuning.tuning_cars import HIDDEN, NOMINAL, log_of

from craftsim.checking.setup import RANDOMIZE
from craftsim.errors import InputError
from craftsim.models.sensing import EXACT
from craftsim.tuning.identification import MISFIT, identify, unidentified_directions
from craftsim.tuning.identified import identification_figures, identified_report, write_parameters
from craftsim.tuning.prediction import SIGNALS, UNKNOWNS, Predictor, machines_of, unknowns_of

UNKNOWNS_HERE = [unknown.name for unknown in unknowns_of(loaded=False)]


def test_hidden_figures_are_found(found):
    # Of gears and gain so short a log tells hardly more than the ratio.
    assert not found["smartcar.gear_friction_nm"].identified
    assert all(found[key].identified for key in HIDDEN if key != "smartcar.gear_friction_nm")
    assert all(
        abs(found[key].value - true) <= 1.5 * found[key].half_width for key, true in HIDDEN.items()
    )
    values = {key: found[key].value for key in HIDDEN}
    bounds = {
        key: 0.005 if key.startswith("noise") else 0.05 * true for key, true in HIDDEN.items()
    }
    assert {key: pytest.approx(true, abs=bounds[key]) for key, true in HIDDEN.items()} == values


def test_what_the_log_cannot_tell_is_held_and_said(found):
    assert found["smartcar.wheel_mass_kg"].half_width is None
    assert found["smartcar.wheel_mass_kg"].value == NOMINAL.car(0).wheel_mass_kg
    texts = [one.text for one in found.unidentified]
    assert any("mass of the car" in text and "only as ratios" in text for text in texts)
    torque = found["smartcar.wheel_torque_nm"]
    assert torque.half_width is None  # it has not reached its limit
    assert torque.value == NOMINAL.car(0).wheel_torque_nm
    assert torque.range is not None
    assert torque.range[0] < torque.value < torque.range[1]
    assert all(estimate.half_width is None for estimate in found.estimates if estimate.range)


def test_a_model_that_follows_the_log_leaves_noise_alone(found):
    assert found.fits
    assert found.noise.keys() == found.misfit.keys()
    assert all(0.8 < ratio < MISFIT for ratio in found.misfit.values())


def test_what_fits_as_well_is_kept_of_each_figure_that_the_log_does_not_tell(found):
    """Intervals include all of it: what was tried last alone would make them too narrow."""
    again = copy.copy(found)
    again._ranges = {}
    again._as_good = {}
    columns = [UNKNOWNS_HERE.index(key) for key in ("wheel_torque_nm", "screw_friction_n")]
    for column in columns:
        assert not again._go_to_best(column)
    assert list(again._ranges) == list(again._as_good) == columns
    widths = {}
    for kept in ([], columns[:1], columns):
        again._as_good = {column: [again._vector + 0.01 * (column + 1)] for column in kept}
        widths[len(kept)] = again._estimates()[0].half_width
    assert widths[0] < widths[1] < widths[2]


LIMITED = {
    "smartcar.wheel_torque_nm": 1.0,
    "smartcar.gear_friction_nm": 0.6,
    "smartcar.wheel_gain_nms_rad": 3.2,
    "smartcar.wheel_armature_kgm2": 0.015,
    "noise.delay_s": 0.02,
    "noise.motor_lag_s": 0.02,
}


@pytest.fixture(scope="module")
def limited():
    """A car that reaches its torque limit; the one that is assumed, of 2.5 Nm, never would."""
    return identify(log_of(LIMITED, 16.0), NOMINAL)


def test_a_limit_that_the_assumed_car_does_not_reach_is_found_and_all_intervals_hold_the_truth(
    limited,
):
    assert limited.fits
    assert limited["smartcar.wheel_torque_nm"].value == pytest.approx(1.0, rel=0.1)
    for key, true in LIMITED.items():
        estimate = limited[key]
        assert estimate.half_width is not None, key
        assert abs(estimate.value - true) <= 1.5 * estimate.half_width, key


@pytest.mark.slow
def test_two_minutes_tell_gears_gain_and_a_limit_that_is_reached_to_one_per_cent():
    hidden = {
        "smartcar.wheel_torque_nm": 1.4,
        "smartcar.gear_friction_nm": 0.6,
        "smartcar.wheel_gain_nms_rad": 3.2,
    }
    identification = identify(log_of(hidden, 120.0), NOMINAL)
    assert identification.fits
    for key, true in hidden.items():
        estimate = identification[key]
        assert estimate.identified, key
        assert estimate.value == pytest.approx(true, rel=0.01), key
        assert abs(estimate.value - true) <= estimate.half_width, key


def test_a_model_that_cannot_follow_the_log_is_not_called_identified(log, tmp_path):
    """Wheels of which one is slower than commanded, which no parameter gives."""
    log = log.between(4.0, 6.0)
    commands = log.commands.copy()
    commands[:, 0] *= 1.3
    found = identify(replace(log, commands=commands), NOMINAL)
    assert not found.fits
    figures = identification_figures(found, Predictor(log, NOMINAL), None)
    figures["left_out"] = write_parameters(tmp_path / "parameters.yaml", found, NOMINAL, "log.csv")
    figures["notes"] = []
    report = identified_report(found, "log.csv", {"figures": figures}, {})
    assert report.headline.badge == "Does not fit"
    assert "times the noise" in report.headline.sentence
    assert report.exit_code == 1
    assert "The model misses the log" in (tmp_path / "parameters.yaml").read_text(encoding="utf-8")


def test_the_noise_of_measurements_is_found_beside_motion(log):
    noise = Predictor(log, NOMINAL).measured_noise(dict.fromkeys(SIGNALS, 0.0))
    sensors = RANDOMIZE["mild"].sensors
    assert noise["position"] == pytest.approx(sensors.position_m, rel=0.1)
    assert noise["heading"] == pytest.approx(sensors.heading_rad, rel=0.1)
    assert noise["board force"] == pytest.approx(sensors.board_force_n, rel=0.2)


def test_a_prediction_by_the_truth_leaves_nothing_but_noise():
    hidden = {key: value for key, value in HIDDEN.items() if not key.startswith("noise")}
    predictor = Predictor(log_of(hidden, 10.0, EXACT), NOMINAL)
    errors = predictor.errors(machines_of(NOMINAL, hidden), {})
    assert np.abs(errors).max() < 1e-6
    assert np.abs(predictor.errors(NOMINAL, {})[..., 3:7]).max() > 0.01


def test_a_prediction_changes_in_proportion_to_a_small_change_of_a_parameter(log):
    """Derivatives are difference quotients. Band: 10 %, and a thousandth, for inertias of MJCF have six digits."""
    predictor = Predictor(log, NOMINAL)
    here = predictor.errors(machines_of(NOMINAL, HIDDEN), HIDDEN)
    for unknown in unknowns_of(loaded=False):
        if not unknown.of_machine:
            continue
        assumed = HIDDEN.get(unknown.key, unknown.start(NOMINAL))
        quotients = {}
        for share in (0.001, 0.01):
            values = HIDDEN | {unknown.key: assumed * (1 + share)}
            there = predictor.errors(machines_of(NOMINAL, values), values)
            quotients[share] = (there - here)[..., :7] / share
        for channel in (slice(0, 2), slice(2, 3), slice(3, 7)):
            large = quotients[0.01][..., channel]
            small = quotients[0.001][..., channel]
            assert np.nanmax(np.abs(small - large)) <= 0.1 * np.nanmax(np.abs(large)) + 1e-3, (
                unknown.key
            )


def test_errors_do_not_depend_on_where_a_log_was_taken(log):
    turned = log.pose.copy()
    c, s = np.cos(2.0), np.sin(2.0)
    turned[:, :2] = log.pose[:, :2] @ np.array([[c, s], [-s, c]]) + [30.0, -7.0]
    turned[:, 2] = (log.pose[:, 2] + 2.0 + np.pi) % (2 * np.pi) - np.pi
    here, there = (
        Predictor(one, NOMINAL).errors(NOMINAL, {}) for one in (log, replace(log, pose=turned))
    )
    assert np.allclose(
        np.hypot(here[..., 0], here[..., 1]), np.hypot(there[..., 0], there[..., 1]), atol=1e-9
    )
    assert np.allclose(here[..., 2:], there[..., 2:], atol=1e-9)


def test_a_heading_that_is_read_askew_turns_the_way_and_not_the_motion(log):
    predictor = Predictor(replace(log, pose=log.pose + np.array([0.0, 0.0, 0.1])), NOMINAL)
    straight = Predictor(log, NOMINAL).errors(NOMINAL, {})
    assert np.allclose(
        predictor.errors(NOMINAL, {"mounting.heading_bias_rad": 0.1}), straight, atol=1e-9
    )
    assert np.nanstd(predictor.errors(NOMINAL, {})[..., :2]) > 1.2 * np.nanstd(straight[..., :2])


@pytest.mark.parametrize(("period_s", "stepped_s"), [(0.004, 0.005), (0.03, 0.03)])
def test_a_log_at_another_rate_is_predicted_as_well(log, period_s, stepped_s):
    predictor = Predictor(log.resampled(period_s), NOMINAL)
    assert predictor.period_s == stepped_s
    errors = predictor.errors(machines_of(NOMINAL, HIDDEN), HIDDEN)
    assert np.nanstd(errors[..., :2]) < 0.005


def test_what_no_log_tells_is_held():
    """Forces in proportion, whatever a log says, and however surely; and what it says nothing of."""
    unknowns = unknowns_of(loaded=False)
    jacobian = np.random.default_rng(0).normal(size=(500, len(unknowns)))
    (one,) = unidentified_directions(jacobian, unknowns)
    assert one.held_key == "smartcar.wheel_mass_kg"
    assert set(one.members) == {unknown.key for unknown in unknowns if unknown.scales}
    jacobian[:, [one.name for one in unknowns].index("screw_friction_n")] = 0.0
    first, _ = unidentified_directions(jacobian, unknowns)
    assert first.held_key == "smartcar.screw_friction_n"
    assert "the log does not tell it" in first.text


def test_a_log_that_tells_nothing_is_refused(log):
    for change, said in (
        ({"commands": 0.0}, "no wheel is ever commanded"),
        ({"tilt": 0.2}, "the car leans all the time"),
        ({"pose": np.nan, "wheel_speeds": np.nan}, "neither poses nor"),
    ):
        changed = {name: np.full_like(getattr(log, name), value) for name, value in change.items()}
        with pytest.raises(InputError, match=said):
            identify(replace(log, **changed), NOMINAL)
    with pytest.raises(InputError, match="shorter than 2 s"):
        identify(log.between(0.0, 1.9), NOMINAL)


def test_a_log_of_a_car_that_hardly_moves_tells_nothing(log):
    still = log.between(0.0, 3.0)
    commands = np.zeros_like(still.commands)
    commands[5, 0] = 1e-9
    quiet = replace(still, commands=commands, board=np.full_like(still.board, np.nan))
    quiet.pose[:], quiet.wheel_speeds[:] = still.pose[0], 0.0
    found = identify(quiet, NOMINAL)
    assert not any(one.identified for one in found.estimates)
    assert len(found.unidentified) == len(found.estimates)
    assert "board" not in found.noise


def test_every_unknown_has_its_own_name():
    assert (
        len({one.key for one in UNKNOWNS}) == len({one.words for one in UNKNOWNS}) == len(UNKNOWNS)
    )


def test_a_car_that_leans_by_one_angle_is_left_out_though_the_other_was_not_measured(log):
    tilt = np.zeros((len(log), 2))
    tilt[:, 0] = np.nan
    assert len(Predictor(replace(log, tilt=tilt), NOMINAL).segments) > 0
    tilt[:, 1] = 0.2
    assert Predictor(replace(log, tilt=tilt), NOMINAL).segments == []
