"""Recordings of Rerun hold the world, poses, contacts and verdicts of a trajectory."""

from collections import defaultdict
from dataclasses import replace

import numpy as np
import pytest
from rendering.recorded import record

from craftsim import Action, Grid
from craftsim.cli import main
from craftsim.discrete.geometry import LEVEL_HEIGHT_M, cell_position
from craftsim.discrete.grid import Kind
from craftsim.rendering.trajectory import GoalCell, SeenWorld


@pytest.fixture(scope="module")
def run():
    grid = Grid.empty((3, 2, 1), n_cars=1)
    grid.kind[2, 0, 1] = Kind.BLOCK
    return record(grid, Action.ROTATE_LEFT, Action.FOLD, title="a turn")


def test_without_the_sdk_the_command_says_what_to_install(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr("craftsim.storage.extras.find_spec", lambda name: None)
    assert main(["render", "strip", str(tmp_path / "out.rrd")]) == 2
    said = capsys.readouterr().err
    assert "files for Rerun need rerun, not installed here; try: " in said
    assert not any(tmp_path.iterdir())


def test_moments_and_other_runs_are_refused(tmp_path, capsys):
    assert main(["render", "strip", str(tmp_path / "out.rrd"), "--at", "1"]) == 2
    assert "is of one whole run; leave --beside and --at out" in capsys.readouterr().err


def test_a_recording_holds_what_the_trajectory_holds(run, tmp_path):
    pytest.importorskip("rerun")
    from rerun.chunk import RrdReader

    goal = GoalCell("block", (1, 1, 1), -1)
    replace(run, story=replace(run.story, design=(goal,))).write(tmp_path / "run.npz")
    assert main(["render", str(tmp_path / "run.npz"), str(tmp_path / "run.rrd")]) == 0
    columns = defaultdict(list)
    for chunk in RrdReader(tmp_path / "run.rrd").stream():
        batch = chunk.to_record_batch()
        for name in batch.schema.names:
            columns[chunk.entity_path.strip("/"), name] += batch.column(name).to_pylist()
    seen = SeenWorld(run.physics)
    for name in ("car0/smartcar", "car0/wheel_fl", "block0/block"):
        entity = f"world/{name}"
        body = seen.model.body(name).id
        poses = [np.r_[data.xpos[body], data.xquat[body]] for data in map(seen.at, run.qpos)]
        position = np.squeeze(columns[entity, "Transform3D:translation"])
        x, y, z, w = np.squeeze(columns[entity, "Transform3D:quaternion"]).T
        np.testing.assert_allclose(np.c_[position, w, x, y, z], poses, atol=1e-6)
        times = [time.total_seconds() for time in columns[entity, "simulated"]]
        np.testing.assert_allclose(times, run.time, atol=1e-6)
        assert len(columns[entity, "Mesh3D:vertex_positions"][0]) > 30
    (centers,) = columns["design", "Boxes3D:centers"]
    expected = cell_position(1, 1, 1) + np.array([0, 0, LEVEL_HEIGHT_M / 2])
    np.testing.assert_allclose(centers, [expected], rtol=1e-6)
    forces = np.squeeze(columns["contact/force_n", "Scalars:scalars"])
    np.testing.assert_allclose(forces, run.contact, rtol=1e-6)
    believed = np.squeeze(columns["cars/car_0/measured", "Points3D:positions"])
    np.testing.assert_allclose(believed[:, :2], run.measured[:, 0, :2], rtol=1e-6)
    turn, fold = run.story.attempts
    texts = [text for (text,) in columns["actions", "TextLog:text"]]
    assert texts == [
        "car 0 ROTATE_LEFT",
        "car 0 ROTATE_LEFT: as predicted",
        "car 0 FOLD",
        f"car 0 FOLD: failed: {fold.reason}",
    ]
    assert columns["actions", "TextLog:level"] == [["DEBUG"], ["INFO"], ["DEBUG"], ["ERROR"]]
    moments = [time.total_seconds() for time in columns["actions", "simulated"]]
    assert moments[1] == pytest.approx(turn.start_s + turn.duration_s)
