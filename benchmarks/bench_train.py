"""What a rollout and an update of IPPO with its shipped settings take, on one thread, beside the grid alone."""

import numpy as np
import pytest

from craftsim.tasks import make_task
from craftsim.tasks.episodes import Episodes

torch = pytest.importorskip("torch")


@pytest.mark.parametrize("what", ["grid", "rollout", "update"])
@pytest.mark.parametrize("task", ["strip", "simple_two_story"])
def test_ippo(benchmark, task, what):
    """``steps``, in the report, is how many a call has: one tick of one world each."""
    from craftsim.learning.config import TrainConfig
    from craftsim.learning.trainer import Trainer

    torch.set_num_threads(1)
    trainer = Trainer(TrainConfig(task, seed=0))
    rng = np.random.default_rng(0)
    episodes = Episodes(make_task(task), rng, trainer.config.worlds)
    episodes.reset()

    def grid():
        for _ in range(trainer.learner.ticks):
            mask = episodes.offered()
            done = episodes.step((rng.random(mask.shape) * mask).argmax(-1)).done
            episodes.reset(done.nonzero()[0])

    rollout = trainer.play(0)
    trainer.learner.update(rollout)
    work = {
        "grid": grid,
        "rollout": lambda: trainer.play(1),
        "update": lambda: trainer.learner.update(rollout),
    }[what]
    benchmark.pedantic(work, rounds=5)
    benchmark.extra_info["steps"] = trainer.steps_an_iteration
