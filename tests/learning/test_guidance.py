"""What a run is given before it learns: exploration and plans, and that a policy then does what these show."""

from contextlib import closing
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import torch

from craftsim.discrete.grid import CarField, Kind
from craftsim.discrete.kinds import Action
from craftsim.discrete.rules import Rules
from craftsim.errors import InputError
from craftsim.learning.algorithms import ALGORITHMS, with_trait
from craftsim.learning.config import TrainConfig
from craftsim.learning.evaluation import choose_actions
from craftsim.learning.exploration import explore
from craftsim.learning.policy_gradient import imitate
from craftsim.learning.starts import NOT_SHOWN, planned_demonstrations
from craftsim.learning.trainer import Trainer
from craftsim.tasks import as_task, make_task
from craftsim.tasks.episodes import Episodes
from craftsim.tasks.starts import targets_of


def _explored(seed, rules="published", ticks=20_000):
    task = make_task("block")
    return task, *explore(task, rules, ticks, np.random.default_rng(seed))


def potential(task, grid):
    return task.potential(grid[None], targets_of(task.design)[None])[0]


def test_it_reaches_every_potential_but_the_last():
    task, starts, _, _ = _explored(0)
    assert {potential(task, grid) for grid in starts} == {0.0, 1.0, 2.0, 3.0}
    assert not any(task.succeeded(grid) for grid in starts)


@pytest.mark.parametrize("rules", ["published", "physical"])
def test_the_way_to_the_best_world_can_be_gone_again(rules):
    task, starts, way, ticks = _explored(2, rules)
    assert len(ticks) == len(way) - 1
    grid = task.draw(np.random.default_rng(0))
    for joint, reached in zip(ticks, way[1:], strict=True):
        grid, applied = Rules(rules).tick(grid, joint)
        assert applied.all()
        assert grid.same_visible(reached)
    assert potential(task, grid) == max(potential(task, other) for other in starts + way)


def test_the_same_seed_reaches_the_same_legal_worlds_and_another_something_else():
    task, *first = _explored(1, "physical", 5000)
    again, other = (_explored(seed, "physical", 5000)[1] for seed in (1, 2))
    rows = [[grid.cars.tolist() for grid in grids] for grids in (first[0], again, other)]
    assert rows[0] == rows[1] != rows[2]
    start = task.draw(np.random.default_rng(0))
    for grid in first[0][:200]:
        loads = np.count_nonzero(grid.cars[:, CarField.LOAD] != Kind.AIR)
        assert np.count_nonzero(grid.kind) + loads == np.count_nonzero(start.kind)
        assert Rules("physical").mask(grid).shape == (grid.n_cars, 15)


EXPLORED = {"task": "block", "rules": "published", "helper_depth": 20, "explore": 20_000}


@pytest.mark.parametrize(
    "given", [EXPLORED, {"task": "random_strip", "imitate": 5}], ids=["explored", "planned"]
)
def test_a_policy_does_what_it_was_shown(given):
    torch.manual_seed(0)
    trainer = Trainer(TrainConfig(worlds=4, **given))
    config, shown = trainer.config, trainer.guidance.demonstrations
    # Without a plan no car has to wait: all that they did is shown, STOP too.
    assert not config.explore or (shown.actions != NOT_SHOWN).all()
    rules = config.rules, config.helper_depth
    episodes = Episodes(trainer.task, np.random.default_rng(0), len(shown.actions), *rules)
    episodes.begin(np.arange(len(shown.actions)), shown.worlds)
    seen, offered = episodes.vectors(), episodes.offered()
    taught = np.take_along_axis(offered, shown.actions.clip(0)[..., None], -1)[..., 0]
    taught &= shown.actions != NOT_SHOWN

    def alike():
        return (choose_actions(trainer.learner.net, seen, offered) == shown.actions)[taught].mean()

    assert alike() < 0.4
    imitate(trainer.learner, trainer.task, shown, *rules)
    assert alike() > 0.9


@pytest.mark.parametrize("name", ["random_strip", "random_breaking_barrier", "designs"])
def test_what_is_shown_leads_from_world_to_world_by_the_rules(name):
    task, rules = as_task(name), Rules("physical")
    shown = planned_demonstrations(task, 5, np.random.default_rng(0))
    assert len(shown.worlds) == len(shown.actions) == len(shown.rewards) == len(shown.first)
    assert shown.first.sum() == 5
    for i in np.flatnonzero(~shown.first):
        before, after = shown.worlds.grid(i - 1), shown.worlds.grid(i)
        did = [
            (car, Action(action))
            for car, action in enumerate(shown.actions[i - 1])
            if action != NOT_SHOWN
        ]
        tries = [rules.tick(before, joint)[0] for joint in (did, did[::-1])]
        assert any(grid.same_visible(after) for grid in tries)
        assert np.array_equal(shown.worlds.designs[i - 1], shown.worlds.designs[i])


def test_episodes_may_all_start_with_what_was_shown():
    trainer = Trainer(TrainConfig("random_strip", worlds=50, imitate=3, shown_share=1.0))
    assert trainer.guidance.demonstrations is not None
    assert trainer.guidance.starts is not None
    drawn = trainer.guidance.starts.draw_starts(np.random.default_rng(0), 50)
    assert set(drawn.digests()) <= set(trainer.guidance.demonstrations.worlds.digests())
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


def test_half_of_the_episodes_start_on_the_way_of_a_plan():
    trainer = Trainer(TrainConfig("designs", worlds=400, width=4, network="relative", imitate=5))
    shown = {world.tobytes() for world in trainer.guidance.demonstrations.worlds.designs}
    there = sum(design.tobytes() in shown for design in trainer.worlds.episodes.designs)
    assert 140 < there < 260


def test_a_task_that_nothing_can_be_planned_for_is_refused():
    task = as_task("random_strip")
    short = replace(task, max_steps=1)
    with pytest.raises(InputError, match="no plan within 3 ticks for any of 2 starts"):
        planned_demonstrations(short, 2, np.random.default_rng(0))


def test_an_evaluation_in_physics_starts_where_the_task_does(monkeypatch):
    config = TrainConfig(
        "random_strip", worlds=1, width=4, network="relative", backend="physics", imitate=2
    )
    monkeypatch.setattr(
        "craftsim.learning.trainer.evaluate_in_physics", lambda net, worlds, *_: worlds.task
    )
    with closing(Trainer(config, workers=1)) as trainer:
        assert trainer.worlds.envs.task is not trainer.task
        assert trainer.evaluate(1) is trainer.task


def test_what_was_imitated_is_evaluated_at_once(monkeypatch):
    monkeypatch.setattr("craftsim.learning.policy_gradient.LEAST", 8)
    few = {"imitate": 1, "evaluation_episodes": 5}
    trainer = Trainer(TrainConfig("random_strip", worlds=4, width=8, network="relative", **few))
    assert list(trainer.run(2 * trainer.steps_an_iteration, until=2.0)) == [True, False]


def test_a_policy_is_one_of_its_rule_set_and_is_evaluated_with_the_helper(monkeypatch):
    trainer = Trainer(TrainConfig("strip", worlds=4, width=4, rules="published", helper_depth=20))
    assert trainer.identity.rules == "published"
    assert trainer.worlds.episodes.depth == 20
    monkeypatch.setattr("craftsim.learning.trainer.evaluate", lambda *given: given)
    assert trainer.evaluate(3)[-4:] == ("published", 20, "greedy", "synchronous")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"rules": "paper"},
            "unknown rule set 'paper'; there are published, physical, or give a YAML",
        ),
        ({"backend": "physics", "helper_depth": 5}, "or train on the grid"),
        (
            {"backend": "physics", "randomize": "wild"},
            "allowed: none, mild, strong, lab_floor, workshop_floor",
        ),
        ({"randomize": "mild"}, "on the grid nothing is drawn of physics"),
        ({"drive": "rollers"}, "on the grid nothing drives"),
        ({"imitate": 5, "algo": "qmix"}, "leave imitate out"),
        ({"imitate": 5, "rules": "published"}, "leave imitate out"),
        ({"imitate": 5, "explore": 5}, "leave imitate out"),
        ({"stages": ("block",)}, "give each at least one step"),
        ({"stage_steps": 5}, "leave both out"),
        (
            {"stages": ("block",), "stage_steps": 5, "imitate": 3},
            "without exploration and imitation",
        ),
        (
            {"stages": ("random_breaking_barrier",), "stage_steps": 5},
            "stage 'random_breaking_barrier' has",
        ),
        ({"execution": "asynchronous", "algo": "vdn"}, "trained asynchronously by ippo and mappo"),
        ({"recurrent": True}, r"ippo has no recurrent policy.*iql, vdn, qmix, qtran"),
        ({"last_action": False}, "last_action is for a recurrent policy"),
        ({"queue_survives": True}, "queue_survives is for an action helper"),
        ({"shows_hidden": True, "execution": "asynchronous"}, "shows_hidden is for episodes on"),
        ({"shows_hidden": True, "backend": "physics"}, "shows_hidden is for episodes on the grid"),
        (
            {"algo": "vdn", "hyperparameters": {"epsilon_start": 0.1, "epsilon_end": 0.5}},
            r"at most epsilon_start, 0\.1",
        ),
        *(
            (
                {"algo": algo, "acting": acting},
                f"{algo} rates actions by value.* acting must be greedy",
            )
            for algo in sorted(set(ALGORITHMS) - set(with_trait("learns_probabilities")))
            for acting in ("sampled", "varied")
        ),
    ],
    ids=str,
)
def test_settings_that_make_no_sense_are_refused(options, message):
    with pytest.raises(InputError, match=message):
        Trainer(TrainConfig("strip", **options))
