"""Off-screen renderers that work whenever they are made, whatever was imported before."""

from __future__ import annotations

import atexit
import importlib
import os
import sys
import weakref
from typing import Any, Final

import mujoco

from craftsim.rendering.backend import BACKENDS, choose_backend

_OPEN: Final[weakref.WeakSet[mujoco.Renderer]] = weakref.WeakSet()


def make_renderer(model: mujoco.MjModel, size: tuple[int, int]) -> mujoco.Renderer:
    """Return a renderer of a model on the backend of :func:`craftsim.rendering.backend.choose_backend`.

    Args:
        model: what is rendered; its off-screen buffer is enlarged to ``size`` where it is smaller.
        size: width and height in pixels.

    Raises:
        RenderingUnavailable: nothing renders on this machine.
    """
    backend = choose_backend()
    if backend in BACKENDS:
        _use(backend)
    width, height = size
    buffers = model.vis.global_
    buffers.offwidth = max(buffers.offwidth, width)
    buffers.offheight = max(buffers.offheight, height)
    renderer = mujoco.Renderer(model, height, width)
    # Shadows cost three and a half times a frame with a software renderer; who wants them switches them on.
    renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = False
    if not _OPEN:
        # Registered after the display's own clean-up, so that it runs before: what outlives the display complains.
        atexit.unregister(_close_all)
        atexit.register(_close_all)
    _OPEN.add(renderer)
    return renderer


def _use(backend: str) -> None:
    # MuJoCo reads MUJOCO_GL once, at its import, and keeps the class of contexts that it then found in a module
    # that its Renderer looks into whenever one is made. That class is what has to follow a later choice.
    _let_opengl_follow(backend)
    contexts: Any = vars(sys.modules[mujoco.Renderer.__module__])["gl_context"]
    contexts.GLContext = importlib.import_module(f"mujoco.{backend}").GLContext


def _let_opengl_follow(backend: str) -> None:
    # PyOpenGL chooses at its import, too, and MuJoCo's contexts ask it for the functions of their backend.
    os.environ["PYOPENGL_PLATFORM"] = backend
    platform: Any = sys.modules.get("OpenGL.platform")
    if platform is not None and backend not in type(platform.PLATFORM).__name__.lower():
        platform._load()


def _close_all() -> None:
    for renderer in list(_OPEN):
        renderer.close()
