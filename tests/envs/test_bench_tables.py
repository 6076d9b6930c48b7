"""What the benches of rules, environments and workers print is what they write, and Ray is measured where it is."""

import multiprocessing
import os
from dataclasses import astuple

import numpy as np
import pytest
from rich.console import Console

from craftsim.commands import bench_handing
from craftsim.commands.bench_env import bench_env
from craftsim.commands.bench_handing import HandingOver, family_cpu_s, hand_over
from craftsim.commands.bench_rules import bench_rules

TASK = "simple_two_story"


def test_the_table_of_the_rules_is_printed_and_written(tmp_path):
    console = Console(record=True, width=120)
    figures, wall = bench_rules(console, [TASK], 5, "physical", 2, 0.01, 3, 0, tmp_path)
    page, text = (tmp_path / "rules.md").read_text(), console.export_text()
    assert figures["memory_worlds"] == 3
    for name, rate in wall["rates"][TASK].items():
        work, n = name.removesuffix("s").removesuffix(" world").split(", ")
        cells = (TASK, work, n, *rate.cells())
        assert f"| {' | '.join(cells)} |" in page
        assert rate.cells()[0] in text
    assert f"- 3 worlds of {TASK}:" in page


def test_the_tables_of_the_environments_are_printed_and_written(tmp_path):
    console = Console(record=True, width=120)
    wall = bench_env(console, [TASK], 5, 2, 0.01, 2, 0, tmp_path)
    page, text = (tmp_path / "env.md").read_text(), console.export_text()
    for name, rate in wall["rates"][TASK].items():
        form, helper = name.split(",")[0], name.rpartition(" ")[2]
        assert f"| {TASK} | {form} | {helper} | {' | '.join(rate.cells())} |" in page
    ratio = f"{wall['physics'][TASK]['ratio']:.2f} (bar"
    assert ratio in page
    assert ratio in text


def test_joint_steps_and_trials_are_timed_where_they_are_and_ray_may_be_missing(monkeypatch):
    for name, few in (("_TURNS", 1), ("_CALLS", 20), ("_FEW", 5), ("_MANY", 45)):
        monkeypatch.setattr(bench_handing, name, few)
    monkeypatch.setattr(bench_handing, "find_spec", lambda name: None)
    found = hand_over(TASK)
    assert list(found) == ["local"]
    # Differences of times, whose sign a machine with other work can turn where so little is timed.
    assert np.isfinite(astuple(found["local"])).all()


def test_handing_over_costs_what_a_step_takes_longer_in_another_process_and_what_each_further_trial_takes(
    monkeypatch,
):
    timed = []

    def time_of(step):
        step()
        timed.append(step.__name__)
        assert len(multiprocessing.active_children()) == 1
        return {"step_there": (3.0, 7.0), "step_here": (1.0, 2.0)}[step.__name__]

    monkeypatch.setattr(bench_handing, "_time", time_of)
    monkeypatch.setattr(bench_handing, "_TURNS", 2)
    monkeypatch.setattr(bench_handing, "of_nothing", lambda n, engine, cpu_s: 4.0 + 0.5 * n)
    monkeypatch.setattr(bench_handing, "find_spec", lambda name: None)
    assert hand_over(TASK) == {"local": HandingOver(2.0, 5.0, 0.5e6)}
    assert timed == ["step_there", "step_here"] * 2


def test_ray_is_measured_on_a_cluster_of_this_machine_alone_that_is_ended(alone, monkeypatch):
    ray = pytest.importorskip("ray", reason="the extra 'ray' is not installed")
    from craftsim.envs.ray_connection import connect, processors

    def hand_over_there(task, engine):
        if engine == "ray":
            assert processors(connect("")[0]) == 1
            assert connect("")[1] == os.environ["RAY_ADDRESS"]
        return HandingOver(1.0, 2.0, family_cpu_s())

    monkeypatch.setenv("RAY_ADDRESS", "127.0.0.1:9")
    monkeypatch.setattr(bench_handing, "_hand_over", hand_over_there)
    found = hand_over(TASK)
    assert list(found) == ["local", "ray"]
    assert found["ray"].trial_cpu_us > found["local"].trial_cpu_us  # the processes of Ray count
    assert os.environ["RAY_ADDRESS"] == "127.0.0.1:9"
    assert not ray.is_initialized()
