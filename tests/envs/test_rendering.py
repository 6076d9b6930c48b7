"""Pictures of the environment in physics."""

import os
import subprocess
import sys
from itertools import pairwise

import gymnasium
import numpy as np
import pytest

from craftsim.discrete.actions import Action
from craftsim.envs import GYMNASIUM_IDS, parallel_env
from craftsim.errors import InputError

pytestmark = pytest.mark.usefixtures("rendering")


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


MOVE = {"car_0": int(Action.MOVE_LEFT), "car_1": int(Action.STOP)}
BACK = {"car_0": int(Action.MOVE_RIGHT), "car_1": int(Action.STOP)}


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
    env.step(BACK)
    env.step(MOVE)
    assert len(env.render()) > len(moving)
    env.step(MOVE)
    env.reset(seed=0)
    assert len(env.render()) == 1, "a new episode does not show the last one's end"
    env.close()


def test_on_the_grid_the_list_has_one_picture_a_tick():
    env = parallel_env("strip", "grid", render_mode="rgb_array_list")
    assert env.metadata["render_fps"] == 2
    env.reset(seed=0)
    env.step(MOVE)
    env.step(MOVE)
    assert len(env.render()) == 3


def test_the_camera_and_the_size_are_chosen_and_an_unknown_camera_is_refused_with_those_there_are():
    pictures = {}
    for camera in ("overview", "top"):
        env = parallel_env(
            "strip", "physics", render_mode="rgb_array", render_camera=camera, render_size=(100, 60)
        )
        env.reset(seed=0)
        pictures[camera] = env.render()
        env.close()
    assert pictures["top"].shape == (60, 100, 3)
    assert (pictures["top"] != pictures["overview"]).any()
    env = parallel_env("strip", "physics", render_mode="rgb_array", render_camera="topp")
    with pytest.raises(InputError, match=r"did you mean 'top'.*there are overview, top"):
        env.reset(seed=0)


def test_gymnasiums_recording_tools_take_pictures_and_lists_of_them(tmp_path):
    pytest.importorskip("moviepy")
    from gymnasium.utils.save_video import save_video
    from gymnasium.wrappers import RecordVideo

    options = {"backend": "physics", "render_size": (64, 48), "disable_env_checker": True}
    env = RecordVideo(
        gymnasium.make(GYMNASIUM_IDS["strip"], render_mode="rgb_array", **options), str(tmp_path / "ticks")
    )
    env.reset(seed=0)
    env.step(np.array([Action.MOVE_LEFT, Action.STOP]))
    env.close()
    assert list((tmp_path / "ticks").glob("*.mp4"))
    env = gymnasium.make(GYMNASIUM_IDS["strip"], render_mode="rgb_array_list", **options)
    env.reset(seed=0)
    env.step(np.array([Action.MOVE_LEFT, Action.STOP]))
    save_video(
        env.render(), str(tmp_path / "motion"), fps=env.metadata["render_fps"], episode_trigger=lambda n: True
    )
    assert list((tmp_path / "motion").glob("*.mp4"))
    env.close()
