"""Makespans of plans in physics, in each order, beside the predicted ones."""

import json
import math

import pytest

from craftsim.cli import main
from craftsim.discrete.tasks import as_task
from craftsim.discrete.tasks.starts import load_starts
from craftsim.training.starts import with_starts
from craftsim.validation import execution
from craftsim.validation.execution import plan_figures, ratio_of


def test_a_plan_is_executed_in_each_order_from_the_same_start(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(execution, "TASK_NAMES", ("strip",))
    assert main(["bench", "execution", "--out", str(tmp_path)]) == 0
    (world,) = json.loads((tmp_path / "report.json").read_text())["figures"]["worlds"]
    orders = world["orders"]
    assert [one["agrees"] for one in orders.values()] == [True] * 3
    assert orders["sequential"]["executed_s"] > 1.5 * orders["concurrent"]["executed_s"]
    assert all(0.9 < one["executed_s"] / one["predicted_s"] < 1.4 for one in orders.values())
    assert "times sequential" in capsys.readouterr().out


def test_a_policy_is_executed_in_each_mode_from_the_same_starts(tmp_path, monkeypatch, capsys):
    *others, network = execution.MODES
    assert (network.drive, network.randomize) == ("rollers", "workshop_floor")
    quick = network._replace(drive="reduced", randomize="mild")
    monkeypatch.setattr(execution, "MODES", (*others, quick))
    assert (
        main(["bench", "execution", "random_strip", "--worlds", "1", "--seed", "3", "--out", str(tmp_path)])
        == 0
    )
    modes = json.loads((tmp_path / "report.json").read_text())["figures"]["modes"]["random_strip"]
    assert set(modes) == {*map(str, execution.MODES)}
    assert {one["success"]["trials"] for one in modes.values()} == {1}
    assert "grid asynchronous" in capsys.readouterr().out
    (reached,) = load_starts(tmp_path / "starts-random_strip.npz")
    with_starts(as_task("random_strip"), tmp_path / "starts-random_strip.npz")
    assert reached.n_cars == 2


def test_only_worlds_that_go_as_predicted_in_all_orders_are_compared():
    def record(sequential_s, agrees=True):
        named = {"sequential": sequential_s, "ticks": sequential_s / 2, "concurrent": 2.0}
        return {
            "orders": {
                name: {"agrees": agrees, "executed_s": s, "predicted_s": 2.0} for name, s in named.items()
            }
        }

    figures = plan_figures([record(4.0), record(16.0), record(9.0, False), {"no_plan": "none"}])
    assert (figures["compared"], figures["as_predicted"]["ticks"].successes) == (2, 2)
    assert figures["as_predicted"]["ticks"].trials == 3
    assert figures["concurrent_by"]["sequential"].value == pytest.approx(0.25)


def test_a_ratio_is_a_geometric_mean_with_an_interval():
    found = ratio_of([(1.0, 2.0), (1.0, 8.0)])
    assert found.value == pytest.approx(0.25)
    assert found.low < 0.25 < found.high
    assert found.low * found.high == pytest.approx(0.25**2)
    assert not math.isnan(found.low)
