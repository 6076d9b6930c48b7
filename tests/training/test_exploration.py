"""Exploration before learning: it reaches what chance alone does not, by the rules, and the same again."""

from types import SimpleNamespace

import numpy as np
import pytest

from craftsim.discrete.grid import CarField, Kind
from craftsim.discrete.rules import Rules
from craftsim.discrete.tasks import make_task
from craftsim.discrete.tasks.episodes import Episodes
from craftsim.discrete.tasks.starts import targets_of
from craftsim.errors import InputError
from craftsim.training.config import TrainConfig
from craftsim.training.demonstrations import NOT_SHOWN
from craftsim.training.evaluation import choose_actions
from craftsim.training.exploration import done_on, explore
from craftsim.training.ppo import imitate
from craftsim.training.trainer import Trainer


def _explored(seed, rules="published", ticks=20_000):
    task = make_task("block")
    return task, SimpleNamespace(
        **dict(zip(("starts", "way"), explore(task, rules, ticks, np.random.default_rng(seed)), strict=True))
    )


def potential(task, grid):
    return task.potential(grid[None], targets_of(task.design)[None])[0]


def test_it_reaches_every_potential_but_the_last():
    task, found = _explored(0)
    assert {potential(task, grid) for grid in found.starts} == {0.0, 1.0, 2.0, 3.0}
    assert not any(task.succeeded(grid) for grid in found.starts)


@pytest.mark.parametrize("rules", ["published", "physical"])
def test_the_way_to_the_best_world_can_be_gone_again(rules):
    task, found = _explored(2, rules)
    ticks = done_on(found.way, Rules(rules))
    assert len(ticks) == len(found.way) - 1
    grid = task.draw(np.random.default_rng(0))
    for joint, reached in zip(ticks, found.way[1:], strict=True):
        grid, applied = Rules(rules).tick(grid, joint)
        assert applied.all()
        assert grid.same_visible(reached)
    assert potential(task, grid) == max(potential(task, other) for other in found.starts + found.way)


def test_what_no_actions_do_is_no_way():
    _, found = _explored(2, ticks=2000)
    with pytest.raises(ValueError, match="no actions lead"):
        done_on([found.way[0], found.way[-1]], Rules("published"))


def test_a_policy_first_does_what_led_to_the_best_world():
    config = TrainConfig("block", worlds=4, rules="published", helper_depth=20, explore=20_000)
    trainer = Trainer(config)
    shown = trainer.guidance.shown
    # Without a plan no car has to wait: all that they did is shown, STOP too.
    assert (shown.actions != NOT_SHOWN).all()
    imitate(trainer.learner, trainer.task, shown, "published", 20)
    episodes = Episodes(trainer.task, np.random.default_rng(0), len(shown.actions), "published", 20)
    episodes.begin(np.arange(len(shown.actions)), shown.worlds)
    offered = np.take_along_axis(episodes.offered(), shown.actions[..., None], -1)[..., 0]
    done = choose_actions(trainer.learner.net, episodes.vectors(), episodes.offered())
    assert (done == shown.actions)[offered].mean() > 0.95


def test_the_same_seed_reaches_the_same_and_another_something_else():
    first, again, other = (
        [grid.cars.tolist() for grid in _explored(seed, ticks=5000)[1].starts] for seed in (1, 1, 2)
    )
    assert first == again
    assert first != other


def test_worlds_that_were_reached_are_legal_ones_with_all_that_was_there():
    task, found = _explored(3, "physical", 5000)
    start, rules = task.draw(np.random.default_rng(0)), Rules("physical")
    for grid in found.starts[:200]:
        loads = np.count_nonzero(grid.cars[:, CarField.LOAD] != Kind.AIR)
        assert np.count_nonzero(grid.kind) + loads == np.count_nonzero(start.kind)
        assert rules.mask(grid).shape == (grid.n_cars, 15)


def test_a_run_that_explored_goes_on_with_the_same_starts(goes_on):
    goes_on(TrainConfig("strip", worlds=8, width=8, rules="published", helper_depth=20, explore=3000))


def test_a_policy_is_one_of_its_rule_set_and_is_evaluated_with_the_helper(monkeypatch):
    trainer = Trainer(TrainConfig("strip", worlds=4, width=4, rules="published", helper_depth=20))
    assert trainer.identity.rules == "published"
    assert trainer.worlds.episodes.depth == 20
    monkeypatch.setattr("craftsim.training.trainer.evaluate", lambda *given: given)
    assert trainer.evaluate(3)[-4:] == ("published", 20, "greedy", "synchronous")


def test_bad_settings_are_refused():
    for options, message in [
        ({"rules": "paper"}, "rules: unknown value 'paper'; allowed: published, physical"),
        ({"helper_depth": -1}, "helper_depth: -1 is out"),
        ({"explore": -1}, "explore: -1 is out"),
        ({"backend": "physics", "helper_depth": 5}, "or train on the grid"),
        ({"backend": "physics", "explore": 5}, "or train on the grid"),
    ]:
        with pytest.raises(InputError, match=message):
            TrainConfig("strip", **options)
