"""What the networks see of a world."""

import numpy as np
import pytest
import torch
from torch import nn

from craftsim.discrete.kinds import MOVE_DIRECTION
from craftsim.learning.features import Features, make_encoder
from craftsim.learning.networks import CarNet
from craftsim.learning.shape import Shape
from craftsim.tasks import TASK_NAMES, as_task, make_task
from craftsim.tasks.episodes import Episodes
from craftsim.tasks.kernel import (
    IS_BLOCK,
    IS_BODY,
    IS_CAR,
    IS_FOOT,
    IS_FSLOPE,
    IS_GOAL,
    ROW,
    YAW_HIGH,
    YAW_LOW,
)
from craftsim.tasks.random_tasks import random_task


@pytest.mark.parametrize("name", TASK_NAMES)
def test_different_entities_have_places_of_their_own(name):
    task = make_task(name)
    episodes, rng = Episodes(task, np.random.default_rng(0), 40), np.random.default_rng(1)
    encoder = make_encoder(Shape.of(task, 4))
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
    encoder = make_encoder(Shape.of(task, 8))
    assert not torch.equal(turned, rows)
    vectors = [encoder(Features(encoder.places(rows), mask)) for rows in (turned.flatten(-2), seen)]
    assert torch.allclose(*vectors, atol=1e-6)


def _turned(grids_rows, size, quarters):
    """Return rows as they are after a quarter turn of a square world, counter-clockwise, so many times."""
    rows = grids_rows.copy()
    for _ in range(quarters):
        x, y = rows[..., 0].copy(), rows[..., 1].copy()
        there = rows[..., 3:10].any(-1)
        rows[..., 0] = np.where(there, size - 1 - y, 0)
        rows[..., 1] = np.where(there, x, 0)
        turns = rows[..., [IS_CAR, IS_FSLOPE, IS_BODY, IS_FOOT]].any(-1)
        yaw = (2 * rows[..., YAW_HIGH] + rows[..., YAW_LOW] + turns) % 4
        rows[..., YAW_HIGH], rows[..., YAW_LOW] = yaw >> 1, yaw & 1
    return rows


def _values(net, observation, mask):
    return net(Features(net.encoder.places(observation), mask))


def test_a_world_that_is_turned_looks_the_same_from_a_car():
    task = as_task("designs")
    episodes, rng = Episodes(task, np.random.default_rng(0), 100), np.random.default_rng(1)
    net = CarNet(Shape.of(task, 4, "relative"))
    nn.init.normal_(net.head[1][-1].weight)
    encoder, size = net.encoder, task.starts[0].size[0]
    for _ in range(20):
        mask = episodes.offered()
        episodes.step((rng.random(mask.shape) * mask).argmax(-1))
    rows = episodes.vectors().reshape(100, 2, -1, ROW)
    places = encoder.places(torch.from_numpy(rows).flatten(-2))
    assert encoder.own <= int(places[..., 1:].min())
    assert int(places.max()) <= encoder.absent
    offered = torch.from_numpy(episodes.offered())
    values = _values(net, torch.from_numpy(rows).flatten(-2), offered)
    moves = sorted(MOVE_DIRECTION, key=MOVE_DIRECTION.__getitem__)
    for quarters in (1, 2, 3):
        seen = torch.from_numpy(_turned(rows, size, quarters)).flatten(-2)
        assert torch.equal(encoder.places(seen)[..., 1:], places[..., 1:])
        order = torch.arange(15)
        order[moves] = torch.tensor(moves).roll(quarters)
        torch.testing.assert_close(_values(net, seen, offered[..., order]), values[..., order])


def test_a_design_that_is_built_looks_otherwise_than_one_that_is_not():
    task = as_task("random_strip")
    encoder = make_encoder(Shape.of(task, 4, "relative"))
    episodes = Episodes(task, np.random.default_rng(0), 50)
    free = encoder.places(torch.from_numpy(episodes.vectors()))[..., -task.layout.n_targets :]
    rows = episodes.vectors().reshape(50, task.layout.n_cars, -1, ROW)
    targets, blocks = rows[..., -task.layout.n_targets :, :3], rows[..., IS_BLOCK].astype(bool)
    built = (rows[:, :, None, :, :3] == targets[..., None, :]).all(-1) & (
        blocks & (rows[..., IS_GOAL] == 0)
    )[:, :, None]
    kinds = (free - encoder.own) // encoder.offsets // encoder.n_forms
    assert torch.equal(kinds, 1 + torch.from_numpy(built.any(-1)).long())


def test_networks_that_look_from_a_car_see_where_the_flag_is_to_go():
    task = as_task("random_breaking_barrier")
    seen = torch.from_numpy(Episodes(task, np.random.default_rng(0), 30).vectors())
    rows = seen.unflatten(-1, (-1, ROW)).clone()
    goal = (rows[..., IS_GOAL] != 0) & ~rows[..., IS_CAR:IS_GOAL].any(-1)
    assert (goal.sum(-1) == 1).all()
    rows[..., 0] = torch.where(goal, (rows[..., 0] + 1) % task.starts[0].size[0], rows[..., 0])
    encoder = make_encoder(Shape.of(task, 4, "relative"))
    places, elsewhere = encoder.places(seen), encoder.places(rows.flatten(-2))
    assert torch.equal(places != elsewhere, goal)


def test_networks_that_look_from_a_car_serve_more_cars():
    two, three = (random_task("strip", n_cars=n) for n in (2, 3))
    net = CarNet(Shape.of(two, 8, "relative"))
    assert net.encoder.absent == make_encoder(Shape.of(three, 8, "relative")).absent
    episodes = Episodes(three, np.random.default_rng(0), 4)
    seen, mask = torch.from_numpy(episodes.vectors()), torch.from_numpy(episodes.offered())
    assert _values(net, seen, mask).shape == (4, 3, 15)
