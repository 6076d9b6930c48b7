"""scripts/learned.py learns the rules of machines, and says what can be planned with them."""

import sys

import learned
import pytest
from learned import MACHINES, correction_rows, planned, table_rows
from measure_results import cpu_seconds_of

from craftsim.discrete.learned import LearnedRule, LearnedRules


def test_the_planner_builds_with_learned_rules_or_says_why_not():
    assert planned("strip", LearnedRules("mine", "physical")).endswith(" ticks")
    no_drop = LearnedRule("no-drop", "DROP", car={"level": ("floor", "above")})
    assert "no plan" in planned("strip", LearnedRules("mine", "physical", rules=(no_drop,)))


def test_commands_name_files_of_the_project():
    for machine in MACHINES:
        assert machine.command.startswith(f"audit --learn out/learned/{machine.name}.yaml ")
    assert "--machines" not in MACHINES[0].command
    assert MACHINES[1].command.endswith("--machines out/learned/machines/unladen_car.yaml")


def test_a_table_has_what_is_stored():
    stored = {
        "default": {
            "actions": 9000,
            "rules": ["LIFT, load none"],
            "held_out": {"actions": 5000, "failures": 5, "bounds": [0.99, 1.0]},
            "compared": {"allowed": 4000, "forbidden": 40},
            "corrections": {
                "run_out": {"tried": 20, "failures": 10, "forbidden": 9, "rules": ["move-1"]}
            },
            "tasks": {"strip": "11 ticks", "block": "no plan found"},
            "cpu_s": 1200.0,
            "revision": "12345678",
        }
    }
    (row,) = table_rows(stored)
    assert row["as predicted"] == "4,995/5,000"
    assert row["interval, %"] == "99.00-100.00"
    assert row["forbidden though it works"] == "40/4,000"
    assert row["no plan for"] == "block"
    assert row["CPU min"] == "20"
    (correction,) = correction_rows(stored)
    assert correction["by"] == "move-1"
    assert learned.STORED.name == "learned.json"


def test_a_command_that_fails_leaves_no_report_of_an_earlier_run_to_be_stored(tmp_path):
    report = tmp_path / "report.json"
    writes = f"open({str(report)!r}, 'w'); raise SystemExit(1)"
    assert cpu_seconds_of([sys.executable, "-S", "-c", writes], tmp_path) > 0
    with pytest.raises(SystemExit, match="nothing is stored: exit status 2"):
        cpu_seconds_of([sys.executable, "-S", "-c", "raise SystemExit(2)"], tmp_path)
    assert not report.exists()
