"""One car builds a design in a given order by the physical rules: a witness that it can be built.

Each thing is fetched from where a search over the car's poses finds one that it can bring. Nothing is moved aside, and
other cars are left out.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator

from craftsim.discrete.grid import Cell, Grid, Kind, Piece
from craftsim.discrete.kinds import Action
from craftsim.discrete.rules import Rules

RULES = Rules("physical")
DRIVING = [int(action) for action in Action if action.name.startswith(("MOVE_", "ROTATE"))][:6]


def poses(grid: Grid) -> Iterator[tuple[int, ...]]:
    """Yield the poses that car 0 can drive to as it is, the nearest first; the grid shows each while it is yielded."""
    row = grid.cars[0]
    start = tuple(row.tolist())
    seen, waiting = {start}, deque([start])
    while waiting:
        pose = waiting.popleft()
        row[:] = pose
        yield pose
        for action in DRIVING:
            row[:] = pose
            if RULES.legal(grid, 0, action):
                after = tuple(RULES.enforce(grid, 0, action).cars[0].tolist())
                if after not in seen:
                    seen.add(after)
                    waiting.append(after)
    row[:] = start


def do(grid: Grid, *actions: Action) -> bool:
    """Let car 0 act in place; return whether the rules let it."""
    for action in actions:
        after, applied = RULES.tick(grid, [(0, action)])
        grid.cells[:], grid.cars[:] = after.cells, after.cars
        if not applied[0]:
            return False
    return True


def bring(grid: Grid, step: Piece, done: set[Cell]) -> Grid | None:
    """Return the world after car 0 has put a block, or a slope that it unfolds, where a step says, or None."""
    slope = step.kind == Kind.BODY
    kind = Kind.FSLOPE if slope else Kind.BLOCK
    for pose in poses(grid):
        if grid.kind[pose[:3]] != kind or pose[:3] in done:
            continue
        loaded = grid.copy()
        loaded.cars[0] = pose
        if not do(loaded, Action.LIFT):
            continue
        for place in poses(loaded):
            if place[:3] != step.cell or place[3] not in step.yaws:
                continue
            after = loaded.copy()
            after.cars[0] = place
            if do(after, Action.DROP, *([Action.UNFOLD] if slope else [])):
                return after
    return None


def build(start: Grid, steps: tuple[Piece, ...]) -> tuple[Grid, int]:
    """Return the world after as many steps as one car can do, and how many these are."""
    grid = start.copy()
    grid.cars = grid.cars[:1].copy()
    grid.derive_marks()
    done: set[Cell] = set()
    for i, step in enumerate(steps):
        after = bring(grid, step, done)
        if after is None:
            return grid, i
        grid = after
        done.add(step.cell)
    grid.derive_marks()
    return grid, len(steps)
