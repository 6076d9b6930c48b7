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
_OPTIONS: Final[dict[str, dict[str, Any]]] = {
    ".webp": {"quality": 80, "method": 4, "minimize_size": False},
    ".gif": {"optimize": False, "disposal": 1},
}


class AnimationWriter:
    """Context manager that collects frames, and writes them as an animated WebP or GIF, which runs for ever."""

    def __init__(self, path: Path, fps: int) -> None:
        """Prepare an animation at ``path``, a ``.webp`` or ``.gif`` (its folder must exist)."""
        self.path, self.fps = path, fps
        self._frames: list[Image.Image] = []
        self._pixels = 0

    @property
    def frames(self) -> int:
        """Frames written so far."""
        return len(self._frames)

    def __enter__(self) -> Self:
        return self

    def write(self, frame: Frame) -> None:
        """Append a frame, shape (height, width, 3), uint8, RGB. Raises InputError for more than fit into memory."""
        self._pixels += frame.shape[0] * frame.shape[1]
        if self._pixels > MOST_PIXELS:
            raise InputError(
                f"{self.path}: more than the {MOST_PIXELS // 10**6} million pixels that an animation may have; "
                "give a smaller --size, fewer --fps, a higher --speed, or make an mp4 or webm"
            )
        picture = Image.fromarray(frame)
        # A GIF has 256 colours a frame anyway, and takes a third of the memory.
        self._frames.append(picture.quantize(256, dither=Image.Dither.NONE) if self._is_gif else picture)

    @property
    def _is_gif(self) -> bool:
        return self.path.suffix == ".gif"

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
                duration=round(1000 / self.fps),
                loop=0,
                **_OPTIONS[self.path.suffix],
            )
