"""A rollout holds what the episodes of the grid or of physics do, and what a recurrent policy remembers of them."""

from contextlib import closing
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from craftsim.cli import main
from craftsim.discrete.kernel.codes import N_ACTIONS
from craftsim.discrete.kinds import Action
from craftsim.envs import parallel_env
from craftsim.envs.physics_vector import PhysicsVectorEnv
from craftsim.learning.config import TrainConfig
from craftsim.learning.evaluation import choose_actions, evaluate, evaluate_in_physics
from craftsim.learning.features import Features, LinearEncoder, make_encoder
from craftsim.learning.learner import drawn, drawn_offers
from craftsim.learning.policy import load_policy
from craftsim.learning.rollouts import distinct_features
from craftsim.learning.shape import Shape
from craftsim.learning.trainer import Trainer
from craftsim.learning.worlds import GridWorlds, Novelty, PhysicsWorlds, play_rollout
from craftsim.tasks import make_task
from craftsim.tasks.episodes import Episodes
from craftsim.tasks.kernel import ROW


def _encoder(task):
    return make_encoder(Shape.of(task, 4))


def _played(worlds, encoder, ticks):
    """Return what is played by random legal actions."""
    learner = SimpleNamespace(
        net=SimpleNamespace(encoder=encoder),
        act=lambda seen: drawn_offers(seen.offers),
        begin=lambda begun: None,
        ticks=ticks,
    )
    return play_rollout(worlds, learner)


def test_a_rollout_is_what_the_episodes_do():
    task = make_task("simple_two_story", max_steps=3)
    worlds, twin, encoder = (
        GridWorlds(task, 8),
        Episodes(task, np.random.default_rng(5), 8),
        _encoder(task),
    )
    worlds.reset(5)
    played = _played(worlds, encoder, 12)
    twin.reset()

    def same(seen):
        places = encoder.places(torch.from_numpy(twin.vectors()))
        return torch.equal(seen.places.long(), places) and np.array_equal(
            seen.offers.numpy(), twin.offered()
        )

    for t in range(12):
        assert same(played.before[t])
        steps = twin.step(played.actions[t].numpy())
        assert np.allclose(played.rewards[t].numpy(), steps.reward)
        assert np.array_equal(played.done[t].numpy(), steps.done)
        assert np.array_equal(played.terminated[t].numpy(), steps.success & steps.done)
        assert same(played.after[t])
        twin.reset(steps.done.nonzero()[0])
    assert played.done.sum() == 8 * 2  # every five ticks, though worlds are reset meanwhile


def _always(grid):
    return True


@pytest.mark.parametrize("ends", [True, False])
def test_an_episode_that_ends_by_its_time_alone_is_not_terminated_on_the_grid_or_in_physics(ends):
    """Work that is done at the last tick does not make the time that ends the episode its success."""
    task = replace(make_task("strip", max_steps=0), success=_always, ends_on_success=ends)
    encoder = _encoder(task)
    for execution in ("synchronous", "asynchronous"):
        worlds = GridWorlds(task, 3, "physical", None, execution)
        worlds.reset(0)
        played = _played(worlds, encoder, 4)
        assert played.done.any()
        assert torch.equal(played.terminated, played.done & ends)
    with closing(PhysicsWorlds(task, 2, workers=1)) as worlds:
        worlds.reset(0)
        played = _played(worlds, encoder, 2)
    assert played.done.any()
    assert torch.equal(played.terminated, played.done & ends)


def _is_at_edge(grid):
    """Return whether the first car is in the first column."""
    return int(grid.cars[0, 0]) == 0


def test_success_that_does_not_end_an_episode_counts_alike_on_the_grid_and_in_physics(monkeypatch):
    """The first car drives to the edge, and comes back before the episode ends: it has been there."""
    task = replace(make_task("strip", max_steps=1), success=_is_at_edge, ends_on_success=False)
    assert task.draw(np.random.default_rng(0)).cars[0, 0] == 1
    plan = []

    def act(net, seen, *_):
        action = (Action.MOVE_LEFT, Action.MOVE_RIGHT, Action.STOP)[len(plan)]
        plan.append(action)
        return np.full(seen.shape[:-1], int(action))

    monkeypatch.setattr("craftsim.learning.evaluation.choose_actions", act)
    net = Trainer(TrainConfig("strip")).learner.net
    on_grid = evaluate(net, task, 2, 0)
    plan.clear()
    with closing(PhysicsVectorEnv(task, 2, workers=1)) as envs:
        in_physics = evaluate_in_physics(net, envs, 2, 0)
    assert on_grid.successes == 2
    assert in_physics.successes == 2


def test_a_rollout_in_physics_keeps_the_last_observations_and_begins_each_episode_anew():
    task = make_task("strip", max_steps=0)  # two ticks an episode
    encoder = _encoder(task)
    with closing(PhysicsWorlds(task, 2, workers=1)) as worlds:
        worlds.reset(3)
        played = _played(worlds, encoder, 4)
        worlds.reset(3)
        start = encoder.places(torch.from_numpy(worlds.observe()[0].astype(np.int64)))
    assert played.done.T.tolist() == [[False, True, False, True]] * 2
    assert not played.terminated.any()
    now, after = played.before.places, played.after.places
    # A world sees what it saw last, but at an episode's end: the strip always starts the same.
    assert torch.equal(now[1], after[0])
    assert torch.equal(now[3], after[2])
    assert torch.equal(now[2], now[0])
    assert torch.equal(now[0].long(), start)


def test_an_asynchronous_rollout_is_what_the_cars_decide_one_by_one():
    task = make_task("simple_two_story", max_steps=3)
    worlds, encoder = GridWorlds(task, 8, "physical", None, "asynchronous"), _encoder(task)
    rollouts = []
    for _ in range(2):
        torch.manual_seed(0)
        worlds.reset(5)
        rollouts.append(_played(worlds, encoder, 30))
    played, again = rollouts
    assert all(
        torch.equal(getattr(played, name), getattr(again, name))
        for name in ("actions", "decides", "elapsed")
    )
    assert played.decides.any(-1).all()  # an event without a decision is none
    assert not played.decides.all(-1).all()
    assert played.decides[0].all()
    assert (played.elapsed >= 0).all()
    # A car in the middle of an action is offered nothing but to go on.
    only_stop = torch.nn.functional.one_hot(torch.tensor(int(Action.STOP)), 15).bool()
    assert (played.before.offers[~played.decides] == only_stop).all()
    # Four decisions of each car are an episode, but for a wait that an event ended.
    assert played.done.any(0).all()


def test_rows_are_the_same_exactly_where_all_their_columns_are():
    rows = torch.tensor([[1, 2], [1, 2], [2, 1], [1, 2], [1, -2]], dtype=torch.int32)
    flags = torch.tensor([[True], [True], [True], [False], [True]])
    once, inverse = distinct_features(Features(rows, flags))
    assert len(once.places) == 4
    assert torch.equal(once.places[inverse], rows)
    assert torch.equal(once.offers[inverse], flags)


def test_what_the_network_says_of_distinct_worlds_it_says_of_all():
    trainer = Trainer(TrainConfig("strip", worlds=20, width=8))
    with torch.random.fork_rng():
        seen = trainer.play(0).before.flat()
    net, (once, inverse) = trainer.learner.net, distinct_features(seen)
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
    worlds, novelty = GridWorlds(task, 2), Novelty(1.0, Shape.of(task, 4))
    worlds.reset(0)
    for k in range(1, 5):  # nothing is built: cars stand or drive
        worlds.step(np.full((2, 2), int(Action.STOP)))
        assert np.allclose(novelty(worlds.observe()[0]), (2 * k) ** -0.5)
    assert novelty.counts.sum() == 8


@pytest.fixture(scope="module")
def trained():
    trainer = Trainer(TrainConfig("strip", "vdn", worlds=6, width=8, recurrent=True))
    steps = 2 * trainer.steps_an_iteration
    list(trainer.run(steps, until=2.0))
    return trainer


def test_values_to_learn_from_are_those_of_acting_tick_by_tick(trained):
    net, rollout = trained.learner.net, trained.play(1)
    rollout = replace(
        rollout, done=torch.rand(rollout.done.shape, generator=torch.manual_seed(0)) < 0.1
    )
    memory, found, ends = net.memory(*rollout.actions.shape[1:]), [], []
    with torch.no_grad():
        now, after = net.of_rollouts(rollout)
        for t, actions in enumerate(rollout.actions):
            found.append(net(rollout.before[t], memory))
            memory.last.copy_(actions)
            ends.append(net(rollout.after[t], type(memory)(memory.hidden.clone(), memory.last)))
            memory.forget(rollout.done[t])
    torch.testing.assert_close(now, torch.stack(found))
    torch.testing.assert_close(after, torch.stack(ends))
    goes_on = ~rollout.done[:-1]
    torch.testing.assert_close(after[:-1][goes_on], now[1:][goes_on])
    assert net.of_rollouts(rollout)[0].requires_grad


def test_only_a_network_of_last_actions_sees_them():
    for sees in (True, False):
        config = TrainConfig("strip", "vdn", width=8, recurrent=True, last_action=sees)
        trainer = Trainer(replace(config, network="linear", worlds=2))
        net, seen = trainer.learner.net, trainer.play(1).before[0]
        rest = [net(seen, net.memory(2, 2)._replace(last=torch.full((2, 2), k))) for k in (0, 1)]
        assert torch.equal(*rest) is not sees


def test_a_linear_layer_sees_ticks_above_those_of_a_byte():
    shape = Shape.of(make_task("strip", max_steps=300), 8, "linear", ticks=302)
    encoder = LinearEncoder(shape)
    observed = np.full((1, shape.n_cars, shape.vector_length), 300)
    features = encoder.look(observed, np.ones((1, shape.n_cars, 15), np.bool_))
    assert (features.places == 300).all()


@pytest.mark.parametrize("network", ["map", "relative", "linear"])
def test_a_policy_may_see_the_tick_and_whether_a_helper_is_under_way(network, tmp_path):
    config = TrainConfig(
        "strip",
        "vdn",
        worlds=2,
        width=8,
        network=network,
        rules="published",
        helper_depth=20,
        shows_hidden=True,
        novelty=0.1,
    )
    trainer = Trainer(config)
    shown, shape = GridWorlds(trainer.task, 2, "published", 20, shows_hidden=True), trainer.shape
    hidden = GridWorlds(trainer.task, 2, "published", 20)
    for worlds in (shown, hidden):
        worlds.reset(0)
        worlds.episodes.queue[1, 0, 0] = int(Action.LIFT)
        worlds.episodes.t[:] = 7
    vectors, masks = shown.observe()
    assert vectors.shape[-1] == shape.vector_length == hidden.observe()[0].shape[-1] + ROW
    assert np.array_equal(vectors[..., :-ROW], hidden.observe()[0])
    own_and_other = [[[7, 0, 0], [7, 0, 0]], [[7, 1, 0], [7, 0, 1]]]
    assert vectors[..., -ROW:-10].tolist() == own_and_other
    # A car that does not decide has one action.
    assert masks[1, 0].nonzero()[0].tolist() == [Action.STOP]
    others = np.array([[True, True], [False, True]])
    assert np.array_equal(masks[others], hidden.observe()[1][others])
    # All cells and things are looked up as ever, and by two places more.
    net = trainer.learner.net
    places = net.encoder.look(vectors, masks).places
    if network != "linear":
        plain = make_encoder(Shape.of(trainer.task, 8, network)).look(vectors[..., :-ROW], masks)
        assert torch.equal(places[..., :-2], plain.places)
        assert len(set(places[..., -2].flatten().tolist())) == 1
        assert len(set(places[..., -1].flatten().tolist())) == 3
        assert places.max() < net.encoder.table.num_embeddings
    # The bonus for new buildings does not depend on the tick.
    assert trainer.novelty(vectors).tolist() == pytest.approx([0.1 * 0.5**0.5] * 2)
    list(trainer.run(trainer.steps_an_iteration, until=2.0))
    trainer.save(tmp_path)
    policy, env = load_policy(tmp_path), parallel_env("strip", "grid")
    for weight in policy.net.parameters():
        weight.data.normal_()
    observations = dict(env.reset(seed=0)[0])
    seen = []
    policy.net.register_forward_pre_hook(lambda _, inputs: seen.append(inputs[0].places))
    for _ in range(2):
        policy(observations)
    policy.reset()
    policy(observations)
    assert torch.equal(seen[0], seen[2])
    assert not torch.equal(seen[0], seen[1])


@pytest.mark.parametrize("shows_hidden", [False, True])
def test_the_time_limit_ends_an_episode_where_the_tick_is_shown(shows_hidden):
    task = replace(make_task("strip"), max_steps=1)
    worlds = GridWorlds(task, 2, shows_hidden=shows_hidden)
    worlds.reset(0)
    stops = np.full((2, task.layout.n_cars), int(Action.STOP))
    worlds.observe()
    steps = [worlds.step(stops) for _ in range(3)]
    assert [step.done.tolist() for step in steps] == [[False] * 2, [False] * 2, [True] * 2]
    assert steps[-1].terminated.tolist() == [shows_hidden] * 2
    assert not any(step.terminated.any() for step in steps[:-1])


def test_what_a_helper_has_still_to_do_may_outlive_an_episode():
    """As in CraftEnv (smartcar.py:74-109), where nothing clears it."""
    for survives in (True, False):
        worlds = GridWorlds(make_task("strip"), 3, "published", 20, queue_survives=survives)
        worlds.reset(0)
        worlds.episodes.queue[:, :, 0] = int(Action.LIFT)
        worlds.episodes.t[1] = 18
        worlds.reset(1)
        assert (worlds.episodes.queue == int(Action.LIFT)).any() == survives
        assert (worlds.episodes.t == 0).all()
        worlds.episodes.queue[:, :, 0] = int(Action.DROP)
        worlds.episodes.t[1] = 19
        worlds.step(np.zeros((3, 2), np.int64))
        worlds.episodes.queue[:, :, 0] = int(Action.DROP)
        worlds.restart()
        left = (worlds.episodes.queue[:, :, 0] == int(Action.DROP)).all(-1)
        assert left.tolist() == [True, survives, True]


def test_a_learner_forgets_episodes_that_are_over_while_it_plays(trained, monkeypatch):
    forgotten = []
    monkeypatch.setattr(
        type(trained.learner), "begin", lambda self, worlds: forgotten.append(worlds.tolist())
    )
    rollout = trained.play(1)
    trained.learner.acting = None
    over = [done.tolist() for done in rollout.done if done.any()]
    assert over
    assert forgotten == [[True] * 6, *over]


def test_a_policy_forgets_the_episode_before(trained, tmp_path):
    trained.save(tmp_path)
    policy, env, episodes = load_policy(tmp_path), parallel_env("strip", "grid"), []
    torch.manual_seed(0)
    for weight in policy.net.parameters():
        weight.data.normal_()  # so that what is remembered decides
    for _ in range(2):
        observations, done = env.reset(seed=3)[0], []
        while env.agents:
            done.append(policy(observations))
            observations = env.step(done[-1])[0]
        episodes.append(done)
    assert episodes[0] == episodes[1]
    worlds = Episodes(make_task("strip"), np.random.default_rng(0), 1)
    memory, first = trained.learner.net.memory(1, worlds.n_cars), []
    looks = enumerate(zip(worlds.vectors()[0], worlds.offered()[0], strict=True))
    seen = {f"car_{car}": {"observation": row, "action_mask": mask} for car, (row, mask) in looks}
    for _ in range(2):
        policy.reset()
        first.append(policy(seen))
    assert first[0] == first[1]
    assert [*first[0].values()] == choose_actions(
        policy.net, worlds.vectors(), worlds.offered(), memory=memory
    )[0].tolist()
    assert (memory.last < N_ACTIONS).all()


def test_policies_that_learnt_values_are_evaluated_on_the_grid(trained, tmp_path):
    trained.save(tmp_path)
    words = ["validate", "strip", "--backend", "grid", "--trials", "2", "--policy"]
    assert main([*words, str(tmp_path), "--out", str(tmp_path / "out")]) == 0


def test_settings_of_a_command_may_be_true_or_false(tmp_path):
    words = [
        "--steps",
        "80",
        "--recurrent",
        "--worlds",
        "1",
        "--width",
        "4",
        "--episodes",
        "1",
        "--out",
    ]
    assert main(["train", "strip", "--algo", "vdn", *words, str(tmp_path)]) == 0
    assert load_policy(tmp_path).net.recurrent
