"""Figures of runs and plans show what there is, say what failed, and are the same for the same run."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rendering.recorded import record

from craftsim.cli import main
from craftsim.discrete.actions import ACTIONS
from craftsim.discrete.files.shipped import shipped_plan
from craftsim.discrete.grid import Grid, Kind
from craftsim.discrete.kinds import Action
from craftsim.discrete.rules import Rules
from craftsim.discrete.schedule import make_schedule
from craftsim.errors import InputError
from craftsim.planning.plan_file import read_plan
from craftsim.rendering.plots import figures, style
from craftsim.rendering.plots.figures import (
    FAILURE_SIGNS,
    motor_forces,
    notes_of,
    path_of,
    plots_of,
    tracking_error,
    write_figures,
)
from craftsim.rendering.plots.gantt import VERB_COLOURS, draw_gantt
from craftsim.rendering.trajectory import GoalCell, Trajectory, trajectory_files
from craftsim.tasks import make_task


@pytest.fixture(scope="module")
def recorded() -> Trajectory:
    """A move, of which the record says that it failed, beside a slope."""
    grid = Grid.empty((4, 2, 1), n_cars=1)
    grid.kind[2, 1, 1], grid.kind[3, 1, 1] = Kind.FSLOPE, Kind.GEAR
    grid.derive_marks()
    trajectory = record(grid, Action.MOVE_RIGHT)
    failed = replace(
        trajectory.story.attempts[0], result="unsafe", reason="it fell on <b>$x_1$</b>"
    )
    design = (GoalCell("block", (3, 0, 1), -1),)
    return replace(trajectory, story=replace(trajectory.story, attempts=(failed,), design=design))


def test_errors_are_along_and_across_the_car(recorded):
    path, measured = np.full_like(recorded.path, np.nan), recorded.measured.copy()
    path[:, 0] = (0.5, 0.5, np.pi / 2)
    measured[:, 0] = (0.4, 0.7, np.pi / 2 + 0.1)
    error = tracking_error(replace(recorded, path=path, measured=measured), 0)
    # It faces +y: 0.2 m ahead of its path, and 0.1 m to the left of it.
    assert np.allclose(error, (0.2, 0.1, 0.1), atol=1e-6)


def test_signals_are_what_was_recorded(recorded):
    assert np.allclose(path_of(recorded, 0)[[0, -1]], [(0, 0, 1), (1, 0, 1)], atol=0.02)
    torque_nm, force_n = motor_forces(recorded, 0)
    limits = recorded.physics.cars[0].parameters
    assert np.nanmax(np.abs(torque_nm)) <= limits.wheel_torque_nm + 1e-6
    assert np.nanmax(np.abs(force_n)) <= limits.board_force_n + 1e-6
    thrown = recorded.qpos.copy()
    thrown[-1, recorded.story.poses["car 0"] :][:3] = 1e12
    assert (path_of(replace(recorded, qpos=thrown), 0) <= (4, 2, 2)).all(), "drawn at the edge"
    (note,) = notes_of(recorded)
    assert note.startswith("✗1 1.")
    assert "car 0 move right: unsafe. it fell on" in note


def test_every_action_that_is_carried_out_has_a_sign_of_its_own():
    assert set(FAILURE_SIGNS) == {action.name for action, spec in ACTIONS.items() if spec.performed}
    assert len(set(FAILURE_SIGNS.values())) == len(FAILURE_SIGNS)


def test_there_is_no_figure_of_contacts_where_none_were_looked_at(recorded):
    blind = replace(recorded, contact=np.full_like(recorded.contact, np.nan))
    names = list(plots_of(recorded))
    assert names == ["paths", "tracking", "torques", "boards", "contact"]
    assert list(plots_of(blind)) == names[:-1]


def test_trajectories_of_a_run_have_names_and_an_audit_s_lie_in_its_bundles(tmp_path: Path):
    run, bundle = tmp_path / "run", tmp_path / "bundles" / "00000"
    for path in (*(run / "trajectories" / f"move-{n}.npz" for n in (1, 0)), bundle / "before.npz"):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    (run / "trajectories" / ".partial-0-move-0.npz").touch()  # left by a kill
    for folder in (run, run / "trajectories"):
        assert [path.stem for path in trajectory_files(folder)] == ["move-0", "move-1"]
    (bundle / "bundle.json").write_text("{}")
    for folder, message in (
        (bundle, "no trajectories in it; run it again with --record trajectory"),
        (tmp_path / "nowhere", "no such file or folder"),
    ):
        with pytest.raises(InputError, match=message):
            trajectory_files(folder)
    (bundle / "trajectory.npz").touch()
    for folder in (bundle, tmp_path):
        assert trajectory_files(folder) == [bundle / "trajectory.npz"]


def test_a_run_is_drawn_as_pdf_and_png_and_the_same_for_the_same_run(
    recorded, tmp_path, capsys, monkeypatch
):
    monkeypatch.setattr(figures, "_ROWS", {"contact": figures._ROWS["contact"]})
    monkeypatch.setattr(style, "DPI", 40)
    recorded.write(tmp_path / "move.npz")
    assert main(["render", str(tmp_path / "move.npz"), "--out", f"{tmp_path}/out/"]) == 0
    files = {path.name: path.read_bytes() for path in (tmp_path / "out" / "move").iterdir()}
    names = list(plots_of(recorded))
    assert set(files) == {f"{name}.{end}" for name in names for end in ("pdf", "png")} | {"all.pdf"}
    assert all(content[:5] in (b"%PDF-", b"\x89PNG\r") for content in files.values())
    assert f"move: {len(files)} files in" in capsys.readouterr().out
    again = write_figures(tmp_path / "again", recorded)
    for path in (next(again), next(again)):
        assert path.read_bytes() == files[path.name]


def test_a_gantt_chart_has_a_row_for_each_car_the_makespan_and_the_colours_of_its_verbs(tmp_path):
    grid = make_task("complex_two_story").draw(np.random.default_rng(0))
    ticks = read_plan(shipped_plan("complex_two_story"), grid.n_cars).ticks
    schedule = make_schedule(grid, ticks, Rules("physical"))
    text = draw_gantt(tmp_path / "a.svg", schedule, "mine").read_text()
    words = re.findall(r"<!-- (.*?) -->", text)
    assert f"mine: {len(schedule.steps)} actions, makespan {schedule.makespan():.1f} s" in words
    assert [word for word in words if word.startswith("car ")] == [f"car {car}" for car in range(4)]
    assert "loaded" in words
    css = {
        verb: "#" + "".join(f"{round(255 * part):02x}" for part in rgb)
        for verb, rgb in VERB_COLOURS.items()
    }
    assert {verb for verb in css if css[verb] in text} == {
        "move",
        "rotate",
        "lift",
        "drop",
        "unfold",
    }
    assert draw_gantt(tmp_path / "b.svg", schedule, "mine").read_text() == text
    with pytest.raises(InputError, match="nowhere"):
        draw_gantt(tmp_path / "nowhere" / "a.png", schedule, "nothing")
