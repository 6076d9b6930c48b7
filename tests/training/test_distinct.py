"""The distinct ones among what was observed."""

import torch

from craftsim.discrete.tasks import make_task
from craftsim.training.config import TrainConfig
from craftsim.training.distinct import Distinct
from craftsim.training.networks import MASK, OBSERVATION
from craftsim.training.trainer import Trainer


def test_rows_are_the_same_exactly_where_all_their_columns_are():
    rows = torch.tensor([[1, 2], [1, 2], [2, 1], [1, 2], [1, -2]], dtype=torch.int16)
    flags = torch.tensor([[True], [True], [True], [False], [True]])
    distinct = Distinct(rows, flags)
    assert len(distinct.first) == 4
    assert distinct.first[distinct.inverse].tolist() == [0, 0, 2, 3, 4]


def test_what_the_network_says_of_distinct_worlds_it_says_of_all():
    trainer = Trainer(TrainConfig("strip", worlds=20, width=8), task=make_task("strip"))
    with torch.random.fork_rng():
        rollout = trainer.play(0).reshape(-1)
    seen, masks, net = rollout[OBSERVATION], rollout[MASK], trainer.learner.net
    distinct = Distinct(seen, masks)
    assert len(distinct.first) < len(seen)
    said = net(seen[distinct.first], masks[distinct.first])[distinct.inverse]
    assert torch.allclose(said, net(seen, masks), atol=1e-6)
