"""Figures of recorded runs show what was recorded, say what failed, and are the same for the same run."""

from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from recorded import record

from craftsim.checking.contacts import impact_limit_n
from craftsim.cli import main
from craftsim.discrete.actions import ACTIONS
from craftsim.discrete.grid import Grid, Kind
from craftsim.discrete.kinds import Action
from craftsim.errors import InputError
from craftsim.rendering.plots.figures import plots_of, write_figures
from craftsim.rendering.plots.signals import Signals, path_points, thinned
from craftsim.rendering.plots.timeline import SIGNS, notes_of
from craftsim.rendering.trajectory import GoalCell, Trajectory, trajectory_files


@pytest.fixture(scope="module")
def recorded() -> Trajectory:
    """A move, of which the record says that it failed, beside a slope."""
    grid = Grid.empty((4, 2, 1), n_cars=1)
    grid.kind[2, 1, 1], grid.kind[3, 1, 1] = Kind.FSLOPE, Kind.GEAR
    grid.derive_marks()
    trajectory = record(grid, Action.MOVE_RIGHT)
    failed = replace(trajectory.story.attempts[0], result="unsafe", reason="it fell on <b>$x_1$</b>")
    design = (GoalCell("block", (3, 0, 1), -1),)
    return replace(trajectory, story=replace(trajectory.story, attempts=(failed,), design=design))


@pytest.fixture(scope="module")
def signals(recorded: Trajectory) -> Signals:
    return Signals.of(recorded)


@pytest.fixture
def run(recorded: Trajectory, tmp_path: Path) -> Path:
    for name in ("move-0", "move-1"):
        (tmp_path / "run" / "trajectories").mkdir(parents=True, exist_ok=True)
        recorded.write(tmp_path / "run" / "trajectories" / f"{name}.npz")
    return tmp_path / "run"


def test_a_thinned_line_keeps_its_peaks_and_its_gaps() -> None:
    time, values = np.arange(10_000.0), np.zeros(10_000)
    values[7123], values[2001], values[5000:5200] = 9.0, -9.0, np.nan
    times, kept = thinned(time, values, 100)
    assert len(kept) < 200
    assert np.nanmax(kept) == 9.0
    assert np.nanmin(kept) == -9.0
    assert np.isnan(kept).any()
    assert times[0] == 0
    assert times[-1] == 9999


def test_a_short_line_is_left_as_it_is() -> None:
    time, values = np.arange(5.0), np.arange(5.0)
    assert thinned(time, values, 5)[1] is values


def test_a_resting_car_needs_two_points_of_its_path() -> None:
    assert path_points(np.ones((1000, 3))) == [0, 999]


def test_errors_are_along_and_across_the_car(recorded: Trajectory) -> None:
    path, measured = np.full_like(recorded.path, np.nan), recorded.measured.copy()
    path[:, 0] = (0.5, 0.5, np.pi / 2)
    measured[:, 0] = (0.4, 0.7, np.pi / 2 + 0.1)
    car = Signals.of(replace(recorded, path=path, measured=measured)).cars[0]
    # It faces +y: 0.2 m ahead of its path, and 0.1 m to the left of it.
    assert np.allclose(car.error, (0.2, 0.1, 0.1), atol=1e-6)


def test_signals_are_what_was_recorded(recorded: Trajectory, signals: Signals) -> None:
    car = signals.cars[0]
    assert np.allclose(car.place[0], (0, 0, 1), atol=0.02)
    assert np.allclose(car.place[-1], (1, 0, 1), atol=0.02)
    assert np.nanmax(np.abs(car.torque_nm)) <= car.torque_limit_nm + 1e-6
    assert signals.impact_limit_n == impact_limit_n()
    assert np.nanmax(signals.contact_n) == np.nanmax(recorded.contact)
    assert len(signals.hinges_rad) == 1


def test_what_failed_is_named_with_its_number_time_and_reason(signals: Signals) -> None:
    (note,) = notes_of(signals.failures)
    assert note.startswith("✗1 1.")
    assert "car 0 move right: unsafe. it fell on" in note


def test_every_action_that_is_carried_out_has_a_sign_of_its_own() -> None:
    assert set(SIGNS) == {action.name for action, spec in ACTIONS.items() if spec.performed}
    assert len(set(SIGNS.values())) == len(SIGNS)


def test_there_is_no_figure_of_contacts_where_none_were_looked_at(recorded: Trajectory) -> None:
    blind = replace(recorded, contact=np.full_like(recorded.contact, np.nan))
    assert [plot.name for plot in plots_of(Signals.of(blind))] == ["paths", "tracking", "torques", "boards"]


def test_a_car_that_was_thrown_far_away_is_drawn_at_the_edge(recorded: Trajectory) -> None:
    qpos = recorded.qpos.copy()
    qpos[-1, recorded.story.poses["car 0"] : recorded.story.poses["car 0"] + 3] = 1e12
    assert (Signals.of(replace(recorded, qpos=qpos)).cars[0].place <= (4, 2, 2)).all()


def test_a_run_s_folder_has_its_trajectories_by_name(run: Path) -> None:
    (run / "trajectories" / ".partial-0-move-0.npz").touch()  # left by a kill
    assert [path.stem for path in trajectory_files(run)] == ["move-0", "move-1"]
    assert [path.stem for path in trajectory_files(run / "trajectories")] == ["move-0", "move-1"]
    assert trajectory_files(run, "move-1.npz") == [run / "trajectories" / "move-1.npz"]


def test_an_audit_s_trajectories_lie_in_its_bundles(recorded: Trajectory, tmp_path: Path) -> None:
    bundle = tmp_path / "bundles" / "00000"
    bundle.mkdir(parents=True)
    (bundle / "bundle.json").write_text("{}")
    (bundle / "before.npz").write_bytes(b"")
    with pytest.raises(InputError, match="no trajectories"):
        trajectory_files(bundle)
    path = recorded.write(bundle / "trajectory.npz")
    assert (
        trajectory_files(bundle)
        == trajectory_files(tmp_path)
        == trajectory_files(tmp_path, "00000")
        == [path]
    )


def test_plot_draws_one_run_of_a_folder_and_the_same_for_the_same_run(
    run: Path, signals: Signals, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["plot", str(run), "--run", "move-1", "--out", str(tmp_path / "out")]) == 0
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["move-1"]
    files = {path.name: path.read_bytes() for path in (tmp_path / "out" / "move-1").iterdir()}
    names = [plot.name for plot in plots_of(signals)]
    assert set(files) == {f"{name}.{end}" for name in names for end in ("pdf", "png")} | {"all.pdf"}
    assert all(content[:5] in (b"%PDF-", b"\x89PNG\r") for content in files.values())
    assert f"move-1: {len(files)} files in" in capsys.readouterr().out
    for again in islice(write_figures(tmp_path / "again", signals), 2):
        assert again.read_bytes() == files[again.name]


def test_plot_says_what_is_wrong(
    run: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for words, message in (
        (
            ["run", "--run", "move-2"],
            "no trajectory 'move-2'; did you mean 'move-1'?; there are move-0, move-1",
        ),
        (["run/trajectories/move-0.npz", "--run", "move-0"], "is no folder"),
        (["nowhere"], "no such file or folder"),
        (["."], "no trajectories in it; run it again with --record"),
    ):
        monkeypatch.chdir(run.parent)
        assert main(["plot", *words]) == 2
        assert message in capsys.readouterr().err
