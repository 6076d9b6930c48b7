"""What a campaign costs beside its trials."""

from types import SimpleNamespace

import numpy as np
import pytest

from craftsim.commands import bench_campaign
from craftsim.commands.bench_campaign import TrialCost, cost_of_a_trial


def test_a_trial_costs_what_each_further_one_takes(monkeypatch):
    times = SimpleNamespace(now_s=0.0)

    def validate(task, *, trials, **options):
        times.now_s += 7.0 + 0.5 * trials

    def of_nothing(n, engine, cpu_s):
        return 3.0 + 0.25 * n

    monkeypatch.setattr(bench_campaign, "_cpu_s", lambda: times.now_s)
    monkeypatch.setattr(bench_campaign, "validate", validate)
    monkeypatch.setattr(bench_campaign, "of_nothing", of_nothing)
    assert cost_of_a_trial("strip", 4, 0) == TrialCost(0.5, 0.25)


def test_campaigns_are_run_to_find_what_a_trial_costs(monkeypatch):
    monkeypatch.setattr(bench_campaign, "_FEW", 2)
    monkeypatch.setattr(bench_campaign, "_MANY", 4)
    cost = cost_of_a_trial("strip", 1, 0)
    assert np.isfinite([cost.trial_s, cost.handing_out_s]).all()


def test_a_million_trials_of_36_ms_are_10_hours():
    assert TrialCost(0.036, 0.001).million_h == pytest.approx(10.0)
