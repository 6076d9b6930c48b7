"""The colours of machines and things in films, pictures and plots, and worlds as coloured text, level by level."""

from __future__ import annotations

from typing import Final

import numpy as np
from rich.color import Color
from rich.style import Style
from rich.text import Text

from craftsim.discrete.grid import CarField, Cell, Grid, Kind, cell_of
from craftsim.discrete.kinds import KINDS

Rgb = tuple[float, float, float]
"""Red, green, blue, each 0..1."""

_CAR_COLOURS: Final[tuple[Rgb, ...]] = (
    (0.80, 0.24, 0.22),
    (0.16, 0.47, 0.72),
    (0.20, 0.58, 0.32),
    (0.56, 0.33, 0.66),
    (0.88, 0.50, 0.12),
    (0.10, 0.60, 0.62),
    (0.72, 0.30, 0.50),
    (0.45, 0.42, 0.16),
)
"""Colours of the cars; car ids beyond the last start over."""

KIND_COLOURS: Final[dict[Kind, Rgb]] = {kind: spec.colour for kind, spec in KINDS.items()}
"""Colours by kind; machines as their MJCF colours them, an unfolded slope's two cells as its base and its flap."""

TRIM: Final[Rgb] = (0.45, 0.32, 0.20)
"""The edges of a block."""
FLAG_POST: Final[Rgb] = (0.88, 0.84, 0.76)
"""The column under a flag."""
TYRE_COLOUR: Final[Rgb] = (0.13, 0.13, 0.14)
GOAL: Final[Rgb] = (0.10, 0.55, 0.25)
"""Goal cells and designs; darker than in films, where it is seen through."""
INK: Final[Rgb] = (0.15, 0.15, 0.16)
LINE: Final[Rgb] = (0.74, 0.74, 0.73)
"""Between cells."""

ARROWS: Final = "→↑←↓"
"""Signs of the yaws 0..3, with x to the right and y up."""


LEGEND: Final = (
    "[] block  |> flag  ## wall  S folded slope, g its gear  B body and f foot of a slope\n"
    "0→ car 0 facing +x, then b, f or s for what it carries  * goal  x to the right, y up"
)


def car_colour(car: int) -> Rgb:
    """Return the colour of a car."""
    return _CAR_COLOURS[car % len(_CAR_COLOURS)]


def cars_by_cell(grid: Grid) -> dict[Cell, list[int]]:
    """Return the ids of the cars in each cell that has any."""
    cells: dict[Cell, list[int]] = {}
    for car in range(grid.n_cars):
        cells.setdefault(cell_of(grid, car), []).append(car)
    return cells


def _cell_text(grid: Grid, cell: Cell, cars: list[int], goal: bool) -> Text:
    kind = grid.kind_at(cell)
    sign = KINDS[kind].sign
    if len(sign) == 1:
        sign += ARROWS[grid.yaw[cell]]
    text = Text(sign, KINDS[kind].style)
    for car in cars:
        row = grid.cars[car]
        colour = Color.from_rgb(*(255 * component for component in car_colour(car)))
        load = KINDS[Kind(row[CarField.LOAD])].letter
        text.append(f"{car}{ARROWS[row[CarField.YAW]]}{load}", Style(bold=True, color=colour))
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
        cells = []
        for y in range(width):
            row = []
            for x in range(length):
                cell = (x, y, z)
                row.append(_cell_text(grid, cell, cars.get(cell, []), goal == cell))
            cells.append(row)
        columns = []
        for x in range(length):
            columns.append(max(len(cells[y][x]) for y in range(width)))
        for y in range(width - 1, -1, -1):
            text.append(f"{y:>3} ", "dim")
            for x in range(length):
                drawn_cell = cells[y][x]
                drawn_cell.pad_right(columns[x] - len(drawn_cell))
                text.append_text(drawn_cell)
                text.append(" ")
            text.append("\n")
        text.append("    " + " ".join(f"{x:<{columns[x]}}" for x in range(length)) + "\n", "dim")
    return text
