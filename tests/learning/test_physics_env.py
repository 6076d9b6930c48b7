"""Training in physics: the same run at any number of workers."""

from contextlib import closing
from dataclasses import replace

import pytest
import torch

from craftsim.errors import InputError
from craftsim.learning.config import TrainConfig
from craftsim.learning.trainer import Trainer
from craftsim.tasks import make_task

SHORT = make_task("strip", max_steps=0)
"""Two ticks an episode."""


def test_a_run_in_physics_is_the_same_with_one_worker_and_with_two_and_resumes(tmp_path):
    config = TrainConfig("strip", worlds=3, width=8, backend="physics")
    weights = []
    for workers in (1, 2):
        with closing(Trainer(config, task=SHORT, workers=workers)) as trainer:
            assert next(iter(trainer.run(1, 2.0))) is False
            played = trainer.evaluate(4)
            assert (played.episodes, played.mean_ticks) == (4, 2.0)
            weights.append(
                [*(w.clone() for w in trainer.learner.net.parameters()), played.mean_return]
            )
            trainer.save(tmp_path)
            if workers == 1:
                assert trainer.evaluate(4, record=tmp_path / "trajectories") == played, (
                    "recording changes nothing"
                )
                assert len(list((tmp_path / "trajectories").glob("*.npz"))) == 4
    assert all(
        bool((a == b).all()) if torch.is_tensor(a) else a == b
        for a, b in zip(*weights, strict=True)
    )
    with closing(Trainer.resume(tmp_path, task=SHORT, workers=1)) as resumed:
        assert resumed.iteration == 1
        assert resumed.config == config
    for other, words in (
        ({"backend": "grid"}, "backend='physics', not 'grid'"),
        ({"drive": "rollers"}, "drive="),
    ):
        with pytest.raises(InputError, match=f"it was begun with {words}"):
            Trainer.resume(tmp_path, task=SHORT, config=replace(config, **other))


def test_a_run_plays_in_the_physics_of_its_configuration(monkeypatch):
    asked = []

    def note(task, n_worlds, workers, engine, drive, randomization):
        asked.append((workers, engine, drive, randomization))

    monkeypatch.setattr("craftsim.learning.worlds.PhysicsVectorEnv", note)
    for drive, randomize in (("wheels", "none"), ("rollers", "lab_floor")):
        config = TrainConfig(
            "strip", worlds=1, width=8, backend="physics", drive=drive, randomize=randomize
        )
        assert Trainer(config, task=SHORT, workers=2, engine="ray").worlds is not None
    assert asked == [(2, "ray", "wheels", "none"), (2, "ray", "rollers", "lab_floor")]
