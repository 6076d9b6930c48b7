"""Recordings, files of starts, policies and runs that are damaged: read, or refused with our own error."""

import numpy as np
import pytest

from fuzzing import policies, recordings

CASES = {
    **{name: (target, 600) for name, target in recordings.TARGETS.items()},
    "policy": (policies.policy, 300),
    "run": (policies.run, 30),
}


@pytest.mark.parametrize("name", CASES)
def test_a_damaged_file_is_read_or_refused(name, tmp_path):
    target, n = CASES[name]
    for case in range(n):
        target(np.random.default_rng([2026, case]), tmp_path)
