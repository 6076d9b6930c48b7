"""Many worlds of one size side by side: the same compiled rules, one call for all of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.grid import Grid
from craftsim.discrete.kernel import batch
from craftsim.discrete.kernel.batch import NO_HELPER
from craftsim.discrete.kernel.codes import N_ACTIONS
from craftsim.discrete.kernel.jit import compiled
from craftsim.discrete.kernel.search import search_buffers
from craftsim.discrete.kernel.state import World, world_at
from craftsim.discrete.kinds import Action
from craftsim.discrete.rules import Rules, empty_queue
from craftsim.discrete.tasks.batches import Targets
from craftsim.discrete.tasks.observation import ROW, Layout, fill_rows, target_rows
from craftsim.errors import CraftsimError


@compiled
def _fill_rows(
    worlds: World,
    n_slopes: int,
    n_blocks: int,
    goal: tuple[int, int, int],
    shows_flag: bool,
    slots: NDArray[np.int64],
    out: NDArray[np.int32],
) -> bool:
    fits = True
    for i in range(out.shape[0]):
        fits &= fill_rows(world_at(worlds, i), n_slopes, n_blocks, goal, shows_flag, slots, out[i])
    return fits


class Worlds:
    """B worlds of one size and number of cars under one rule set; they are changed in place.

    With a ``depth`` the action helper is on and ``queue`` (B, n, depth + 1) holds what it still has to do, -1
    where nothing.
    """

    def __init__(self, rules: Rules, grids: Sequence[Grid], depth: int | None = None) -> None:
        shapes = {(grid.size, grid.n_cars) for grid in grids}
        if len(shapes) != 1:
            raise CraftsimError(
                f"worlds of a batch must be of one size and number of cars, not {sorted(shapes)}"
            )
        self.rules = rules
        self.depth = depth
        self.n_cars = grids[0].n_cars
        self.grids = Grid.stack(grids)
        """All of them, a batch."""
        self.queue = np.stack([empty_queue(self.n_cars, depth or 0) for _ in grids])
        self._space = search_buffers(grids[0].size)

    def __len__(self) -> int:
        return len(self.grids)

    @property
    def arrays(self) -> World:
        """What compiled code sees of them."""
        return self.grids.world(self.rules.corrections)

    def grid(self, i: int) -> Grid:
        """Return a copy of world i."""
        return self.grids[i].copy()

    def put(self, which: int | NDArray[np.integer], grids: Grid) -> None:
        """Replace one world by a copy of a grid, or several by those of a batch, and empty their queues."""
        self.grids.cells[which], self.grids.cars[which] = grids.cells, grids.cars
        self.queue[which] = -1

    def legal(self) -> NDArray[np.bool_]:
        """Return (B, n, 15): what each car could do at once."""
        return self.reachable(NO_HELPER)

    def reachable(self, depth: int) -> NDArray[np.bool_]:
        """Return (B, n, 15): what is legal, and the moves that a helper of a given depth has a plan for."""
        out = np.empty((len(self), self.n_cars, N_ACTIONS), np.bool_)
        batch.masks(*self.arrays, self._space, depth, out)
        return out

    def offered(self) -> NDArray[np.bool_]:
        """Return (B, n, 15): what is legal, with the helper also what is reachable; never all false.

        A car that the rules leave nothing, on a ramp with both ways blocked, is offered STOP, which does nothing.
        """
        mask = self.legal() if self.depth is None else self.reachable(self.depth)
        mask[..., Action.STOP] |= ~mask.any(-1)
        return mask

    def tick(self, actions: NDArray[np.integer], order: NDArray[np.integer]) -> NDArray[np.bool_]:
        """Let all cars act; return (B, n), by car, whether what each did was legal when its turn came.

        ``actions`` (B, n) is by car, ``order`` (B, n) lists the cars of each world as they act. Raises ValueError if
        a shape or an order is wrong.
        """
        turns: NDArray[np.int64] = np.ascontiguousarray(order, np.int64)
        acts: NDArray[np.int64] = np.asarray(actions, np.int64)
        shape = (len(self), self.n_cars)
        if acts.shape != shape or turns.shape != shape:
            raise ValueError(f"actions and order must have shape {shape}, not {acts.shape} and {turns.shape}")
        if self.n_cars and (np.sort(turns, axis=1) != np.arange(self.n_cars)).any():
            raise ValueError(f"an order must name each of the cars 0 to {self.n_cars - 1} once")
        acting = np.take_along_axis(acts, turns, axis=1)
        in_order = np.empty(turns.shape, np.bool_)
        if self.depth is None:
            batch.step(*self.arrays, turns, acting, in_order)
        else:
            helper = self.queue, self._space, self.depth
            batch.step_with_helper(*self.arrays, turns, acting, in_order, *helper)
        applied = np.empty_like(in_order)
        np.put_along_axis(applied, turns, in_order, axis=1)
        return applied

    def entity_rows(self, layout: Layout, designs: Targets) -> NDArray[np.int32]:
        """Return (B, n_observed, 13): the rows of all entities of each world, and of its design (B, T, 5) if it shows.

        Raises CraftsimError if a world has more slopes or blocks than the layout has rows for.
        """
        out = np.empty((len(self), layout.n_rows, ROW), np.int32)
        slots = np.empty((2, ROW), np.int64)
        counts = (layout.n_slopes, layout.n_blocks)
        if not _fill_rows(self.arrays, *counts, layout.goal_cell, layout.shows_flag, slots, out):
            raise CraftsimError(layout.overflow)
        return np.concatenate([out, target_rows(designs)], axis=1) if layout.n_targets else out
