"""The stored studies are of the shipped ones, and their times are of whole runs; tests/test_docs.py has the tables."""

import json
from pathlib import Path

import pytest

from craftsim.learning.study import read_study

TRAINING = Path(__file__).parents[2] / "docs" / "results" / "training"


@pytest.mark.parametrize("name", ["paper_ippo", "random", "random_complex", "designs"])
def test_a_stored_report_is_of_the_shipped_study_and_its_times_are_of_whole_runs(name):
    """The fastest runs learn 20,000 steps a second; a call that had nothing left to train seems faster."""
    report = json.loads((TRAINING / f"{name}.json").read_text(encoding="utf-8"))
    study, asked, runs = read_study(name), report["config"]["study"], report["figures"]["runs"]
    assert (asked["tasks"], asked["seeds"], asked["steps"]) == (
        [*study.tasks],
        study.seeds,
        study.steps,
    )
    assert [run["key"] for run in runs] == [run.key for run in study.runs]
    steps = {run["key"]: run["steps"] for run in runs}
    for key, cpu_s in report["wall"]["cpu_s"].items():
        assert cpu_s is None or cpu_s > steps[key] / 50_000, key
