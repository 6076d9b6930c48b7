"""A rollout holds what the episodes of the grid or of physics do, tick by tick, and which of its rows are the same."""

from contextlib import closing

import numpy as np
import torch

from craftsim.discrete.grid import CarField
from craftsim.discrete.kinds import Action
from craftsim.discrete.tasks import make_task
from craftsim.discrete.tasks.episodes import Episodes
from craftsim.training.features import Encoder
from craftsim.training.learner import drawn, drawn_offers
from craftsim.training.rollouts import (
    BUCKETS,
    GridWorlds,
    NoveltyWorlds,
    PhysicsWorlds,
    Seen,
    distinct,
    play,
)
from craftsim.training.shape import Shape
from craftsim.training.trainer import TrainConfig, Trainer


def _encoder(task):
    return Encoder(Shape.of(task, 4))


def _random_legal(seen):
    return drawn_offers(seen.offers)


def test_a_rollout_is_what_the_episodes_do():
    task = make_task("simple_two_story", max_steps=3)
    worlds, twin, encoder = GridWorlds(task, 8), Episodes(task, np.random.default_rng(5), 8), _encoder(task)
    worlds.reset(5)
    played = play(worlds, encoder, _random_legal, 12)
    twin.reset()

    def same(seen):
        places = encoder.places(torch.from_numpy(twin.vectors()))
        return torch.equal(seen.places.long(), places) and np.array_equal(seen.offers.numpy(), twin.offered())

    for t in range(12):
        assert same(played.now[t])
        steps = twin.step(played.actions[t].numpy())
        assert np.allclose(played.rewards[t].numpy(), steps.reward)
        assert np.array_equal(played.done[t].numpy(), steps.done)
        assert np.array_equal(played.terminated[t].numpy(), steps.success & steps.done)
        assert same(played.after[t])
        twin.reset(steps.done.nonzero()[0])
    assert played.done.sum() == 8 * 2  # every five ticks, though worlds are reset meanwhile


def test_a_rollout_in_physics_keeps_the_last_observations_and_begins_each_episode_anew():
    task = make_task("strip", max_steps=0)  # two ticks an episode
    encoder = _encoder(task)
    with closing(PhysicsWorlds(task, 2, workers=1)) as worlds:
        worlds.reset(3)
        played = play(worlds, encoder, _random_legal, 4)
        worlds.reset(3)
        start = encoder.places(torch.from_numpy(worlds.observe()[0].astype(np.int64)))
    assert played.done.T.tolist() == [[False, True, False, True]] * 2
    assert not played.terminated.any()
    now, after = played.now.places, played.after.places
    # A world sees what it saw last, but at an episode's end: the strip always starts the same.
    assert torch.equal(now[1], after[0])
    assert torch.equal(now[3], after[2])
    assert torch.equal(now[2], now[0])
    assert torch.equal(now[0].long(), start)


def test_an_asynchronous_rollout_is_what_the_cars_decide_one_by_one():
    task = make_task("simple_two_story", max_steps=3)
    worlds, encoder = GridWorlds(task, 8, asynchronous=True), _encoder(task)
    rollouts = []
    for _ in range(2):
        torch.manual_seed(0)
        worlds.reset(5)
        rollouts.append(play(worlds, encoder, _random_legal, 30))
    played, again = rollouts
    assert all(
        torch.equal(getattr(played, name), getattr(again, name)) for name in ("actions", "decides", "elapsed")
    )
    assert played.decides.any(-1).all()  # an event without a decision is none
    assert not played.decides.all(-1).all()
    assert played.decides[0].all()
    assert (played.elapsed >= 0).all()
    # A car in the middle of an action is offered nothing but to go on.
    only_stop = torch.nn.functional.one_hot(torch.tensor(int(Action.STOP)), 15).bool()
    assert (played.now.offers[~played.decides] == only_stop).all()
    # Four decisions of each car are an episode, but for a wait that an event ended.
    assert played.done.any(0).all()


def test_a_car_that_can_do_nothing_is_offered_stop():
    episodes = Episodes(make_task("simple_two_story"), np.random.default_rng(0), 1)
    cars = episodes.grids.cars
    cars[0, 0, [CarField.YAW, CarField.SLOPE]] = 2, 1  # as if on a slope that leads up to the edge of the map
    assert not episodes.legal()[0, 0].any()
    assert episodes.offered()[0, 0].nonzero()[0].tolist() == [Action.STOP]


def test_rows_are_the_same_exactly_where_all_their_columns_are():
    rows = torch.tensor([[1, 2], [1, 2], [2, 1], [1, 2], [1, -2]], dtype=torch.int32)
    flags = torch.tensor([[True], [True], [True], [False], [True]])
    once, inverse = distinct(Seen(rows, flags))
    assert len(once.places) == 4
    assert torch.equal(once.places[inverse], rows)
    assert torch.equal(once.offers[inverse], flags)


def test_what_the_network_says_of_distinct_worlds_it_says_of_all():
    trainer = Trainer(TrainConfig("strip", worlds=20, width=8))
    with torch.random.fork_rng():
        seen = trainer.play(0).now.flat()
    net, (once, inverse) = trainer.learner.net, distinct(seen)
    assert len(once.places) < len(seen.places)
    assert torch.allclose(net(once)[inverse], net(seen), atol=1e-6)


def test_actions_are_drawn_with_the_probabilities_of_their_logits_and_only_where_offered():
    torch.manual_seed(0)
    probs = torch.tensor([0.5, 0.0, 0.2, 0.3])
    found = torch.bincount(drawn(probs.log().expand(40_000, 4)), minlength=4) / 40_000
    assert torch.allclose(found, probs, atol=0.01)
    offers = torch.tensor([True, False, True, True])
    found = torch.bincount(drawn_offers(offers.expand(40_000, 4)), minlength=4) / 40_000
    assert torch.allclose(found, offers / 3, atol=0.01)


def test_the_bonus_for_new_buildings_fades_and_does_not_depend_on_where_cars_are():
    task = make_task("strip")
    counts = np.zeros(BUCKETS, np.int32)
    worlds = NoveltyWorlds(GridWorlds(task, 2), 1.0, Shape.of(task, 4), counts)
    worlds.reset(0)
    bonuses = []
    for _ in range(4):  # nothing is built: cars stand or drive
        reward = worlds.step(np.full((2, 2), int(Action.STOP))).reward
        bonuses.append(reward.tolist())
    assert np.allclose(bonuses, [[(2 * k) ** -0.5] * 2 for k in range(1, 5)])
    assert counts.sum() == 8
