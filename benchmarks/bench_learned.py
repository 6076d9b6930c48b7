"""The grid's speed with a learned rule set beside that of ``physical``: masks of all cars and a step, in turn."""

import time
from pathlib import Path

import numpy as np
import pytest

from craftsim.cli.bench import pick
from craftsim.discrete.learned import read_rules
from craftsim.tasks import make_task
from craftsim.tasks.episodes import Episodes

WORLDS = 500
STEPS = 40
ROUNDS = 5
LEAST_SHARE = 0.8
FILE = Path(__file__).parent / "fifty_rules.yaml"
"""Rules that learners found, enough of them to measure the speed; they hold for no machine."""


def _steps_a_cpu_s(task, rules):
    rng = np.random.default_rng(1)
    episodes = Episodes(make_task(task), rng, WORLDS, rules)
    spent_s = 0.0
    for _ in range(STEPS):
        began_s = time.process_time()
        masks = episodes.offered()
        spent_s += time.process_time() - began_s
        actions = pick(rng, masks)
        began_s = time.process_time()
        episodes.step(actions)
        spent_s += time.process_time() - began_s
    return WORLDS * STEPS / spent_s


@pytest.mark.parametrize("task", ["strip", "simple_two_story", "complex_two_story"])
def test_fifty_patterns(task):
    rules = read_rules(FILE)
    assert len(rules.rules) == 50
    shares = []
    for _ in range(ROUNDS):
        shares.append(_steps_a_cpu_s(task, rules) / _steps_a_cpu_s(task, "physical"))
    share = float(np.median(shares))
    print(f"{task}: {share:.2f} of physical")
    assert share >= LEAST_SHARE
