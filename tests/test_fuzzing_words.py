"""Mutated words, names and tables end in success or in our error."""

import numpy as np
import pytest
from fuzzing import words


@pytest.mark.parametrize(("target", "cases"), [("durations", 2000), ("names", 500), ("numbers", 20)])
def test_mutations_end_in_success_or_in_our_error(target, cases, tmp_path):
    for seed in range(cases):
        words.TARGETS[target](np.random.default_rng(seed), tmp_path)


def test_a_case_is_drawn_from_all_targets(tmp_path):
    words.attack(np.random.default_rng(0), tmp_path)
