"""The list of mutants fits the rules: each changes exactly one place. ``make mutants`` shows that tests notice them."""

import pytest

from .mutants import MUTANTS, ROOT


def test_there_are_at_least_ten():
    assert len({mutant.rule for mutant in MUTANTS}) == len(MUTANTS) >= 10


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: mutant.rule)
def test_each_changes_exactly_one_place(mutant):
    source = (ROOT / "craftsim" / "discrete" / mutant.file).read_text()
    assert source.count(mutant.old) == 1
    assert mutant.new != mutant.old
