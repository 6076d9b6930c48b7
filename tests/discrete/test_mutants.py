"""The list of mutants fits the rules: each changes something. ``make mutants`` shows that tests notice them."""

import re

import pytest

from craftsim.discrete.reasons import REASONS

from .mutants import MUTANTS, ROOT


def test_there_is_one_for_each_reason_and_more():
    assert len({mutant.rule for mutant in MUTANTS}) == len(MUTANTS) > len(REASONS) + 10


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: mutant.rule)
def test_each_changes_the_rules(mutant):
    source = (ROOT / "craftsim" / "discrete" / mutant.file).read_text()
    assert mutant.rule.startswith("never ") or len(re.findall(mutant.old, source)) == 1
    changed = mutant.change(source)
    assert changed != source
    compile(changed, mutant.file, "exec")
