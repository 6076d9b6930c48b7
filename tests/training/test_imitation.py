"""Imitation of the planner: what is shown, and that a policy then does it."""

from contextlib import closing
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import torch

from craftsim.discrete.kinds import Action
from craftsim.discrete.rules import Rules
from craftsim.discrete.tasks import as_task
from craftsim.discrete.tasks.episodes import Episodes
from craftsim.errors import InputError
from craftsim.training.config import TrainConfig
from craftsim.training.demonstrations import NOT_SHOWN, planned_demonstrations
from craftsim.training.evaluation import choose_actions
from craftsim.training.ppo import imitate
from craftsim.training.trainer import Trainer


@pytest.mark.parametrize("name", ["random_strip", "random_breaking_barrier", "designs"])
def test_what_is_shown_leads_from_world_to_world_by_the_rules(name):
    task, rules = as_task(name), Rules("physical")
    shown = planned_demonstrations(task, 5, np.random.default_rng(0))
    assert len(shown.worlds) == len(shown.actions) == len(shown.rewards) == len(shown.first)
    assert shown.first.sum() == 5
    for i in np.flatnonzero(~shown.first):
        before, after = shown.worlds.grid(i - 1), shown.worlds.grid(i)
        did = [
            (car, Action(action)) for car, action in enumerate(shown.actions[i - 1]) if action != NOT_SHOWN
        ]
        tries = [rules.tick(before, joint)[0] for joint in (did, did[::-1])]
        assert any(grid.same_visible(after) for grid in tries)
        assert np.array_equal(shown.worlds.designs[i - 1], shown.worlds.designs[i])


def test_episodes_may_all_start_with_what_was_shown():
    trainer = Trainer(TrainConfig("random_strip", worlds=50, imitate=3, shown_share=1.0))
    assert trainer.guidance.shown is not None
    assert trainer.guidance.starts is not None
    drawn = trainer.guidance.starts.draw_starts(np.random.default_rng(0), 50)
    assert set(drawn.digests()) <= set(trainer.guidance.shown.worlds.digests())
    with pytest.raises(InputError, match="nothing is imitated"):
        TrainConfig("random_strip", shown_share=1.0)
    with pytest.raises(InputError, match="it is of the plans"):
        Trainer(TrainConfig("strip", imitate=3, shown_share=1.0))


def test_returns_add_up_to_the_end_of_each_plan():
    shown = planned_demonstrations(as_task("random_strip"), 4, np.random.default_rng(0))
    returns = shown.returns(0.5)
    firsts = [*np.flatnonzero(shown.first), len(returns)]
    for first, end in pairwise(firsts):
        for i in range(first, end):
            expected = sum(0.5 ** (j - i) * shown.rewards[j] for j in range(i, end))
            assert returns[i] == pytest.approx(expected)


def test_the_same_seed_shows_the_same():
    first, again = (planned_demonstrations(as_task("designs"), 3, np.random.default_rng(5)) for _ in range(2))
    assert first.worlds.digests() == again.worlds.digests()
    assert np.array_equal(first.actions, again.actions)


def test_a_policy_does_what_it_was_shown():
    torch.manual_seed(0)
    trainer = Trainer(TrainConfig("random_strip", worlds=4, imitate=5))
    shown = trainer.guidance.shown
    episodes = Episodes(trainer.task, np.random.default_rng(0), len(shown.actions))
    episodes.begin(np.arange(len(shown.actions)), shown.worlds)
    seen, offered = episodes.vectors(), episodes.offered()
    taught = np.take_along_axis(offered, shown.actions.clip(0)[..., None], -1)[..., 0]
    taught &= shown.actions != NOT_SHOWN

    def alike():
        done = choose_actions(trainer.learner.net, seen, offered)
        return (done == shown.actions)[taught].mean()

    assert alike() < 0.4
    imitate(trainer.learner, trainer.task, shown)
    assert alike() > 0.9


def test_half_of_the_episodes_start_on_the_way_of_a_plan():
    trainer = Trainer(TrainConfig("designs", worlds=400, width=4, network="relative", imitate=5))
    shown = {world.tobytes() for world in trainer.guidance.shown.worlds.designs}
    there = sum(design.tobytes() in shown for design in trainer.worlds.episodes.designs)
    assert 140 < there < 260


def test_a_run_that_imitates_goes_on_as_if_it_had_never_stopped(goes_on):
    goes_on(TrainConfig("designs", worlds=4, width=8, network="relative", imitate=3))


def test_what_does_not_go_with_plans_is_refused():
    for options in [{"algo": "qmix"}, {"rules": "published"}, {"explore": 5}]:
        with pytest.raises(InputError, match="leave imitate out"):
            TrainConfig("strip", imitate=5, **options)
        with pytest.raises(InputError, match="imitate: -1 is out"):
            TrainConfig("strip", imitate=-1)


def test_a_task_that_nothing_can_be_planned_for_is_refused():
    task = as_task("random_strip")
    short = replace(task, max_steps=1)
    with pytest.raises(InputError, match="no plan within 3 ticks for any of 2 starts"):
        planned_demonstrations(short, 2, np.random.default_rng(0))


def test_an_evaluation_in_physics_starts_where_the_task_does(monkeypatch):
    config = TrainConfig("random_strip", worlds=1, width=4, network="relative", backend="physics", imitate=2)
    monkeypatch.setattr("craftsim.training.trainer.evaluate_in_physics", lambda net, worlds, *_: worlds.task)
    with closing(Trainer(config, workers=1)) as trainer:
        assert trainer.worlds.envs.task is not trainer.task
        assert trainer.evaluate(1) is trainer.task


def test_what_was_imitated_is_evaluated_at_once():
    trainer = Trainer(TrainConfig("random_strip", worlds=4, width=8, network="relative", imitate=2))
    assert list(trainer.run(2 * trainer.steps_an_iteration, until=2.0)) == [True, False]
