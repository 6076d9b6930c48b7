"""Write films that play in a browser: H.264 in MP4, or VP9 in WebM. PyAV ships both encoders."""

from __future__ import annotations

from contextlib import ExitStack, suppress
from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self

import av
import cv2
import numpy as np
from av.video.reformatter import ColorRange, Colorspace
from numpy.typing import NDArray

from craftsim.errors import InputError
from craftsim.storage.writing import unwritten, whole

Frame = NDArray[np.uint8]
"""A picture, shape (height, width, 3), red green blue."""

_H264: Final = {
    "crf": "23",
    "preset": "veryfast",
    # Its macroblock tree reads what lies behind small pictures: equal frames gave other bytes each time.
    "x264-params": "mbtree=0",
}
_ENCODERS: Final = {
    ".mp4": ("mp4", "libx264", _H264, {"movflags": "+faststart"}),
    ".webm": ("webm", "libvpx-vp9", {"crf": "34", "b": "0", "deadline": "realtime", "cpu-used": "6"}, {}),
}
"""By the ending of the file's name: the container, the encoder, its options, and those of the container."""
_THREADS: Final = {"threads": "2"}
"""Encoders are deterministic at a given number of threads, so the number must not depend on the machine."""


class _Abandoned(Exception):
    """A film is given up because of an error elsewhere."""


class VideoWriter:
    """Context manager that encodes frames into an MP4 file (H.264, index before the pictures) or a WebM file (VP9), as
    the ending of its name says; yuv420p both.

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
            form, self._encoder, self._options, options = _ENCODERS[self.path.suffix]
            self._container = av.open(str(partial), "w", format=form, options=options)
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
                raise ValueError(f"yuv420p needs even sizes, not {width} x {height}")
            self._stream = self._container.add_stream(
                self._encoder, rate=self.fps, options=self._options | _THREADS
            )
            self._stream.width, self._stream.height = width, height
            self._stream.pix_fmt = "yuv420p"
            self._stream.codec_context.colorspace = Colorspace.SMPTE170M
            self._stream.codec_context.color_range = ColorRange.MPEG
            self._stream.codec_context.time_base = Fraction(1, self.fps)
        elif (height, width) != (self._stream.height, self._stream.width):
            raise ValueError(
                f"this film is {self._stream.width} x {self._stream.height}, the frame {width} x {height}"
            )
        planes: Any = cv2.cvtColor(frame, cv2.COLOR_RGB2YUV_I420)
        picture = av.VideoFrame.from_ndarray(planes, format="yuv420p")
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
