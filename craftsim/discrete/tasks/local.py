"""What a car observes around it, and the places it can be sent to by one number (CraftEnv's local mode).

Actions are numbered: 0 goes on with the queued plan; then one number for each row of a block, of a slope and of a
free raised cell, each "get there"; the last 15 are the primitive actions, moves with the helper.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.actions import Action
from craftsim.discrete.grid import Cell, Grid, Kind
from craftsim.discrete.planning.planner import Planner
from craftsim.discrete.tasks.observation import ROW, Layout, car_vectors, type_flag, write_row
from craftsim.discrete.tasks.worlds import Worlds

VIEW: Final = 3
"""How many columns a car looks in each direction; its window is 7 cells wide."""

CONTINUE: Final = 0
"""The action that goes on with a queued plan."""


@dataclass(frozen=True)
class LocalRows:
    """How many rows an observation has for what is near."""

    blocks: int
    slopes: int
    free: int = 20

    @classmethod
    def of(cls, layout: Layout) -> LocalRows:
        """Return CraftEnv's numbers for a layout: all blocks, all slopes, 20 free cells."""
        return cls(layout.n_blocks, layout.n_slopes)

    @property
    def n_actions(self) -> int:
        """How many actions there are."""
        return 1 + self.blocks + self.slopes + self.free + len(Action)


@dataclass(frozen=True)
class LocalView:
    """One car's observation and what it can be told to do."""

    vector: NDArray[np.int32]
    """The global observation, then the rows of near blocks, slopes and free cells, 13 numbers each."""
    mask: NDArray[np.bool_]
    """(n_actions,): what is allowed."""
    places: dict[int, Cell]
    """Where the actions go that send the car to a place."""


def local_view(
    grid: Grid, car: int, queue: NDArray[np.int8], planner: Planner, layout: Layout, rows: LocalRows
) -> LocalView:
    """Return what a car observes; ``queue`` (n_cars, depth + 1) is the helper's.

    Near are the cells that the car could get to without its load, with the other cars where they are.
    """
    levels = grid.kind.shape[2]
    near = planner.surroundings(grid, car, VIEW)[:, :, :levels]
    raised_air = (grid.kind == Kind.AIR) & (np.arange(levels) > 1)
    groups = [
        (grid.kind == Kind.BLOCK, rows.blocks),
        ((grid.kind == Kind.FSLOPE) | (grid.kind == Kind.BODY), rows.slopes),
        (raised_air, rows.free),
    ]
    listed = np.zeros((rows.blocks + rows.slopes + rows.free, ROW), np.int32)
    places: dict[int, Cell] = {}
    first = 0
    for wanted, count in groups:
        for i, (x, y, z) in enumerate(np.argwhere(near & wanted)[:count]):
            cell = (int(x), int(y), int(z))
            flag = type_flag(grid.kind[cell])
            if flag:
                write_row(listed[first + i], *cell, flag, grid.yaw[cell])
            else:
                listed[first + i, :3] = cell
            places[1 + first + i] = cell
        first += count
    mask = np.zeros(rows.n_actions, np.bool_)
    if queue[car, 0] >= 0:
        mask[CONTINUE] = True
    else:
        mask[list(places)] = True
        mask[-len(Action) :] = planner.reachable(grid)[car]
    shared = car_vectors(Worlds(planner.rules, [grid]).entity_rows(layout), grid.n_cars)[0, car]
    return LocalView(np.concatenate([shared, listed.ravel()]), mask, places)


def choose(
    view: LocalView, number: int, grid: Grid, car: int, queue: NDArray[np.int8], planner: Planner
) -> Action:
    """Return the primitive to hand to the helper's tick for an action number; a way to a place is put into the queue.

    Going on with a queue needs no action of its own, and a place that the helper finds no way to gives STOP.
    """
    n_special = len(view.mask) - len(Action)
    if number >= n_special:
        return Action(number - n_special)
    if number in view.places:
        plan = planner.plan_to(grid, car, view.places[number]) or ()
        queue[car, : len(plan)] = plan
    return Action.STOP
