"""A curriculum: a run learns on easier tasks before its own."""

from dataclasses import replace

import numpy as np
import pytest

import craftsim
from craftsim.errors import InputError
from craftsim.training.config import TrainConfig
from craftsim.training.trainer import Trainer

SMALL = {"worlds": 2, "width": 8, "network": "relative"}
OPTIONS = {**SMALL, "stages": ("easy_designs",), "stage_steps": 300}


def _config(**options):
    return TrainConfig("designs", **OPTIONS | options)


@pytest.fixture(autouse=True)
def _registered(monkeypatch):
    """Make a stage known by its name."""
    monkeypatch.setattr("craftsim.discrete.tasks.registry._REGISTERED", {})
    monkeypatch.setattr("craftsim.designs.tasks.POOL", 60)
    craftsim.register_task(replace(craftsim.designs_task(difficulty=(0.0, 0.0)), name="easy_designs"))


def _blocks(trainer):
    """Return how many blocks the designs of its worlds have on average."""
    return np.count_nonzero(trainer.worlds.episodes.designs[..., 0], axis=-1).mean()


def test_each_stage_has_its_steps_and_the_task_comes_last():
    trainer = Trainer(_config(worlds=40, width=4))
    seen = [(trainer.stage, _blocks(trainer))]
    for _ in trainer.run(2 * trainer.steps_an_iteration, until=2.0):
        seen.append((trainer.stage, _blocks(trainer)))
    assert [stage for stage, _ in seen] == [0, 1, 1]
    assert seen[0][1] < seen[1][1]


def test_what_is_evaluated_is_the_task_itself(monkeypatch):
    trainer = Trainer(_config())
    monkeypatch.setattr("craftsim.training.trainer.evaluate", lambda net, task, *given: task)
    assert trainer.stage == 0
    assert trainer.evaluate(3) is trainer.task


def test_a_run_with_stages_goes_on_as_if_it_had_never_stopped(goes_on):
    goes_on(_config())


def test_stages_that_make_no_sense_are_refused():
    for options, said in [
        ({"stage_steps": 0}, "give each at least one step"),
        ({"stages": ()}, "leave both out"),
        ({"imitate": 3}, "without exploration and imitation"),
    ]:
        with pytest.raises(InputError, match=said):
            _config(**options)


def test_a_stage_of_another_size_is_refused():
    with pytest.raises(InputError, match="stage 'random_strip' has 4 x 4 x 3 cells"):
        Trainer(TrainConfig("designs", stages=("random_strip",), stage_steps=5, **SMALL))
