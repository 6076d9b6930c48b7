"""Neighbourhoods as situations of the audit: one neighbour each, wherever geometry or a rule says that it matters.

Merged are neighbours that physics cannot tell apart: of one kind, whichever way it is turned, in the way of the same
action by the same solids to a tenth of a millimetre, and the rules alike. One stands for all of them; mirror images,
and flags for blocks, are left out from the start. Neighbours of a kind that are in the way, or
forbidden and close, are one row, and so are all out of reach; what is allowed although it is close is a row each.
Left out of what the physical rules allow are starts to which no play of theirs leads, for a load has no room there: in
three a block that leans on a ramp stands 0.8 mm deep in the gear of a slope that another car carries.
"""

from __future__ import annotations

import re
from collections.abc import Collection
from dataclasses import dataclass
from typing import Final

import numpy as np

from craftsim.discrete.actions import ACTIONS
from craftsim.discrete.grid import SECOND_PART, CarField, Cell, Grid, Kind
from craftsim.discrete.rules import Rules, RuleSet
from craftsim.validation.audit.scenes import Scene
from craftsim.validation.contexts.context import DIRECTION_NAMES
from craftsim.validation.neighbourhoods.occupants import occupants
from craftsim.validation.neighbourhoods.scenery import draw, without
from craftsim.validation.neighbourhoods.situations import LEVEL, situations
from craftsim.validation.neighbourhoods.table import Entry, read_entries
from craftsim.validation.play.cars import has_room

_MARGIN: Final = 3
"""Free columns round all, since what is beside the map counts as wall."""
_BRUSH_MM: Final = 1.0
"""What overlaps less may slip by."""
_SIDES: Final = re.compile(r"_(f|r)?[lr]\b|_(left|right|front|back)\b")
_TURNS: Final = re.compile(rf"-({'|'.join(DIRECTION_NAMES)})$")
_WITHOUT_SECOND: Final = (Kind.AIR, Kind.GROUND, *SECOND_PART.values())


@dataclass(frozen=True)
class Nearby(Scene):
    """The world of a bare situation and one neighbour."""

    clearance_mm: float | None = None
    """What geometry expects: negative where the neighbour is in the way, None where it is out of reach."""

    @property
    def id(self) -> str:
        """Such as ``ROTATE_LEFT/load=block/near=car+block-low-left@(1,0,-1)``."""
        return self.name

    def row(self, legal: bool) -> str:
        """Return the name of its row: its own where the action is allowed close by, else one with others."""
        situation, occupant = self.name.split("/near=")
        judged = "allowed" if legal else "forbidden"
        if self.clearance_mm is None:
            return f"{situation}/near=any/{judged} out of reach"
        kind = f"{situation}/near={re.split('[-@]', occupant)[0]}"
        if self.clearance_mm < -_BRUSH_MM:
            return f"{kind}/{judged} in the way"
        return self.name if legal else f"{kind}/forbidden close by"


def nearby(rule_set: RuleSet, verbs: Collection[str] = ()) -> list[tuple[Nearby, bool]]:
    """Return the neighbourhoods of these verbs, or of all, and whether a rule set allows the action in each."""
    rules = Rules(rule_set)
    bare = {one.name: (one, draw(one.scenery)) for one in situations()}
    near = {one.name: one for one in occupants()}
    found: dict[tuple[object, ...], tuple[Nearby, bool]] = {}
    for entry in read_entries():
        situation, around = bare[entry.situation]
        if verbs and ACTIONS[situation.action].verb not in verbs:
            continue
        occupant, (dx, dy, dz) = near[entry.occupant], entry.at
        below, here = (of.moved(dx, dy, LEVEL + dz) for of in (occupant.bearer, occupant.scenery))
        grid = draw(below + here, around)
        legal = rules.legal(grid, 0, situation.action)
        if not legal and not rules.legal(without(grid, here), 0, situation.action):
            continue
        if legal and rule_set == "physical" and not has_room(grid):
            continue
        key = (entry.situation, _TURNS.sub("", entry.occupant), legal, *_met(entry))
        if key not in found:
            clearance = float(entry.clearance_mm) if entry.clearance_mm else None
            name = f"{entry.situation}/near={entry.occupant}@({dx},{dy},{dz})"
            size, things, cars = _cropped(grid)
            found[key] = Nearby(name, things, cars, (situation.action,), None, size, clearance), legal
    return list(found.values())


def _met(entry: Entry) -> tuple[object, ...]:
    """Return what physics can tell apart: how close which solids come; out of reach, where the neighbour is."""
    if not entry.clearance_mm:
        return entry.occupant, entry.at
    return entry.clearance_mm, _SIDES.sub("", entry.closest)


def _cropped(grid: Grid) -> tuple[Cell, tuple, tuple]:
    """Return size, things and cars of a world without the empty columns round them."""
    cells = [(x, y, z) for x, y, z in np.argwhere(~np.isin(grid.kind, _WITHOUT_SECOND)).tolist()]
    taken = np.vstack([np.argwhere(grid.kind > Kind.GROUND), grid.cars[:, : CarField.Z + 1]])
    low = taken.min(axis=0) - _MARGIN
    size = taken.max(axis=0) + 1 + _MARGIN - low
    things = tuple(
        (Kind(grid.kind[x, y, z]), (x - int(low[0]), y - int(low[1]), z), int(grid.yaw[x, y, z]))
        for x, y, z in cells
    )
    cars = tuple(
        (x - int(low[0]), y - int(low[1]), z, yaw, Kind(load), load_yaw, slope)
        for x, y, z, yaw, load, load_yaw, slope in grid.cars.tolist()
    )
    return (int(size[0]), int(size[1]), int(taken[:, 2].max()) + 1), things, cars
