"""What a registered action, which Python decides, costs on the grid beside the compiled ones; decisions a second in
ticks and without."""

import sys
from pathlib import Path

import numpy as np
import pytest

import craftsim
from craftsim.cli.bench import pick
from craftsim.discrete.tasks.episodes import Episodes

sys.path.append(str(Path(__file__).parents[1] / "examples"))
WORLDS = 1000


@pytest.fixture(scope="module")
def own():
    return __import__("own_action").TURN_ABOUT


@pytest.mark.parametrize("registered", [False, True])
@pytest.mark.parametrize("what", ["masks", "step"])
def test_a_registered_action(benchmark, own, registered, what):
    """A call is for ``worlds`` worlds: all masks, or a step of masked random play; with the action, or the 15 alone."""
    rng = np.random.default_rng(0)
    episodes = Episodes(
        craftsim.make_task("simple_two_story"), rng, WORLDS, actions=(own,) if registered else ()
    )
    masks = episodes.offered()
    work = episodes.offered if what == "masks" else lambda: episodes.step(pick(rng, masks))
    benchmark.pedantic(work, rounds=5, warmup_rounds=1)
    benchmark.extra_info["us_a_world"] = 1e6 * benchmark.stats.stats.median / WORLDS


@pytest.mark.parametrize("task", ["simple_two_story", "complex_two_story"])
@pytest.mark.parametrize("helper", [None, 10])
@pytest.mark.parametrize("worlds", [64, 500])
@pytest.mark.parametrize("execution", ["synchronous", "asynchronous"])
def test_decisions_of_a_batch(benchmark, task, helper, worlds, execution):
    """A call is a step of ``worlds`` worlds in masked random play; cars whose actions run do not decide."""
    options = {} if execution == "synchronous" else {"execution": execution, "jitter": 0.1}
    envs = craftsim.vector_env(task, worlds, helper_depth=helper, **options)
    (seen, infos), rng, decisions = envs.reset(seed=0), np.random.default_rng(0), []

    def choose():
        actions = pick(rng, seen["action_mask"])
        decisions.append(infos["decides"].sum() if options else actions.size)
        return (actions,), {}

    def step(actions):
        nonlocal seen, infos
        seen, _, _, _, infos = envs.step(actions)

    benchmark.pedantic(step, setup=choose, rounds=60, warmup_rounds=20)
    benchmark.extra_info["decisions_a_second"] = np.mean(decisions[20:]) / benchmark.stats.stats.mean
