"""Some damaged files of every format; ``make fuzz`` tries many more."""

import pytest

from fuzzing.fuzz import attack, targets

CASES = 1000
SLOW = {"run": 40, "policy": 400, "numbers": 40, "mesh": 200, "picture": 400}
"""Fewer cases of what takes ten milliseconds each."""


@pytest.mark.parametrize("name", targets())
def test_a_damaged_file_is_read_or_refused_with_our_own_error(name):
    outcome = attack(name, 0, SLOW.get(name, CASES), seed=1)
    assert outcome.failures == ()
    # Some files survive: damage that is always seen at once would test little.
    assert 0 < outcome.refused < outcome.cases or name in ("numbers", "run")
