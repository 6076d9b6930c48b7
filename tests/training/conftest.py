"""Tests of training run on one thread: sums are then added up in one order."""

import pytest
import torch

from craftsim.training.trainer import Trainer


@pytest.fixture(autouse=True)
def _one_thread():
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture
def goes_on(tmp_path):
    """Hold that a run of a configuration ends alike, whether it was stopped after an iteration or not."""

    def check(config):
        whole, part = Trainer(config), Trainer(config)
        steps = whole.steps_an_iteration
        list(whole.run(2 * steps, until=2.0))
        list(part.run(steps, until=2.0))
        part.save(tmp_path)
        resumed = Trainer.resume(tmp_path, config=config)
        assert resumed.iteration == 1
        list(resumed.run(2 * steps, until=2.0))
        ends = (run.learner.net.state_dict().values() for run in (whole, resumed))
        assert all(a.equal(b) for a, b in zip(*ends, strict=True))

    return check
