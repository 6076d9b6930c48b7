"""The list of plants fits the rules: each changes its places. ``plants.py`` shows that an audit finds them."""

import re

from .plants import PLANTS, ROOT


def test_there_are_at_least_twelve():
    assert len({plant.rule for plant in PLANTS}) == len(PLANTS) >= 12


def test_each_changes_its_places():
    for plant in PLANTS:
        source = (ROOT / "craftsim" / "discrete" / plant.file).read_text()
        assert len(re.findall(plant.old, source)) == plant.places
        assert re.sub(plant.old, plant.new, source) != source
