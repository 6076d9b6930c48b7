"""Small worlds, drawn in a line of code, for tests of any room."""

from collections.abc import Sequence

from craftsim.discrete.grid import KINDS_WITH_YAW, SECOND_PART, Grid, beside


def draw(size, objects: Sequence[tuple] = (), cars: Sequence[Sequence[int]] = ()) -> Grid:
    """Return a Grid of objects (kind, cell, yaw if any; a slope by its first cell) and cars (rows of Grid.cars)."""
    grid = Grid.empty(size, len(cars))
    for row, values in zip(grid.cars, cars, strict=True):
        row[: len(values)] = values
    for kind, cell, *yaw in objects:
        parts = [(kind, cell)]
        if kind in SECOND_PART:
            parts.append((SECOND_PART[kind], beside(cell, *yaw)))
        for part, where in parts:
            grid.kind[where] = part
            grid.yaw[where] = yaw[0] if kind in KINDS_WITH_YAW else 0
    grid.derive_marks()
    return grid
