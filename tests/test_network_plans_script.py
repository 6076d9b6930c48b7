"""Buildings by plans behind a network, and with a car that dies: which count, and what they come to."""

import pytest
from network_plans import (
    BEHIND,
    CONDITIONS,
    HEADS,
    _counts,
    can_do_without,
    cells,
    main,
    summary,
    table_rows,
)

from craftsim.tasks import TASK_NAMES


def _run(built, **more):
    run = {
        "built": built,
        "ended": "built" if built else "gave up",
        "why": "" if built else "no way",
        "seconds": 30.0,
        "actions": 20,
        "failed": 1,
        "retried": 2,
        "went_back": 1,
        "seated": 0,
        "plans": 2,
        "disturbed": "",
        "counts": True,
    }
    return {**run, **more}


def test_buildings_that_count_are_summed():
    figures = summary([_run(True), _run(False), _run(False, counts=False)])
    assert (figures["success"].successes, figures["success"].trials) == (1, 2)
    assert (figures["left_out"], figures["lost"]) == (1, ["gave up: no way"])
    row = cells(figures)
    assert row == ("1/2", "1", "30", "2/40", "4", "2", "0", "4", "gave up: no way")
    assert len(row) == len(HEADS) - 1
    stored = {**figures, "success": vars(figures["success"])}
    by_group = {f"{task}, {condition}": stored for task in TASK_NAMES for condition in CONDITIONS}
    heads, first, *_ = table_rows(by_group)
    assert first == ("strip", "1/2", "1/2", "1", "2 gave up")
    assert len(heads) == len(first)
    proved = {
        **stored,
        "lost": ["gave up: no plan: not enough slopes", "gave up: no plan found: x"],
    }
    _, first, *_ = table_rows({**by_group, f"strip, {CONDITIONS[0]}": proved})
    assert first[-1] == "1 no plan exists; 2 gave up"


def test_a_building_counts_where_the_car_that_died_can_be_done_without():
    died = "car 1 is out of action from 3.00 s on"
    assert can_do_without("strip", 1)
    assert _counts("strip", {"disturbed": died, "why": ""})
    assert not _counts("strip", {"disturbed": "", "why": ""})
    too_few = "no plan: not enough blocks; the design has 4, the start 3"
    assert not _counts("strip", {"disturbed": died, "why": too_few})


@pytest.mark.parametrize("words", [("castle",), ("strip", "--conditions", "storm")])
def test_what_is_not_there_is_said(words, tmp_path, capsys):
    assert main([*words, "--out", str(tmp_path)]) == 2
    assert BEHIND in capsys.readouterr().err or words == ("castle",)
