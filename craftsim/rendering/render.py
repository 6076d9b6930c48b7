"""Rendering a trajectory into a film, an animation, stills or a contact sheet, by the ending of the file's name.

:func:`film_plan` films a plan on the grid: what the rules predict, at the pace of nominal physics, and no physics at
all.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, closing, nullcontext
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from PIL import Image

from craftsim.checking.attempt import SAME_TIME_S
from craftsim.discrete.actions import ACTIONS
from craftsim.discrete.grid import CarField, Grid, Piece
from craftsim.discrete.rules import Rules
from craftsim.discrete.schedule import Schedule
from craftsim.errors import InputError
from craftsim.rendering.encode import (
    ANIMATIONS,
    FILM_SUFFIXES,
    Frame,
    OnFrame,
    check_animation,
    encode,
)
from craftsim.rendering.film import FilmOptions, Frames, fit_into
from craftsim.rendering.grid_picture import levels_of, world_image
from craftsim.rendering.layout import arrange
from craftsim.rendering.overlay import PAPER, Caption, CarCaption, draw_panel, label
from craftsim.rendering.trajectory import Trajectory
from craftsim.storage.writing import write_whole
from craftsim.workers.pool import Pool, answered

_FORMATS: Final = (*FILM_SUFFIXES, *ANIMATIONS, ".png")
SHEET: Final = 12
"""Moments on a contact sheet."""
_BATCH: Final = 8  # frames that a process makes at once
PLAN_SIZE: Final = (1280, 720)
PLAN_FPS: Final = 20
_PLAN_SPEED: Final = 4.0  # seconds of the plan in a second of film, at least
LONGEST_S: Final = 60.0
"""Length of a plan's film at most: a long plan is shown faster."""
_END_S: Final = 1.5
"""How long its last picture stays."""

_Progress = Callable[[int], AbstractContextManager[OnFrame]]
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
    progress: _Progress = no_progress,
) -> list[Path]:
    """Render a trajectory, or several side by side at the same simulated time, and return the files that were written.

    Args:
        shown: what is rendered.
        path: a film (``.mp4``, ``.webm``), an animation (``.webp``, ``.gif``), or a picture (``.png``); its folder
            must exist. It is written whole or not at all.
        look: how it looks.
        workers: processes to share the work; the pictures do not depend on it.
        at: simulated times (of the longest) of pictures, one file each; without any, a ``.png`` is a contact sheet.
        progress: shows what is done.

    Raises InputError, and RenderingUnavailable where nothing renders.
    """
    path = Path(path)
    look = look or FilmOptions()
    check_format(path, at)
    picture = path.suffix == ".png"
    with closing(
        Frames(shown, replace(look, captions=bool(look.captions)) if picture else look)
    ) as frames:
        if picture:
            if at:
                return _stills(frames, path, at)
            return [_sheet(frames, path)]
        if path.suffix in ANIMATIONS:
            check_animation(path, len(frames), look.size, look.fps)
        with progress(len(frames)) as tell:
            encode(path, look.fps, frames_in_order(frames, workers), tell)
    return [path]


def check_format(path: Path, at: Sequence[float] = ()) -> None:
    """Raise InputError for a file of no format, and for moments in one that is no picture."""
    if path.suffix not in _FORMATS:
        raise InputError(
            f"{path}: no format ends in '{path.suffix}'; there are {', '.join(_FORMATS)}"
        )
    if at and path.suffix != ".png":
        raise InputError(
            f"{path}: moments are pictures; give a name that ends in .png, or leave them out"
        )


def frames_in_order(frames: Frames, workers: int = 1) -> Iterator[Frame]:
    """Yield the frames of a film, the same for any number of workers."""
    numbers = range(len(frames))
    if workers == 1:
        yield from map(frames.__getitem__, numbers)
        return
    batches = [numbers[first : first + _BATCH] for first in numbers[::_BATCH]]
    early: dict[range, list[Frame]] = {}
    # Copies have no compiled model, which would be sent along.
    copies = tuple(replace(trajectory) for trajectory in frames.shown)
    with Pool(workers) as pool:
        answers = pool.map_unordered(partial(_make_frames, copies, frames.look), batches)
        for batch in batches:
            while batch not in early:
                done, frames_of_it = next(answers)
                early[done] = answered(frames_of_it)
            yield from early.pop(batch)


@lru_cache(1)
def _prepared(trajectories: tuple[Trajectory, ...], look: FilmOptions) -> Frames:
    return Frames(trajectories, look)


def _make_frames(
    trajectories: tuple[Trajectory, ...], look: FilmOptions, numbers: range
) -> list[Frame]:
    """Make frames in a worker, which prepares the film once."""
    return [_prepared(trajectories, look)[number] for number in numbers]


def _stills(frames: Frames, path: Path, at: Sequence[float]) -> list[Path]:
    first, last = frames.span_s
    for moment in at:
        if not first - SAME_TIME_S <= moment <= last + SAME_TIME_S:
            raise InputError(
                f"there is no moment {moment:.10g} s; allowed: {round(first, 6):.10g} to {round(last, 6):.10g} s"
            )
    names = [
        path if len(at) == 1 else path.with_stem(f"{path.stem}-{moment:.10g}") for moment in at
    ]
    return [_write_png(name, frames.at(moment)) for name, moment in zip(names, at, strict=True)]


def _sheet(frames: Frames, path: Path) -> Path:
    width, height = frames.look.size
    if width >= height:
        columns = 3
    else:
        columns = 4
    small = []
    for number in np.linspace(0, len(frames.times) - 1, SHEET).round().astype(int):
        time_s = float(frames.times[number])
        picture = Image.fromarray(frames.at(time_s)).resize((width // columns, height // columns))
        small.append(label(np.asarray(picture), f"{time_s:.1f} s"))
    rows = [np.hstack(small[i : i + columns]) for i in range(0, SHEET, columns)]
    return _write_png(path, np.vstack(rows))


def _write_png(path: Path, picture: Frame) -> Path:
    _, data = cv2.imencode(".png", picture[:, :, ::-1])
    return write_whole(path, data.tobytes())


def film_plan(
    path: Path,
    schedule: Schedule,
    rules: Rules,
    title: str,
    design: Collection[Piece] = (),
    progress: _Progress = no_progress,
) -> Path:
    """Write a film (``.mp4``, ``.webm``) of a schedule, made with these rules, over its timetable.

    Cars glide from cell to cell; all else of an action is seen when it ends. The panel at the side says what each car
    does. Returns the path; raises InputError where the disk does not take it.
    """
    n_frames = len(plan_moments(schedule)[0])
    with progress(n_frames) as tell:
        encode(path, PLAN_FPS, plan_frames(schedule, rules, title, design), tell)
    return path


def plan_moments(schedule: Schedule) -> tuple[list[float], float]:
    """Return the time of each frame of a plan's film in seconds of the plan, and how many of them a second shows."""
    took_s = schedule.makespan()
    speed = max(_PLAN_SPEED, took_s / LONGEST_S)
    n = int(np.ceil(took_s / speed * PLAN_FPS - 1e-6)) + 1 + round(_END_S * PLAN_FPS)
    return np.minimum(np.arange(n) * speed / PLAN_FPS, took_s).tolist(), speed


def plan_worlds(
    schedule: Schedule, rules: Rules, moments: Iterable[float]
) -> Iterator[tuple[Grid, dict[int, int]]]:
    """Yield for each moment the world as what has ended left it, and the running step of each car."""
    steps = schedule.steps
    times = schedule.times()
    grids = [steps[0].before if steps else schedule.final]
    # In the order of their ends, in which each comes after all that it waits for.
    for step in (steps[index] for index in np.argsort(times[:, 1], kind="stable").tolist()):
        grids.append(rules.tick(grids[-1], [(step.car, step.action)])[0])
    for moment in moments:
        has_begun = times[:, 0] <= moment + SAME_TIME_S
        ended = times[:, 1] <= moment + SAME_TIME_S
        running = np.flatnonzero(has_begun & ~ended).tolist()
        yield grids[int(ended.sum())], {steps[index].car: index for index in running}


def plan_frames(
    schedule: Schedule, rules: Rules, title: str, design: Collection[Piece] = ()
) -> Iterator[Frame]:
    """Yield the frames of a plan's film, each of shape (height, width, 3), uint8, RGB."""
    (tile,), panel = arrange(PLAN_SIZE, (1.0,), "side", captions=True)
    assert panel is not None
    steps = schedule.steps
    times = schedule.times()
    moments, speed = plan_moments(schedule)
    if steps:
        start = steps[0].before
    else:
        start = schedule.final
    levels = levels_of([start, *(step.after for step in steps)], design=design)
    for moment, (grid, running) in zip(moments, plan_worlds(schedule, rules, moments), strict=True):
        shifts = {}
        doing = {}
        for car, index in running.items():
            step = steps[index]
            begins, ends = times[index].tolist()
            share = max(0.0, moment - begins) / (ends - begins)
            displacement = share * (step.after.cars[car] - step.before.cars[car])
            shifts[car] = float(displacement[CarField.X]), float(displacement[CarField.Y])
            doing[car] = ACTIONS[step.action].words
        picture = world_image(grid, levels=levels, design=design, shifts=shifts)
        frame = np.full((*PLAN_SIZE[::-1], 3), PAPER, np.uint8)
        frame[tile.place] = fit_into(picture, tile.size)
        cars = tuple(CarCaption(car, doing.get(car, "waits")) for car in range(grid.n_cars))
        n_begun = int((times[:, 0] <= moment + SAME_TIME_S).sum())
        caption = Caption(title, n_begun, len(steps), cars, (), moment, speed)
        frame[panel.place] = draw_panel(caption, panel.size, PLAN_SIZE[1])
        yield frame
