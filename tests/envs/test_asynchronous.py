"""Asynchronous execution: it agrees with ticks where all actions take the same time, and keeps to its claims."""

import warnings

import numpy as np
import pytest
from pettingzoo.test import api_test, parallel_api_test

import craftsim
from craftsim.discrete.kinds import Action
from craftsim.discrete.rules import Rules
from craftsim.discrete.tasks import make_task

STOP = int(Action.STOP)
RULES = Rules("physical")
CASES = [
    ("simple_two_story", None, {}),
    ("complex_two_story", None, {}),
    ("strip", 3, {}),
    ("free_building", 4, {}),
    ("breaking_barrier", None, {}),
    ("simple_two_story", None, {"helper_depth": 10}),
]


def aec(task="simple_two_story", n_cars=None, backend="grid", max_steps=None, **options):
    task = make_task(task, n_cars=n_cars, **({} if max_steps is None else {"max_steps": max_steps}))
    return craftsim.env(task, backend, execution="asynchronous", **options)


def pick(rng, mask):
    return int(rng.choice(np.flatnonzero(mask)))


def same_as_ticks(task, n_cars, options, seed, max_steps=15):
    """Play a random asynchronous episode of equal durations, and the same in ticks; both must agree."""
    one = aec(task, n_cars, max_steps=max_steps, durations="equal", **options)
    other = craftsim.parallel_env(make_task(task, n_cars=n_cars, max_steps=max_steps), "grid", **options)
    one.reset(seed)
    other.reset(seed)
    rng = np.random.default_rng(seed)
    ticks = 0
    while other.agents:
        actions, queued, order = {}, one.core.episodes.queue[0, :, 0] >= 0, list(one.core.turns)
        for car in order:
            agent = one.agent_selection
            assert agent == f"car_{car}"
            # What the queue of the helper holds may be blocked by a claim, which ticks know nothing of.
            actions[agent] = STOP if queued[car] else pick(rng, one.observe(agent)["action_mask"])
            if not queued[car]:
                assert one.observe(agent)["action_mask"][actions[agent]]
            one.step(actions[agent])
        if any(info["blocked"] for info in one.infos.values()):
            return ticks
        _, rewards, terminated, truncated, infos = other.step(actions)
        ticks += 1
        assert one.core.episodes.confirmed[0].same_visible(other.grid), (task, seed, ticks)
        assert one.core.episodes.confirmed[0].same_marks(other.grid)
        assert one.core.grid.same_visible(other.grid)
        assert one.core.episodes.time_s[0] == ticks
        assert one.rewards == pytest.approx(rewards)
        for agent, info in infos.items():
            assert one.infos[agent]["success"] == info["success"]
            assert one.infos[agent]["illegal"] == info["illegal"], (task, seed, ticks, actions, order)
        assert one.terminations == terminated
        if one.infos["car_0"]["deadlock"]:
            return ticks
        assert one.truncations == truncated
    return ticks


@pytest.mark.parametrize(("task", "n_cars", "options"), CASES)
def test_equal_durations_give_what_ticks_give(task, n_cars, options):
    assert sum(same_as_ticks(task, n_cars, options, seed) for seed in range(9)) > 100


@pytest.mark.slow
def test_equal_durations_give_what_ticks_give_in_a_thousand_episodes():
    for seed in range(1000):
        task, n_cars, options = CASES[seed % len(CASES)]
        same_as_ticks(task, n_cars, options, 1000 + seed, max_steps=30)


@pytest.mark.parametrize(
    "options", [{}, {"jitter": 0.3, "failures": 0.3, "helper_depth": 10, "local_view": 2}]
)
def test_pettingzoo_takes_both_forms(options):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        api_test(aec(max_steps=20, **options), num_cycles=120)
        parallel_api_test(
            craftsim.parallel_env("strip", "grid", execution="asynchronous", **options), num_cycles=60
        )
