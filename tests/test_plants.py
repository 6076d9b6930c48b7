"""Each fault of ``scripts/plants.py`` changes its places, and the stored table says of every instrument what it sees.

The script shows what is found; two fast cells of its table are measured here.
"""

import re

import plants
import pytest
from plants import CONTROL, FAULTS, HEALTHY, INSTRUMENTS, PLANTS, ROOT, Bench

ALL = {plant.rule: plant for plant in PLANTS}
ALL |= {name: fault.plant for name, fault in FAULTS.items() if fault.plant is not None}


def test_there_are_at_least_twelve_unsound_rules():
    assert len({plant.rule for plant in PLANTS}) == len(PLANTS) >= 12


@pytest.mark.parametrize("name", ALL)
def test_each_changes_its_places(name):
    plant = ALL[name]
    source = (ROOT / "craftsim" / plant.file).read_text("utf-8")
    changed, places = re.subn(plant.old, plant.new, source)
    assert places == plant.places
    assert changed != source
    compile(changed, plant.file, "exec")


def test_the_table_has_no_blank():
    cells = plants.read_stored()["cells"]
    assert cells.keys() == INSTRUMENTS.keys()
    for instrument, row in cells.items():
        assert row.keys() == FAULTS.keys() - {HEALTHY}, instrument
        for fault, cell in row.items():
            assert cell["seen"] or cell["why"], (instrument, fault)
            if cell["seen"] is not None:
                assert {"at", "of", "figure", "healthy", "commands", "seed", "cpu_s"} <= cell.keys()
            if cell["seen"]:
                assert 0 < cell["at"] <= cell["of"]


def test_a_validation_sees_a_solver_that_stops_early_and_nothing_without_it(tmp_path, monkeypatch):
    monkeypatch.setattr(
        plants, "PLAN", "validate strip --randomize mild --seed {seed} --trials 1 --video none"
    )
    bench = Bench(tmp_path)
    seen = plants.measure(bench, "validate", "solver")
    assert (seen["seen"], seen["at"], seen["figure"], seen["healthy"]) == (
        True,
        1,
        "0/1 runs",
        "1/1 runs",
    )
    unseen = plants.measure(bench, "validate", CONTROL)
    assert (unseen["seen"], unseen["why"]) == (False, "less than 95.0 % failing")
    # What has run is not run again.
    monkeypatch.setattr(bench, "call", None)
    assert plants.measure(bench, "validate", "solver") == seen
