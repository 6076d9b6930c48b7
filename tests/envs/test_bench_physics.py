"""What is measured of physics in worlds made for it: cars to and fro, blocks at rest, many worlds."""

import numpy as np
import pytest
from rich.console import Console

from craftsim.commands import bench_batches, bench_physics
from craftsim.commands.bench_worlds import MOST_BLOCKS, MOST_CARS, to_and_fro, yard
from craftsim.discrete.grid import Kind
from craftsim.envs import parallel_env


@pytest.mark.parametrize(("n_cars", "n_blocks"), [(2, 8), (MOST_CARS, MOST_BLOCKS)])
def test_in_a_yard_all_cars_drive_to_and_fro_as_the_rules_allow_and_blocks_stay(n_cars, n_blocks):
    env = parallel_env(yard(n_cars, n_blocks), "grid")
    observations, _ = env.reset(seed=0)
    start = env.grid
    assert (start.kind == Kind.BLOCK).sum() == n_blocks
    for tick in range(2):
        assert len(env.agents) == n_cars
        observations, *_, infos = env.step(to_and_fro(tick, None, observations))
        assert not any(info["illegal"] for info in infos.values())
        moved = np.abs(env.grid.cars[:, :2] - start.cars[:, :2]).sum(-1)
        assert (moved == (1 - tick)).all()
    assert env.grid.same_visible(start)
    assert not env.agents


def test_the_bench_of_physics_prints_plots_and_says_what_grows(tmp_path, monkeypatch):
    for name, few in (("WORLDS", 2), ("_TICKS", 1)):
        monkeypatch.setattr(bench_batches, name, few)
    for name, few in (("_REPEATS", 1), ("_RESETS_S", 0.05), ("_PACE_S", 0.05)):
        monkeypatch.setattr(bench_physics, name, few)
    console = Console(record=True, width=120)
    figures = bench_physics.bench_physics(
        console, ["simple_two_story"], 0.02, 0, tmp_path, ["rollers"], cars=[2, 4], blocks=[8]
    )
    text = console.export_text()
    assert "a car of 4 costs" in text
    assert "8 blocks at rest add" in text
    assert (tmp_path / "physics.png").stat().st_size > 5000
    page = (tmp_path / "physics.md").read_text()
    assert page.count("| rollers |") == 4
    assert "with equal results" in page
    assert figures["joint_steps"]["simple_two_story, rollers"]["times"] > 0
    assert [(row["n_cars"], row["n_blocks"]) for row in figures["yards"]] == [(2, 0), (4, 0), (4, 8)]
    for row in figures["yards"]:
        assert row["share_of_mj_step"] > 0
        assert row["resets_a_second"] > 0
    workers = figures["workers"]["rollers"]
    assert workers["free_ratio"] > 0
    assert 0 < figures["mib_a_world"]["rollers"] < 50
