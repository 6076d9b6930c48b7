"""A run stops where the world cannot be read any more, and both worlds start alike."""

import numpy as np
import pytest

from craftsim.checking.setup import setup_of
from craftsim.experiments.bundle import read_bundle
from craftsim.learning.policies import make_policy
from craftsim.models.world import PhysicsWorld
from craftsim.validation.rollout import run_job
from craftsim.validation.sources import policy_source, rollout_trials, rollout_worlds


@pytest.fixture
def run_of(tmp_path):
    """Return the run of a policy on a task."""

    def make(place, policy):
        worlds = rollout_worlds([place])
        sources = [policy_source(policy, worlds)]
        (item,) = rollout_trials(
            worlds, sources, 1, 3, setup_of(drive="wheels"), order="ticks", out=tmp_path
        )
        return item.job

    return make


def test_a_simulation_that_breaks_down_ends_its_run_and_can_be_replayed(
    run_of, monkeypatch, tmp_path
):
    advance = PhysicsWorld.advance

    def explode(physics, observe=None):
        if physics.time_s > 2.0:
            physics.data.qvel[:] = 1e12
        advance(physics, observe)

    monkeypatch.setattr(PhysicsWorld, "advance", explode)
    done = run_job(run_of("strip", "planner"))
    assert not done.agrees
    assert done.extra["physics_success"] is False
    assert done.extra["grid_success"] is True
    last = done.attempts[-1]
    assert (last.result, last.finding) == ("numerics", "diverged")
    assert all(
        attempt.result == "as predicted" for attempt in done.attempts if attempt.tick < last.tick
    )
    recorded = read_bundle(tmp_path / done.bundle)
    assert recorded.bundle.attempts[-1].finding == "diverged"


def test_a_policy_sees_the_same_in_both_worlds_as_long_as_they_agree(run_of, monkeypatch):
    seen = []

    def watch(name, seed, task):
        policy = make_policy(name, seed, task)

        def act(observations):
            seen.append(
                {agent: value["observation"].copy() for agent, value in observations.items()}
            )
            return policy(observations)

        return act

    monkeypatch.setattr("craftsim.validation.rollout.make_policy", watch)
    done = run_job(run_of("strip", "random"))
    assert done.agrees
    in_physics, by_rules = seen[: len(seen) // 2], seen[len(seen) // 2 :]
    assert len(in_physics) == done.extra["ticks"] == 20
    for a, b in zip(in_physics, by_rules, strict=True):
        assert all(np.array_equal(a[agent], b[agent]) for agent in a)
