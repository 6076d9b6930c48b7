"""A film shows the simulation at the right moments, whatever the step it runs with."""

from pathlib import Path

import av
import mujoco
import numpy as np
import pytest

from craftsim.rendering.film import Film

pytestmark = pytest.mark.usefixtures("rendering")

SCENE = """
<mujoco>
  <option timestep="{step}" gravity="0 0 0"/>
  <worldbody>
    <light pos="0 0 3"/>
    <camera name="above" pos="0 0 3"/>
    <geom type="plane" size="5 5 1"/>
    <body pos="-0.5 0 0.2"><joint type="slide" axis="1 0 0"/><geom size="0.2" rgba="1 0 0 1"/></body>
  </worldbody>
</mujoco>
"""


def _film(path: Path, *, step: float, speed: float, duration: float, **options) -> int:
    model = mujoco.MjModel.from_xml_string(SCENE.format(step=step))
    data = mujoco.MjData(model)
    data.qvel[0] = 1.0
    mujoco.mj_forward(model, data)
    with Film(path, model, "above", size=(320, 240), fps=20, speed=speed, **options) as film:
        while data.time < duration - step / 2:
            if film.due(data.time):
                film.capture(data, ["a ball"])
            mujoco.mj_step(model, data)
    return film.frames


def _pictures(path: Path) -> list[np.ndarray]:
    with av.open(str(path)) as container:
        return [picture.to_ndarray(format="rgb24") for picture in container.decode(video=0)]


@pytest.mark.parametrize("step", [0.001, 0.004, 0.02, 0.125])
def test_frames_follow_simulated_time_at_every_step(tmp_path, step):
    frames = _film(tmp_path / "film.mp4", step=step, speed=2.0, duration=1.0)
    # 20 frames a second at double speed: one each 0.1 s. The last step of 0.125 s is at 0.875 s.
    assert frames == (9 if step == 0.125 else 10)
    assert len(_pictures(tmp_path / "film.mp4")) == frames


def test_the_pictures_show_the_motion(tmp_path):
    _film(tmp_path / "film.mp4", step=0.01, speed=1.0, duration=1.0)

    def red_column(picture: np.ndarray) -> float:
        scene = picture[:180].astype(int)
        return float(np.argwhere(scene[..., 0] - scene[..., 1] > 80)[:, 1].mean())

    columns = [red_column(picture) for picture in _pictures(tmp_path / "film.mp4")]
    assert np.all(np.diff(columns) > 0)
    middle = (columns[0] + columns[-1]) / 2
    assert middle == pytest.approx(160, abs=8), "the ball goes from left to right through the middle"


def test_a_capture_before_its_moment_adds_nothing(tmp_path):
    model = mujoco.MjModel.from_xml_string(SCENE.format(step=0.01))
    data = mujoco.MjData(model)
    with Film(tmp_path / "film.mp4", model, "above", size=(64, 48)) as film:
        film.capture(data, [])
        assert not film.due(data.time)
        film.capture(data, [])
    assert film.frames == 1


def test_the_offscreen_buffer_grows_to_the_asked_size(tmp_path):
    model = mujoco.MjModel.from_xml_string(SCENE.format(step=0.01))
    assert model.vis.global_.offheight < 720
    with Film(tmp_path / "film.mp4", model, "above") as film:
        film.capture(mujoco.MjData(model), [])
    assert _pictures(tmp_path / "film.mp4")[0].shape == (720, 1280, 3)


def test_filming_leaves_the_simulation_alone(tmp_path):
    model = mujoco.MjModel.from_xml_string(SCENE.format(step=0.01))
    filmed, plain = mujoco.MjData(model), mujoco.MjData(model)
    for data in (filmed, plain):
        data.qvel[0] = 1.0
    with Film(tmp_path / "film.mp4", model, "above", size=(64, 48)) as film:
        for _ in range(50):
            film.capture(filmed, [])
            mujoco.mj_step(model, filmed)
            mujoco.mj_step(model, plain)
    assert np.array_equal(filmed.qpos, plain.qpos)
    assert np.array_equal(filmed.qacc_warmstart, plain.qacc_warmstart)
