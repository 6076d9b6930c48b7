"""What a run writes down is what was simulated, and a file that is not whole is refused."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from craftsim import Trajectory
from craftsim.checking.episode import Recipe, Step, do, start
from craftsim.checking.setup import setup_of
from craftsim.discrete.files.blueprint import blueprint_text
from craftsim.discrete.grid import Grid, Kind
from craftsim.discrete.kinds import Action
from craftsim.errors import InputError
from craftsim.rendering.trajectory import Recorder


def _recipe() -> Recipe:
    grid = Grid.empty((3, 2, 1), n_cars=1)
    grid.kind[2, 0, 1] = Kind.BLOCK
    step = Step.single(0, 0, Action.MOVE_RIGHT)
    return Recipe(blueprint_text(grid), (step,))


@pytest.fixture(scope="module")
def recorded() -> Trajectory:
    recipe, recorder = _recipe(), Recorder()
    judge = start(recipe)
    recorder.begin(judge)
    attempts = do(judge, recipe.steps[0])
    return recorder.trajectory("a move", recipe, attempts)


@pytest.fixture
def file(recorded: Trajectory, tmp_path: Path) -> Path:
    return recorded.write(tmp_path / "move.npz")


def _changed(file: Path, **arrays: np.ndarray) -> Path:
    with np.load(file) as kept:
        np.savez_compressed(file, **{**kept, **arrays})
    return file


def _retold(file: Path, **keys: object) -> Path:
    with np.load(file) as kept:
        story = json.loads(kept["story"].tobytes()) | keys
    return _changed(file, story=np.frombuffer(json.dumps(story).encode(), np.uint8))


def test_samples_are_the_physics_bit_for_bit(recorded: Trajectory) -> None:
    judge = start(_recipe())
    seen = [judge.physics.data.qpos.copy()]
    judge.executor.observers.append(lambda physics: seen.append(physics.data.qpos.copy()))
    do(judge, _recipe().steps[0])
    assert np.array_equal(recorded.qpos, np.array(seen))


def test_a_file_gives_back_what_was_written(recorded: Trajectory, file: Path) -> None:
    again = Trajectory.read(file)
    assert again.story == recorded.story
    for name in ("time", "qpos", "ctrl", "force", "measured", "path", "contact"):
        assert np.array_equal(getattr(again, name), getattr(recorded, name), equal_nan=True), name


def test_the_largest_contact_force_is_what_the_judge_found(recorded: Trajectory) -> None:
    assert recorded.contact.max() == pytest.approx(recorded.story.attempts[0].peak_force_n, rel=1e-6)


def test_a_recording_is_no_larger_than_a_reader_takes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("craftsim.rendering.trajectory.MOST_BYTES", 10_000)
    recipe, recorder = _recipe(), Recorder()
    judge = start(recipe)
    recorder.begin(judge)
    kept = recorder.trajectory("cut", recipe, do(judge, recipe.steps[0]))
    assert 5 < len(kept) < 40
    assert kept.qpos.nbytes <= 10_000


def test_recording_changes_nothing() -> None:
    recipe = replace(_recipe(), setup=setup_of("mild", "physical"))
    ends = []
    for recorder in (None, Recorder()):
        judge = start(recipe)
        if recorder is not None:
            recorder.begin(judge)
        attempts = do(judge, recipe.steps[0])
        data = judge.physics.data
        ends.append((attempts, data.time, data.qpos.tobytes(), data.qvel.tobytes()))
    assert ends[0] == ends[1]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"time": np.zeros(3)}, "'qpos' is float64"),
        ({"more": np.zeros(3)}, "not a trajectory"),
        ({"story": np.zeros(3)}, "is no text"),
        ({"story": np.frombuffer(b'{"schema_version": 99}', np.uint8)}, "schema_version is 99"),
        ({"story": np.frombuffer(b"[1]", np.uint8)}, "story"),
    ],
)
def test_a_file_that_contradicts_itself_is_refused(
    file: Path, change: dict[str, np.ndarray], words: str
) -> None:
    with pytest.raises(InputError, match=words):
        Trajectory.read(_changed(file, **change))


def test_times_that_no_simulation_reaches_are_refused(file: Path, recorded: Trajectory) -> None:
    for first_s, factor in ((0.0, 1e7), (0.0, 1e290), (-100.0, 1.0)):
        time = first_s + recorded.time * factor
        with pytest.raises(InputError, match=r"a number of 'time' is .*; allowed: 0 to 1000000"):
            Trajectory.read(_changed(file, time=time))


def test_poses_beyond_the_columns_are_refused(file: Path) -> None:
    with pytest.raises(InputError, match="points outside"):
        Trajectory.read(_retold(file, poses={"car 0": 10_000}))


def test_a_damaged_file_is_refused(file: Path) -> None:
    file.write_bytes(file.read_bytes()[:-200])
    with pytest.raises(InputError, match="damaged"):
        Trajectory.read(file)


def test_machines_of_another_version_are_refused(recorded: Trajectory) -> None:
    other = replace(recorded, story=replace(recorded.story, motors=recorded.story.motors[::-1]))
    with pytest.raises(InputError, match="record it again"):
        _ = other.model


def test_an_unknown_machine_is_named(recorded: Trajectory) -> None:
    with pytest.raises(InputError, match="no machine 'car 7'; there are car 0, block 0"):
        recorded.pose("car 7")


def test_a_design_that_cannot_be_is_refused(file: Path) -> None:
    for goal, words in (
        ({"kind": "castle", "cell": [0, 0, 1], "yaw": -1}, "kind"),
        ({"kind": "block", "cell": [0, 9, 1], "yaw": -1}, "outside of the area"),
    ):
        with pytest.raises(InputError, match=words):
            Trajectory.read(_retold(file, design=[goal]))
