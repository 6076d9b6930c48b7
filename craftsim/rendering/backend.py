"""Choose how MuJoCo renders off-screen: the one place where that is decided.

`choose_backend` tries the backends, each in a process of its own, and may be called at any time, before or after
MuJoCo was imported; `craftsim.rendering.renderer.make_renderer` calls it and makes renderers that use the choice.

``python -m craftsim.rendering.backend`` prints the backend that works, or says what is missing and exits
with 1.
"""

from __future__ import annotations

import functools
import os
import subprocess
import sys
from typing import Final

from craftsim.errors import CraftsimError

BACKENDS: Final = ("egl", "osmesa")
"""Off-screen backends of MuJoCo on Linux, the preferred one first."""

DEBIAN_PACKAGES: Final = ("libegl1", "libgl1-mesa-dri")
"""What Debian and Ubuntu lack for the first backend: the EGL loader and Mesa's (software) drivers."""

INSTALL_COMMAND: Final = f"sudo apt-get install {' '.join(DEBIAN_PACKAGES)}"
"""The one command that makes rendering work on Debian and Ubuntu."""

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


class RenderingUnavailable(CraftsimError):
    """No backend renders a frame on this machine; the message says why and which command fixes it."""


@functools.cache
def failure(backend: str) -> str | None:
    """Render one frame in a process of its own and return why that failed, or None when it worked.

    A process of its own, because a broken OpenGL driver may crash the process that tries it.
    """
    try:
        child = subprocess.run(
            [sys.executable, "-P", "-c", _ONE_FRAME],
            env={**_without_choice(), "MUJOCO_GL": backend},
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return "no frame within 60 s"
    if child.returncode == 0:
        return None
    if child.returncode < 0:
        return f"crashed with signal {-child.returncode}"
    lines = child.stderr.strip().splitlines()
    return lines[-1] if lines else f"exit status {child.returncode}"


def _without_choice() -> dict[str, str]:
    # MuJoCo's import leaves its backend for PyOpenGL in the environment, and refuses another one then.
    return {name: value for name, value in os.environ.items() if name != "PYOPENGL_PLATFORM"}


def choose_backend() -> str:
    """Return the backend that renders, and set ``MUJOCO_GL`` to it for this process and its children.

    A ``MUJOCO_GL`` that is already set is used, or refused if it does not render, but never replaced.

    Raises:
        RenderingUnavailable: nothing renders.
    """
    wanted = os.environ.get("MUJOCO_GL", "").strip().lower()
    if wanted:
        reason = failure(wanted)
        if reason:
            raise RenderingUnavailable(
                f"MUJOCO_GL={wanted} does not render ({reason}). Unset MUJOCO_GL to let craftsim choose."
            )
        return wanted
    reasons = []
    for backend in BACKENDS:
        reason = failure(backend)
        if reason is None:
            os.environ["MUJOCO_GL"] = backend
            return backend
        reasons.append(f"{backend}: {reason}")
    raise RenderingUnavailable(
        f"Off-screen rendering does not work ({'; '.join(reasons)}). "
        f"On Debian or Ubuntu run: {INSTALL_COMMAND}"
    )


if __name__ == "__main__":
    try:
        print(choose_backend())
    except RenderingUnavailable as error:
        sys.exit(str(error))
