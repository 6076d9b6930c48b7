"""Pictures of the environment in physics."""

import os
import subprocess
import sys
from contextlib import closing
from itertools import pairwise
from pathlib import Path
from types import ModuleType

import gymnasium
import numpy as np
import pytest
from gymnasium.wrappers import RecordVideo

from craftsim.discrete.kinds import Action
from craftsim.envs import TASK_IDS, parallel_env
from craftsim.errors import InputError

pytestmark = pytest.mark.usefixtures("rendering")
MOVE = {"car_0": int(Action.MOVE_LEFT), "car_1": int(Action.STOP)}
SMALL = {"backend": "physics", "render_size": (64, 48)}
JOINT = np.array([Action.MOVE_LEFT, Action.STOP])


def test_a_picture_shows_the_physics_and_follows_it_and_other_starts():
    env = parallel_env("strip", "physics", render_mode="rgb_array")
    env.reset(seed=0)
    first = env.render()
    assert first.shape == (480, 640, 3)
    assert np.ptp(first) > 100
    env.step({"car_0": int(Action.MOVE_LEFT), "car_1": int(Action.STOP)})
    second = env.render()
    assert (first != second).any()
    env.reset(seed=0)
    np.testing.assert_array_equal(env.render(), first)
    grid = env.grid
    grid.cars[0, 0] = 3
    grid.derive_marks()
    env.reset(options={"grid": grid})
    assert (env.render() != first).any()
    env.close()


def test_training_in_physics_first_and_filming_after_it_works_in_one_process():
    code = """
from craftsim.envs import parallel_env
from craftsim.models.randomization import DomainRandomization
env = parallel_env("strip", "physics", randomization=DomainRandomization())
env.reset(seed=0)
env.step(dict.fromkeys(env.agents, 12))
films = parallel_env("strip", "physics", render_mode="rgb_array")
films.reset(seed=0)
print(films.render().std() > 10)
"""
    environment = {key: value for key, value in os.environ.items() if key != "MUJOCO_GL"}
    child = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True
    )
    assert child.stdout == "True\n"
    assert child.stderr == ""


def test_a_list_of_pictures_shows_the_motion_since_the_last_render():
    env = parallel_env("strip", "physics", render_mode="rgb_array_list", render_size=(64, 48))
    assert env.metadata["render_fps"] == 10
    env.reset(seed=0)
    (start,) = env.render()
    assert start.shape == (48, 64, 3)
    assert env.render() == []
    duration_s = env.step(MOVE)[4]["car_0"]["duration_s"]
    moving = env.render()
    assert len(moving) == pytest.approx(10 * duration_s, abs=1)
    assert all((a != b).any() for a, b in pairwise(moving[:-1]))
    env.step(MOVE)
    env.reset(seed=0)
    assert len(env.render()) == 1, "a new episode does not show the last one's end"
    env.close()


def test_on_the_grid_the_list_has_one_picture_a_tick_and_text_shows_the_levels(capsys):
    env = parallel_env("strip", "grid", render_mode="rgb_array_list")
    assert env.metadata["render_fps"] == 2
    env.reset(seed=0)
    env.step(MOVE)
    env.step(MOVE)
    assert len(env.render()) == 3
    for mode in ("ansi", "human"):
        env = parallel_env("strip", "grid", render_mode=mode)
        env.reset(seed=0)
        said = (env.render() or "") + capsys.readouterr().out
        assert said.count("level 1") == 1


def test_the_camera_and_the_size_are_chosen_and_an_unknown_camera_is_refused_with_those_there_are():
    pictures = {}
    for camera in ("overview", "top", "front:0"):
        env = parallel_env(
            "strip", "physics", render_mode="rgb_array", render_camera=camera, render_size=(100, 60)
        )
        env.reset(seed=0)
        pictures[camera] = env.render()
        env.close()
    assert pictures["top"].shape == (60, 100, 3)
    assert (pictures["top"] != pictures["overview"]).any()
    assert (pictures["front:0"] != pictures["top"]).any()
    env = parallel_env("strip", "physics", render_mode="rgb_array", render_camera="topp")
    with pytest.raises(InputError, match=r"did you mean 'top'.*there are overview, top"):
        env.reset(seed=0)


@pytest.fixture
def clips(monkeypatch):
    """MoviePy's clip, which the recording wrappers write films with, as they call it: pictures, rate and path.

    MoviePy itself wants an older Pillow than matplotlib brings.
    """
    written = {}

    class Clip:
        def __init__(self, pictures, fps):
            self.pictures, self.fps = list(pictures), fps

        def write_videofile(self, path, logger):
            written[Path(path).name] = self

    module = ModuleType("moviepy.video.io.ImageSequenceClip")
    module.ImageSequenceClip = Clip
    for name in ("moviepy", "moviepy.video", "moviepy.video.io"):
        monkeypatch.setitem(sys.modules, name, ModuleType(name))
    monkeypatch.setitem(sys.modules, module.__name__, module)
    yield written
    sys.modules.pop("gymnasium.utils.save_video", None)  # it took the clip at its import


def test_gymnasiums_recorder_takes_a_picture_a_step_in_either_mode(clips, tmp_path):
    for mode in ("rgb_array", "rgb_array_list"):
        made = gymnasium.make(
            TASK_IDS["strip"], render_mode=mode, disable_env_checker=True, **SMALL
        )
        with closing(RecordVideo(made, str(tmp_path / mode), name_prefix=mode)) as env:
            env.reset(seed=0)
            env.step(JOINT)
            last = made.unwrapped.core.backend.picture(env.unwrapped.core.grid, None)
            fps = env.metadata["render_fps"]
        clip = clips[f"{mode}-episode-0.mp4"]
        assert (len(clip.pictures), clip.fps) == (2, fps)
        # The last picture of the motion is up to a tenth of a second old.
        change = np.abs(clip.pictures[1].astype(int) - last)
        assert change.max() == 0 if mode == "rgb_array" else change.mean() < 0.5
        assert np.abs(clip.pictures[0].astype(int) - last).mean() > 1
