"""What cars observe as sets: a row for each thing and for each cell of the design, in the frame of map or car."""

from __future__ import annotations

from typing import Final, Literal

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from craftsim.discrete.grid import Grid
from craftsim.discrete.kernel.state import F_X, F_YAW, F_Z
from craftsim.discrete.kernel.tasks import IS_CAR, IS_FLAG, IS_FOOT, IS_LOADED, YAW_HIGH, YAW_LOW
from craftsim.discrete.tasks import Task
from craftsim.discrete.tasks.observation import Layout, entity_rows
from craftsim.discrete.tasks.starts import Targets, targets_of
from craftsim.envs.observe import Observe
from craftsim.errors import InputError

Frame = Literal["car", "map"]
FEATURES: Final = 8
"""Of a row: what, x, y, z, yaw, loaded, own, filled."""
WHAT, X, Y, Z, YAW, LOADED, OWN, FILLED = range(FEATURES)
TARGET: Final = 7
"""``what`` is 0 in a row to be masked, 1 to 6 for car, folded slope, body, foot, block and flag, and in a cell of the
design this and the cell's :class:`craftsim.discrete.grid.Kind`."""
ANY_YAW: Final = -1
"""Of blocks and flags, and of cells of the design where it does not matter."""


def entity_sets(
    grids: Grid, layout: Layout, designs: Targets, frame: Frame = "car", radius: int | None = None
) -> NDArray[np.int16]:
    """Return (B, n, n_rows - 1 + T, 8): for each of n cars a row for each thing, then for each cell of the design.

    Args:
        grids: a batch of B worlds.
        layout: how many things of each kind there may be.
        designs: (B, T, 5), what is to be built in each world.
        frame: ``car`` counts cells from the car, x ahead, and yaw from its heading; ``map`` as the grid does.
        radius: things and cells further away than so many cells, along x or y, are masked; none unless given.
    """
    if frame not in ("car", "map"):
        raise InputError(f"unknown frame '{frame}'; there are car, map")
    if radius is not None and not (isinstance(radius, int) and radius >= 0):
        raise InputError(f"radius is {radius!r}; allowed: None, or 0 and more cells")
    # The last row of these repeats the goal, which is nothing that stands there.
    rows = entity_rows(grids, layout, designs)[:, : layout.n_rows - 1]
    things = np.zeros((*rows.shape[:2], FEATURES), np.int16)
    flags = rows[..., IS_CAR : IS_FLAG + 1]
    things[..., WHAT] = flags @ np.arange(1, TARGET)
    things[..., X : Z + 1] = rows[..., :3]
    turned = flags[..., : IS_FOOT + 1 - IS_CAR].any(-1)  # blocks and flags have no yaw
    things[..., YAW] = np.where(turned, 2 * rows[..., YAW_HIGH] + rows[..., YAW_LOW], ANY_YAW)
    things[..., LOADED] = rows[..., IS_LOADED]
    both = np.concatenate([things, _targets(grids, designs)], axis=1)
    cars = grids.cars
    out = np.repeat(both[:, None], grids.n_cars, axis=1)
    each = np.arange(grids.n_cars)
    out[:, each, each, OWN] = 1
    apart = out[..., X : Z + 1] - cars[:, :, None, F_X : F_Z + 1]
    if frame == "car":
        heading = cars[:, :, None, F_YAW]
        dx, dy = apart[..., 0], apart[..., 1]
        out[..., X] = np.choose(heading, [dx, dy, -dx, -dy])
        out[..., Y] = np.choose(heading, [dy, -dx, -dy, dx])
        out[..., Z] = apart[..., 2]
        out[..., YAW] = np.where(out[..., YAW] == ANY_YAW, ANY_YAW, (out[..., YAW] - heading) % 4)
    hidden = out[..., WHAT] == 0
    if radius is not None:
        hidden |= np.abs(apart[..., :2]).max(-1) > radius
    out[hidden] = 0
    return out


def _targets(grids: Grid, designs: Targets) -> NDArray[np.int16]:
    kind, x, y, z, yaw = np.moveaxis(designs, -1, 0)
    each = np.arange(len(designs))[:, None]
    filled = (grids.kind[each, x, y, z] == kind) & ((yaw < 0) | (grids.yaw[each, x, y, z] == yaw))
    zero = np.zeros_like(kind)
    what = np.where(kind == 0, 0, TARGET + kind)
    return np.stack([what, x, y, z, yaw, zero, zero, filled], axis=-1).astype(np.int16)


def observe_entities(task: Task, frame: Frame = "car", radius: int | None = None) -> Observe:
    """Return the option ``observe`` with which cars see :func:`entity_sets` of a task whose design is fixed.

    Raises InputError for a task in which each episode has a design of its own, and for a bad frame or radius.
    """
    if task.draws_designs:
        raise InputError(
            f"in task '{task.name}' each episode has a design of its own, which 'observe' does not see; take "
            "entity_sets with the designs of a batch"
        )
    layout, design = task.layout, targets_of(task.design)[None]
    most = max(*task.starts[0].size, TARGET + int(design[..., 0].max(initial=0)))

    def of(grid: Grid, car: int) -> NDArray[np.int16]:
        return entity_sets(grid[None], layout, design, frame, radius)[0, car]

    of(task.draw(np.random.default_rng(0)), 0)
    rows = layout.n_rows - 1 + design.shape[1]
    return Observe(spaces.Box(-most, most, (rows, FEATURES), np.int16), of)
