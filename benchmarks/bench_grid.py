"""What a registered action, which Python decides, costs on the grid beside the compiled ones; decisions a second in
ticks and without."""

import sys
import time
from pathlib import Path

import numpy as np
import pytest

import craftsim
from craftsim.cli.bench import pick
from craftsim.tasks.episodes import Episodes

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


def _steps(task, worlds, helper, **options):
    """Return a function that takes a step of masked random play; it returns how many cars decided, and its CPU time."""
    envs = craftsim.vector_env(task, worlds, helper_depth=helper, **options)
    (seen, infos), rng = envs.reset(seed=0), np.random.default_rng(0)

    def step():
        nonlocal seen, infos
        actions = pick(rng, seen["action_mask"])
        decisions = infos["decides"].sum() if options else actions.size
        began_s = time.process_time()
        seen, _, _, _, infos = envs.step(actions)
        return decisions, time.process_time() - began_s

    return step


@pytest.mark.parametrize(
    ("task", "cars"), [("strip", 2), ("simple_two_story", 4), ("complex_two_story", 4)]
)
@pytest.mark.parametrize("helper", [None, 10])
@pytest.mark.parametrize("worlds", [64, 500])
def test_decisions_of_asynchronous_batches(benchmark, task, cars, helper, worlds):
    """A call is a step of ``worlds`` asynchronous worlds in masked random play, in turn with synchronous ones.

    ``ratio`` is asynchronous decisions a second by synchronous ones; cars whose actions run do not decide.
    """
    made = craftsim.make_task(task, n_cars=cars)
    ticks = _steps(made, worlds, helper)
    events = _steps(made, worlds, helper, execution="asynchronous", jitter=0.1)
    found = {"synchronous": [], "asynchronous": []}

    def tick():
        found["synchronous"].append(ticks())

    benchmark.pedantic(
        lambda: found["asynchronous"].append(events()), setup=tick, rounds=200, warmup_rounds=20
    )
    rates = {name: float(np.divide(*np.sum(steps[20:], axis=0))) for name, steps in found.items()}
    benchmark.extra_info |= {f"{name}_decisions_a_second": rate for name, rate in rates.items()}
    benchmark.extra_info["ratio"] = rates["asynchronous"] / rates["synchronous"]
