"""What a run writes down is what was simulated, and a file that is not whole is refused."""

import json
import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from craftsim import Trajectory
from craftsim.checking.recipe import Recipe, Step, perform_step, start
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
    attempts = perform_step(judge, recipe.steps[0])
    return recorder.trajectory("a move", recipe, attempts)


@pytest.fixture
def file(recorded: Trajectory, tmp_path: Path) -> Path:
    return recorded.write(tmp_path / "move.npz")


def test_samples_are_the_physics_bit_for_bit(recorded: Trajectory) -> None:
    judge = start(_recipe())
    seen = [judge.physics.data.qpos.copy()]
    judge.executor.observers.append(lambda physics: seen.append(physics.data.qpos.copy()))
    perform_step(judge, _recipe().steps[0])
    assert np.array_equal(recorded.qpos, np.array(seen))


def test_a_file_gives_back_what_was_written(recorded: Trajectory, file: Path) -> None:
    again = Trajectory.read(file)
    assert again.story == recorded.story
    for name in ("time", "qpos", "ctrl", "force", "measured", "path", "contact"):
        assert np.array_equal(getattr(again, name), getattr(recorded, name), equal_nan=True), name


def test_the_largest_contact_force_is_what_the_judge_found(recorded: Trajectory) -> None:
    assert recorded.contact.max() == pytest.approx(
        recorded.story.attempts[0].peak_force_n, rel=1e-6
    )


def test_a_recording_is_no_larger_than_a_reader_takes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("craftsim.rendering.trajectory.MOST_BYTES", 10_000)
    recipe, recorder = _recipe(), Recorder()
    judge = start(recipe)
    recorder.begin(judge)
    kept = recorder.trajectory("cut", recipe, perform_step(judge, recipe.steps[0]))
    assert 5 < len(kept) < 50
    assert kept.qpos.nbytes <= 10_000


def test_recording_changes_nothing() -> None:
    recipe = replace(_recipe(), setup=setup_of("mild", "physical"))
    ends = []
    for recorder in (None, Recorder()):
        judge = start(recipe)
        if recorder is not None:
            recorder.begin(judge)
        attempts = perform_step(judge, recipe.steps[0])
        data = judge.physics.data
        ends.append((attempts, data.time, data.qpos.tobytes(), data.qvel.tobytes()))
    assert ends[0] == ends[1]


def _contradictions(kept: dict[str, np.ndarray]) -> Iterator[tuple[dict[str, np.ndarray], str]]:
    """Yield what is changed in a file, and what is said about it."""
    told = json.loads(kept["story"].tobytes())

    def story(**keys: object) -> dict[str, np.ndarray]:
        return {"story": np.frombuffer(json.dumps(told | keys).encode(), np.uint8)}

    yield {"time": np.zeros(3)}, "'qpos' is float64"
    yield {"more": np.zeros(3)}, "not a trajectory"
    yield {"story": np.zeros(3)}, "is no text"
    yield {"story": np.frombuffer(b"[1]", np.uint8)}, "story"
    yield story(schema_version=99), "schema_version is 99"
    yield story(poses={"car 0": 10_000}), "points outside"
    yield story(design=[{"kind": "castle", "cell": [0, 0, 1], "yaw": -1}]), "kind"
    yield story(design=[{"kind": "block", "cell": [0, 9, 1], "yaw": -1}]), "outside of the area"
    n, column = len(kept["time"]), json.loads(kept["story"].tobytes())["poses"]["car 0"]
    for first, numbers, words in (
        (0, (math.nan,), "'qpos' holds what is no number"),
        (1, (-1.1e4,), rf"car 0 is further than 10000 m away at .* s \(sample {n - 1}\)"),
        (3, (0.0, 0.0, 0.0, 0.0), "car 0 is turned by a quaternion whose length is not 1"),
        (3, (0.5, 0.0, 0.0, 0.0), "car 0 is turned by a quaternion whose length is not 1"),
        (3, (1e200, 0.0, 0.0, 0.0), "car 0 is turned by a quaternion whose length is not 1"),
    ):
        qpos = kept["qpos"].copy()
        qpos[-1, column + first : column + first + len(numbers)] = numbers
        yield {"qpos": qpos}, words
    for first_s, factor in ((0.0, 1e290), (-100.0, 1.0)):  # which no simulation reaches
        yield (
            {"time": first_s + kept["time"] * factor},
            "a number of 'time' is .*; allowed: 0 to 1000000",
        )


def test_a_file_that_contradicts_itself_or_is_damaged_is_refused(file: Path) -> None:
    with np.load(file) as arrays:
        kept = dict(arrays)
    for change, words in _contradictions(kept):
        np.savez(file, **(kept | change))
        with pytest.raises(InputError, match=words):
            Trajectory.read(file)
    file.write_bytes(file.read_bytes()[:-200])
    with pytest.raises(InputError, match="damaged"):
        Trajectory.read(file)


def test_machines_that_this_version_does_not_make_are_refused(recorded: Trajectory) -> None:
    other = replace(recorded, story=replace(recorded.story, motors=recorded.story.motors[::-1]))
    with pytest.raises(InputError, match="record it again"):
        _ = other.model
    with pytest.raises(InputError, match="no machine 'car 7'; there are car 0, block 0"):
        recorded.pose("car 7")
