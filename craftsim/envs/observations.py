"""What is observed in place of the rows of all entities, or beside them: images, local views and sets of entities."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, Literal, get_args

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from craftsim.discrete.grid import Grid, Kind
from craftsim.discrete.kernel.state import F_LOAD, F_X, F_Y, F_YAW, F_Z
from craftsim.errors import InputError, check_choice
from craftsim.rendering.images import PIXELS, ImageKind, check_images
from craftsim.tasks import Task
from craftsim.tasks.kernel import IS_CAR, IS_FLAG, IS_FOOT, IS_LOADED, YAW_HIGH, YAW_LOW
from craftsim.tasks.observation import Layout, entity_rows
from craftsim.tasks.starts import Targets, targets_of

Observation = dict[str, NDArray[Any]]

ImageCamera = Literal["front", "overview", "top"]
IMAGE_CAMERAS: Final[tuple[str, ...]] = get_args(ImageCamera)

FrameChoice = Literal["car", "map"]
FRAMES: Final[tuple[str, ...]] = get_args(FrameChoice)
FEATURES: Final = 8
"""Of a row: what, x, y, z, yaw, loaded, own, filled."""
WHAT, X, Y, Z, YAW, LOADED, OWN, FILLED = range(FEATURES)
TARGET: Final = 7
"""``what`` is 0 in a row to be masked, 1 to 6 for car, folded slope, body, foot, block and flag, and in a cell of the
design this and the cell's :class:`craftsim.discrete.grid.Kind`."""
_ANY_YAW: Final = -1
"""Of blocks and flags, and of cells of the design where it does not matter."""
CHANNELS: Final = 6
"""Of a cell of a local view: kind, yaw, car, its yaw and load, and the kind to be built."""


@dataclass(frozen=True)
class Observe:
    """What each car observes: the ``observation`` of the PettingZoo forms; the action mask stays beside it."""

    space: spaces.Space[Any]  # of one car's observation
    of: Callable[[Grid, int], Any]
    """Returns the observation of a car, given by number, in the world as it is seen."""


@dataclass(frozen=True)
class Images:
    """Camera images beside the observation; docs/reference/environments.md explains them.

    Raises InputError for a bad value.
    """

    camera: ImageCamera = "front"
    """``front``, each car's own in its nose, or one of the world's, of which all cars get the same images."""
    size: tuple[int, int] = (64, 48)  # width and height in pixels
    kinds: tuple[ImageKind, ...] = ("rgb",)
    """Some of rgb, depth and segmentation, as :func:`craftsim.take_images` takes them."""

    def __post_init__(self) -> None:
        check_images(self.size, self.kinds)
        check_choice("camera", self.camera, IMAGE_CAMERAS)

    def cameras(self, n_cars: int) -> list[str]:
        """Return the names of the cameras of a world with so many cars."""
        if self.camera == "front":
            return [f"front:{car}" for car in range(n_cars)]
        return [self.camera]

    def of_car(self, images_by_kind: Observation, car: int) -> Observation:
        """Return a car's images, by kind, out of those of all cameras."""
        return {
            kind: images[car if self.camera == "front" else 0]
            for kind, images in images_by_kind.items()
        }

    def of_all(self, images_by_kind: Observation) -> Observation:
        """Return the images for an agent of all cars: with a leading dimension of the cars, if each has its own."""
        if self.camera == "front":
            return images_by_kind
        return self.of_car(images_by_kind, 0)

    def spaces(self, n_cars: int | None = None) -> dict[str, spaces.Space[Any]]:
        """Return the spaces, by kind, of the images of a car, or of an agent that acts for so many."""
        width, height = self.size
        leading = () if n_cars is None or self.camera != "front" else (n_cars,)
        image_spaces: dict[str, spaces.Space[Any]] = {}
        for kind in self.kinds:
            shape, dtype, low, high = PIXELS[kind]
            image_spaces[kind] = spaces.Box(low, high, (*leading, height, width, *shape), dtype)
        return image_spaces


def local_views(grids: Grid, designs: Targets, radius: int) -> NDArray[np.int8]:
    """Return (B, n, 2 * radius + 1, 2 * radius + 1, H + 1, 6): the cells around each car, along x, y and z from 1.

    The last dimension is the cell's kind, a wall outside the map, and its yaw; whether a car is there, 1, or the car
    itself, 2, and its yaw and load; and the kind to be built there, ``designs`` (B, T, 5), AIR where nothing is. Kinds
    are :class:`craftsim.discrete.grid.Kind`; directions are those of the map, as moves are.
    """
    length, width, height = grids.size
    world = np.zeros(
        (len(grids), length + 2 * radius, width + 2 * radius, height + 2, CHANNELS), np.int8
    )
    world[..., 0] = Kind.WALL
    inside = world[:, radius : radius + length, radius : radius + width]
    inside[..., 0] = Kind.AIR
    inside[..., : height + 1, 0], inside[..., : height + 1, 1] = grids.kind, grids.yaw
    cars = grids.cars.astype(np.int64)
    worlds = np.arange(len(grids))[:, None]
    x = cars[..., F_X]
    y = cars[..., F_Y]
    z = cars[..., F_Z]
    inside[worlds, x, y, z, 2] = 1
    inside[worlds, x, y, z, 3:5] = cars[..., [F_YAW, F_LOAD]]
    kind, goal_x, goal_y, goal_z, _ = np.moveaxis(designs, -1, 0)
    to_build = np.nonzero(kind)
    inside[to_build[0], goal_x[to_build], goal_y[to_build], goal_z[to_build], 5] = kind[to_build]
    span = np.arange(2 * radius + 1)
    columns = (x[..., None] + span)[..., :, None], (y[..., None] + span)[..., None, :]
    views = world[worlds[..., None, None], *columns][..., 1:, :]
    np.put_along_axis(views[:, :, radius, radius, :, 2], z[..., None] - 1, 2, -1)
    return views


def entity_sets(
    grids: Grid,
    layout: Layout,
    designs: Targets,
    frame: FrameChoice = "car",
    radius: int | None = None,
) -> NDArray[np.int16]:
    """Return (B, n, n_rows - 1 + T, 8): for each of n cars a row for each thing, then for each cell of the design.

    Args:
        grids: a batch of B worlds.
        layout: how many things of each kind there may be.
        designs: (B, T, 5), what is to be built in each world.
        frame: ``car`` counts cells from the car, x ahead, and yaw from its heading; ``map`` as the grid does.
        radius: things and cells further away than so many cells, along x or y, are masked; none unless given.
    """
    check_choice("frame", frame, FRAMES)
    if radius is not None and not (isinstance(radius, int) and radius >= 0):
        raise InputError(f"radius is {radius!r}; allowed: None, or 0 and more cells")
    # The last row of these repeats the goal, which is nothing that stands there.
    rows = entity_rows(grids, layout, designs)[:, : layout.n_rows - 1]
    entities = np.zeros((*rows.shape[:2], FEATURES), np.int16)
    flags = rows[..., IS_CAR : IS_FLAG + 1]
    entities[..., WHAT] = flags @ np.arange(1, TARGET)
    entities[..., X : Z + 1] = rows[..., :3]
    turned = flags[..., : IS_FOOT + 1 - IS_CAR].any(-1)  # blocks and flags have no yaw
    entities[..., YAW] = np.where(turned, 2 * rows[..., YAW_HIGH] + rows[..., YAW_LOW], _ANY_YAW)
    entities[..., LOADED] = rows[..., IS_LOADED]
    kind, x, y, z, yaw = np.moveaxis(designs, -1, 0)
    cells = np.arange(len(designs))[:, None], x, y, z
    filled = (grids.kind[cells] == kind) & ((yaw < 0) | (grids.yaw[cells] == yaw))
    zero = np.zeros_like(kind)
    columns = np.where(kind == 0, 0, TARGET + kind), x, y, z, yaw, zero, zero, filled
    car_rows = np.concatenate([entities, np.stack(columns, axis=-1).astype(np.int16)], axis=1)
    cars = grids.cars
    out = np.repeat(car_rows[:, None], grids.n_cars, axis=1)
    numbers = np.arange(grids.n_cars)
    out[:, numbers, numbers, OWN] = 1
    apart = out[..., X : Z + 1] - cars[:, :, None, F_X : F_Z + 1]
    if frame == "car":
        heading = cars[:, :, None, F_YAW]
        dx = apart[..., 0]
        dy = apart[..., 1]
        out[..., X] = np.choose(heading, [dx, dy, -dx, -dy])
        out[..., Y] = np.choose(heading, [dy, -dx, -dy, dx])
        out[..., Z] = apart[..., 2]
        out[..., YAW] = np.where(out[..., YAW] == _ANY_YAW, _ANY_YAW, (out[..., YAW] - heading) % 4)
    hidden = out[..., WHAT] == 0
    if radius is not None:
        hidden |= np.abs(apart[..., :2]).max(-1) > radius
    out[hidden] = 0
    return out


def observe_entities(task: Task, frame: FrameChoice = "car", radius: int | None = None) -> Observe:
    """Return the option ``observe`` with which cars see :func:`entity_sets` of a task whose design is fixed.

    Raises InputError for a task in which each episode has a design of its own, and for a bad frame or radius.
    """
    if task.draws_designs:
        raise InputError(
            f"in task '{task.name}' each episode has a design of its own, which 'observe' does not see; take "
            "entity_sets with the designs of a batch"
        )
    layout = task.layout
    design = targets_of(task.design)[None]
    bound = max(*task.starts[0].size, TARGET + int(design[..., 0].max(initial=0)))

    def of(grid: Grid, car: int) -> NDArray[np.int16]:
        return entity_sets(grid[None], layout, design, frame, radius)[0, car]

    of(task.draw(np.random.default_rng(0)), 0)
    rows = layout.n_rows - 1 + design.shape[1]
    return Observe(spaces.Box(-bound, bound, (rows, FEATURES), np.int16), of)
