"""The backend is chosen by trying, and a user's choice is never replaced."""

import os
import subprocess
import sys

import pytest

from craftsim import Grid, PhysicsWorld
from craftsim.errors import RenderingUnavailable
from craftsim.rendering import offscreen
from craftsim.rendering.trajectory import SeenWorld

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
        monkeypatch.setattr(offscreen, "backend_failure", failures.get)

    return set_up


@pytest.mark.parametrize(("broken", "chosen"), [({}, "egl"), ({"egl": "no"}, "osmesa")])
def test_the_first_backend_that_renders_is_chosen(machine, broken, chosen):
    machine(broken)
    assert offscreen.choose_backend() == os.environ["MUJOCO_GL"] == chosen


def test_without_any_the_message_gives_reasons_and_the_command(machine):
    machine({"egl": "no EGL here", "osmesa": "no OSMesa here"})
    message = "no EGL here.*no OSMesa here.*apt-get install libegl1 libgl1-mesa-dri"
    with pytest.raises(RenderingUnavailable, match=message):
        offscreen.choose_backend()
    assert "MUJOCO_GL" not in os.environ


def test_a_users_choice_is_kept_when_it_works_and_refused_when_not(machine, monkeypatch):
    machine({"egl": "no EGL here"})
    monkeypatch.setenv("MUJOCO_GL", "osmesa")
    assert offscreen.choose_backend() == "osmesa"
    monkeypatch.setenv("MUJOCO_GL", "egl")
    with pytest.raises(RenderingUnavailable, match="MUJOCO_GL=egl does not render"):
        offscreen.choose_backend()
    assert os.environ["MUJOCO_GL"] == "egl"


@pytest.mark.usefixtures("rendering")
def test_pictures_come_whatever_was_imported_before_the_choice():
    environment = {key: value for key, value in os.environ.items() if key != "MUJOCO_GL"}
    child = subprocess.run(
        [sys.executable, "-c", RENDER], env=environment, capture_output=True, text=True
    )
    assert child.stdout == "(16, 4000, 3) True\n"
    assert child.stderr == "", "a renderer left open is closed before the display is"


def test_as_a_program_it_says_what_is_wrong():
    words, environment = (
        ["-m", "craftsim.rendering.offscreen"],
        {**os.environ, "MUJOCO_GL": "no_such_backend"},
    )
    child = subprocess.run(
        [sys.executable, *words], env=environment, capture_output=True, text=True
    )
    assert child.returncode == 1
    assert "MUJOCO_GL=no_such_backend does not render" in child.stderr


IN_PLACES = """
import gc, os, sys, threading
import craftsim
import craftsim.errors

env = craftsim.parallel_env("strip", render_mode="rgb_array", render_size=(64, 48))
env.reset(seed=0)
first = env.render()
where = sys.argv[1]
if where == "thread":
    seen = []
    for _ in range(4):
        thread = threading.Thread(target=lambda: seen.append(env.render()))
        thread.start()
        thread.join()
    print(len(seen), all((picture == first).all() for picture in [*seen, env.render()]))
    thread = threading.Thread(target=env.close)
    thread.start()
    thread.join()
else:
    child = os.fork()
    if child == 0:
        if where == "forked":
            for one in (env, craftsim.parallel_env("strip", render_mode="rgb_array")):
                try:
                    one.reset(seed=0)
                    one.render()
                except craftsim.errors.CraftsimError as error:
                    print(error, flush=True)
            env.close()
            del env
            gc.collect()
        sys.exit(0)
    print(os.waitpid(child, 0)[1], (env.render() == first).all())
"""


def _in_place(where: str) -> list[str]:
    command = [sys.executable, "-c", IN_PLACES, where]
    child = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert (child.returncode, child.stderr) == (0, "")
    return child.stdout.splitlines()


@pytest.mark.usefixtures("rendering")
def test_threads_render_in_turn_and_may_close():
    assert _in_place("thread") == ["4 True"]


@pytest.mark.usefixtures("rendering")
def test_a_forked_process_is_told_that_it_cannot_render():
    *errors, last = _in_place("forked")
    assert len(errors) == 2
    assert all(
        "was forked from one that had rendered" in error and "'spawn'" in error for error in errors
    )
    assert last == "0 True"


@pytest.mark.usefixtures("rendering")
def test_a_forked_process_that_does_not_render_ends():
    assert _in_place("fork") == ["0 True"]


@pytest.mark.usefixtures("rendering")
def test_closing_a_renderer_leaves_others_what_they_draw_with():
    world = SeenWorld(PhysicsWorld(Grid.empty((3, 1, 1), n_cars=1)))
    first, second = (offscreen.make_renderer(world.model, (64, 48)) for _ in range(2))
    for renderer in (first, second):
        renderer.update_scene(world.now())
        before = renderer.render()
    first.close()
    second.update_scene(world.now())
    assert (second.render() == before).all()
    second.close()
