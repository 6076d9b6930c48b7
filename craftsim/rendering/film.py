"""A film of a running simulation: pictures at the right simulated moments, captioned and encoded."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

import mujoco

from craftsim.rendering.renderer import make_renderer
from craftsim.rendering.video import VideoWriter, caption


class Film:
    """Context manager that films a model through one of its cameras.

    Call `capture` whenever `due` says so; a frame that comes late stays on screen for the frames it missed,
    so playback keeps its speed whatever the caller's step.
    """

    def __init__(
        self,
        path: Path,
        model: mujoco.MjModel,
        camera: str | mujoco.MjvCamera,
        *,
        size: tuple[int, int] = (1280, 720),
        fps: int = 30,
        speed: float = 4.0,
        shadows: bool = False,
        start_s: float = 0.0,
    ) -> None:
        """Prepare a film.

        Args:
            path: the MP4 file; its folder must exist.
            model: what is filmed; its off-screen buffer is enlarged to ``size`` where it is smaller.
            camera: name of one of its cameras, or a camera of your own.
            size: width and height in pixels, both even.
            fps: frames a second of film.
            speed: simulated seconds in a second of film.
            shadows: draw them, at three and a half times the cost of a frame with Mesa's software renderer.
            start_s: simulated time of the first frame.

        Raises:
            RenderingUnavailable: nothing renders on this machine.
        """
        self.speed = speed
        self._camera = camera
        self._start_s = start_s
        self._frame_time_s = speed / fps
        self._writer = VideoWriter(path, fps)
        self._renderer = make_renderer(model, size)
        self._renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = shadows

    @property
    def frames(self) -> int:
        """Frames written so far."""
        return self._writer.frames

    def __enter__(self) -> Self:
        self._writer.__enter__()
        return self

    def due(self, time_s: float) -> bool:
        """Return whether the next frame's moment has come at simulated time ``time_s``."""
        return self._missing(time_s) > 0

    def _missing(self, time_s: float) -> int:
        # The allowance is for sums of time steps that end a rounding error before a frame's moment.
        return math.floor((time_s - self._start_s) / self._frame_time_s + 1e-6) + 1 - self.frames

    def capture(self, data: mujoco.MjData, lines: Sequence[str]) -> None:
        """Append the scene as it stands, with ``lines``, the simulated time and the speed as its caption.

        The first frame belongs to the start and needs ``mj_forward`` to have run. Nothing happens when no frame
        is due.
        """
        repeat = self._missing(data.time)
        if repeat <= 0:
            return
        self._renderer.update_scene(data, self._camera)
        clock = f"t = {data.time:.1f} s   speed x{self.speed:g}"
        self._writer.write(caption(self._renderer.render(), [*lines, clock]), repeat)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self._writer.__exit__(kind, error, trace)
        finally:
            self._renderer.close()
