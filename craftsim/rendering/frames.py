"""The frames of a film: pictures of a trajectory, captions beside them, and cards at the start and the end.

Each frame is made from the trajectory and its number alone, so that any process can make any of them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Final, Protocol

import cv2
import mujoco
import numpy as np

from craftsim.errors import InputError
from craftsim.rendering.cameras import View, make_view
from craftsim.rendering.captions import Captions
from craftsim.rendering.cards import end_card, title_card
from craftsim.rendering.inset import hidden_by
from craftsim.rendering.layout import Layout, Tile, arrange
from craftsim.rendering.pacing import Pace, adapted_pace, even_pace, fitted_pace
from craftsim.rendering.panel import PAPER, Frame, Panel
from craftsim.rendering.playback import Playback
from craftsim.rendering.prediction import Prediction
from craftsim.rendering.renderer import make_renderer
from craftsim.rendering.shapes import levels_of
from craftsim.rendering.stage import Quality, Stage
from craftsim.rendering.trajectory import Trajectory
from craftsim.rendering.world_image import world_image
from craftsim.storage.limits import FILM_SPEED, FRAME_PIXELS, FRAME_RATE

GRID: Final = "grid"
"""The view that is not physics: what the rules predict."""
TITLE_S: Final = 1.5
END_S: Final = 2.5
"""How long the cards stay."""
LEAST_PIXELS: Final = 64
"""Of a side of a frame, and of a view."""


@dataclass(frozen=True)
class Look:
    """How a film looks. Raises InputError for a size or a number that no film has."""

    size: tuple[int, int] = (1280, 720)
    """Width and height in pixels, even."""
    fps: int = 30
    cameras: tuple[str, ...] = ("overview",)
    """The views, as of :func:`craftsim.rendering.cameras.make_view`, or ``grid`` for what the rules predict."""
    layout: Layout = "side"
    quality: Quality = "draft"
    speed: float | None = None
    """Simulated seconds in a second of film; it follows what the cars do if None."""
    length_s: float | None = None
    """Length of the film without its cards, in place of a speed."""
    ghost: bool = True
    """Whether to draw what the design still lacks, translucent."""
    captions: bool = True
    cards: bool = True
    title: str | None = None
    """That of the trajectory unless given."""

    def __post_init__(self) -> None:
        width, height = self.size
        if width % 2 or height % 2 or min(width, height) < LEAST_PIXELS or width * height > FRAME_PIXELS:
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
        return (round(self.fps * TITLE_S), round(self.fps * END_S)) if self.cards else (0, 0)


class _Picture(Protocol):
    def draw(self, sample: int, time_s: float) -> Frame: ...

    def close(self) -> None: ...


class Frames:
    """The frames of a film, by their number; a context manager that closes its renderers."""

    def __init__(self, trajectory: Trajectory, look: Look) -> None:
        """Prepare; raises InputError for a camera that there is not, and RenderingUnavailable where nothing renders."""
        self.trajectory, self.look = trajectory, look
        self.pace = pace_of(trajectory, look)
        self._n_title, self._n_end = look.n_cards
        tiles, panel = arrange(
            look.size, len(look.cameras), look.layout, look.captions, partial(_hidden, trajectory, look)
        )
        if any(min(tile.size) < LEAST_PIXELS for tile in tiles):
            raise InputError(f"{len(tiles)} views do not fit into {look.size[0]} x {look.size[1]} pixels")
        # A copy takes a twentieth of the time.
        self._blank: Frame = np.full((look.size[1], look.size[0], 3), PAPER, np.uint8)
        self._captions = Captions(trajectory, look.title)
        self._panel = None if panel is None else (panel, Panel(panel.size, look.size[1]))
        self._world = _World(trajectory, look)
        self._views: list[tuple[Tile, _Picture]] = []
        for tile, camera in zip(tiles, look.cameras, strict=True):
            picture = _Predicted(trajectory, tile) if camera == GRID else self._world.view(camera, tile)
            self._views.append((tile, picture))

    def __len__(self) -> int:
        return self._n_title + len(self.pace.times) + self._n_end

    @staticmethod
    def count(trajectory: Trajectory, look: Look) -> int:
        """Return how many frames a film has, without preparing one."""
        return len(pace_of(trajectory, look).times) + sum(look.n_cards)

    def __getitem__(self, number: int) -> Frame:
        """Return a frame, shape (height, width, 3), uint8, RGB."""
        if number < self._n_title:
            return title_card(self.trajectory, self.look.size, self._captions.title)
        number -= self._n_title
        if number >= len(self.pace.times):
            return end_card(self.trajectory, self.look.size)
        return self.at(float(self.pace.times[number]), float(self.pace.factors[number]))

    def at(self, time_s: float, factor: float | None = None) -> Frame:
        """Return the picture of a moment, with its captions."""
        frame = self._blank.copy()
        sample = self.trajectory.at(time_s)
        for tile, view in self._views:
            frame[tile.rows, tile.columns] = view.draw(sample, time_s)
        if self._panel is not None:
            tile, panel = self._panel
            frame[tile.rows, tile.columns] = panel.draw(self._captions.at(time_s, factor))
        return frame

    def close(self) -> None:
        """Close the renderers."""
        for _, view in self._views:
            view.close()


class _World:
    """The stage, and the trajectory that plays on it."""

    def __init__(self, trajectory: Trajectory, look: Look) -> None:
        self._trajectory = trajectory
        self.stage, self.ghost = Stage(trajectory, look.quality), look.ghost
        self.model = self.stage.model
        self._playback = Playback(self.model, trajectory)
        self._shown: tuple[int, mujoco.MjData] | None = None

    def view(self, camera: str, tile: Tile) -> _Seen:
        return _Seen(self, make_view(camera, self._trajectory, tile.width / tile.height), tile)

    def at(self, sample: int) -> mujoco.MjData:
        if self._shown is None or self._shown[0] != sample:
            self._shown = sample, self._playback.at(sample)
        return self._shown[1]


class _Seen:
    """What a camera sees of the world."""

    def __init__(self, world: _World, view: View, tile: Tile) -> None:
        self._world, self._view = world, view
        self._renderer = make_renderer(world.model, tile.size)
        self._renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = world.stage.shadows

    def draw(self, sample: int, time_s: float) -> Frame:
        world, data = self._world, self._world.at(sample)
        world.model.vis.global_.fovy = self._view.fovy_deg
        self._renderer.update_scene(data, self._view.camera(time_s))
        world.stage.finish(self._renderer.scene, data.qpos, ghost=world.ghost and self._view.ghost)
        picture: Frame = self._renderer.render()
        return picture

    def close(self) -> None:
        self._renderer.close()


class _Predicted:
    """The world that the rules predict, drawn level by level."""

    def __init__(self, trajectory: Trajectory, tile: Tile) -> None:
        self._prediction, self._tile, self._design = Prediction(trajectory), tile, trajectory.wanted
        self._levels = levels_of(self._prediction.grids, design=self._design)
        self._drawn: tuple[int, Frame] | None = None

    def draw(self, sample: int, time_s: float) -> Frame:
        grid = self._prediction.at(time_s)
        if self._drawn is None or self._drawn[0] != id(grid):
            picture = world_image(grid, levels=self._levels, design=self._design)
            self._drawn = id(grid), fitted(picture, self._tile.size)
        return self._drawn[1]

    def close(self) -> None:
        """Nothing is open."""


def _hidden(trajectory: Trajectory, look: Look, first: Tile) -> Callable[[Tile], int]:
    """Return what gives the pixels that a tile on the first view hides; on the grid's prediction any hides some."""
    if look.cameras[0] == GRID:
        return lambda tile: 1
    return hidden_by(trajectory, make_view(look.cameras[0], trajectory, first.width / first.height), first)


def pace_of(trajectory: Trajectory, look: Look) -> Pace:
    """Return when the frames between the cards are."""
    if look.length_s is not None:
        return fitted_pace(trajectory, look.fps, look.length_s)
    if look.speed is not None:
        return even_pace(trajectory, look.fps, look.speed)
    return adapted_pace(trajectory, look.fps)


def fitted(picture: Frame, size: tuple[int, int]) -> Frame:
    """Return a picture in the middle of a tile of ``size`` (width, height), as large as fits."""
    width, height = size
    scale = min(0.96 * width / picture.shape[1], 0.96 * height / picture.shape[0])
    small = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    found = np.full((height, width, 3), PAPER, np.uint8)
    top, left = (height - small.shape[0]) // 2, (width - small.shape[1]) // 2
    found[top : top + small.shape[0], left : left + small.shape[1]] = small
    return found
