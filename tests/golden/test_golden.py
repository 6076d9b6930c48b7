"""What craftsim does is what the golden records say; ``make golden`` compares the long ones, too."""

import pytest

from .golden import KINDS, compute, differences, names, stored, where


@pytest.mark.parametrize("name", [name for name in names() if KINDS[name].fast])
def test_a_record_is_as_it_is_stored(name):
    old = stored(name)
    if old["machine"] != where(name):
        pytest.skip(f"recorded on {old['machine']}")
    assert list(differences(old["value"], compute(name)[0])) == []
