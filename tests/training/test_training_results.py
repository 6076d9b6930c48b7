"""The stored studies are of the shipped ones, and their times are of whole runs; tests/test_docs.py has the tables."""

import json
from pathlib import Path

from craftsim.studies.study import read_study

TRAINING = Path(__file__).parents[2] / "docs" / "results" / "training"
STUDIES = ("paper_ippo", "random", "random_complex", "designs")
PHYSICS = sorted(path.stem for path in TRAINING.glob("physics_*.json"))


def test_the_stored_report_is_of_the_shipped_study():
    for name in STUDIES:
        report = json.loads((TRAINING / f"{name}.json").read_text(encoding="utf-8"))
        study, asked = read_study(name), report["config"]["study"]
        assert (asked["tasks"], asked["seeds"], asked["steps"]) == ([*study.tasks], study.seeds, study.steps)
        assert [run["key"] for run in report["figures"]["runs"]] == [run.key for run in study.runs]


def _cpu_s(name):
    report = json.loads((TRAINING / f"{name}.json").read_text(encoding="utf-8"))
    steps = {run["key"]: run["steps"] for run in report["figures"]["runs"]}
    return {key: (steps[key], found) for key, found in report["wall"]["cpu_s"].items() if found is not None}


def test_no_time_is_that_of_a_call_that_had_nothing_left_to_train():
    """The fastest runs learn 8,000 steps a second."""
    for name in STUDIES:
        for key, (steps, cpu_s) in _cpu_s(name).items():
            assert cpu_s > steps / 20_000, key


def test_there_are_stored_validations():
    assert len(PHYSICS) > 5
