"""Frames into files: films that play in a browser (H.264 in MP4, VP9 in WebM), and animations (WebP, GIF)."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import ExitStack
from fractions import Fraction
from pathlib import Path
from typing import Any, Final, Self

import av
import cv2
import numpy as np
from av.video.reformatter import ColorRange, Colorspace
from numpy.typing import NDArray
from PIL import Image

from craftsim.errors import InputError
from craftsim.storage.writing import unwritten, whole
from craftsim.workers.copying import NotCopyable

Frame = NDArray[np.uint8]
"""A picture, shape (height, width, 3), red green blue."""
OnFrame = Callable[[bool], None]

FILM_SUFFIXES: Final = (".mp4", ".webm")
ANIMATIONS: Final = (".webp", ".gif")
_H264: Final = {
    "crf": "23",
    "preset": "veryfast",
    # Its macroblock tree reads what lies behind small pictures: equal frames gave other bytes each time.
    "x264-params": "mbtree=0",
}
_ENCODERS: Final = {
    ".mp4": ("mp4", "libx264", _H264, {"movflags": "+faststart"}),
    ".webm": (
        "webm",
        "libvpx-vp9",
        {"crf": "34", "b": "0", "deadline": "realtime", "cpu-used": "6"},
        {},
    ),
}
"""By the ending of the file's name: the container, the encoder, its options, and those of the container."""
_THREADS: Final = {"threads": "2"}
"""Encoders are deterministic at a given number of threads, so the number must not depend on the machine."""
_ANIMATION_PIXELS: Final = 400_000_000
"""Of all frames of an animation together: they are all in memory at its end."""
_GIF_FPS: Final = 50  # more than that is shown slowly: a frame of 10 ms is taken for a mistake


def encode(
    path: Path, fps: int, frames: Iterable[Frame], tell: OnFrame = lambda done: None
) -> None:
    """Write frames into a film or an animation; ``tell`` is called after each."""
    if path.suffix in ANIMATIONS:
        _animate(path, fps, frames, tell)
        return
    with VideoWriter(path, fps) as writer:
        for frame in frames:
            writer.write(frame)
            tell(True)


class VideoWriter(NotCopyable):
    """Encodes frames into an MP4 file (H.264, index first) or a WebM file (VP9), by its name's ending; yuv420p both.

    A context manager: the file is complete or as it was. Raises InputError where the disk does not take it.
    """

    _instead = "begin another film"

    def __init__(self, path: Path, fps: int) -> None:
        """Prepare a film at ``path`` (its folder must exist) with ``fps`` frames a second."""
        self.path = path
        self.fps = fps
        self.frames = 0
        self._container: Any = None
        self._stream: Any = None

    def __enter__(self) -> Self:
        form, _, _, options = _ENCODERS[self.path.suffix]
        with ExitStack() as file:
            partial = file.enter_context(whole(self.path))
            self._container = file.enter_context(
                av.open(str(partial), "w", format=form, options=options)
            )
            file.push(self._flush)
            self._file = file.pop_all()
        return self

    def __exit__(self, *error: Any) -> None:
        self._file.__exit__(*error)

    def write(self, frame: Frame) -> None:
        """Append a frame, shape (height, width, 3), uint8, RGB.

        Raises ValueError for another type, an odd size or another one than before.
        """
        if frame.dtype != np.uint8 or frame.ndim != 3 or frame.shape[2] != 3:
            raise ValueError(
                f"a frame is uint8 of shape (height, width, 3), not {frame.dtype} {frame.shape}"
            )
        height, width = frame.shape[:2]
        if height % 2 or width % 2:
            raise ValueError(f"yuv420p needs even sizes, not {width} x {height}")
        if self._stream is None:
            _, encoder, options, _ = _ENCODERS[self.path.suffix]
            self._stream = self._container.add_stream(
                encoder, rate=self.fps, options=options | _THREADS
            )
            self._stream.width = width
            self._stream.height = height
            self._stream.pix_fmt = "yuv420p"
            context = self._stream.codec_context
            context.colorspace = Colorspace.SMPTE170M
            context.color_range = ColorRange.MPEG
            context.time_base = Fraction(1, self.fps)
        elif (height, width) != (self._stream.height, self._stream.width):
            raise ValueError(
                f"this film is {self._stream.width} x {self._stream.height}, the frame {width} x {height}"
            )
        planes: Any = cv2.cvtColor(frame, cv2.COLOR_RGB2YUV_I420)
        picture = av.VideoFrame.from_ndarray(planes, format="yuv420p")
        picture.pts = self.frames
        try:
            self._container.mux(self._stream.encode(picture))
        except OSError as error:
            raise InputError(unwritten(self.path, error)) from error
        self.frames += 1

    def _flush(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            if self._stream is None:
                raise ValueError("a film needs at least one frame")
            self._container.mux(self._stream.encode(None))


def check_animation(path: Path, n_frames: int, size: tuple[int, int], fps: int) -> None:
    """Raise InputError for an animation of more pixels than fit into memory, and for a GIF too quick for its clock."""
    if n_frames * size[0] * size[1] > _ANIMATION_PIXELS:
        raise InputError(
            f"{path}: {n_frames} frames of {size[0]} x {size[1]}; allowed: {_ANIMATION_PIXELS // 10**6} million "
            "pixels in all; give a smaller --size, fewer --fps, a higher --speed, or make an mp4 or webm"
        )
    if path.suffix == ".gif" and fps > _GIF_FPS:
        raise InputError(
            f"{path}: {fps} frames a second; a GIF has {_GIF_FPS} at most, try --fps 25 or a webp"
        )


def _animate(path: Path, fps: int, frames: Iterable[Frame], tell: OnFrame) -> None:
    gif = path.suffix == ".gif"
    pictures = []
    for frame in frames:
        picture = Image.fromarray(frame)
        # A GIF has 256 colours a frame anyway, and takes a third of the memory.
        pictures.append(picture.quantize(256, dither=Image.Dither.NONE) if gif else picture)
        tell(True)
    # A GIF counts in hundredths of a second, of which no sum may drift.
    if gif:
        tick = 10
    else:
        tick = 1
    shown_ms = np.diff(
        [round(1000 * i / fps / tick) * tick for i in range(len(pictures) + 1)]
    ).tolist()
    options: dict[str, Any] = {"quality": 80, "method": 4, "minimize_size": False}
    if gif:
        options = {"optimize": False, "disposal": 1}
    with whole(path) as partial:
        pictures[0].save(
            partial, save_all=True, append_images=pictures[1:], duration=shown_ms, loop=0, **options
        )
