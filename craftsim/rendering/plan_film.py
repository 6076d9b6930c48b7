"""A plan as a film on the grid: what the rules predict, at the pace of nominal physics, and no physics at all."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Final

import numpy as np

from craftsim.discrete.actions import ACTIONS
from craftsim.discrete.grid import CarField, Grid, Piece
from craftsim.discrete.rules import Rules
from craftsim.discrete.schedule import Schedule
from craftsim.rendering.encode import Frame, encode
from craftsim.rendering.film import fitted
from craftsim.rendering.grid_picture import levels_of, world_image
from craftsim.rendering.layout import arrange
from craftsim.rendering.overlay import PAPER, Caption, CarCaption, Panel
from craftsim.rendering.render import Progress, no_progress

SIZE: Final = (1280, 720)
FPS: Final = 20
SPEED: Final = 4.0
"""Seconds of the plan in a second of film, at least."""
LONGEST_S: Final = 60.0
"""Length of a film at most: a long plan is shown faster."""
END_S: Final = 1.5
"""How long the last picture stays."""


def film_plan(
    path: Path,
    schedule: Schedule,
    rules: Rules,
    title: str,
    design: Collection[Piece] = (),
    progress: Progress | None = None,
) -> Path:
    """Write a film (``.mp4``, ``.webm``) of a schedule over its timetable.

    Cars glide from cell to cell; all else of an action is seen when it ends. The panel at the side says what each car
    does. Returns the path; raises InputError where the disk does not take it.
    """
    film = PlanFilm(schedule, rules, title, design)
    with (progress or no_progress)(len(film)) as tell:
        encode(path, FPS, film.frames(), tell)
    return path


class PlanFilm:
    """The frames of a film of a schedule."""

    def __init__(self, schedule: Schedule, rules: Rules, title: str, design: Collection[Piece] = ()) -> None:
        """Prepare for a schedule, made with these rules."""
        self._schedule, self._rules, self._title, self._design = schedule, rules, title, design
        self._times, took_s = schedule.times(), schedule.makespan()
        self._start = schedule.steps[0].before if schedule.steps else schedule.final
        self.speed = max(SPEED, took_s / LONGEST_S)
        """Seconds of the plan in a second of film."""
        n = int(np.ceil(took_s / self.speed * FPS)) + 1 + round(END_S * FPS)
        self.moments = np.minimum(np.arange(n) * self.speed / FPS, took_s)
        """(n,) the time of each frame in seconds of the plan."""

    def __len__(self) -> int:
        return len(self.moments)

    def worlds(self) -> Iterator[tuple[float, Grid, dict[int, int]]]:
        """Yield for each frame its time, the world as what has ended left it, and the running step of each car."""
        steps, starts = self._schedule.steps, np.argsort(self._times[:, 0], kind="stable").tolist()
        ends = np.argsort(self._times[:, 1], kind="stable").tolist()
        grid, begun, ended = self._start, 0, 0
        running: dict[int, int] = {}
        for moment in self.moments.tolist():
            # In the order of their ends, in which each comes after all that it waits for.
            while ended < len(ends) and self._times[ends[ended], 1] <= moment:
                step = steps[ends[ended]]
                grid, _ = self._rules.tick(grid, [(step.car, step.action)])
                ended += 1
            while begun < len(starts) and self._times[starts[begun], 0] <= moment:
                running[steps[starts[begun]].car] = starts[begun]
                begun += 1
            running = {car: index for car, index in running.items() if self._times[index, 1] > moment}
            yield moment, grid, running.copy()

    def frames(self) -> Iterator[Frame]:
        """Yield the frames, each of shape (height, width, 3), uint8, RGB."""
        (tile, *_), place = arrange(SIZE, (1.0,), "side", captions=True)
        assert place is not None
        panel, steps = Panel(place.size, SIZE[1]), self._schedule.steps
        levels = levels_of([self._start, *(step.after for step in steps)], design=self._design)
        for moment, grid, running in self.worlds():
            shifts = {car: self._shift(index, moment) for car, index in running.items()}
            picture = world_image(grid, levels=levels, design=self._design, shifts=shifts)
            frame = np.full((SIZE[1], SIZE[0], 3), PAPER, np.uint8)
            frame[tile.rows, tile.columns] = fitted(picture, tile.size)
            doing = {car: ACTIONS[steps[index].action].words for car, index in running.items()}
            cars = tuple(CarCaption(car, doing.get(car, "waits")) for car in range(grid.n_cars))
            begun = int((self._times[:, 0] <= moment).sum())
            caption = Caption(self._title, begun, len(steps), cars, moment, self.speed)
            frame[place.rows, place.columns] = panel.draw(caption)
            yield frame

    def _shift(self, index: int, moment: float) -> tuple[float, float]:
        """Return how far the car of a step has come from its cell, in cells along x and y."""
        step, (start, end) = self._schedule.steps[index], self._times[index].tolist()
        way = step.after.cars[step.car] - step.before.cars[step.car]
        share = (moment - start) / (end - start)
        return share * float(way[CarField.X]), share * float(way[CarField.Y])
