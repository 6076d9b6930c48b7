"""The tables of the page on speed are those of the reports beside them."""

import json
from pathlib import Path

from craftsim.commands.bench_calibration import Rate

SPEED = Path(__file__).parents[1] / "docs/speed"
PAGE = (SPEED.parent / "speed.md").read_text(encoding="utf-8")


def _wall(name):
    return json.loads((SPEED / name / "report.json").read_text(encoding="utf-8"))["wall"]


def test_the_tables_of_physics_are_those_of_its_report():
    wall, table = _wall("physics"), (SPEED / "physics/physics.md").read_text(encoding="utf-8")
    for name, rate in wall["joint_steps"].items():
        task, drive = name.split(", ")
        assert f"| {task} | {drive} | {rate['steps_a_second']:.1f} |" in table
        assert f"| {rate['times']:.3f} |" in table
    for row in wall["yards"]:
        what = f"| {row['drive']} | {row['n_cars']} | {row['n_blocks']} |"
        assert f"{what} {row['joint_steps_a_second']:.1f} | {row['units_a_step']:.1f} |" in table
    for workers in wall["workers"].values():
        assert f"two workers do {workers['free_ratio']:.2f} times" in table


def test_the_tables_of_rules_and_environments_are_those_of_their_reports():
    rules, env = ((SPEED / f"{name}/{name}.md").read_text(encoding="utf-8") for name in ("rules", "env"))
    for table, rates in ((rules, _wall("rules")["rates"]), (env, _wall("env")["rates"])):
        for task, by_work in rates.items():
            lines = [line for line in table.splitlines() if line.startswith(f"| {task} |")]
            for rate in by_work.values():
                cells = " | ".join(Rate(**rate).cells())
                assert any(line.endswith(f"| {cells} |") for line in lines)
    for timing in _wall("env")["physics"].values():
        assert f"| {timing['ratio']:.2f} (bar" in env


def test_what_handing_over_costs_is_what_was_measured():
    for engine, who in (("local", "a process"), ("ray", "an actor of Ray")):
        over = _wall("workers")["handing_over"][engine]
        assert f"| {who} | {over['joint_step_cpu_us']:.0f} us | {over['trial_cpu_us']:.0f} us |" in PAGE


def test_what_a_million_runs_cost_is_what_was_measured():
    wall = _wall("workers")
    assert f"| {wall['cpu_s_a_run']:.2f} s |" in PAGE
    assert f"| {1e3 * wall['cpu_s_of_handing_out']:.1f} ms |" in PAGE
    hours = 1e6 * wall["cpu_s_a_run"] / 3600
    assert f"| {hours:.0f} h | {hours / 64:.1f} h |" in PAGE


def test_the_table_of_films_is_that_of_its_report():
    wall, table = _wall("render"), (SPEED / "render/render.md").read_text(encoding="utf-8")
    for film in wall["films"]:
        ratios = film["film_fps"] / film["bare_fps"], film["two_fps"] / film["one_fps"]
        row = next(line for line in table.splitlines() if line.startswith(f"| {film['quality']} |"))
        assert all(f"| {ratio:.2f} |" in row for ratio in ratios)
    for drive, share in wall["recording"].items():
        assert f"adds {100 * share:.1f} % to a run with {drive}" in table


def test_the_table_of_learning_is_that_of_its_report():
    table = (SPEED / "train/train.md").read_text(encoding="utf-8")
    kinds = ("grid", "rollout", "learning", "all")
    for task, rates in _wall("train").items():
        assert f"| {task} | {' | '.join(f'{rates[kind]:,.0f}' for kind in kinds)} |" in table
