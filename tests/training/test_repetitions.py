"""Episodes that repeat another count once, and an interval is one of different starts."""

import numpy as np
import pytest

from craftsim.cli import main
from craftsim.training.config import TrainConfig
from craftsim.training.curve import EvaluationResult
from craftsim.training.evaluation import Repetitions
from craftsim.training.trainer import Trainer

ALL = np.arange(4)


def _seen(*numbers):
    return np.array(numbers)[:, None, None]


def test_a_start_and_a_trajectory_count_once():
    distinct = Repetitions(np.zeros((4, 0, 5), np.int64))
    distinct.add(ALL, _seen(1, 1, 1, 2), _seen(5, 5, 6, 5))
    distinct.add(ALL[:3], _seen(3, 3, 3), _seen(7, 7, 7))
    assert len(np.unique(distinct.trajectories)) == 3
    assert distinct.solved(np.array([1, 1, 0, 1])) == (1, 2)
    assert distinct.solved(np.array([1, 1, 1, 0])) == (1, 2)


def test_another_design_is_another_start():
    designs = np.zeros((4, 1, 5), np.int64)
    designs[3] = 1
    distinct = Repetitions(designs)
    distinct.add(ALL, _seen(1, 1, 1, 1), _seen(2, 2, 2, 2))
    assert distinct.solved(np.ones(4)) == (2, 2)


def test_one_start_has_no_interval():
    assert EvaluationResult(1000, 1000, 1.0, 1.0, 1, 1, 1).interval is None
    low, high = EvaluationResult(1000, 1000, 1.0, 1.0, 1000, 1000, 1000).interval
    assert 0.995 < low < high == pytest.approx(1.0)


def test_held_out_starts_are_each_played_once():
    trainer = Trainer(TrainConfig("random_strip@test", worlds=10, width=16))
    played = trainer.evaluate(1000)
    assert (played.starts, played.episodes) == (1000, 1000)
    assert trainer.evaluate(1500).starts == 1000


def test_a_policy_is_evaluated_on_other_starts_than_its_own(tmp_path, capsys):
    Trainer(TrainConfig("random_strip", worlds=10, width=16)).save(tmp_path)
    words = ["evaluate", str(tmp_path), "--episodes", "50", "--out", str(tmp_path / "out")]
    assert main([*words, "--task", "random_strip@test", "random_strip"]) == 0
    assert "of 50" in capsys.readouterr().out
    assert main([*words, "--task", "random_simple_two_story"]) == 2
    assert "network is for" in capsys.readouterr().err
