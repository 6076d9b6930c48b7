"""Which rule forbids an action, in words.

The rules without corrections are asked first; their reasons stand in :mod:`craftsim.discrete.rules.reasons`. What
only a correction of the physical set forbids is found by switching its rule flag off, and what is in the way by
looking which single thing or car nearby, taken away, makes the action legal.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from craftsim.discrete.grid import CarField, Cell, Kind
from craftsim.discrete.kernel.state import KIND, World, pose_of
from craftsim.discrete.kinds import NAMES, Action, CellField, Correction
from craftsim.discrete.rules.reasons import at
from craftsim.discrete.rules.table import ACTIONS, legal

_NEAR: Final = 3
"""How many columns away, and how many levels, something may be that a correction looks at."""

CORRECTIONS: Final = {
    "swinging_flap": ("the flap would meet something on its way", "flap"),
    "turning_load": ("the load would hit a car, or a load that leans, as it turns", "turning-load"),
    "leaning_load": ("a load that leans on a ramp would meet something", "leaning-load"),
    "own_ramp": ("on a ramp a car goes on along that ramp only", "own-ramp"),
    "ramp_below_gear": ("a ramp below a gear is driven down in its own direction only", "through-a-gear"),
    "reaching_load": ("something would meet a load that reaches in from another level", "reaching-load"),
    "overhead_wall": ("there is a wall overhead", "overhead-wall"),
    "crossing_gear": ("the gear of the slope would cross something", "crossing-gear"),
    "run_out": ("who comes down a ramp does not drive under what stands right behind its foot", "run-out"),
}
"""The rule flags that forbid, each with what it forbids and the heading of docs/rules.md that explains it."""
_FORBIDDING: Final = sum(int(Correction[name]) for name in CORRECTIONS)


@dataclass(frozen=True)
class Explanation:
    """Why an action is forbidden, or that it is not; ``str()`` gives it in one line."""

    action: Action
    legal: bool
    reason: str = ""
    """In words; empty if the action is legal."""
    flag: str | None = None
    """The rule flag that forbids it; None where the published rules do, too."""
    cells: tuple[Cell, ...] = ()
    """The cells concerned."""

    def __str__(self) -> str:
        if self.legal:
            return f"{self.action.name} is legal"
        return f"{self.action.name} is forbidden: {self.why}"

    @property
    def why(self) -> str:
        """The reason, and the rule flag with its place in the docs where one forbids the action."""
        named = "" if self.flag is None else f" ({self.flag}, docs/rules.md#{CORRECTIONS[self.flag][1]})"
        return f"{self.reason}{named}"


def explain(w: World, car: int, action: Action) -> Explanation:
    """Return why an action of a car is forbidden, or that it is legal."""
    if _legal(w, car, action):
        return Explanation(action, True)
    off = w._replace(corrections=w.corrections & ~_FORBIDDING)
    if not _legal(off, car, action):
        reason = ACTIONS[action].why_not(off, car, pose_of(off, car), int(action))
        if reason is None:
            raise RuntimeError(
                f"{action.name} is forbidden, but {ACTIONS[action].why_not.__name__}() has no reason"
            )
        return Explanation(action, False, reason.text, None, reason.cells)
    flag = _flag(w, off.corrections, car, action)
    things = list(_in_the_way(w, car, action))
    named = "; ".join(text for _, text in things)
    words = CORRECTIONS[flag][0] + (f": {named}" if named else "")
    cells = tuple(dict.fromkeys(cell for cell, _ in things)) or (at(pose_of(w, car)),)
    return Explanation(action, False, words, flag, cells)


def _legal(w: World, car: int, action: Action) -> bool:
    return bool(legal(w, car, pose_of(w, car), int(action)))


def _flag(w: World, without: int, car: int, action: Action) -> str:
    """Return the rule flag that forbids an action: one without which it is legal, else the first that forbids alone."""
    on = {name: int(Correction[name]) for name in CORRECTIONS if w.corrections & Correction[name]}
    for name, bit in on.items():
        if _legal(w._replace(corrections=w.corrections & ~bit), car, action):
            return name
    for name, bit in on.items():
        if not _legal(w._replace(corrections=without | bit), car, action):
            return name
    raise RuntimeError(f"{action.name} is forbidden by no single rule flag")


def _in_the_way(w: World, car: int, action: Action) -> Iterator[tuple[Cell, str]]:
    """Yield each thing and each other car nearby without which the action is legal, with its cell."""
    x, y, z = at(pose_of(w, car))
    for other, row in enumerate(w.cars.tolist()):
        cell = (row[CarField.X], row[CarField.Y], row[CarField.Z])
        if other == car or max(abs(cell[0] - x), abs(cell[1] - y)) > _NEAR:
            continue
        cars = w.cars.copy()
        cars[other, CarField.Z] += w.cells.shape[2] + _NEAR
        if _legal(w._replace(cars=cars), car, action):
            load = "" if row[CarField.LOAD] == Kind.AIR else f" with {NAMES[Kind(row[CarField.LOAD])]}"
            yield cell, f"car {other}{load} is in {cell}"
    length, width, levels = w.cells.shape[:3]
    for cx in range(max(x - _NEAR, 0), min(x + _NEAR + 1, length)):
        for cy in range(max(y - _NEAR, 0), min(y + _NEAR + 1, width)):
            for cz in range(max(z - 1, 1), min(z + 3, levels)):
                kind = Kind(w.cells[cx, cy, cz, KIND])
                if kind == Kind.AIR or (cx, cy, cz) == (x, y, z):
                    continue
                cells = w.cells.copy()
                cells[cx, cy, cz, CellField.KIND] = Kind.AIR
                if _legal(w._replace(cells=cells), car, action):
                    yield (cx, cy, cz), f"{NAMES[kind]} is in {(cx, cy, cz)}"
