"""What an action needs of the world while it runs: the cells it sweeps, and the objects it relies on or changes.

Two actions of different cars may run at the same time when neither sweeps space that the other sweeps, neither changes
an object that the other relies on, and no two loads in motion pass side by side, where 2.5 mm of air are too little
for two moving machines. The table of actions (:mod:`craftsim.discrete.actions`) says which function is whose.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from craftsim.discrete.geometry import DIRECTIONS
from craftsim.discrete.grid import CarField, Cell, Grid, Kind, beside


@dataclass(frozen=True)
class Footprint:
    """The cells (x, y, z) that matter to one action."""

    space: frozenset[Cell] = frozenset()
    """Swept by the car, its load or a flap."""
    changes: frozenset[Cell] = frozenset()
    """Whose object the action takes, puts down or turns."""
    relies: frozenset[Cell] = frozenset()
    """Whose object must stay as it is: what is stood on, driven under or out of."""
    loads: frozenset[Cell] = frozenset()
    """Through which a load moves, sideways play and all."""

    def __or__(self, other: Footprint) -> Footprint:
        return Footprint(
            self.space | other.space,
            self.changes | other.changes,
            self.relies | other.relies,
            self.loads | other.loads,
        )

    def conflicts(self, other: Footprint) -> bool:
        """Return whether the two actions must not run at the same time."""
        return bool(
            self.space & other.space
            or self.changes & (other.changes | other.relies)
            or self.relies & other.changes
            or (self.loads and other.loads and self._beside_loads & other.loads)
        )

    @cached_property
    def _beside_loads(self) -> frozenset[Cell]:
        """The cells of the loads and their neighbours on the same level."""
        steps = ((0, 0), *DIRECTIONS.tolist())
        return frozenset((x + dx, y + dy, z) for x, y, z in self.loads for dx, dy in steps)


def of_nothing(before: Grid, after: Grid, car: int) -> Footprint:
    """Return that nothing is needed beyond what the car needs where it stands."""
    return Footprint()


def of_move(before: Grid, after: Grid, car: int) -> Footprint:
    """Return what a move needs: a load sweeps the space that it stands in before and after."""
    loaded = before.cars[car, CarField.LOAD] != Kind.AIR
    return _swept((standing(before, car) | standing(after, car)).space if loaded else frozenset())


def of_turn(before: Grid, after: Grid, car: int) -> Footprint:
    """Return what a turn needs: a load sweeps the neighbour cells, a folded slope the corners, too."""
    row = before.cars[car]
    x, y, z = here = cell_of(before, car)
    if row[CarField.LOAD] == Kind.AIR:
        return of_nothing(before, after, car)
    around = {(x + dx, y + dy, z) for dx, dy in DIRECTIONS.tolist()}
    if row[CarField.LOAD] == Kind.FSLOPE:
        around |= {(x + dx, y + dy, z) for dx in (-1, 1) for dy in (-1, 1)}
    return _swept(frozenset({here, *around}))


def of_board(before: Grid, after: Grid, car: int) -> Footprint:
    """Return what LIFT and DROP need: the object, a slope's gear too, and room above it."""
    x, y, z = here = cell_of(before, car)
    gears = _gear(before, car) | _gear(after, car)
    changed = frozenset({here}) | gears
    return Footprint(changed | {(x, y, z + 1)}, changed, frozenset(), changed)


def of_flap(before: Grid, after: Grid, car: int) -> Footprint:
    """Return what FOLD and UNFOLD need: the slope, and room for its flap."""
    here, downhill = cell_of(before, car), int(before.cars[car, CarField.YAW]) + 2
    foot = beside(here, downhill)
    # The flap is a third of a metre long: it reaches into the second level above, and 12 mm past the foot's cell.
    swung = {(cx, cy, z + up) for cx, cy, z in (here, foot) for up in (0, 1, 2)} | {beside(foot, downhill)}
    held = frozenset({(foot[0], foot[1], foot[2] - 1)})
    return Footprint(frozenset(swung), frozenset({here, foot}), held, frozenset())


def cell_of(grid: Grid, car: int) -> Cell:
    """Return the cell of a car."""
    x, y, z = grid.cars[car, : CarField.YAW].tolist()
    return x, y, z


def _swept(cells: frozenset[Cell]) -> Footprint:
    """Return the footprint of a load that moves through cells; carried, it is 32 mm into the level above."""
    above = {(x, y, z + 1) for x, y, z in cells}
    return Footprint(cells | above, frozenset(), frozenset(), cells)


def standing(grid: Grid, car: int) -> Footprint:
    """Return what a car needs where it stands."""
    x, y, z, _, load, _, slope = grid.cars[car].tolist()
    loads: frozenset[Cell] = frozenset()
    if load != Kind.AIR:
        loads = frozenset({(x, y, z)}) | _gear(grid, car)
        if slope:
            # A load leans downhill with its car, by 40 to 60 mm at its height: into the next cell.
            downhill = int(grid.yaw[x, y, z if slope == 1 else z - 1])
            dx, dy = (int(v) for v in DIRECTIONS[downhill])
            loads |= {(cx + dx, cy + dy, cz) for cx, cy, cz in loads}
    space = frozenset({(x, y, z), *({(x, y, z + 1)} if slope == 1 else set())})
    relies = frozenset({(x, y, z), (x, y, z - 1)})
    return Footprint(space | loads, frozenset(), relies, loads)


def _gear(grid: Grid, car: int) -> frozenset[Cell]:
    """Return the cell of the gear of a folded slope that a car carries, if it carries one."""
    row = grid.cars[car]
    if row[CarField.LOAD] != Kind.FSLOPE:
        return frozenset()
    return frozenset({beside(cell_of(grid, car), int(row[CarField.LOAD_YAW]))})
