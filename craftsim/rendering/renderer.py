"""MuJoCo's renderer, with an OpenGL context that any thread of its process may use, and no forked process.

An OpenGL context is current in one thread, and what MuJoCo draws or frees is that of the thread's current context. So a
context here is current only while it is used: several renderers neither free nor draw into what is another's.
"""

from __future__ import annotations

import atexit
import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import mujoco
from numpy.typing import NDArray

from craftsim.errors import RenderingUnavailable
from craftsim.workers.copying import NotCopyable

_FORKED = (
    "this process was forked from one that had rendered, and OpenGL works in no such process; start processes with "
    "multiprocessing's method 'spawn', or render for the first time after the fork"
)


class SharedRenderer(NotCopyable, mujoco.Renderer):
    """A renderer that threads may use in turn; one that uses it at the same time waits."""

    _instead = "make another one, or copy its environment, which then renders with its own"
    _gl_context: Any
    _mjr_context: Any

    def __init__(self, model: mujoco.MjModel, size: tuple[int, int]) -> None:
        """Make a context for pictures of ``size`` (width, height). Raises RenderingUnavailable in a forked process."""
        self._process = os.getpid()
        self._lock = threading.RLock()
        check_not_forked()
        width, height = size
        super().__init__(model, height, width)
        _note_use()
        self._let_go()

    @contextmanager
    def current(self) -> Iterator[None]:
        """Have the OpenGL context in this thread. Raises RenderingUnavailable in a forked process."""
        if os.getpid() != self._process:
            raise RenderingUnavailable(_FORKED)
        with self._lock:
            if self._gl_context:
                self._gl_context.make_current()
            try:
                yield
            finally:
                self._let_go()

    def render(self, *, out: NDArray[Any] | None = None) -> NDArray[Any]:
        """Return the picture, as :meth:`mujoco.Renderer.render` does."""
        with self.current():
            picture: NDArray[Any] = super().render(out=out)
        return picture

    def close(self) -> None:
        """Free the context; in a forked process only forget it."""
        if os.getpid() != self._process:
            if self._gl_context:
                self._gl_context._context = None
            self._gl_context = None
            return
        if self._mjr_context or self._gl_context:
            with self.current():
                super().close()

    def _let_go(self) -> None:
        """Leave this thread without a current context."""
        if not self._gl_context:
            return
        module: Any = sys.modules[type(self._gl_context).__module__]
        if module.__name__ == "mujoco.egl":
            egl = module.EGL
            egl.eglMakeCurrent(
                module.EGL_DISPLAY, egl.EGL_NO_SURFACE, egl.EGL_NO_SURFACE, egl.EGL_NO_CONTEXT
            )
        elif module.__name__ == "mujoco.osmesa":
            module.osmesa.OSMesaMakeCurrent(None, None, module.GL.GL_FLOAT, 0, 0)
        elif module.__name__ == "mujoco.glfw":
            module.glfw.make_context_current(None)


_used_in: int | None = None
"""The process in which OpenGL was used first; those that it forks have not the threads of its drivers."""


def check_not_forked() -> None:
    """Raise RenderingUnavailable in a process that was forked from one that had rendered."""
    if _used_in not in (None, os.getpid()):
        raise RenderingUnavailable(_FORKED)


def _note_use() -> None:
    global _used_in
    if _used_in is None:
        _used_in = os.getpid()
        os.register_at_fork(after_in_child=_forget_display)


def _forget_display() -> None:
    """In a forked process: close no display at its end, for that would wait for threads that are not there."""
    egl = sys.modules.get("mujoco.egl")
    if egl is not None:
        atexit.unregister(egl.EGL.eglTerminate)
