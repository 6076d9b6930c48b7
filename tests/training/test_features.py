"""What the networks see of a world."""

import numpy as np
import pytest
import torch

from craftsim.discrete.tasks import TASK_NAMES, make_task
from craftsim.discrete.tasks.episodes import Episodes
from craftsim.discrete.tasks.observation import IS_BLOCK, ROW
from craftsim.training.features import Encoder, Shape


@pytest.mark.parametrize("name", TASK_NAMES)
def test_different_entities_have_places_of_their_own(name):
    task = make_task(name)
    episodes, rng = Episodes(task, np.random.default_rng(0), 200), np.random.default_rng(1)
    encoder = Encoder(Shape.of(task, 4))
    rows_at: dict[int, tuple] = {}
    for _ in range(25):
        vectors = episodes.vectors()
        places = encoder.places(torch.from_numpy(vectors)).numpy()
        assert places.min() >= 0
        assert places.max() <= encoder.absent
        rows = vectors.reshape(*places.shape, ROW)
        for own in (True, False):
            some = slice(0, 1) if own else slice(1, None)
            for place, row in zip(
                places[..., some].ravel(), rows[..., some, :].reshape(-1, ROW), strict=True
            ):
                if place != encoder.absent:
                    assert rows_at.setdefault(int(place), (own, *row)) == (own, *row)
        mask = episodes.offered()
        done = episodes.step((rng.random(mask.shape) * mask).argmax(-1)).done
        episodes.reset(done.nonzero()[0])
    shown = rows[..., 3:9].any(-1)
    assert np.array_equal(places != encoder.absent, shown)


def test_the_order_of_blocks_plays_no_part():
    task = make_task("strip")
    episodes = Episodes(task, np.random.default_rng(0), 1)
    seen, mask = torch.from_numpy(episodes.vectors()), torch.from_numpy(episodes.offered())
    rows = seen.unflatten(-1, (-1, ROW))
    blocks = rows[0, 0, :, IS_BLOCK].nonzero()[:, 0]
    turned = rows.clone()
    turned[:, :, blocks] = rows[:, :, blocks.flip(0)]
    encoder = Encoder(Shape.of(task, 8))
    assert not torch.equal(turned, rows)
    assert torch.allclose(encoder(turned.flatten(-2), mask), encoder(seen, mask), atol=1e-6)
