"""Hyperparameters from a file: what is given counts, what is wrong is one message, and a run goes on with them."""

from dataclasses import fields
from itertools import pairwise

import pytest
import torch
from training_files import read_content, write_content

from craftsim.cli import main
from craftsim.errors import InputError
from craftsim.storage.limits import ranges_of
from craftsim.training.checkpoint import POLICY_FILE, read_policy
from craftsim.training.config import ALGO_NAMES, TrainConfig
from craftsim.training.settings import KINDS, read_settings, settings_of
from craftsim.training.trainer import Trainer

GIVEN = {
    "ippo": {"learning_rate": 3e-4, "epochs": 2, "gae_lambda": 0.5},
    "coma": {"minibatches": 3, "td_lambda": 0.5},
    "vdn": {"batch": 16, "replays": 4, "epsilon_ticks": 500},
}


def _file(tmp_path, text):
    path = tmp_path / "settings.yaml"
    path.write_text(text)
    return path


def test_every_algorithm_has_settings_within_their_ranges():
    assert set(KINDS) == set(ALGO_NAMES)
    for algo, kind in KINDS.items():
        assert settings_of(algo, {}) == kind()
        for of in fields(kind):
            for edge in (ranges_of(kind)[of.name].low, ranges_of(kind)[of.name].high):
                if of.name not in ("epsilon_start", "epsilon_end"):
                    assert getattr(settings_of(algo, {of.name: edge}), of.name) == edge


def test_a_file_says_what_differs(tmp_path):
    path = _file(tmp_path, "learning_rate: 3e-4\nepochs: 2\n")
    given = read_settings(path, "ippo")
    assert given == {"learning_rate": 3e-4, "epochs": 2}
    settings = settings_of("ippo", given)
    assert (settings.learning_rate, settings.epochs, settings.gamma) == (3e-4, 2, 0.99)


def test_a_learning_rate_falls_to_nothing_and_then_nothing_is_learnt(tmp_path):
    settings = settings_of("ippo", {"learning_rate": 0.01, "decay_ticks": 400})
    assert [settings.rate(ticks) for ticks in (0, 100, 400, 500)] == pytest.approx([0.01, 0.0075, 0, 0])
    assert settings_of("ippo", {}).rate(10**9) == settings_of("ippo", {}).learning_rate
    config = TrainConfig("strip", worlds=2, width=4, hyperparameters={"decay_ticks": 80})
    trainer, weights = Trainer(config), []
    assert trainer.steps_an_iteration == 40
    for steps in (80, 160):
        for _ in trainer.run(steps, 2.0):
            weights.append(trainer.learner.modules.state_dict()["net.head.1.2.bias"].clone())
        trainer.save(tmp_path)
        trainer = Trainer.resume(tmp_path, config=config)
    changed = [not torch.equal(one, other) for one, other in pairwise(weights)]
    assert changed == [True, False, False]


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


def test_random_actions_do_not_grow_more():
    with pytest.raises(InputError, match=r"epsilon_end is 0\.5; allowed: at most epsilon_start, 0\.1"):
        TrainConfig("strip", "vdn", hyperparameters={"epsilon_start": 0.1, "epsilon_end": 0.5})


def _same(a, b):
    return all(torch.equal(a[key], b[key]) for key in a)


@pytest.mark.parametrize("algo", GIVEN)
def test_a_run_with_settings_goes_on_number_for_number(algo, tmp_path):
    config = TrainConfig("strip", algo, worlds=10, width=8, hyperparameters=GIVEN[algo])
    whole, part, plain = (
        Trainer(config),
        Trainer(config),
        Trainer(TrainConfig("strip", algo, worlds=10, width=8)),
    )
    for trainer, iterations in ((whole, 2), (part, 1), (plain, 2)):
        for _ in trainer.run(iterations * trainer.steps_an_iteration, until=2.0):
            pass
    part.save(tmp_path)
    assert read_policy(tmp_path / POLICY_FILE)[0].config == config
    resumed = Trainer.resume(tmp_path, config=config)
    next(resumed.run(whole.steps, until=2.0))
    weights = whole.learner.net.state_dict()
    assert _same(resumed.learner.net.state_dict(), weights)
    assert not _same(plain.learner.net.state_dict(), weights)
    with pytest.raises(InputError, match="begun with"):
        Trainer.resume(tmp_path, config=plain.config)


def test_a_policy_file_with_settings_out_of_range_is_one_message(tmp_path):
    Trainer(TrainConfig("strip", worlds=1, width=4)).save(tmp_path)
    path = tmp_path / POLICY_FILE
    content = read_content(path)
    content["head"]["config"]["hyperparameters"] = {"epochs": 1e9}
    write_content(path, content)
    with pytest.raises(
        InputError, match=r"policy.safetensors: .*epochs: 1000000000 is out of range, allowed: 1 to 100"
    ):
        read_policy(path)


def test_the_command_takes_a_file(tmp_path, capsys):
    words = [
        "train",
        "--worlds",
        "2",
        "--steps",
        "1",
        "--episodes",
        "1",
        "--out",
        str(tmp_path / "run"),
        "--settings",
    ]
    assert main([*words, str(_file(tmp_path, "epochs: 0"))]) == 2
    assert "key 'epochs': 0 is out of range, allowed: 1 to 100" in capsys.readouterr().err
    assert main([*words, str(_file(tmp_path, "epochs: 1"))]) == 0
    assert read_policy(tmp_path / "run" / POLICY_FILE)[0].config.hyperparameters == {"epochs": 1}
