"""Which neighbours matter to which action: how close the swept volume comes to each, and what the rules say there."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.actions import ACTIONS
from craftsim.discrete.geometry import CELL_PITCH_M, LEVEL_HEIGHT_M
from craftsim.discrete.grid import CarField, Cell, Grid, Kind
from craftsim.mjcf.parameters import Machines
from craftsim.models.placement import placements
from craftsim.validation.contexts.worlds import ImpossibleError
from craftsim.validation.neighbourhoods.bodies import Clearance, Solids, convexes_of
from craftsim.validation.neighbourhoods.occupants import Occupant, occupants, places
from craftsim.validation.neighbourhoods.scenery import MIDDLE, Scenery, draw, without
from craftsim.validation.neighbourhoods.situations import LEVEL, Situation, situations, sweep

_SAMPLED_M: Final = 0.0001
"""What the samples of a way leave out of its volume."""
OVERLAP_M: Final = 0.001
"""What overlaps deeper at the start cannot stand there."""


@dataclass(frozen=True)
class Neighbour:
    """One neighbour of a situation that can stand there."""

    situation: Situation
    occupant: Occupant
    at: Cell
    """Its cell: of a slope that of the body, of a car its own; the level counts from the acting car's lower one."""
    clearance: Clearance | None
    """Between what moves and the occupant, the least over the way; None beyond the margin."""
    grid: Grid
    """The world with both, and what bears them; the car acts as number 0."""
    alone: Grid
    """The same without the occupant."""

    @property
    def name(self) -> str:
        """Such as ``ROTATE_LEFT/load=block/near=car+block-low-left@(1,0,-1)``."""
        return f"{self.situation.name}/near={self.occupant.name}@({','.join(map(str, self.at))})"


def margin_m(machines: Machines) -> float:
    """Return how near a neighbour has to come to matter: nearer than things do that fill neighbouring cells.

    A load that goes past a block keeps this gap, 2.5 mm less 0.1 mm; contexts with tight room show that it is enough.
    """
    return CELL_PITCH_M - max(machines.block.side_m, machines.slope.side_m) - _SAMPLED_M


def neighbours(machines: Machines, actions: Collection[str] = ()) -> Iterator[Neighbour]:
    """Yield every occupant of the cells near each bare situation that can stand there, mirror images once.

    Args:
        machines: whose geometry decides; of several cars the first one's.
        actions: verbs of the table of actions; all if empty.
    """
    machines = replace(machines, cars=machines.cars[:1])
    margin = margin_m(machines)
    bodies = {occupant: bodies_of(occupant, machines) for occupant in occupants()}
    for situation in situations():
        if actions and ACTIONS[situation.action].verb not in actions:
            continue
        bare = draw(situation.scenery)
        volume = sweep(situation, machines)
        start = Solids([p for part in placements(bare, machines) for p in convexes_of(part, machines)])
        for occupant, (body, bearer, block) in bodies.items():
            for at in places(occupant):
                if situation.symmetric and (at[1], occupant.name) < (-at[1], occupant.mirrored):
                    continue
                shift = shift_of(*at)
                if _overlaps(start, body, shift) or (bearer is not None and _overlaps(start, bearer, shift)):
                    continue
                below, here = (
                    of.moved(at[0], at[1], LEVEL + at[2]) for of in (occupant.bearer, occupant.scenery)
                )
                try:
                    grid = draw(below + here, bare)
                except ImpossibleError:
                    continue
                own = tuple(grid.cars[0, : CarField.Z + 1])
                if grid.kind[own] not in (bare.kind[own], Kind.GEAR):
                    continue
                alone = without(grid, here)
                stacks = np.argwhere((alone.kind == Kind.BLOCK) & (bare.kind != Kind.BLOCK))
                if any(
                    _overlaps(start, block, shift_of(*(cell - (MIDDLE, MIDDLE, LEVEL)))) for cell in stacks
                ):
                    continue
                yield Neighbour(situation, occupant, at, volume.clearance(body, margin, shift), grid, alone)


def shift_of(dx: int, dy: int, dz: int) -> NDArray[np.float64]:
    """Return how far a neighbour is from where :func:`bodies_of` has it, metres."""
    return np.array([dx * CELL_PITCH_M, dy * CELL_PITCH_M, dz * LEVEL_HEIGHT_M])


def _overlaps(start: Solids, body: Solids, shift: NDArray[np.float64]) -> bool:
    return start.clearance(body, -OVERLAP_M, shift) is not None


def bodies_of(occupant: Occupant, machines: Machines) -> tuple[Solids, Solids | None, Solids]:
    """Return the solids of an occupant, of its bearer, and of a block that stands below, on LEVEL of column (0, 0)."""
    parts = (occupant.bearer + occupant.scenery).moved(0, 0, LEVEL).parts(machines)
    n = len(parts) - len(occupant.bearer.things)
    stack = Scenery(((Kind.BLOCK, (0, 0, LEVEL), 0),)).parts(machines)
    own, below, block = (
        [p for part in of for p in convexes_of(part, machines)] for of in (parts[:n], parts[n:], stack)
    )
    return Solids(own), Solids(below) if below else None, Solids(block)
