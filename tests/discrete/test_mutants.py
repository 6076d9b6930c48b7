"""The list of mutants fits the rules: each changes something. ``mutants.py`` shows that tests notice them."""

import re

from craftsim.discrete.rules import REASONS

from .mutants import MUTANTS, ROOT


def test_there_is_one_for_each_reason_and_more_and_each_changes_the_rules():
    assert len({mutant.rule for mutant in MUTANTS}) == len(MUTANTS) > len(REASONS) + 10
    for mutant in MUTANTS:
        source = (ROOT / "craftsim" / "discrete" / mutant.file).read_text()
        assert mutant.rule.startswith("never ") or len(re.findall(mutant.old, source)) == 1, (
            mutant.rule
        )
        changed = mutant.change(source)
        assert changed != source, mutant.rule
        compile(changed, mutant.file, "exec")
