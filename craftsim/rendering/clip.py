"""A clip: a film of one action, close up, that always lasts the same time."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final

import mujoco

from craftsim.models.site import Site
from craftsim.rendering.film import Film
from craftsim.skills.executor import Observer

CLIP_S: Final = 3.0
"""Length of a clip."""
_AFTER_S: Final = 0.5
"""For how long at least it shows what follows the action."""
_FPS: Final = 30
_SIZE: Final = (640, 360)
_DISTANCE_M: Final = 1.6


@contextmanager
def clip(path: Path, site: Site, car: int, span_s: float, lines: Sequence[str]) -> Iterator[Observer]:
    """Film a Site from now on, and yield what is to be called after each control period.

    At the end the Site runs on until the clip is long enough.

    Args:
        path: the MP4 file; its folder must exist.
        site: as it stands before the action.
        car: at which the camera looks.
        span_s: simulated time that the action takes; a long one is shown faster, never slower than it is.
        lines: the caption.
    """
    camera = mujoco.MjvCamera()
    camera.lookat[:] = site.free_body_state(site.cars[car].base)[0]
    camera.distance, camera.azimuth, camera.elevation = _DISTANCE_M, 130.0, -30.0
    speed = max(1.0, span_s / (CLIP_S - _AFTER_S))
    frames = round(CLIP_S * _FPS)
    with Film(path, site.model, camera, size=_SIZE, fps=_FPS, speed=speed, start_s=site.time_s) as film:

        def watch(site: Site) -> None:
            if film.due(site.time_s) and film.frames < frames:
                film.capture(site.data, lines)

        watch(site)
        yield watch
        # A simulation that breaks down starts its time over again and again: then the clip stays short.
        for _ in range(math.ceil(CLIP_S * speed / site.config.control_period_s) + 1):
            if film.frames >= frames:
                break
            site.advance()
            watch(site)
