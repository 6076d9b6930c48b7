"""Hyperparameters from a file: what is given counts, and what is wrong is one message."""

from dataclasses import fields

import pytest
from training_files import read_content, write_content

from craftsim.cli import main
from craftsim.errors import InputError
from craftsim.storage.records import type_and_range
from craftsim.training.checkpoint import POLICY_FILE, read_policy
from craftsim.training.config import ALGO_NAMES, KINDS, read_settings, settings_of


def _file(tmp_path, text):
    path = tmp_path / "settings.yaml"
    path.write_text(text)
    return path


def test_every_algorithm_has_settings_within_their_ranges():
    assert set(KINDS) == set(ALGO_NAMES)
    for algo, kind in KINDS.items():
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
    words = ["train", "--set", "worlds=2", "width=4", "--steps", "1", "--episodes", "1"]
    words += ["--out", str(tmp_path / "run")]
    assert main([*words, "--set", f"settings={_file(tmp_path, 'epochs: 0')}"]) == 2
    assert "key 'epochs': 0 is out of range, allowed: 1 to 100" in capsys.readouterr().err
    assert main([*words, "--set", f"settings={_file(tmp_path, 'epochs: 1')}"]) == 0
    path = tmp_path / "run" / POLICY_FILE
    assert read_policy(path)[0].config.hyperparameters == {"epochs": 1}
    content = read_content(path)
    content["head"]["config"]["hyperparameters"] = {"epochs": 1e9}
    write_content(path, content)
    with pytest.raises(
        InputError, match=r"policy.safetensors: .*epochs: 1000000000 is out of range, allowed: 1 to 100"
    ):
        read_policy(path)
