"""Makespans of plans in physics, in each order, beside the predicted ones; success of policies in each mode."""

import json
import runpy
import sys
from contextlib import contextmanager

import plan_orders
import policy_modes
import pytest
import running
from plan_orders import executed, plan_figures

from craftsim.checking.setup import setup_of
from craftsim.discrete.grid import CarField, Grid
from craftsim.discrete.kinds import Action
from craftsim.learning.starts import with_starts
from craftsim.tasks import as_task
from craftsim.tasks.starts import load_starts


def _side_by_side(*case):
    """Two cars that drive along side by side."""
    grid, move = Grid.empty((4, 2, 1), n_cars=2), Action.MOVE_RIGHT
    grid.cars[1, CarField.Y] = 1
    return grid, [[(0, move), (1, move)]] * 2


def _executed(case):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(plan_orders, "_planned", _side_by_side)
        return executed(case)


@pytest.fixture
def short_plan(monkeypatch):
    """Execute a plan of four moves in the place of those of the tasks."""
    monkeypatch.setattr(plan_orders, "executed", _executed)


def test_the_plans_are_those_of_the_tasks():
    grid, ticks = plan_orders._planned("strip", None, 0, setup_of("mild", drive="wheels"))
    assert (grid.n_cars, sum(map(len, ticks))) == (2, 22)


def test_a_plan_is_executed_in_each_order_from_the_same_start(
    short_plan, tmp_path, monkeypatch, capsys
):
    monkeypatch.setattr(plan_orders, "TASK_NAMES", ("strip",))
    assert plan_orders.main(["--out", str(tmp_path)]) == 0
    (world,) = json.loads((tmp_path / "report.json").read_text())["figures"]["worlds"]
    orders = world["orders"]
    assert [one["agrees"] for one in orders.values()] == [True] * 3
    assert orders["sequential"]["executed_s"] > 1.5 * orders["concurrent"]["executed_s"]
    assert all(0.9 < one["executed_s"] / one["predicted_s"] < 1.5 for one in orders.values())
    said = capsys.readouterr().out
    assert "times sequential" in said
    (row,) = (line.split() for line in said.splitlines() if line.startswith("strip"))
    assert row[3::2] == [f"{orders[name]['executed_s']:.1f}" for name in plan_orders.ORDERS]


def test_a_policy_is_executed_in_each_mode_from_the_same_starts(tmp_path, monkeypatch, capsys):
    *others, network = policy_modes.MODES
    assert (network.drive, network.randomize) == ("rollers", "workshop_floor")
    quick = network._replace(drive="wheels", randomize="mild")
    monkeypatch.setattr(policy_modes, "MODES", (*others, quick))
    asked = ["random_strip", "--episodes", "1", "--seed", "3", "--out", str(tmp_path)]
    assert policy_modes.main(asked) == 0
    modes = json.loads((tmp_path / "report.json").read_text())["figures"]["modes"]["random_strip"]
    assert set(modes) == {*map(str, policy_modes.MODES)}
    assert {one["success"]["trials"] for one in modes.values()} == {1}
    assert "grid asynchronous" in capsys.readouterr().out
    (reached,) = load_starts(tmp_path / "starts-random_strip.npz")
    with_starts(as_task("random_strip"), tmp_path / "starts-random_strip.npz")
    assert reached.n_cars == 2


def test_policies_are_executed_by_the_script_that_is_started_by_its_path(tmp_path, monkeypatch):
    monkeypatch.setattr(policy_modes, "MODES", (policy_modes.REACHED,))
    words = ["policy_modes.py", "random_strip", "--episodes", "1", "--out", str(tmp_path)]
    monkeypatch.setattr(sys, "argv", words)
    with pytest.raises(SystemExit) as ended:
        runpy.run_path(policy_modes.__file__, run_name="__main__")
    assert ended.value.code == 0


@pytest.mark.parametrize(
    "policies", [(), ("random_breaking_barrier",)]
)  # of the latter actions are sampled
def test_an_interrupted_run_goes_on_to_the_same_report(policies, short_plan, tmp_path, monkeypatch):
    monkeypatch.setattr(plan_orders, "TASK_NAMES", ("strip", "block"))
    monkeypatch.setattr(policy_modes, "MODES", (policy_modes.REACHED,))
    main = policy_modes.main if policies else plan_orders.main
    asked = [*policies, *(["--episodes", "2"] if policies else []), "--out"]
    done = []

    @contextmanager
    def interrupted(total):
        def on_record(record):
            done.append(record["key"])
            if len(done) == total - 1:
                raise KeyboardInterrupt

        yield on_record

    with monkeypatch.context() as cut:
        cut.setattr(running, "counting", lambda what: interrupted)
        assert main([*asked, str(tmp_path / "cut")]) == 130
    assert main([*asked, str(tmp_path / "cut"), "--resume", "--workers", "2"]) == 0
    assert main([*asked, str(tmp_path / "whole")]) == 0
    one, other = (
        json.loads((tmp_path / name / "report.json").read_text()) for name in ("cut", "whole")
    )
    one.pop("wall"), other.pop("wall")
    assert one == other
    for starts in (tmp_path / "whole").glob("starts-*"):
        assert starts.read_bytes() == (tmp_path / "cut" / starts.name).read_bytes()
    lines = [
        json.loads(line) for line in (tmp_path / "cut" / "trials.jsonl").read_text().splitlines()
    ]
    assert {line["key"] for line in lines} > set(done)
    assert len({line["key"] for line in lines}) == len(lines) == len(done) + 1


def test_what_is_no_trained_policy_is_refused_before_anything_is_played(tmp_path, capsys):
    asked = ["random_strp", "--out", str(tmp_path / "out")]
    assert policy_modes.main(asked) == 2
    assert (
        "random_strp: no such file; did you mean 'random_strip'?; shipped"
        in capsys.readouterr().err
    )
    assert not (tmp_path / "out" / "session.db").exists()
    assert policy_modes.main([*asked, "--episodes", "0"]) == 2
    assert plan_orders.main(["--out", str(tmp_path), "--designs", "-1"]) == 2
    assert plan_orders.main(["--out", str(tmp_path), "--workers", "0"]) == 2
    said = capsys.readouterr().err
    assert all(
        f"{option}; allowed: " in said
        for option in ("--episodes is 0", "--designs is -1", "--workers is 0")
    )


def test_only_worlds_that_go_as_predicted_in_all_orders_are_compared():
    def record(sequential_s, agrees=True):
        took_s = {"sequential": sequential_s, "ticks": sequential_s / 2, "concurrent": 2.0}
        of = {
            name: {"agrees": agrees, "executed_s": s, "predicted_s": 2.0}
            for name, s in took_s.items()
        }
        return {"orders": of}

    figures = plan_figures([record(4.0), record(16.0), record(9.0, False), {"no_plan": "none"}])
    shares, ratio = figures["as_predicted"]["ticks"], figures["concurrent_by"]["sequential"]
    assert (figures["compared"], shares.successes, shares.trials) == (2, 2, 3)
    # A geometric mean, with an interval.
    assert (ratio.value, ratio.low * ratio.high) == pytest.approx((0.25, 0.25**2))
    assert ratio.low < 0.25 < ratio.high
