"""The frames of a film: pictures of a trajectory, captions beside them, and cards at the start and the end.

Several trajectories are shown side by side, at the same simulated time. Each frame is made from them and its number
alone, so that any process can make any of them.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import accumulate
from typing import Final

import cv2
import mujoco
import numpy as np
from numpy.typing import NDArray

from craftsim.checking.attempt import SAME_TIME_S, Attempt
from craftsim.compiled.arrays import Flags
from craftsim.discrete.grid import Grid
from craftsim.discrete.kinds import Action
from craftsim.discrete.rules import Rules
from craftsim.errors import InputError
from craftsim.rendering.cameras import aspect_of, make_view
from craftsim.rendering.encode import Frame
from craftsim.rendering.grid_picture import levels_of, world_image
from craftsim.rendering.layout import Tile, TileLayout, arrange, covered_by, tiles_in_row
from craftsim.rendering.offscreen import make_renderer
from craftsim.rendering.outlines import draw_outlines
from craftsim.rendering.overlay import PAPER, caption_of, draw_panel, end_card, title_card
from craftsim.rendering.ranges import FILM_SPEED, FRAME_RATE
from craftsim.rendering.stage import Quality, Stage
from craftsim.rendering.trajectory import Trajectory, show_at
from craftsim.storage.limits import FRAME_PIXELS
from craftsim.workers.copying import NotCopyable

GRID: Final = "grid"
"""The view that is not physics: what the rules predict."""
TITLE_S: Final = 1.5
_END_S: Final = 2.5
"""How long the cards stay."""
_BETWEEN: Final = 196  # grey between trajectories that are side by side
LEAST_PIXELS: Final = 64
"""Of a side of a frame, and of a view."""
IDLE: Final = 12.0
"""Simulated seconds in a second of film while no car does anything."""
VERB_SPEEDS: Final = {"LIFT": 2.0, "DROP": 2.0, "MOVE": 4.0, "FOLD": 8.0, "UNFOLD": 8.0}
"""The same while a car does this."""
_OTHERWISE: Final = 4.0
_ON_A_SLOPE: Final = 2.5
_DOCKING: Final = 3.0
"""At the beginning and at the end of each folding, for :data:`_DOCKING_S`."""
_DOCKING_S: Final = 0.6
_FAILING: Final = 0.5
"""About the end of an action that did not do as predicted, for :data:`_FAILING_S`."""
_FAILING_S: Final = 0.8
_SMOOTH_S: Final = 0.8  # simulated time over which a change of speed is spread
_SMOOTH_SAMPLES: Final = 2000  # at most, of which a recording has 40 in that time
_Picture = Callable[[int, float], Frame]
"""Gives what a view shows at a sample and its time."""


@dataclass(frozen=True)
class FilmOptions:
    """Appearance of a film. Raises InputError for a size or a number that no film has."""

    size: tuple[int, int] = (1280, 720)
    """Width and height in pixels, even."""
    fps: int = 30
    cameras: tuple[str, ...] = ("overview",)
    """The views, as of :func:`craftsim.rendering.cameras.make_view`, or ``grid`` for what the rules predict."""
    layout: TileLayout = "side"
    quality: Quality = "draft"
    speed: float | None = None
    """Simulated seconds in a second of film; it follows what the cars do if None."""
    length_s: float | None = None
    """Length of the film without its cards, in place of a speed."""
    ghost: bool = True
    """Whether to draw what the design still lacks, translucent."""
    captions: bool | None = None
    """Whether a panel says what the cars do; in films alone if None."""
    cards: bool = True

    def __post_init__(self) -> None:
        width, height = self.size
        if (
            width % 2
            or height % 2
            or min(width, height) < LEAST_PIXELS
            or width * height > FRAME_PIXELS
        ):
            raise InputError(
                f"a frame of {width} x {height} pixels; allowed: even numbers of {LEAST_PIXELS} or more, and "
                "4096 x 2304 pixels at most"
            )
        FRAME_RATE.check("fps", self.fps)
        if self.speed is not None:
            FILM_SPEED.check("speed", self.speed)
        if not self.cameras:
            raise InputError("no camera; give one or more")

    @property
    def n_cards(self) -> tuple[int, int]:
        """Frames of the card at the start, and of the one at the end."""
        if self.cards:
            return round(self.fps * TITLE_S), round(self.fps * _END_S)
        return 0, 0


class Frames(NotCopyable):
    """The frames of a film, by their number; to be closed at the end."""

    _instead = "make them again of the trajectory"

    def __init__(self, shown: Trajectory | Sequence[Trajectory], look: FilmOptions) -> None:
        """Make frames of a trajectory, or of several that stand side by side; raises InputError for none."""
        self.look = look
        self.shown = (shown,) if isinstance(shown, Trajectory) else tuple(shown)
        if not self.shown:
            raise InputError("no trajectory; give one or more")
        longest = max(self.shown, key=lambda trajectory: trajectory.duration_s)
        self.span_s: tuple[float, float] = tuple(longest.time[[0, -1]].tolist())
        """Start and end of the longest trajectory, by whose time the film goes."""
        self.times, self._factors = pace_of(longest, look)
        """Simulated time of each frame between the cards, (n,), in seconds."""

    def __len__(self) -> int:
        return len(self.times) + sum(self.look.n_cards)

    @cached_property
    def _panes(self) -> list[_Pane]:
        tiles = tiles_in_row(Tile(0, 0, *self.look.size), [1.0] * len(self.shown))
        return [_Pane(*pane, self.look) for pane in zip(self.shown, tiles, strict=True)]

    def __getitem__(self, number: int) -> Frame:
        """Return a frame, shape (height, width, 3), uint8, RGB.

        Raises InputError for a camera that there is not, and RenderingUnavailable where nothing renders.
        """
        number -= self.look.n_cards[0]
        if 0 <= number < len(self.times):
            return self.at(float(self.times[number]), float(self._factors[number]))
        if number < 0:
            return self._title
        return self._end

    @cached_property
    def _title(self) -> Frame:
        return self._joined(
            [title_card(pane.trajectory, pane.tile.size, pane.last) for pane in self._panes]
        )

    @cached_property
    def _end(self) -> Frame:
        return self._joined(
            [end_card(pane.trajectory, pane.tile.size, pane.last) for pane in self._panes]
        )

    def at(self, time_s: float, factor: float | None = None) -> Frame:
        """Return the picture of a moment, with its captions.

        Of several trajectories it is a moment of the longest; each is shown as long after its own start, or at its end.
        """
        since_s = time_s - self.span_s[0]
        return self._joined(
            [pane.at(since_s + float(pane.trajectory.time[0]), factor) for pane in self._panes]
        )

    def _joined(self, pictures: Sequence[Frame]) -> Frame:
        if len(pictures) == 1:
            return pictures[0]
        frame: Frame = np.full((*self.look.size[::-1], 3), _BETWEEN, np.uint8)
        for pane, picture in zip(self._panes, pictures, strict=True):
            frame[pane.tile.place] = picture
        return frame

    def close(self) -> None:
        """Close the renderers, if any was made."""
        for pane in vars(self).get("_panes", ()):
            for renderer in pane.renderers:
                renderer.close()


class _Pane(NotCopyable):
    """Pictures of one trajectory, of the size of its tile of the film."""

    _instead = "make the film again of the trajectory"

    def __init__(self, trajectory: Trajectory, tile: Tile, look: FilmOptions) -> None:
        self.trajectory = trajectory
        self.tile = tile
        self.look = look

        def covered(size: tuple[int, int]) -> Flags:
            if look.cameras[0] == GRID:
                return np.ones(size[::-1], bool)
            return covered_by(
                trajectory, make_view(look.cameras[0], trajectory, size[0] / size[1]), size
            )

        aspects = [_aspect(trajectory, camera) for camera in look.cameras]
        captions = look.captions is not False
        below = tile.size != look.size
        tiles, self._panel = arrange(tile.size, aspects, look.layout, captions, covered, below)
        if any(min(tile.size) < LEAST_PIXELS for tile in tiles):
            raise InputError(
                f"{len(tiles)} views do not fit into {tile.width} x {tile.height} pixels"
            )
        # A copy takes a twentieth of the time.
        self._blank: Frame = np.full((tile.height, tile.width, 3), PAPER, np.uint8)
        self._stage = Stage(trajectory, look.quality)
        self.renderers: list[mujoco.Renderer] = []
        self._views: list[tuple[Tile, _Picture]] = [
            (
                tile,
                _predicted(trajectory, tile.size) if camera == GRID else self._seen(camera, tile),
            )
            for tile, camera in zip(tiles, look.cameras, strict=True)
        ]

    @cached_property
    def last(self) -> Frame:
        """The last picture, which cards show: the first frame of a film serves as its poster."""
        return self._views[0][1](len(self.trajectory) - 1, float(self.trajectory.time[-1]))

    def at(self, time_s: float, factor: float | None) -> Frame:
        frame = self._blank.copy()
        sample = self.trajectory.at(time_s)
        for tile, picture in self._views:
            frame[tile.place] = picture(sample, min(time_s, float(self.trajectory.time[-1])))
        if self._panel is not None:
            caption = caption_of(self.trajectory, time_s, factor)
            words = draw_panel(caption, self._panel.size, min(self.look.size))
            frame[self._panel.place] = words
        return frame

    def _seen(self, camera: str, tile: Tile) -> _Picture:
        stage = self._stage
        trajectory = self.trajectory
        data = mujoco.MjData(self._stage.model)
        view = make_view(camera, trajectory, tile.width / tile.height)
        renderer = make_renderer(stage.model, tile.size, stage.shadows)
        self.renderers.append(renderer)

        def draw(sample: int, time_s: float) -> Frame:
            show_at(stage.model, data, trajectory.qpos[sample], trajectory.time[sample])
            stage.model.vis.global_.fovy = view.fovy_deg
            renderer.update_scene(data, view.camera(time_s))
            stage.finish(renderer.scene, data.qpos, ghost=self.look.ghost and view.ghost)
            stage.shade(renderer, data)
            picture: Frame = renderer.render()
            return draw_outlines(picture, trajectory, stage.model, data, view.aim(time_s))

        return draw


def _aspect(trajectory: Trajectory, camera: str) -> float:
    if camera != GRID:
        return aspect_of(camera, trajectory)
    _, grids = predicted_worlds(trajectory)
    picture = world_image(grids[0], levels=levels_of(grids, design=trajectory.wanted))
    return picture.shape[1] / picture.shape[0]


def _predicted(trajectory: Trajectory, size: tuple[int, int]) -> _Picture:
    """Return the world that the rules predict, drawn level by level into tiles of a size."""
    times, grids = predicted_worlds(trajectory)
    levels = levels_of(grids, design=trajectory.wanted)

    @lru_cache(1)
    def picture(number: int) -> Frame:
        return fit_into(world_image(grids[number], levels=levels, design=trajectory.wanted), size)

    return lambda sample, time_s: picture(max(0, bisect_right(times, time_s + SAME_TIME_S) - 1))


def predicted_worlds(trajectory: Trajectory) -> tuple[list[float], list[Grid]]:
    """Return the worlds that the rules alone predict, and from when on: an action counts from its end on.

    All that was done is applied to the start, in the order in which it ended where that leads to the same world.
    """
    story = trajectory.story
    start_s = float(trajectory.time[0])
    acts = [(act, step.intended_grid) for step in story.recipe.steps for act in step.acts]
    before = len(acts) - len(story.attempts)  # what was done before the recording
    ends = [start_s] * before + [attempt.start_s + attempt.duration_s for attempt in story.attempts]
    rules = Rules(story.recipe.setup.rules)
    start = story.recipe.grid

    def worlds(order: Iterable[int]) -> list[Grid]:
        grids = [start]
        for act, intended in (acts[i] for i in order):
            grid = grids[-1]
            action = Action[act.action]
            if intended is not None:
                grid = intended
            elif rules.legal(grid, act.car, action):
                grid = rules.apply(grid, act.car, action)
            grids.append(grid)
        return grids

    by_end = sorted(range(len(acts)), key=ends.__getitem__)
    in_order = worlds(range(len(acts)))
    as_they_end = worlds(by_end)
    if as_they_end[-1].same_visible(in_order[-1]):
        return [start_s, *(ends[i] for i in by_end)], as_they_end
    # Some of them depend on each other: then each waits for those that act before it.
    return [start_s, *accumulate(ends, max)], in_order


def fit_into(picture: Frame, size: tuple[int, int]) -> Frame:
    """Return a picture in the middle of a tile of ``size`` (width, height), as large as fits."""
    width, height = size
    scale = min(0.96 * width / picture.shape[1], 0.96 * height / picture.shape[0])
    small = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    tile = np.full((height, width, 3), PAPER, np.uint8)
    top = (height - small.shape[0]) // 2
    left_px = (width - small.shape[1]) // 2
    tile[top : top + small.shape[0], left_px : left_px + small.shape[1]] = small
    return tile


Pace = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Of each frame of a film, (n,) each: its simulated time in seconds, and the simulated seconds in a second of film."""


def pace_of(trajectory: Trajectory, look: FilmOptions) -> Pace:
    """Return when the frames between the cards are, both ends included; never slower than it happened."""
    took_s = trajectory.duration_s
    if look.length_s is not None:
        n = max(1, round(look.length_s * look.fps))
        speed = max(1.0, took_s / look.length_s)
    elif look.speed is not None:
        n = int(np.ceil(took_s / look.speed * look.fps - 1e-6)) + 1
        speed = look.speed
    else:
        return _adapted_pace(trajectory, look.fps)
    times = np.minimum(trajectory.time[0] + np.arange(n) * speed / look.fps, trajectory.time[-1])
    return times, np.full(n, speed)


def _adapted_pace(trajectory: Trajectory, fps: int) -> Pace:
    """Return frames at a speed that follows what the cars do: contact and docking slowly, waits and foldings fast."""
    time = trajectory.time
    speed = np.full(len(time), IDLE)
    for attempt in trajectory.story.attempts:
        if attempt.performed:
            _slow_down(speed, time, attempt)
    # Film time is the integral of 1 / speed; smoothed, so that it changes gently.
    steps = np.diff(time, prepend=time[0])
    period = 1.0
    if len(time) > 1:
        period = float(np.median(steps[1:]))
    width = max(1, round(min(_SMOOTH_S / period, _SMOOTH_SAMPLES)))
    padded = np.pad(1.0 / speed, (width // 2, width - 1 - width // 2), mode="edge")
    pace = np.convolve(padded, np.full(width, 1.0 / width), mode="valid")
    film = np.cumsum(pace * steps)
    moments = np.arange(int(np.ceil(film[-1] * fps - 1e-6)) + 1) / fps
    return np.interp(moments, film, time), 1.0 / np.interp(moments, film, pace)


def _slow_down(speed: NDArray[np.float64], time: NDArray[np.float64], attempt: Attempt) -> None:
    start = attempt.start_s
    end = attempt.start_s + attempt.duration_s
    usual = VERB_SPEEDS.get(attempt.verb, _OTHERWISE)
    slowed = np.full(len(time), min(usual, _ON_A_SLOPE) if attempt.slope else usual)
    if attempt.verb in ("FOLD", "UNFOLD"):
        slowed[np.minimum(time - start, end - time) < _DOCKING_S] = _DOCKING
    during = (time >= start) & (time <= end)
    speed[during] = np.minimum(speed, slowed)[during]
    if not attempt.agrees:
        speed[np.abs(time - end) < _FAILING_S] = _FAILING
