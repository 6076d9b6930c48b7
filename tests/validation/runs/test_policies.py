"""Policies are found by name, and what is wrong with a name is said."""

import sys

import numpy as np
import pytest

from craftsim.errors import InputError
from craftsim.validation.runs.policies import make_policy, policy_digest

OBSERVATIONS = {
    f"car_{i}": {
        "observation": np.zeros(13, np.int32),
        "action_mask": np.eye(15, dtype=np.int8)[i] + np.eye(15, dtype=np.int8)[7],
    }
    for i in range(3)
}


@pytest.fixture
def module(tmp_path, monkeypatch):
    (tmp_path / "own_policy.py").write_text(
        "def stop(seen):\n    return {name: 14 for name in seen}\n\nN = 3\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "own_policy", raising=False)
    return "own_policy"


def test_a_random_policy_draws_what_is_offered_and_equal_seeds_draw_the_same():
    draws = [make_policy("random", 5)(OBSERVATIONS) for _ in range(2)]
    assert draws[0] == draws[1]
    policy = make_policy("random", 0)
    seen = {tuple(policy(OBSERVATIONS).values()) for _ in range(60)}
    assert seen == {(a, b, c) for a in (0, 7) for b in (1, 7) for c in (2, 7)}


def test_a_function_of_ones_own_is_called(module):
    assert make_policy(f"{module}:stop", 0)(OBSERVATIONS) == dict.fromkeys(OBSERVATIONS, 14)


def test_a_changed_module_has_another_digest(module, tmp_path):
    before = policy_digest(f"{module}:stop")
    assert policy_digest(f"{module}:stop") == before
    path = tmp_path / "own_policy.py"
    path.write_text(path.read_text() + "# changed\n")
    assert policy_digest(f"{module}:stop") != before


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("rendom", "no policy 'rendom': there is no such file; allowed: 'random'"),
        ("no_such_module:f", "No module named 'no_such_module'"),
        ("own_policy:go", "the module own_policy has no 'go'"),
        ("own_policy:N", "is a int, not a function"),
    ],
)
def test_what_is_wrong_with_a_name_is_said(module, name, message):
    with pytest.raises(InputError, match=message):
        make_policy(name, 0)
