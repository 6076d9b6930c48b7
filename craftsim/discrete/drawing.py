"""Worlds as coloured text and as pictures, level by level."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray
from rich.text import Text

from craftsim.discrete.geometry import DIRECTIONS
from craftsim.discrete.grid import CarField, Cell, Grid, Kind

ARROWS: Final = "→↑←↓"
"""Signs of the yaws 0..3, with x to the right and y up."""

SIGNS: Final = {
    Kind.AIR: " .",
    Kind.GROUND: "__",
    Kind.WALL: "##",
    Kind.BLOCK: "[]",
    Kind.FLAG: "|>",
    Kind.FSLOPE: "S",
    Kind.GEAR: "g",
    Kind.BODY: "B",
    Kind.FOOT: "f",
}
"""How the text shows each kind; those with a yaw are followed by its arrow."""

STYLES: Final = {
    Kind.AIR: "dim",
    Kind.GROUND: "dim",
    Kind.WALL: "white on grey37",
    Kind.BLOCK: "yellow",
    Kind.FLAG: "bold red",
    Kind.FSLOPE: "cyan",
    Kind.GEAR: "cyan",
    Kind.BODY: "bold cyan",
    Kind.FOOT: "bold cyan",
}

CAR_STYLE: Final = "bold green"
LOAD_LETTERS: Final = {Kind.BLOCK: "b", Kind.FLAG: "f", Kind.FSLOPE: "s"}

LEGEND: Final = (
    "[] block  |> flag  ## wall  S folded slope, g its gear  B body and f foot of a slope\n"
    "0→ car 0 facing +x, then b, f or s for what it carries  * goal  x to the right, y up"
)


def cars_by_cell(grid: Grid) -> dict[Cell, list[int]]:
    """Return the ids of the cars in each cell that has any."""
    cells: dict[Cell, list[int]] = {}
    for car, row in enumerate(grid.cars):
        cells.setdefault((int(row[CarField.X]), int(row[CarField.Y]), int(row[CarField.Z])), []).append(car)
    return cells


def _cell_text(grid: Grid, cell: Cell, cars: list[int], goal: bool) -> Text:
    kind = grid.kind_at(cell)
    sign = SIGNS[kind]
    if len(sign) == 1:
        sign += ARROWS[grid.yaw[cell]]
    text = Text(sign, STYLES[kind])
    for car in cars:
        row = grid.cars[car]
        text.append(f"{car}{ARROWS[row[CarField.YAW]]}{LOAD_LETTERS.get(row[CarField.LOAD], '')}", CAR_STYLE)
    if goal:
        text.append("*", "bold magenta")
    return text


def world_text(grid: Grid, goal: Cell | None = None) -> Text:
    """Return the levels of a world from the top down, y up and x to the right, without empty levels."""
    length, width, height = grid.size
    cars = cars_by_cell(grid)
    text = Text()
    for z in range(height + 1, 0, -1):
        empty = z > height or not np.any(grid.kind[:, :, z])
        if z > 1 and empty and not any(cell[2] == z for cell in cars):
            continue
        text.append(f"level {z}\n", "bold")
        cells = [
            [_cell_text(grid, (x, y, z), cars.get((x, y, z), []), goal == (x, y, z)) for x in range(length)]
            for y in range(width)
        ]
        columns = [max(len(cells[y][x]) for y in range(width)) for x in range(length)]
        for y in range(width - 1, -1, -1):
            text.append(f"{y:>3} ", "dim")
            for x in range(length):
                cell = cells[y][x]
                cell.pad_right(columns[x] - len(cell))
                text.append_text(cell)
                text.append(" ")
            text.append("\n")
        text.append("    " + " ".join(f"{x:<{columns[x]}}" for x in range(length)) + "\n", "dim")
    return text


COLOURS: Final = {
    Kind.AIR: (236, 236, 232),
    Kind.GROUND: (236, 236, 232),
    Kind.WALL: (90, 90, 90),
    Kind.BLOCK: (222, 170, 80),
    Kind.FLAG: (205, 60, 60),
    Kind.FSLOPE: (110, 180, 200),
    Kind.GEAR: (170, 210, 220),
    Kind.BODY: (50, 120, 160),
    Kind.FOOT: (110, 180, 200),
}
"""RGB of each kind in pictures."""

CAR_COLOUR: Final = (40, 140, 70)
GOAL_COLOUR: Final = (190, 60, 190)
CELL_PX: Final = 48
_LINE: Final = (200, 200, 196)


def world_image(grid: Grid, goal: Cell | None = None) -> NDArray[np.uint8]:
    """Return a picture (height, width, 3), RGB, of all levels side by side, the floor level at the left.

    A car is a green disc with a nose, its load a square on it; yaws of slopes are wedges that point downhill.
    """
    length, width, height = grid.size
    cars = cars_by_cell(grid)
    levels = [z for z in range(1, height + 2) if z <= height or any(cell[2] == z for cell in cars)]
    gap = CELL_PX // 2
    image = np.full(
        (width * CELL_PX + 2 * gap, len(levels) * (length * CELL_PX + gap) + gap, 3), 255, np.uint8
    )
    for column, z in enumerate(levels):
        for x in range(length):
            for y in range(width):
                left = gap + column * (length * CELL_PX + gap) + x * CELL_PX
                top = gap + (width - 1 - y) * CELL_PX
                tile = image[top : top + CELL_PX, left : left + CELL_PX]
                _paint_cell(tile, grid, (x, y, z), cars.get((x, y, z), []), goal == (x, y, z))
    return image


def _paint_cell(tile: NDArray[np.uint8], grid: Grid, cell: Cell, cars: list[int], goal: bool) -> None:
    """Paint one cell; u and v run from -1 to 1 over the tile, to the right and up."""
    kind = grid.kind_at(cell)
    u = np.linspace(-1, 1, CELL_PX)[None, :]
    v = np.linspace(1, -1, CELL_PX)[:, None]
    tile[:] = COLOURS[kind]
    if kind in (Kind.FSLOPE, Kind.GEAR, Kind.BODY, Kind.FOOT):
        dx, dy = DIRECTIONS[grid.yaw[cell]]
        along, across = u * dx + v * dy, np.abs(u * dy - v * dx)
        tile[(along < 0.6) & (along > -0.2) & (across < 0.6 - along)] = 255
    if goal:
        tile[(np.abs(u) > 0.85) | (np.abs(v) > 0.85)] = GOAL_COLOUR
    for car in cars:
        row = grid.cars[car]
        dx, dy = DIRECTIONS[row[CarField.YAW]]
        tile[u * u + v * v < 0.3] = CAR_COLOUR
        tile[(np.abs(u - 0.6 * dx) < 0.16) & (np.abs(v - 0.6 * dy) < 0.16)] = CAR_COLOUR
        if row[CarField.LOAD] != Kind.AIR:
            tile[(np.abs(u) < 0.25) & (np.abs(v) < 0.25)] = COLOURS[Kind(row[CarField.LOAD])]
    tile[0, :] = tile[:, 0] = _LINE
