"""Policies are found by name, and what is wrong with a name is said."""

import signal
import sys

import numpy as np
import pytest

from craftsim.errors import InputError
from craftsim.learning.policies import check_policy, make_policy, policy_digest
from craftsim.tasks import make_task

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


def test_what_is_wrong_with_a_name_is_said(module):
    for name, message in (
        ("rendom", "no policy 'rendom': there is no such file; allowed: 'random'"),
        ("no_such_module:f", "No module named 'no_such_module'"),
        ("own_policy:go", r"own_policy\.py\) has no 'go'"),
        ("own_policy:N", "is a int, not a function"),
        ("own_policy:", "must be module:function"),
        (".rel:x", "must be module:function"),
    ):
        with pytest.raises(InputError, match=message):
            make_policy(name, 0)


ODD = """
import sys, time
if "leave" in __name__: sys.exit(4)
def raises(seen): raise RuntimeError("no idea " + 1000 * "x")
def leaves(seen): sys.exit(3)
def hangs(seen):
    while True:
        try: time.sleep(3600)
        except Exception: pass
def nothing(seen): pass
def one_short(seen): return {name: 6 for name in list(seen)[1:]}
def too_large(seen): return {name: 99 for name in seen}
def words(seen): return {name: "STOP" for name in seen}
"""


def test_the_time_limit_of_a_first_answer_counts_what_the_policy_needs_to_load(
    tmp_path, monkeypatch
):
    answer = "def slow(seen):\n    time.sleep(0.7)\n    return {name: 10 for name in seen}\n"
    source = f"import time\ntime.sleep(0.7)\n{answer}"
    (tmp_path / "slow_policy.py").write_text(source)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "slow_policy", raising=False)
    with pytest.raises(InputError, match="gave no first answer within 1 s"):
        check_policy("slow_policy:slow", make_task("strip"), "physical", 1.0)
    check_policy("slow_policy:slow", make_task("strip"), "physical", 60.0)


def test_what_is_no_policy_is_refused_after_one_question_and_nothing_is_left_of_the_clock(
    tmp_path, monkeypatch
):
    before = signal.getsignal(signal.SIGALRM)
    for module, source in {"odd_policy": ODD, "leave_policy": ODD, "broken_policy": "a b"}.items():
        (tmp_path / f"{module}.py").write_text(source)
        monkeypatch.delitem(sys.modules, module, raising=False)
    monkeypatch.syspath_prepend(tmp_path)
    for name, message in {
        "odd_policy:raises": r"raised RuntimeError: no idea .{0,300}; a policy takes",
        "odd_policy:leaves": "raised SystemExit: 3",
        "odd_policy:hangs": "gave no first answer within 0.5 s",
        "odd_policy:nothing": "returned NoneType",
        "odd_policy:one_short": "no action for car_0",
        "odd_policy:too_large": "99",
        "odd_policy:words": "whole numbers from 0 to 14",
        "leave_policy:x": "cannot be imported: SystemExit: 4",
        "broken_policy:x": "cannot be imported: SyntaxError",
    }.items():
        with pytest.raises(InputError, match=f"policy '{name}'.*{message}"):
            check_policy(name, make_task("strip"), "physical", 0.5)
    assert signal.getsignal(signal.SIGALRM) == before
    assert signal.getitimer(signal.ITIMER_REAL) == (0, 0)
