"""Off-screen rendering: the one place where MuJoCo's backend is chosen, and renderers that use the choice.

``python -m craftsim.rendering.offscreen`` prints the backend that works, or what is missing, and then exits with 1.
"""

from __future__ import annotations

import atexit
import functools
import importlib
import os
import subprocess
import sys
import weakref
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

from craftsim.errors import RenderingUnavailable

if TYPE_CHECKING:
    import mujoco

    from craftsim.rendering.renderer import SharedRenderer

BACKENDS: Final = ("egl", "osmesa")
"""Off-screen backends of MuJoCo on Linux, the preferred one first."""
DEBIAN_PACKAGES: Final = ("libegl1", "libgl1-mesa-dri")
"""What Debian and Ubuntu lack for the first backend: the EGL loader and Mesa's (software) drivers."""
INSTALL_COMMAND: Final = f"sudo apt-get install {' '.join(DEBIAN_PACKAGES)}"

_ONE_FRAME: Final = """
import mujoco
model = mujoco.MjModel.from_xml_string(
    '<mujoco><worldbody><light pos="0 0 3"/><geom type="plane" size="5 5 1"/></worldbody></mujoco>'
)
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
renderer = mujoco.Renderer(model, 16, 16)
renderer.update_scene(data)
if not renderer.render().any():
    raise SystemExit("the rendered frame is black")
renderer.close()
"""
_APART_S: Final = 60
_OPEN: Final[weakref.WeakSet[SharedRenderer]] = weakref.WeakSet()


@functools.cache
def backend_failure(backend: str) -> str | None:
    """Render a frame with a backend; return why that failed, or None where it worked."""
    # MuJoCo's import leaves its backend for PyOpenGL in the environment, and refuses another one then.
    environment = {name: value for name, value in os.environ.items() if name != "PYOPENGL_PLATFORM"}
    return run_apart(_ONE_FRAME, "frame", environment | {"MUJOCO_GL": backend})


def run_apart(code: str, result: str, environment: Mapping[str, str] | None = None) -> str | None:
    """Run Python code for a result in a process that it may crash; return why that failed, or None where it worked."""
    command = [sys.executable, "-P", "-c", code]
    options: dict[str, Any] = {
        "env": environment,
        "capture_output": True,
        "text": True,
        "timeout": _APART_S,
    }
    try:
        child = subprocess.run(command, check=False, **options)
    except subprocess.TimeoutExpired:
        return f"no {result} within {_APART_S} s"
    if child.returncode < 0:
        return f"crashed with signal {-child.returncode}"
    message = child.stderr.strip() or f"exit status {child.returncode}"
    if child.returncode:
        return message.splitlines()[-1]
    return None


def choose_backend() -> str:
    """Return the backend that renders, and set ``MUJOCO_GL`` to it for this process and its children.

    It may be called before or after MuJoCo was imported. A ``MUJOCO_GL`` that is already set is used, or refused if it
    does not render, but never replaced. Raises RenderingUnavailable where nothing renders.
    """
    chosen = os.environ.get("MUJOCO_GL", "").strip().lower()
    if chosen:
        reason = backend_failure(chosen)
        if reason:
            raise RenderingUnavailable(
                f"MUJOCO_GL={chosen} does not render ({reason}). Unset MUJOCO_GL to let craftsim choose."
            )
        return chosen
    reasons = []
    for backend in BACKENDS:
        reason = backend_failure(backend)
        if reason is None:
            os.environ["MUJOCO_GL"] = backend
            return backend
        reasons.append(f"{backend}: {reason}")
    raise RenderingUnavailable(
        f"Off-screen rendering does not work ({'; '.join(reasons)}). "
        f"On Debian or Ubuntu run: {INSTALL_COMMAND}"
    )


def make_renderer(
    model: mujoco.MjModel, size: tuple[int, int], shadows: bool = False
) -> SharedRenderer:
    """Return a renderer of a model, whose off-screen buffer is enlarged to ``size`` (width, height) where needed.

    Threads may use it in turn. Without a GPU, ``shadows`` take a multiple of the time. Raises RenderingUnavailable
    where nothing renders, and in a process that was forked from one that had rendered.
    """
    import mujoco

    from craftsim.rendering.renderer import SharedRenderer, check_not_forked

    check_not_forked()
    backend = choose_backend()
    if backend in BACKENDS:
        _use(backend)
    width, height = size
    buffers = model.vis.global_
    buffers.offwidth = max(buffers.offwidth, width)
    buffers.offheight = max(buffers.offheight, height)
    renderer = SharedRenderer(model, size)
    renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = shadows
    if not _OPEN:
        # Registered after the display's own clean-up, so that it runs before: what outlives the display complains.
        atexit.unregister(_close_all)
        atexit.register(_close_all)
    _OPEN.add(renderer)
    return renderer


def upload_texture(renderer: SharedRenderer, number: int) -> None:
    """Let a renderer draw what a texture of its model is now."""
    import mujoco

    with renderer.current():
        mujoco.mjr_uploadTexture(renderer.model, renderer._mjr_context, number)


def _use(backend: str) -> None:
    """Let MuJoCo and PyOpenGL follow a choice that comes after their imports."""
    import mujoco

    os.environ["PYOPENGL_PLATFORM"] = backend
    platform: Any = sys.modules.get("OpenGL.platform")
    if platform is not None and backend not in type(platform.PLATFORM).__name__.lower():
        platform._load()
    # MuJoCo reads MUJOCO_GL once, and keeps the class of contexts in a module that its Renderer looks into.
    contexts: Any = vars(sys.modules[mujoco.Renderer.__module__])["gl_context"]
    contexts.GLContext = importlib.import_module(f"mujoco.{backend}").GLContext


def _close_all() -> None:
    for renderer in list(_OPEN):
        renderer.close()


if __name__ == "__main__":
    try:
        print(choose_backend())
    except RenderingUnavailable as error:
        sys.exit(str(error))
