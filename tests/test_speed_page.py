"""The tables of the page on speed are those of the reports beside them."""

import json
from dataclasses import fields
from pathlib import Path

import pytest
from speed_tables import tables

from craftsim.cli.calibration import Rate

SPEED = Path(__file__).parents[1] / "docs/speed"


@pytest.mark.parametrize("what", ["rules", "env", "physics"])
def test_the_table_of_rates_is_that_of_its_report(what):
    rates = json.loads((SPEED / what / "report.json").read_text(encoding="utf-8"))["wall"]["rates"]
    table = (SPEED / what / f"{what}.md").read_text(encoding="utf-8")
    for task, cases in rates.items():
        for name, rate in cases.items():
            cells = Rate(*(rate[field.name] for field in fields(Rate))).cells()
            assert f"| {task} | {name} | {' | '.join(cells)} |" in table


def test_the_tables_of_benchmarks_are_those_of_their_report():
    report = json.loads((SPEED / "benchmarks.json").read_text(encoding="utf-8"))
    assert (SPEED / "benchmarks.md").read_text(encoding="utf-8") == tables(report)
