"""Hyperparameters from a file: what is given counts, and what is wrong is one message."""

from dataclasses import fields
from typing import get_args, get_type_hints

import pytest
from cyclopts import Parameter
from learning.training_files import read_content, write_content

from craftsim.cli import main
from craftsim.cli.app import bind
from craftsim.cli.train_options import (
    OF_ALGORITHM,
    Exploration,
    Hyperparameters,
    Learning,
    TrainingPhysics,
    chosen_values,
)
from craftsim.errors import InputError
from craftsim.learning.algorithms import ALGORITHMS
from craftsim.learning.checkpoint import POLICY_FILE, read_policy
from craftsim.learning.config import TrainConfig, protocol, read_settings, settings_of
from craftsim.storage.records import type_and_range
from craftsim.validation.options import range_of

GROUPS = (Learning, Exploration, TrainingPhysics)
"""The options of the command that are fields of a configuration, mostly."""


def test_the_options_of_the_command_are_the_fields_of_a_configuration_with_its_ranges_and_defaults():
    config = {field.name for field in fields(TrainConfig)}
    options = {field.name: group for group in GROUPS for field in fields(group)}
    assert config - {*options} == {"task", "algo", "seed", "backend", "hyperparameters"}
    assert {*options} - config == {"starts", "workers", "engine"}
    for name in config & {*options}:
        default = chosen_values(options[name]()).get(name)
        assert default in (None, getattr(TrainConfig("strip"), name))
        parameter = _parameter(options[name], name)
        allowed = type_and_range(TrainConfig, (name,))[1]
        if allowed is not None:
            assert range_of(parameter) == allowed, name


def test_a_preset_settles_nothing_but_what_an_option_leaves_open():
    settled = protocol("paper_plus", "strip", "vdn").settings
    left_open = {field.name for group in GROUPS for field in fields(group) if field.default is None}
    assert {*settled} - {"hyperparameters"} <= left_open


def test_each_hyperparameter_is_an_option_under_the_algorithms_that_read_it():
    options = {
        field.name: _parameter(Hyperparameters, field.name) for field in fields(Hyperparameters)
    }
    assert {*options} == {field.name for kind in OF_ALGORITHM for field in fields(kind)}
    for name, parameter in options.items():
        readers = [kind for kind in OF_ALGORITHM if hasattr(kind, name)]
        headings = {OF_ALGORITHM[kind].name for kind in readers}
        if len(readers) == len(OF_ALGORITHM):
            headings = {"Hyperparameters of every algorithm"}
        assert {group.name for group in parameter.group} == headings
        for kind in readers:
            allowed = type_and_range(kind, (name,))[1]
            assert allowed.low in range_of(parameter)
            assert allowed.high in range_of(parameter)
            assert f"{getattr(kind, name):g}" in parameter.show_default


def _parameter(group, name):
    return next(
        part
        for part in get_args(get_type_hints(group, include_extras=True)[name])
        if isinstance(part, Parameter)
    )


def test_an_option_comes_before_the_file_and_the_file_before_the_preset(tmp_path):
    file = _file(tmp_path, "epsilon_start: 0.5\nbatch: 64\n")
    words = [
        "train",
        "strip",
        "--algo",
        "vdn",
        "--preset",
        "paper",
        "--steps",
        "1",
        "--episodes",
        "1",
    ]
    words += [
        "--worlds",
        "2",
        "--width",
        "4",
        "--rules",
        "physical",
        "--batch",
        "32",
        "--settings",
        str(file),
    ]
    assert main([*words, "--out", str(tmp_path / "run")]) == 0
    config = read_policy(tmp_path / "run" / POLICY_FILE)[0].config
    assert (config.rules, config.helper_depth) == ("physical", 20)
    hyperparameters = config.hyperparameters
    assert (
        hyperparameters["epsilon_start"],
        hyperparameters["epsilon_end"],
        hyperparameters["batch"],
    ) == (
        0.5,
        0.2,
        32,
    )


def test_whole_hyperparameters_are_whole():
    hyperparameters = bind(["train", "--epochs", "3", "--clip", "1"])[1].arguments[
        "hyperparameters"
    ]
    assert chosen_values(hyperparameters) == {"epochs": 3, "clip": 1.0}


def _file(tmp_path, text):
    path = tmp_path / "settings.yaml"
    path.write_text(text)
    return path


def test_every_algorithm_has_settings_within_their_ranges():
    for algo, algorithm in ALGORITHMS.items():
        kind = algorithm.settings
        assert settings_of(algo, {}) == kind()
        for of in fields(kind):
            allowed = type_and_range(kind, (of.name,))[1]
            for edge in (allowed.low, allowed.high):
                if of.name not in ("epsilon_start", "epsilon_end"):
                    assert getattr(settings_of(algo, {of.name: edge}), of.name) == edge


def test_a_file_says_what_differs(tmp_path):
    path = _file(tmp_path, "learning_rate: 3e-4\nepochs: 2\n")
    given = read_settings(path, "ippo")
    assert given == {"learning_rate": 3e-4, "epochs": 2}
    settings = settings_of("ippo", given)
    assert (settings.learning_rate, settings.epochs, settings.gamma) == (3e-4, 2, 0.99)


WRONG = {
    "learning_rat: 1": r"settings.yaml:1: unknown key 'learning_rat'.*learning_rate",
    "td_lambda: 0.5": "unknown key 'td_lambda'",
    "gamma: 1.5": "settings.yaml:1: key 'gamma': 1.5 is out of range, allowed: 0 to 1",
    "gamma: .nan": "settings.yaml:1: key 'gamma': must be a number from 0 to 1, not '.nan'",
    "gamma: nan": "settings.yaml:1: key 'gamma': must be a number from 0 to 1, not 'nan'",
    "epochs: 2.5": "must be an integer from 1 to 100, not '2.5'",
    "epochs: true": "must be an integer from 1 to 100, not 'true'",
    "clip: [1]": "must be a number from 0.001 to 10, not a list",
    "gamma: 0.9\ngamma: 0.8": "given twice|duplicate|again",
}


@pytest.mark.parametrize("text", WRONG)
def test_a_file_that_is_wrong_is_one_message(text, tmp_path):
    with pytest.raises(InputError, match=WRONG[text]):
        read_settings(_file(tmp_path, text), "ippo")


def test_the_command_takes_a_file_and_a_policy_s_settings_are_checked(tmp_path, capsys):
    words = ["train", "--worlds", "2", "--width", "4", "--steps", "1", "--episodes", "1"]
    words += ["--out", str(tmp_path / "run")]
    assert main([*words, "--settings", str(_file(tmp_path, "epochs: 0"))]) == 2
    assert "key 'epochs': 0 is out of range, allowed: 1 to 100" in capsys.readouterr().err
    assert main([*words, "--settings", str(_file(tmp_path, "epochs: 1"))]) == 0
    path = tmp_path / "run" / POLICY_FILE
    assert read_policy(path)[0].config.hyperparameters == {"epochs": 1}
    content = read_content(path)
    content["head"]["config"]["hyperparameters"] = {"epochs": 1e9}
    write_content(path, content)
    with pytest.raises(
        InputError,
        match=r"policy.safetensors: .*epochs.*: 1000000000 is out of range, allowed: 1 to 100",
    ):
        read_policy(path)
