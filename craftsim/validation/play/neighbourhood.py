"""What an action is, and what stands around it: the words in which random play counts what it covers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from craftsim.discrete.actions import ACTIONS
from craftsim.discrete.footprint import cell_of
from craftsim.discrete.grid import CarField, Cell, Grid, Kind
from craftsim.discrete.kinds import Action

_AROUND: Final = [(dx, dy) for dx in (-1, 0, 1) for dy in (-1, 0, 1) if dx or dy]
_THINGS: Final = {
    Kind.BLOCK: "block",
    Kind.FLAG: "block",
    Kind.WALL: "wall",
    Kind.FSLOPE: "folded slope",
    Kind.GEAR: "gear",
    Kind.BODY: "ramp",
    Kind.FOOT: "ramp",
}
NEIGHBOURS: Final = (
    *("nothing", "block", "wall", "folded slope", "gear", "ramp", "car", "load", "load on a ramp"),
    *("load below", "something above", "wall overhead"),
)
"""All that may be around an action: in the eight cells round the car's own and its next one, on its level; below and
above stands for the same cells one level lower or higher, and a wall overhead is right above the car."""


@dataclass(frozen=True)
class Doing:
    """An action, where it is done, and what is around it."""

    verb: str
    level: int
    load: Kind
    on_slope: bool
    """Whether it starts or ends on a slope."""
    near: tuple[str, ...]
    """Of :data:`NEIGHBOURS`, in their order."""

    @property
    def name(self) -> str:
        """What is done and where, whatever is around: verb, level, load and slope, such as ``MOVE 2+ block slope``."""
        words = [self.verb.split("_")[0], "1" if self.level == 1 else "2+"]
        words += [self.load.name.lower()] if self.load != Kind.AIR else []
        return " ".join([*words, "slope"] if self.on_slope else words)


def doing(before: Grid, after: Grid, car: int, action: Action) -> Doing:
    """Return what an action is, from the worlds before and after it."""
    row = before.cars[car]
    here, there = cell_of(before, car), cell_of(after, car)
    slope = bool(row[CarField.SLOPE] or after.cars[car, CarField.SLOPE])
    near = _near(before, car, here) | _near(before, car, there)
    listed = tuple(name for name in NEIGHBOURS if name in near) or ("nothing",)
    return Doing(ACTIONS[action].verb, here[2], Kind(row[CarField.LOAD]), slope, listed)


def _near(grid: Grid, me: int, cell: Cell) -> set[str]:
    x, y, z = cell
    length, width, _ = grid.size
    found = {"wall overhead"} if grid.kind_at((x, y, z + 1)) == Kind.WALL else set()
    columns = {(x + dx, y + dy) for dx, dy in _AROUND if 0 <= x + dx < length and 0 <= y + dy < width}
    for cx, cy in columns:
        kind = grid.kind_at((cx, cy, z))
        found |= {_THINGS[kind]} if kind in _THINGS else set()
        found |= {"something above"} if grid.kind_at((cx, cy, z + 1)) != Kind.AIR else set()
    for car, row in enumerate(grid.cars.tolist()):
        if car == me or tuple(row[: CarField.Z]) not in columns:
            continue
        loaded, level = row[CarField.LOAD] != Kind.AIR, row[CarField.Z] - z
        if level == 0:
            found.add(("load on a ramp" if row[CarField.SLOPE] else "load") if loaded else "car")
        elif level == 1:
            found.add("something above")
        elif level == -1 and loaded:
            found.add("load below")
    return found
