"""The list of planted mutants fits the package: each changes something. ``mutants.py`` shows that tests notice them."""

from .mutants import PLANTED, ROOT, TESTS, sample


def test_each_planted_or_drawn_mutant_changes_its_file():
    drawn = [mutant for file in TESTS for mutant in sample(file, 3, seed=1)]
    for mutant in (*PLANTED, *drawn):
        source = (ROOT / "craftsim" / mutant.file).read_text(encoding="utf-8")
        changed = mutant.change(source)
        assert changed != source, mutant.name
        compile(changed, mutant.file, "exec")


def test_the_tests_that_ought_to_notice_exist():
    for names in TESTS.values():
        for name in names:
            assert (ROOT / "tests" / name).is_file()
