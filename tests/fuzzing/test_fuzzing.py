"""Some damaged files of every format; ``make fuzz`` tries many more."""

import pytest

from fuzzing.fuzz import attack, targets

CASES = 300
OTHERS = {"names": 1000, "run": 40, "policy": 150, "numbers": 40, "mesh": 100, "picture": 150}
"""Fewer cases of what takes ten milliseconds each, and more of names, of which few are right once they are changed."""


@pytest.mark.parametrize("name", targets())
def test_a_damaged_file_is_read_or_refused_with_our_own_error(name):
    outcome = attack(name, 0, OTHERS.get(name, CASES), seed=1)
    assert outcome.failures == ()
    # Some files survive: damage that is always seen at once would test little.
    assert 0 < outcome.refused < outcome.cases or name in ("numbers", "run")
