"""scripts/gpu.py: trials in lockstep, tables, and MuJoCo Warp itself where it is installed."""

import json
import math
import shutil
from types import SimpleNamespace

import gpu
import numpy as np
import pytest

import craftsim
from craftsim.validation.rollout import do_run

STORED = {
    "device": "cuda:0: a GPU",
    "trials": 2,
    "verdicts": {
        "strip": {
            "trials": 2,
            "as_predicted": [44, 43],
            "actions": 44,
            "differing": 1,
            "differences": [
                {"actions": 1, "kind": "LIFT: as predicted there, failed here", "example": "strip/0"}
            ],
            "makespan_ratios": [0.999, 1.0, 1.25],
            "errors": [],
            "loop": {"worlds": 2, "steps": 6000, "seconds": 3.0, "overflows": ["NEFC"]},
        }
    },
}


class OnMuJoCo:
    """Stands for worlds on a device."""

    def __init__(self, worlds):
        self.stepping = [physics._stepping for physics in worlds]
        self.worlds = SimpleNamespace(figures=lambda: {"overflows": []})

    def advance(self, n_steps):
        self.capped = [stepping.run(n_steps) for stepping in self.stepping]

    def show(self, physics, n_steps):
        return 0


def test_tables_say_what_was_found():
    assert gpu.verdict_table(STORED)[1] == ("strip", "44/44", "43/44", "1", "0.999-1.250")
    assert gpu.notes_of(STORED) == [
        "strip: NEFC in some step",
        "strip: 1 LIFT: as predicted there, failed here: such as strip/0",
    ]


def test_trials_in_lockstep_come_to_the_same(monkeypatch, tmp_path):
    monkeypatch.setattr(gpu, "_Mirror", OnMuJoCo)
    jobs, found = gpu.jobs_of("strip", 2, gpu.own_setup()), {}
    alone = {job.key: do_run(job) for job in jobs}
    figures = gpu.Lockstep(jobs, lambda job, done: found.update({job.key: done})).serve(math.inf)
    assert found == alone
    longest = max(done.extra["makespan_s"] for done in alone.values())
    assert figures["steps"] >= 2 * longest / 0.004 * 0.9


def test_trials_that_are_out_of_time_end(monkeypatch):
    monkeypatch.setattr(gpu, "_Mirror", OnMuJoCo)
    found = []
    gpu.Lockstep(gpu.jobs_of("strip", 2, gpu.own_setup()), lambda _, done: found.append(done)).serve(0.0)
    assert [type(done) for done in found] == [TimeoutError] * 2


def test_a_folder_of_records_is_compared(tmp_path):
    gpu.with_mujoco("strip", 0, 1, math.inf, tmp_path)
    shutil.copy(tmp_path / "mujoco_strip.jsonl", tmp_path / "warp_strip.jsonl")
    (tmp_path / "device.json").write_text(json.dumps({"device": "none", "trials": 1}))
    found = gpu.gather(tmp_path)["verdicts"]["strip"]
    assert found["as_predicted"] == [found["actions"]] * 2
    assert (found["trials"], found["differing"], found["makespan_ratios"]) == (1, 0, [1.0] * 3)


def test_without_mujoco_warp_it_says_what_to_install(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(gpu, "wp", None)
    monkeypatch.setattr("sys.argv", ["gpu.py", "--out", str(tmp_path)])
    assert gpu.main() == 2
    assert gpu.PIP in capsys.readouterr().err
    monkeypatch.setattr("sys.argv", ["gpu.py", "report", "--out", str(tmp_path)])
    assert gpu.main() == 2
    assert "nothing has run" in capsys.readouterr().err


@pytest.mark.slow  # compiles kernels, for minutes
def test_mujoco_warp_steps_as_mujoco_does():
    wp = pytest.importorskip("warp")
    pytest.importorskip("mujoco_warp")

    setup = gpu.own_setup()
    grid = craftsim.Grid.empty((4, 3, 1), n_cars=1)
    physics = craftsim.PhysicsWorld(grid, setup.simulation, machines=setup.machines)
    physics.drive(0, [3.0] * 4)
    before = physics.data.qpos.copy()
    with wp.ScopedDevice("cpu"):
        worlds = gpu.DeviceWorlds([physics] * 2, 2, 120, 200)
        for _ in range(50):
            physics.run(1)
            limits = np.array([physics.model.actuator_forcerange] * 2, np.float32)
            worlds.data.ctrl.assign(np.array([physics.data.ctrl] * 2, np.float32))
            worlds.model.actuator_forcerange.assign(limits)
            worlds.step()
        assert np.abs(worlds.data.qpos.numpy() - physics.data.qpos).max() < 1e-5
        assert worlds.figures()["overflows"] == []
    assert np.abs(physics.data.qpos - before).max() > 1e-3
