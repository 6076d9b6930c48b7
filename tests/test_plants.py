"""Each fault of ``scripts/plants.py`` changes its places, and the stored table says of every instrument what it sees.

The script shows what is found; two fast cells of its table are measured here.
"""

import re

import numpy as np
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


def test_recordings_see_what_leaves_the_intervals_of_the_healthy_package(monkeypatch, tmp_path):
    def report(error, radius_m):
        law = {
            "law": "ours",
            "position_widths": {"value": error, "low": error - 1, "high": error + 1},
        }
        estimate = {"value": radius_m, "half_width_95": 0.001}
        return {"contact_law": [law], "driving": {"identified": {"radius": estimate}}}

    reports = {
        HEALTHY: report(10.0, 0.070),
        CONTROL: report(11.9, 0.0719),
        "solver": report(13.0, 0.070),
        "wheel": report(10.0, 0.073),
    }
    monkeypatch.setattr(plants, "_write_recordings", lambda bench: None)
    monkeypatch.setattr(plants, "_figures", reports.get)
    bench = Bench(tmp_path)
    monkeypatch.setattr(bench, "run", lambda fault, name, command: fault)
    readings = {fault: plants.reality(bench, fault) for fault in reports}
    assert [readings[fault].seen for fault in (HEALTHY, CONTROL)] == [False, False]
    assert (readings["solver"].at, readings["solver"].of) == (1, 4)
    assert readings["solver"].figure == "1/2 moved: ours position_widths 12 to 14 (was 9 to 11)"
    assert readings["wheel"].at == 4


def test_recordings_are_cut(tmp_path):
    lengths = np.full(plants.N_TOSSES + 5, 3)
    states = np.arange(lengths.sum() * 13.0).reshape(-1, 13)
    times = np.arange(0.0, 2 * plants.DRIVEN_S, 0.5)
    data = tmp_path / "data"
    data.mkdir()
    for name in plants.RECORDINGS:
        if "cube" in name:
            np.savez(data / name, states=states, length=lengths)
        else:
            rows = np.column_stack([times + 7, times + 5])
            np.savez(data / name, wheels=rows, pose=rows[2:])
    plants._write_recordings(Bench(tmp_path, data))
    cut = [np.load(tmp_path / "recordings" / name) for name in plants.RECORDINGS]
    assert len(cut[0]["length"]) == plants.N_TOSSES
    assert len(cut[0]["states"]) == 3 * plants.N_TOSSES
    for drive in cut[1:]:
        assert drive["pose"][0, 1] == 6
        assert drive["wheels"][-1, 1] == drive["pose"][-1, 1] == 6 + plants.DRIVEN_S


@pytest.mark.parametrize(
    ("decision", "seen", "misses"),
    [
        ("yes", False, "less than 5 % failing"),
        ("no", True, None),
        ("undecided", False, "undecided after 8"),
    ],
)
def test_a_certificate_sees_a_fault_when_it_says_no(decision, seen, misses, monkeypatch, tmp_path):
    certificate = {"decision": decision, "trials": 8, "successes": 7}
    monkeypatch.setattr(plants, "_figures", lambda folder: {"certificates": [certificate]})
    bench = Bench(tmp_path)
    monkeypatch.setattr(bench, "run", lambda fault, name, command: tmp_path)
    reading = plants.certify(bench, "solver")
    assert (reading.seen, reading.of, reading.figure) == (seen, 8, f"{decision}, 7/8 runs")
    if not seen:
        assert reading.misses == misses
