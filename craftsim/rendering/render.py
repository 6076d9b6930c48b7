"""Rendering a trajectory: films, animations, stills and contact sheets, by the ending of the file's name."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, closing, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from PIL import Image

from craftsim.errors import InputError
from craftsim.rendering.encode import ANIMATIONS, FILMS, Frame, OnFrame, check_animation, encode
from craftsim.rendering.film import FilmOptions, Frames, longest, several
from craftsim.rendering.overlay import label
from craftsim.rendering.trajectory import Trajectory
from craftsim.storage.writing import write_whole
from craftsim.workers.pool import Pool, answered

FORMATS: Final = (*FILMS, *ANIMATIONS, ".png")
SHEET: Final = 12
"""Moments on a contact sheet."""
_BATCH: Final = 8
"""Frames that a process makes at once."""

Progress = Callable[[int], AbstractContextManager[OnFrame]]
"""Given the number of frames, opens what is called after each one."""


def no_progress(total: int) -> AbstractContextManager[OnFrame]:
    """Show nothing of what is done."""
    return nullcontext(lambda done: None)


def render(
    shown: Trajectory | Sequence[Trajectory],
    path: str | Path,
    look: FilmOptions | None = None,
    *,
    workers: int = 1,
    at: Sequence[float] = (),
    progress: Progress = no_progress,
) -> list[Path]:
    """Render a trajectory into a file, and return the files that were written.

    Args:
        shown: a trajectory, or several that are shown side by side at the same simulated time.
        path: a film (``.mp4``, ``.webm``), an animation (``.webp``, ``.gif``), or a picture (``.png``); its folder
            must exist. It is written whole or not at all.
        look: how it looks.
        workers: processes to share the work; the pictures do not depend on it.
        at: simulated times of which a picture is to be made, one file each; without any, a ``.png`` is a contact sheet.
            Of several trajectories they are those of the longest.
        progress: shows what is done.

    Raises:
        InputError: an argument is not as it should be, or the disk does not take the file.
        RenderingUnavailable: nothing renders on this machine.
    """
    path, look = Path(path), look or FilmOptions()
    check_format(path, at)
    if path.suffix == ".png":
        look = replace(look, captions=bool(look.captions))
        return _stills(shown, path, look, at) if at else [_sheet(shown, path, look)]
    n_frames = Frames.count(shown, look)
    if path.suffix in ANIMATIONS:
        check_animation(path, n_frames, look.size, look.fps)
    with progress(n_frames) as tell:
        encode(path, look.fps, render_frames(shown, look, workers), tell)
    return [path]


def check_format(path: Path, at: Sequence[float] = ()) -> None:
    """Raise InputError for a file of no format, and for moments in one that is no picture."""
    if path.suffix not in FORMATS:
        raise InputError(f"{path}: no format ends in '{path.suffix}'; there are {', '.join(FORMATS)}")
    if at and path.suffix != ".png":
        raise InputError(f"{path}: moments are pictures; give a name that ends in .png, or leave them out")


def render_frames(
    shown: Trajectory | Sequence[Trajectory], look: FilmOptions, workers: int = 1
) -> Iterator[Frame]:
    """Yield the frames of a film, the same for any number of workers."""
    if workers == 1:
        with closing(Frames(shown, look)) as frames:
            yield from map(frames.__getitem__, range(len(frames)))
        return
    n_frames = Frames.count(shown, look)
    batches = [range(first, min(first + _BATCH, n_frames)) for first in range(0, n_frames, _BATCH)]
    early: dict[range, list[Frame]] = {}
    with Pool(workers) as pool:
        answers = pool.map_unordered(FrameMaker(shown, look), batches)
        for batch in batches:
            while batch not in early:
                done, frames_of_it = next(answers)
                early[done] = answered(frames_of_it)
            yield from early.pop(batch)


class FrameMaker:
    """Makes frames of a film in a worker, by their numbers; the film is prepared there, once."""

    def __init__(self, shown: Trajectory | Sequence[Trajectory], look: FilmOptions) -> None:
        """Prepare nothing yet."""
        # Copies have no compiled model, which would be sent along.
        self._shown, self._look = [replace(trajectory) for trajectory in several(shown)], look
        self._frames: Frames | None = None

    def __call__(self, numbers: Iterable[int]) -> list[Frame]:
        """Return the frames of these numbers."""
        if self._frames is None:
            self._frames = Frames(self._shown, self._look)
        return [self._frames[number] for number in numbers]


def _stills(
    shown: Trajectory | Sequence[Trajectory], path: Path, look: FilmOptions, at: Sequence[float]
) -> list[Path]:
    first, last = longest(shown).time[[0, -1]].tolist()
    for moment in at:
        if not first <= moment <= last:
            raise InputError(f"there is no moment {moment:g} s; allowed: {first:.2f} to {last:.2f} s")
    names = [path if len(at) == 1 else path.with_stem(f"{path.stem}-{moment:.10g}") for moment in at]
    with closing(Frames(shown, look)) as frames:
        return [_write_png(name, frames.at(moment)) for name, moment in zip(names, at, strict=True)]


def _sheet(shown: Trajectory | Sequence[Trajectory], path: Path, look: FilmOptions) -> Path:
    """Write moments of the film, at equal distances, as one picture of the look's size."""
    with closing(Frames(shown, look)) as frames:
        moments = np.linspace(0, len(frames.pace.times) - 1, SHEET).round().astype(int)
        times = frames.pace.times[moments].tolist()
        pictures = [frames.at(time_s) for time_s in times]
    columns = 3 if look.size[0] >= look.size[1] else 4
    width, height = look.size[0] // columns, look.size[1] // columns
    small = [
        label(np.asarray(Image.fromarray(picture).resize((width, height))), f"{time_s:.1f} s")
        for picture, time_s in zip(pictures, times, strict=True)
    ]
    rows = [np.hstack(small[i : i + columns]) for i in range(0, SHEET, columns)]
    return _write_png(path, np.vstack(rows))


def _write_png(path: Path, picture: Frame) -> Path:
    _, data = cv2.imencode(".png", picture[:, :, ::-1])
    return write_whole(path, data.tobytes())
