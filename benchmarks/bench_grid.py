"""What a registered action, which Python decides, costs on the grid beside the compiled ones."""

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
