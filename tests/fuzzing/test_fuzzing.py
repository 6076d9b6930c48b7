"""A few hundred damaged files of every format; ``make fuzz`` tries many more."""

import pytest

from fuzzing.fuzz import attack, targets


@pytest.mark.parametrize("name", targets())
def test_a_damaged_file_is_read_or_refused_with_our_own_error(name):
    outcome = attack(name, 0, 400, seed=1)
    assert outcome.failures == ()
    # Some files survive, and some do not: damage that is always refused at once would test little.
    assert 0 < outcome.refused < outcome.cases
