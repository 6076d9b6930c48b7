"""A replay bundle gives the same again, bit for bit, says what is damaged, and holds nothing that could run."""

import io
import json
import zipfile
from dataclasses import replace
from pathlib import Path

import av
import mujoco
import numpy as np
import pytest

from craftsim import cli
from craftsim.audit.audit import AuditTrial, recipe_of, run_trial
from craftsim.audit.situation import scenes
from craftsim.checking.recipe import Recipe, Step, perform_step, run_up
from craftsim.checking.setup import Seed, compile_world, setup_of
from craftsim.cli import films
from craftsim.cli.films import record_bundle
from craftsim.discrete.files.blueprint import blueprint_text
from craftsim.discrete.grid import Grid, Kind
from craftsim.discrete.kinds import Action
from craftsim.discrete.rules import Rules
from craftsim.errors import InputError
from craftsim.experiments import bundle as replaying
from craftsim.experiments.bundle import (
    AFTER,
    BEFORE,
    PHYSICS_FILE,
    read_bundle,
    replay,
    write_bundle,
)


def _world() -> Grid:
    """Return a car below a folded slope, a second one that stands where the foot goes, and a block behind."""
    grid = Grid.empty((6, 3, 2), 2)
    grid.cars[:, :4] = [[3, 1, 1, 0], [2, 1, 1, 1]]
    grid.kind[3, 1, 1], grid.kind[2, 1, 1], grid.kind[4, 1, 1] = Kind.FSLOPE, Kind.GEAR, Kind.BLOCK
    grid.yaw[3, 1, 1] = grid.yaw[2, 1, 1] = 2
    grid.derive_marks()
    return grid


CALM = setup_of("none", "published", drive="wheels")
ROLLERS, NOISY = setup_of("none", "published"), setup_of("strong", "published", assume="mild")


def _recipe(setup=CALM) -> Recipe:
    """Return what goes wrong: a turn of the second car, a tick of both, and then the slope unfolds onto a car."""
    steps = (
        Step.single(0, 1, Action.ROTATE_LEFT),
        Step.of_ticks(1, [(0, Action.STOP), (1, Action.ROTATE_RIGHT)]),
        Step.single(2, 0, Action.UNFOLD),
    )
    return Recipe(blueprint_text(_world()), steps, setup, Seed((5, 1)))


def _perform(recipe, reuse=None):
    """Re-run a recipe, and return what came of its last step."""
    return perform_step(run_up(recipe, reuse), recipe.steps[-1])


@pytest.fixture(scope="module")
def calm(tmp_path_factory) -> Path:
    """A bundle of something that failed, under nominal physics."""
    folder = tmp_path_factory.mktemp("calm") / "unfold"
    write_bundle(folder, "unfold onto a car", _recipe())
    return folder


@pytest.fixture(scope="module")
def noisy(tmp_path_factory) -> Path:
    """The same under noise and randomised physics."""
    folder = tmp_path_factory.mktemp("noisy") / "unfold"
    write_bundle(folder, "unfold onto a car", _recipe(NOISY))
    return folder


@pytest.fixture(params=["calm", "noisy"])
def folder(request) -> Path:
    """Either of them."""
    return request.getfixturevalue(request.param)


@pytest.fixture
def copy(calm, tmp_path) -> Path:
    """A bundle to be spoilt."""
    for path in calm.glob("*.*"):
        (tmp_path / path.name).write_bytes(path.read_bytes())
    return tmp_path


def _run(folder: Path, out: Path, *words: str) -> int:
    return cli.main(["replay", str(folder), "--out", str(out), *words])


def test_a_bundle_is_reproduced_bit_for_bit(folder, tmp_path, capsys):
    assert _run(folder, tmp_path) == 0
    said = capsys.readouterr().out
    assert "Reproduced: the same bit for bit." in said
    assert "car 0 UNFOLD: failed." in said
    assert "touched" in said
    figures = json.loads((tmp_path / "report.json").read_text())["figures"]
    assert (figures["reproduced"], figures["differing"]) == (True, [])
    recorded = read_bundle(folder)
    assert 0.3 < recorded.bundle.start_s < recorded.bundle.end_s
    assert recorded.arrays[BEFORE]["time"] == recorded.bundle.start_s
    assert recorded.arrays[AFTER]["time"] == recorded.bundle.end_s
    assert not np.array_equal(recorded.arrays[BEFORE]["qpos"], recorded.arrays[AFTER]["qpos"])


def test_two_bundles_of_one_recipe_are_equal(folder, tmp_path):
    bundle = read_bundle(folder).bundle
    assert write_bundle(tmp_path, bundle.key, bundle.recipe, bundle.attempts) == bundle
    for path in folder.rglob("*.*"):
        assert (tmp_path / path.relative_to(folder)).read_bytes() == path.read_bytes(), path


def test_the_recipe_of_a_trial_is_the_trial():
    scene = next(one for one in scenes() if one.legal(Rules("physical")))
    for randomize in ("none", "strong"):
        trial = AuditTrial(scene, True, 3, 7, setup_of(randomize, drive="wheels"))
        assert _perform(recipe_of(trial)) == run_trial(trial).attempts


def test_a_site_used_again_gives_the_numbers_of_a_fresh_one():
    # Turns are enough: a slope that unfolds takes a second of processor time each.
    noisy, calm = (replace(one, steps=one.steps[:2]) for one in (_recipe(NOISY), _recipe(ROLLERS)))
    world = compile_world(_world(), ROLLERS)
    again = [_perform(recipe, world) for recipe in (noisy, calm, noisy)]
    fresh = [_perform(recipe) for recipe in (noisy, calm)]
    assert again == [*fresh, fresh[0]]


def _shift(path: Path, name: str, by: float) -> None:
    with np.load(path) as archive:
        arrays = dict(archive)
    arrays[name] = arrays[name] + by
    np.savez(path, **arrays)


@pytest.mark.parametrize(
    ("file", "name"),
    [(BEFORE, "qvel"), (AFTER, "qpos"), (AFTER, "qacc_warmstart"), (PHYSICS_FILE, "body_mass")],
)
def test_the_smallest_difference_is_found(copy, tmp_path, capsys, file, name):
    _shift(copy / file, name, 1e-12)
    assert _run(copy, tmp_path / "out") == 1
    assert f"Not the same: {file}: {name}." in capsys.readouterr().out


def test_with_another_version_a_small_difference_passes_and_a_large_one_does_not(
    copy, tmp_path, capsys, monkeypatch
):
    monkeypatch.setattr(
        replaying, "versions", lambda: {"craftsim": "9.9", "mujoco": "4.2.0", "numpy": "x"}
    )
    _shift(copy / AFTER, "qpos", 1e-6)
    assert _run(copy, tmp_path / "out") == 0
    assert (
        f"Recorded with mujoco {mujoco.__version__}, replayed with 4.2.0" in capsys.readouterr().out
    )
    figures = json.loads((tmp_path / "out" / "report.json").read_text())["figures"]
    assert figures["changed_versions"]["mujoco"] == [mujoco.__version__, "4.2.0"]
    assert (figures["reproduced"], figures["differing"]) == (True, [f"{AFTER}: qpos"])
    _shift(copy / AFTER, "qpos", 0.002)
    far = replay(read_bundle(copy))
    assert not far.reproduced
    assert far.position_m == pytest.approx(0.002 * 3**0.5, rel=0.01)


def test_a_bundle_is_text_and_plain_arrays(folder):
    paths = [path for path in folder.rglob("*") if path.is_file()]
    assert {path.suffix for path in paths} == {".json", ".npz", ".csv", ".xml"}
    for path in paths:
        if path.suffix == ".npz":
            with zipfile.ZipFile(path) as archive:
                for name in archive.namelist():
                    np.load(io.BytesIO(archive.read(name)), allow_pickle=False)
        else:
            assert all(c.isprintable() or c in "\r\n" for c in path.read_text(encoding="utf-8"))


def test_the_clip_lasts_as_long_as_it_should_and_moves(
    rendering, calm, tmp_path, capsys, monkeypatch
):
    assert films.CLIP_S == 3.0
    monkeypatch.setattr(films, "CLIP_S", 0.4)
    monkeypatch.setattr(films, "SIZE", (192, 108))
    assert _run(calm, tmp_path, "--video") == 0
    film = tmp_path / "unfold.mp4"
    assert str(film) in capsys.readouterr().out
    with av.open(str(film)) as container:
        (stream,) = container.streams.video
        assert (stream.codec_context.name, stream.average_rate) == ("h264", 30)
        pictures = [frame.to_ndarray(format="gray") for frame in container.decode(video=0)]
    assert len(pictures) / 30 == films.CLIP_S
    change = np.abs(pictures[0][:60].astype(int) - pictures[-1][:60]).max()
    assert change > 60


def test_a_bundle_as_a_trajectory_goes_from_its_state_before_to_the_one_after(noisy):
    recorded = read_bundle(noisy)
    _, trajectory = record_bundle(recorded)
    assert np.array_equal(trajectory.qpos[0], recorded.arrays[BEFORE]["qpos"])
    assert np.array_equal(
        trajectory.qpos[trajectory.at(recorded.bundle.end_s)], recorded.arrays[AFTER]["qpos"]
    )
    assert trajectory.story.attempts == recorded.bundle.attempts


def test_a_pickle_in_the_place_of_an_array_is_not_opened(copy):
    np.savez(copy / BEFORE, qpos=np.array([{"a": 1}], dtype=object))
    with pytest.raises(InputError, match=BEFORE):
        read_bundle(copy)


def test_the_folder_of_a_run_is_no_bundle_but_one_in_it_is_named(tmp_path):
    (tmp_path / "bundles" / "a").mkdir(parents=True)
    (tmp_path / "bundles" / "a" / "bundle.json").write_text("{}", encoding="utf-8")
    with pytest.raises(
        InputError, match=r"give the folder of a replay bundle, such as .*/bundles/a$"
    ):
        read_bundle(tmp_path)
