"""What ``--randomize`` stands for, presets and files; and starts that are settled once and taken again."""

from dataclasses import replace

import numpy as np
import pytest
from discrete.drawn import draw

import craftsim
from craftsim.checking.setup import RANDOMIZE, Setup, set_up, setup_of
from craftsim.checking.thresholds import thresholds_of
from craftsim.discrete.grid import Kind
from craftsim.discrete.kinds import Action
from craftsim.errors import InputError, StartError
from craftsim.models.config import SimulationConfig
from craftsim.models.floor import Floor
from craftsim.models.sensing import ASSUMED, SensorNoise
from craftsim.models.world import _kept

MILD = RANDOMIZE["mild"].sensors


def _setup(tmp_path, text):
    path = tmp_path / "world.yaml"
    path.write_text(text)
    return setup_of(str(path))


def test_a_file_changes_what_it_names_of_its_base(tmp_path):
    text = "base: mild\nfriction: 0.1\nfloor: {lippage_m: 0.001}\nsensors: {position_bias_m: 0.004}"
    setup = _setup(tmp_path, text)
    assert (setup.randomization.friction, setup.assumed) == (0.1, ASSUMED)
    assert setup.randomization.mass == setup_of("mild").randomization.mass
    assert setup.randomization.floor == Floor(lippage_m=0.001)
    assert setup.randomization.sensors == replace(MILD, position_bias_m=0.004)


def test_limits_are_the_same_for_every_preset_and_file(tmp_path):
    biased = _setup(
        tmp_path,
        "floor: {lippage_m: 0.001}\nsensors: {position_bias_m: 0.004, heading_bias_rad: 0.25}",
    )
    for setup in (biased, *map(setup_of, RANDOMIZE)):
        assert setup.thresholds == thresholds_of()
    with pytest.raises(InputError, match="limits"):
        _setup(tmp_path, "limits: {place_m: 0.01}")


def test_noise_takes_the_place_of_the_presets_and_the_assumption_stays():
    setup = setup_of("strong", noise=SensorNoise(position_m=0.002))
    assert (setup.randomization.sensors, setup.assumed) == (SensorNoise(position_m=0.002), ASSUMED)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("base: firm", "key 'base': unknown value 'firm'"),
        ("floor: {lippage: 0.1}", "unknown key 'lippage'.*did you mean 'lippage_m'"),
        ("floor: {lippage_m: 2}", r"key 'floor.lippage_m': 2 is out of range, allowed: at least 0"),
        ("friction: .inf", "key 'friction': must be a"),
    ],
)
def test_a_mistake_in_a_file_is_named(tmp_path, text, message):
    with pytest.raises(InputError, match=f"world.yaml:1: {message}"):
        _setup(tmp_path, text)


def test_a_wrong_section_of_machines_is_named_among_those_of_machines(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text("smartcars: {mass_kg: 3}")
    with pytest.raises(InputError, match=r"did you mean 'smartcar'.*allowed: smartcar, block"):
        setup_of(machines=str(path))


def test_a_word_that_is_no_preset_is_named():
    with pytest.raises(InputError, match=r"unknown randomization 'milld'.*mild.*workshop_floor"):
        setup_of("milld")
    with pytest.raises(InputError, match="unknown randomization '7'"):
        setup_of(7)
    for trials in (0, float("nan"), 1.5):
        with pytest.raises(InputError, match="whole numbers of at least 1"):
            craftsim.validate("strip", trials=trials)


def _grid(y=1):
    return draw((4, 3, 2), [(Kind.BLOCK, (2, y, 1))], [(1, y, 1, 0)])


def _moved():
    judge = set_up(_grid(), Setup())
    names = ("qpos", "qvel", "qacc_warmstart", "tree_asleep")
    start = [getattr(judge.physics.data, name).copy() for name in names]
    return (
        start,
        judge.perform(0, Action.MOVE_RIGHT),
        [getattr(judge.physics.data, name) for name in names],
    )


def test_a_start_is_settled_once_and_goes_on_alike():
    _kept.cache_clear()
    first, second = _moved(), _moved()
    assert (_kept.cache_info().misses, _kept.cache_info().hits) == (1, 1)
    assert second[1] == first[1]
    for a, b in zip(first[0] + first[2], second[0] + second[2], strict=True):
        np.testing.assert_array_equal(a, b)


def test_another_start_configuration_or_goal_is_not_taken_for_it():
    _kept.cache_clear()
    config = Setup(simulation=SimulationConfig(settle_s=0.1))
    for grid, setup, goals in (
        (_grid(), Setup(), ()),
        (_grid(2), Setup(), ()),
        (_grid(), config, ()),
        (_grid(), Setup(), [(0, 0, 1)]),
    ):
        assert set_up(grid, setup, goals=goals).grid.same_visible(grid)
    assert _kept.cache_info().misses == 4


def test_a_start_that_cannot_be_is_refused_each_time():
    grid = draw((4, 3, 2), [(Kind.BLOCK, (1, 1, 1))], [(1, 1, 1, 0, Kind.BLOCK)])
    for _ in range(2):
        with pytest.raises(StartError, match=r"stand .* mm in each other"):
            set_up(grid, Setup())
