"""The backend is chosen by trying, and a user's choice is never replaced."""

import os
import subprocess
import sys

import pytest

from craftsim.rendering import offscreen

RENDER = """
import OpenGL.GL
import mujoco
from craftsim.rendering.offscreen import make_renderer
model = mujoco.MjModel.from_xml_string(
    '<mujoco><worldbody><light pos="0 0 3"/><geom type="plane" size="5 5 1"/></worldbody></mujoco>'
)
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
renderer = make_renderer(model, (4000, 16))  # wider than the model's own buffer
renderer.update_scene(data)
print(renderer.render().shape, renderer.render().any())
"""


@pytest.fixture
def machine(monkeypatch: pytest.MonkeyPatch):
    """A machine on which the backends fail as told."""

    def set_up(failures: dict[str, str]) -> None:
        monkeypatch.delenv("MUJOCO_GL", raising=False)
        monkeypatch.setattr(offscreen, "failure", failures.get)

    return set_up


@pytest.mark.parametrize(("broken", "chosen"), [({}, "egl"), ({"egl": "no"}, "osmesa")])
def test_the_first_backend_that_renders_is_chosen(machine, broken, chosen):
    machine(broken)
    assert offscreen.choose_backend() == os.environ["MUJOCO_GL"] == chosen


def test_without_any_the_message_gives_reasons_and_the_command(machine):
    machine({"egl": "no EGL here", "osmesa": "no OSMesa here"})
    message = "no EGL here.*no OSMesa here.*apt-get install libegl1 libgl1-mesa-dri"
    with pytest.raises(offscreen.RenderingUnavailable, match=message):
        offscreen.choose_backend()
    assert "MUJOCO_GL" not in os.environ


def test_a_users_choice_is_kept_when_it_works_and_refused_when_not(machine, monkeypatch):
    machine({"egl": "no EGL here"})
    monkeypatch.setenv("MUJOCO_GL", "osmesa")
    assert offscreen.choose_backend() == "osmesa"
    monkeypatch.setenv("MUJOCO_GL", "egl")
    with pytest.raises(offscreen.RenderingUnavailable, match="MUJOCO_GL=egl does not render"):
        offscreen.choose_backend()
    assert os.environ["MUJOCO_GL"] == "egl"


@pytest.mark.usefixtures("rendering")
def test_pictures_come_whatever_was_imported_before_the_choice():
    environment = {key: value for key, value in os.environ.items() if key != "MUJOCO_GL"}
    child = subprocess.run([sys.executable, "-c", RENDER], env=environment, capture_output=True, text=True)
    assert child.stdout == "(16, 4000, 3) True\n"
    assert child.stderr == "", "a renderer left open is closed before the display is"


def test_as_a_program_it_says_what_is_wrong():
    words, environment = (
        ["-m", "craftsim.rendering.offscreen"],
        {**os.environ, "MUJOCO_GL": "no_such_backend"},
    )
    child = subprocess.run([sys.executable, *words], env=environment, capture_output=True, text=True)
    assert child.returncode == 1
    assert "MUJOCO_GL=no_such_backend does not render" in child.stderr
