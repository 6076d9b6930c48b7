"""scripts/gpu.py: trials in lockstep, replays, tables, and MuJoCo Warp itself where it is installed."""

import json
import math
import shutil
from types import SimpleNamespace

import gpu
import numpy as np
import pytest

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
    "rates": {
        "strip": {
            "steps": 3000,
            "joint_steps": 12,
            "mujoco_a_second": 10_000.0,
            "mujoco_asleep_a_second": 20_000.0,
            "replays": [
                {
                    "worlds": 64,
                    "steps": 3000,
                    "steps_a_second": 1e6,
                    "equal": 63,
                    "median_off_m": 1e-6,
                    "most_off_m": 2e-5,
                    "overflows": [],
                }
            ],
            "why": "no time for 4096 worlds",
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
    assert gpu.rate_table(STORED) == [
        ("joint steps/s", "worlds", "strip"),
        ("MuJoCo", "1", "80"),
        ("nothing asleep", "1", "40"),
        ("Warp", "64", "4,000"),
        ("closed loop", "2", "8"),
        ("end as MuJoCo's", "64", "63"),
        ("physics steps each", "", "250"),
    ]
    assert gpu.notes_of(STORED) == [
        "strip, 64 worlds: after 3000 steps of replay off by 0.001 mm at the median, 0.02 mm at most",
        "strip: no time for 4096 worlds",
        "strip, 2 worlds: NEFC in some step",
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


def test_a_recording_ends_as_its_trial_whether_machines_sleep_or_not():
    recording = gpu.Recording("strip", gpu.own_setup())
    assert recording.mujoco_rate(0.0) > 0
    assert not recording.grid(recording.positions[-1]).problems


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

    recording = gpu.Recording("strip", gpu.own_setup())
    physics = recording.physics
    physics.restore(recording.first)
    with wp.ScopedDevice("cpu"):
        worlds = gpu.DeviceWorlds([physics], 2, 120, 200)
        for ctrl, limits in zip(recording.ctrl[:50], recording.limits[:50], strict=True):
            physics.data.ctrl[:], physics.model.actuator_forcerange[:] = ctrl, limits
            worlds.data.ctrl.assign(np.tile(ctrl.astype(np.float32), (2, 1)))
            worlds.model.actuator_forcerange.assign(np.tile(limits.astype(np.float32), (2, 1, 1)))
            physics.run(1)
            worlds.step()
        assert np.abs(worlds.data.qpos.numpy() - physics.data.qpos).max() < 1e-5
        assert worlds.figures()["overflows"] == []
    assert np.abs(physics.data.qpos - recording.first.data.qpos).max() > 1e-3
