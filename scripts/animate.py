"""Make a looping picture of a film's middle: ``scripts/animate.py FILM PICTURE``, without the caption below."""

from __future__ import annotations

import sys

import av
import numpy as np
from PIL.Image import Image

BOX = (80, 46, 560, 274)
"""Left, top, right and bottom of what is kept of a clip of 640 by 360 pixels."""
EVERY = 2
"""Which part of the frames is kept."""
REST_MS = 1200
"""How long the last frame stands before it begins again."""


def animate(film: str, picture: str) -> None:
    """Write an animated WebP of a clip; the film's own rest at its end is left out."""
    with av.open(film) as clip:
        stream = clip.streams.video[0]
        frame_ms = round(1000 * EVERY / stream.average_rate)
        frames: list[Image] = [frame.to_image().crop(BOX) for frame in clip.decode(stream)][::EVERY]
    while len(frames) > 2 and _same(frames[-1], frames[-2]):
        frames.pop()
    times = [frame_ms] * (len(frames) - 1) + [REST_MS]
    frames[0].save(
        picture, save_all=True, append_images=frames[1:], duration=times, loop=0, quality=75, method=6
    )


def _same(one: Image, other: Image) -> bool:
    """Return whether two frames differ by no more than the film's compression."""
    return bool(np.abs(np.asarray(one, int) - np.asarray(other, int)).max() < 24)


if __name__ == "__main__":
    animate(*sys.argv[1:3])
