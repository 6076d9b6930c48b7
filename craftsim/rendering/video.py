"""Write H.264 films that play in a browser, and draw captions on their frames.

OpenCV draws but ships no H.264 encoder; PyAV ships libx264 but does not draw. Hence both.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack, suppress
from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self

import av
import cv2
import numpy as np
from numpy.typing import NDArray

from craftsim.errors import InputError
from craftsim.storage.writing import unwritten, whole

Frame = NDArray[np.uint8]
"""A picture, shape (height, width, 3), red green blue."""

_ENCODER_OPTIONS: Final = {
    "crf": "23",
    "preset": "veryfast",
    # x264 is deterministic at a given number of threads, so the number must not depend on the machine.
    "threads": "2",
}

_FONT: Final = cv2.FONT_HERSHEY_DUPLEX
_TEXT_HEIGHT: Final = 1 / 36
"""Height of a capital letter over the height of the frame: 20 pixels in a 720-pixel film."""


class _Abandoned(Exception):
    """A film is given up because of an error elsewhere."""


class VideoWriter:
    """Context manager that encodes frames into an MP4 file (H.264, yuv420p, index before the pictures).

    The film is written under a temporary name and gets its own only when the block ends without an error, so
    a file with the final name is always complete. Raises InputError where the disk does not take it.
    """

    def __init__(self, path: Path, fps: int) -> None:
        """Prepare a film at ``path`` (its folder must exist) with ``fps`` frames a second."""
        self.path = path
        self.fps = fps
        self.frames = 0
        self._file = ExitStack()
        self._container: Any = None
        self._stream: Any = None

    def __enter__(self) -> Self:
        with ExitStack() as file:
            partial = file.enter_context(whole(self.path))
            self._container = av.open(str(partial), "w", format="mp4", options={"movflags": "+faststart"})
            self._file = file.pop_all()
        return self

    def write(self, frame: Frame, repeat: int = 1) -> None:
        """Append a frame, ``repeat`` times.

        Args:
            frame: shape (height, width, 3), uint8, RGB; both sizes even, the same for all frames.
            repeat: how many frame times it stays on screen.

        Raises:
            ValueError: the frame has another type or size, or an odd one.
            InputError: the disk does not take it.
        """
        if frame.dtype != np.uint8 or frame.ndim != 3 or frame.shape[2] != 3:
            raise ValueError(f"a frame is uint8 of shape (height, width, 3), not {frame.dtype} {frame.shape}")
        height, width = frame.shape[:2]
        if self._stream is None:
            if height % 2 or width % 2:
                raise ValueError(f"H.264 with yuv420p needs even sizes, not {width} x {height}")
            self._stream = self._container.add_stream("libx264", rate=self.fps, options=_ENCODER_OPTIONS)
            self._stream.width, self._stream.height = width, height
            self._stream.pix_fmt = "yuv420p"
            self._stream.codec_context.time_base = Fraction(1, self.fps)
        elif (height, width) != (self._stream.height, self._stream.width):
            raise ValueError(
                f"this film is {self._stream.width} x {self._stream.height}, the frame {width} x {height}"
            )
        picture = av.VideoFrame.from_ndarray(np.ascontiguousarray(frame), format="rgb24")
        try:
            for _ in range(repeat):
                picture.pts = self.frames
                self._container.mux(self._stream.encode(picture))
                self.frames += 1
        except OSError as error:
            raise InputError(unwritten(self.path, error)) from error

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with suppress(_Abandoned), self._file:
            if error is None and self._stream is not None:
                self._container.mux(self._stream.encode(None))
            self._container.close()
            if error is not None:
                raise _Abandoned
            if self._stream is None:
                raise ValueError("a film needs at least one frame")


def caption(frame: Frame, lines: Sequence[str]) -> Frame:
    """Return a copy of a frame with lines of text in a dark bar along its lower edge.

    Args:
        frame: shape (height, width, 3), uint8, RGB.
        lines: from top to bottom; a line that is too wide is drawn smaller. OpenCV's fonts know ASCII only,
            other characters become question marks.
    """
    picture = frame.copy()
    if not lines:
        return picture
    height, width = frame.shape[:2]
    capital = max(8, round(height * _TEXT_HEIGHT))
    margin, pitch = capital, round(capital * 1.9)
    scale = cv2.getFontScaleFromHeight(_FONT, capital)
    top = max(0, height - pitch * len(lines) - margin)
    picture[top:] = picture[top:] // 4
    for number, line in enumerate(lines):
        text = line.encode("ascii", "replace").decode()
        (text_width, _), _ = cv2.getTextSize(text, _FONT, scale, 1)
        fitted = scale * min(1.0, (width - 2 * margin) / max(text_width, 1))
        base = top + margin // 2 + pitch * number + round((pitch + capital) / 2)
        cv2.putText(picture, text, (margin, base), _FONT, fitted, (255, 255, 255), 1, cv2.LINE_AA)
    return picture
