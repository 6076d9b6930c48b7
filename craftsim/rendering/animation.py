"""Animated pictures for pages that take no films: WebP and GIF."""

from __future__ import annotations

from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self

from PIL import Image

from craftsim.errors import InputError
from craftsim.rendering.video import Frame
from craftsim.storage.writing import whole

MOST_PIXELS: Final = 400_000_000
"""Of all frames of an animation together: they are all in memory at its end."""
GIF_FPS: Final = 50
"""More than that is shown slowly: a frame of 10 ms is taken for a mistake."""
_OPTIONS: Final[dict[str, dict[str, Any]]] = {
    ".webp": {"quality": 80, "method": 4, "minimize_size": False},
    ".gif": {"optimize": False, "disposal": 1},
}


def check_animation(path: Path, n_frames: int, size: tuple[int, int], fps: int) -> None:
    """Raise InputError for an animation of more pixels than fit into memory, and for a GIF too quick for its clock."""
    if n_frames * size[0] * size[1] > MOST_PIXELS:
        raise InputError(
            f"{path}: {n_frames} frames of {size[0]} x {size[1]}; allowed: {MOST_PIXELS // 10**6} million pixels in "
            "all; give a smaller --size, fewer --fps, a higher --speed, or make an mp4 or webm"
        )
    if path.suffix == ".gif" and fps > GIF_FPS:
        raise InputError(
            f"{path}: {fps} frames a second; a GIF has {GIF_FPS} at most, try --fps 25 or a webp"
        )


class AnimationWriter:
    """Context manager that collects frames, and writes them as an animated WebP or GIF, which runs for ever."""

    def __init__(self, path: Path, fps: int) -> None:
        """Prepare an animation at ``path``, a ``.webp`` or ``.gif`` (its folder must exist)."""
        self.path, self.fps = path, fps
        self._frames: list[Image.Image] = []

    @property
    def frames(self) -> int:
        """Frames written so far."""
        return len(self._frames)

    def __enter__(self) -> Self:
        return self

    def write(self, frame: Frame) -> None:
        """Append a frame, shape (height, width, 3), uint8, RGB."""
        picture = Image.fromarray(frame)
        # A GIF has 256 colours a frame anyway, and takes a third of the memory.
        self._frames.append(picture.quantize(256, dither=Image.Dither.NONE) if self._is_gif else picture)

    @property
    def _is_gif(self) -> bool:
        return self.path.suffix == ".gif"

    def _milliseconds(self) -> list[int]:
        """Return how long each frame stays: a GIF counts in hundredths of a second, of which no sum may drift."""
        tick = 10 if self._is_gif else 1
        ends = [round(1000 * (i + 1) / self.fps / tick) * tick for i in range(len(self._frames))]
        return [end - begin for begin, end in zip([0, *ends[:-1]], ends, strict=True)]

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is not None:
            return
        first, *rest = self._frames
        with whole(self.path) as partial:
            first.save(
                partial,
                save_all=True,
                append_images=rest,
                duration=self._milliseconds(),
                loop=0,
                **_OPTIONS[self.path.suffix],
            )
