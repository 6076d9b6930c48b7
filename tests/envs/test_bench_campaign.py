"""What a campaign costs beside its trials."""

import pytest

from craftsim.commands import bench_campaign
from craftsim.commands.bench_campaign import TrialCost, cost_of_a_trial


def test_a_trial_costs_more_than_handing_it_out(monkeypatch):
    monkeypatch.setattr(bench_campaign, "_FEW", 5)
    monkeypatch.setattr(bench_campaign, "_MANY", 105)
    cost = cost_of_a_trial("strip", 1, 0)
    assert cost.handing_out_s > 0
    assert cost.trial_s > 2 * cost.handing_out_s


def test_a_million_trials_of_36_ms_are_10_hours():
    assert TrialCost(0.036, 0.001).million_h == pytest.approx(10.0)
