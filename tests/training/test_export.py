"""What a trained policy does becomes a dataset, and of its own task only."""

import numpy as np
import pytest

from craftsim.cli import main
from craftsim.envs import parallel_env
from craftsim.training.config import TrainConfig
from craftsim.training.policy import load_policy
from craftsim.training.trainer import Trainer


def test_a_trained_policy_is_exported_and_refuses_another_task(tmp_path, monkeypatch, capsys):
    minari = pytest.importorskip("minari")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "sets"))
    Trainer(TrainConfig("strip", worlds=1, width=4)).save(tmp_path)
    words = ["--policy", str(tmp_path), "--episodes", "1", "--seed", "5", "--out", str(tmp_path / "sets")]
    assert main(["export", "strip", *words, "--name", "strip/net-v1"]) == 0
    actions = minari.load_dataset("strip/net-v1")[0].actions
    env, policy = parallel_env("strip", "grid"), load_policy(tmp_path)
    seen, _ = env.reset(seed=5)
    for row in actions:
        chosen = policy(seen)
        np.testing.assert_array_equal(row, list(chosen.values()))
        seen = env.step(chosen)[0]
    assert not env.agents
    assert main(["export", "block", *words]) == 2
    assert "strip" in capsys.readouterr().err
    assert not (tmp_path / "sets/craftsim").exists()
