"""Episodes on a floor and behind a network, and the causes of buildings that are not finished."""

import json

import pytest
from network_causes import (
    CONDITIONS,
    TASKS,
    TRAINED,
    built_of,
    cause_of,
    causes_rows,
    end_of,
    main,
    recovery_rows,
    summary,
)


def _failure(outcome: str, astray_m: float = 0.001, bystander_m: float = 0.0) -> dict:
    return {"outcome": outcome, "astray_m": astray_m, "bystander_m": bystander_m}


def _run(success: bool, *failures: dict, problems: tuple[str, ...] = ()) -> dict:
    return {
        "success": success,
        "seconds": 20.0,
        "actions": 10,
        "off_limits": 1,
        "retried": 2,
        "went_back": 1,
        "replaces": "" if success else "the world was the same 3 times",
        "plans": 0 if success else 2,
        "failures": failures,
        "deadlock": "",
        "problems": problems,
    }


@pytest.mark.parametrize(
    ("failure", "cause"),
    [
        (_failure("blocked: 50 mm behind the path", 0.008), "the car had lost its place"),
        (_failure("blocked: 50 mm behind the path", bystander_m=0.003), "the car collided"),
        (_failure("blocked: 50 mm behind the path"), "the car was blocked"),
        (_failure("timeout: 3 mm from the target"), "the car stalled"),
        (_failure("load lost: the board feels 0 N"), "the load was lost"),
        (_failure("disconnected: nothing has come"), "messages were late"),
        (_failure("succeeded"), "the car was in a wrong cell"),
    ],
)
def test_the_first_failure_has_a_cause(failure, cause):
    assert cause_of(failure) == cause


def test_runs_that_are_not_built_are_counted_by_cause_and_end():
    runs = [
        _run(True, _failure("timeout")),
        _run(False, _failure("timeout"), _failure("succeeded"), problems=("car 0 leans",)),
        _run(False, problems=("block 1 is turned",)),
        _run(False),
    ]
    figures = summary(runs)
    assert (figures["success"].successes, figures["failed"], figures["off_limits"]) == (1, 3, 4)
    assert (figures["retried"], figures["went_back"]) == (8, 4)
    assert (figures["planner_runs"], figures["plans"]) == (3, 6)
    assert figures["causes"] == {
        "the car stalled": 1,
        "objects were displaced": 1,
        "no action failed": 1,
    }
    assert [end_of(run) for run in runs[1:]] == [*figures["ends"]]


def test_a_policy_is_played_in_a_condition_and_reported(tmp_path, capsys):
    words = ["random_strip", "--episodes", "1", "--conditions", "grid", "network"]
    assert main([*words, "--out", str(tmp_path)]) == 0
    on_grid, figures = json.loads((tmp_path / "report.json").read_text())["figures"].values()
    assert (figures["success"]["successes"], figures["success"]["trials"]) == (1, 1)
    assert (on_grid["success"]["successes"], on_grid["actions"]) == (1, 0)
    assert figures["actions"] > 10
    assert "random_strip, network" in capsys.readouterr().out
    assert main(["--conditions", "storm"]) == 2
    assert f"there are {', '.join(CONDITIONS)}" in capsys.readouterr().err.replace("\n", " ")


def _figures(condition, built, **more):
    lost = {"causes": {"the car stalled": 4 - built}, "ends": {"a deadlock": 4 - built}}
    row = {
        "success": {"successes": built, "trials": 4},
        "makespan_s": 30.0,
        "actions": 100,
        "failed": 2,
        **lost,
        **more,
    }
    return {f"{task}, {condition}": row for task in TASKS}


def test_stored_runs_are_summed_by_policy_and_condition():
    stored = [
        _figures("floor and network", 2),
        _figures("floor and network", 3),
        _figures("floor and network, waits", 3),
        _figures("floor and network, recovers", 4, planner_runs=1),
    ]
    heads, both, _, recovers = causes_rows(stored)
    assert both[:6] == ("floor and network", *["5/8"] * 4, "16/800")
    assert both[6:] == ("12 the car stalled",)
    assert len(heads) == len(recovers)
    stored.append(
        {
            group.replace(task, TRAINED.format(task)): row
            for task in TASKS
            for group, row in _figures("floor and network, recovers", 3).items()
            if group.startswith(task)
        }
    )
    heads, *rows = recovery_rows(stored)
    no, yes, further = rows[:3]
    assert [row[0] for row in rows[::3]] == [*TASKS]
    assert further[:3] == ("random_strip, trained further", "yes", "3/4")
    assert no[1:4] == ("no", "3/4", "30")
    assert yes == ("random_strip", "yes", "4/4", "30", "2/100", "1", "")
    assert len(heads) == len(yes)
    assert (built_of(stored, True).successes, built_of(stored, False).successes) == (16, 12)
