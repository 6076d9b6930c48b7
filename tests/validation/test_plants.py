"""The list of plants fits the rules: each changes exactly one place. ``make plants`` shows that an audit finds them."""

import pytest

from .plants import PLANTS, ROOT


def test_there_are_at_least_twelve():
    assert len({plant.rule for plant in PLANTS}) == len(PLANTS) >= 12


@pytest.mark.parametrize("plant", PLANTS, ids=lambda plant: plant.rule)
def test_each_changes_exactly_one_place(plant):
    source = (ROOT / "craftsim" / "discrete" / "rules" / plant.file).read_text()
    assert source.count(plant.old) == 1
    assert plant.new != plant.old
