"""What ``--randomize`` stands for: presets, and files that start from one."""

from dataclasses import asdict, replace

import pytest

from craftsim.checking.attempt import Thresholds
from craftsim.checking.setup import RANDOMIZE, setup_of, widened
from craftsim.errors import InputError
from craftsim.models.floor import Floor
from craftsim.models.randomization import NONE
from craftsim.models.sensing import ASSUMED, MILD, SensorNoise


def _setup(tmp_path, text):
    path = tmp_path / "world.yaml"
    path.write_text(text)
    return setup_of(str(path))


def test_a_file_changes_what_it_names_of_its_base(tmp_path):
    setup = _setup(
        tmp_path, "base: mild\nfriction: 0.1\nfloor: {lippage_m: 0.001}\nsensors: {position_bias_m: 0.004}"
    )
    mild = setup_of("mild").randomization
    assert setup.randomization.friction == 0.1
    assert setup.randomization.mass == mild.mass
    assert setup.randomization.floor == Floor(lippage_m=0.001)
    assert setup.randomization.sensors.position_m == MILD.position_m
    assert setup.assumed == ASSUMED


def test_limits_are_widened_by_what_no_car_can_know_and_by_nothing_else(tmp_path):
    setup = _setup(
        tmp_path,
        "floor: {lippage_m: 0.001, unevenness_m: 0.002}\nsensors: {position_bias_m: 0.004, heading_bias_rad: 0.25}"
        "\nlimits: {bystander_m: 0.0015}",
    )
    # Half a cell times the heading's bias, and a level times the lean of 3 mm over 0.2 m, add to what may be set down.
    placed_m = 0.00125 + 0.004 + 0.16125 * 0.25 + 0.185 * 0.015
    assert asdict(setup.thresholds) == pytest.approx(
        asdict(Thresholds(0.005, 0.253, placed_m, 0.0015, 0.005, 0.025, 0.255, 0.019, 1.0))
    )
    assert widened(Thresholds(), NONE) == Thresholds()


def test_without_bias_and_relief_limits_are_those_of_the_preset_and_forces_follow_the_masses():
    for name, force in (("none", 1.0), ("mild", 1.1), ("strong", 1.2)):
        assert setup_of(name).thresholds == replace(RANDOMIZE[name][0], force=force)


def test_noise_takes_the_place_of_the_presets_and_the_assumption_stays():
    setup = setup_of("strong", noise=SensorNoise(position_m=0.002))
    assert setup.randomization.sensors == SensorNoise(position_m=0.002)
    assert setup.assumed == ASSUMED


def test_a_mistake_in_a_file_is_named(tmp_path):
    for text, message in (
        ("base: firm", "world.yaml:1: key 'base': unknown value 'firm'"),
        ("floor: {lippage: 0.1}", "world.yaml:1: unknown key 'lippage'.*did you mean 'lippage_m'"),
        (
            "floor: {lippage_m: 2}",
            r"world.yaml:1: key 'floor.lippage_m': 2 is out of range, allowed: at least 0",
        ),
        ("friction: much", "world.yaml:1: key 'friction': must be a number"),
        ("limits: {car_m: .inf}", "world.yaml:1: key 'limits.car_m': must be a"),
        ("wind: 3", "world.yaml:1: unknown key 'wind'"),
    ):
        with pytest.raises(InputError, match=message):
            _setup(tmp_path, text)


def test_a_word_that_is_no_preset_is_named():
    with pytest.raises(InputError, match=r"unknown randomization 'milld'.*mild.*workshop_floor"):
        setup_of("milld")
