"""Designs: the cells that a finished building must fill, from a goal file in CraftEnv's format."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Final

import numpy as np

from craftsim.discrete.files.blueprint import MAX_SIDE
from craftsim.discrete.files.documents import Source, parse_keys, read_text
from craftsim.discrete.files.shipped import find
from craftsim.discrete.grid import KINDS_WITH_YAW, Cell, Grid, Kind, beside
from craftsim.storage.limits import DESIGN_CELLS

TARGET_KEYS: Final = {
    "block": Kind.BLOCK,
    "folded_slope": Kind.FSLOPE,
    "unfolded_body": Kind.BODY,
    "unfolded_foot": Kind.FOOT,
}


@dataclass(frozen=True)
class Target:
    """A cell and what it must hold."""

    kind: Kind
    cell: Cell
    line: int | None = None
    """Line of the goal file that lists it."""


@dataclass(frozen=True)
class Design:
    """A checked goal file, or what :meth:`of` makes without one."""

    path: Path
    """The file; of a design without one its name."""
    targets: tuple[Target, ...]

    @classmethod
    def of(
        cls, name: str | Path, blocks: Iterable[Cell] = (), ramps: Iterable[tuple[Cell, int]] = ()
    ) -> Design:
        """Return a design that is in no file.

        Args:
            name: what messages call it.
            blocks: their cells.
            ramps: the cell of the body of each unfolded slope, and its yaw, downhill.

        Raises BlueprintError for two things in one cell, for what lies outside of the largest area, and for more cells
        than a goal file can list.
        """
        slopes = list(islice(ramps, DESIGN_CELLS))
        targets = [
            *(Target(Kind.BLOCK, cell) for cell in islice(blocks, DESIGN_CELLS + 1)),
            *(Target(Kind.BODY, cell) for cell, _ in slopes),
            *(Target(Kind.FOOT, beside(cell, yaw)) for cell, yaw in slopes),
        ]
        source = Source(Path(name))
        if not 0 < len(targets) <= DESIGN_CELLS:
            found = "no cells" if not targets else f"more than {DESIGN_CELLS} cells"
            source.fail(None, f"{found}; allowed: 1 to {DESIGN_CELLS}")
        taken: set[Cell] = set()
        for target in targets:
            x, y, z = target.cell
            if not (0 <= x < MAX_SIDE and 0 <= y < MAX_SIDE and 1 <= z <= MAX_SIDE):
                source.fail(
                    None, f"cell {target.cell} is outside of the largest area, {MAX_SIDE} cells a side"
                )
            if target.cell in taken:
                source.fail(None, f"two things in the cell {target.cell}; allowed: one")
            taken.add(target.cell)
        design = cls(Path(name), tuple(targets))
        for cell, yaw in slopes:
            if design.body_yaw(cell) != yaw:
                other = beside(cell, design.body_yaw(cell))
                source.fail(
                    None,
                    f"the body {cell} has another slope's foot beside it, {other}, as a file would read it",
                )
        return design

    @property
    def size(self) -> Cell:
        """(L, W, H): the smallest area that holds it."""
        x, y, z = (max(target.cell[axis] for target in self.targets) for axis in range(3))
        return x + 1, y + 1, z

    @property
    def floor(self) -> list[Cell]:
        """The cells of targets on the floor: the building's plan."""
        return [target.cell for target in self.targets if target.cell[2] == 1]

    def moved(self, dx: int, dy: int) -> Design:
        """Return the same building somewhere else."""
        places = [(target.cell[0] + dx, target.cell[1] + dy, target.cell[2]) for target in self.targets]
        return replace(
            self, targets=tuple(replace(t, cell=cell) for t, cell in zip(self.targets, places, strict=True))
        )

    def floating(self) -> list[Cell]:
        """Return the cells of targets that have neither ground nor a target block below them."""
        blocks = {*self.of_kind(Kind.BLOCK)}
        return [t.cell for t in self.targets if t.cell[2] > 1 and (*t.cell[:2], t.cell[2] - 1) not in blocks]

    def finished(self, size: Cell | None = None, n_cars: int = 0) -> Grid:
        """Return a world that holds the finished building and nothing else; raises as :meth:`check_fits`."""
        size = size or self.size
        self.check_fits(size)
        grid = Grid.empty(size, n_cars)
        for target in self.targets:
            grid.kind[target.cell] = target.kind
            if target.kind in KINDS_WITH_YAW:
                grid.yaw[target.cell] = max(self.yaw(target), 0)
        grid.derive_marks()
        return grid

    def of_kind(self, kind: Kind) -> list[Cell]:
        """Return the target cells of one kind in the order of the file."""
        return [target.cell for target in self.targets if target.kind == kind]

    def hits(self, grid: Grid) -> Iterator[tuple[Target, bool]]:
        """Yield each target and whether its cell holds its kind with its yaw; what is carried is in no cell."""
        for target in self.targets:
            cell, yaw = target.cell, self.yaw(target)
            within = all(0 <= c < n for c, n in zip(cell, grid.kind.shape, strict=True))
            yield target, bool(within and grid.kind[cell] == target.kind and yaw in (-1, grid.yaw[cell]))

    def satisfied(self, grid: Grid) -> bool:
        """Return whether every target is hit."""
        return all(hit for _, hit in self.hits(grid))

    def body_yaw(self, cell: Cell) -> int:
        """Return the yaw that a target body has: it points to a target foot beside it."""
        feet = self.of_kind(Kind.FOOT)
        for yaw in range(4):
            if beside(cell, yaw) in feet:
                return yaw
        raise KeyError(f"no target foot beside {cell}")

    def yaw(self, target: Target) -> int:
        """Return the yaw that a target must have, a slope's from body to foot; -1 where any will do."""
        if target.kind == Kind.BODY:
            return self.body_yaw(target.cell)
        if target.kind == Kind.FOOT:
            for body in self.of_kind(Kind.BODY):
                if beside(body, self.body_yaw(body)) == target.cell:
                    return self.body_yaw(body)
        return -1

    def check_fits(self, size: Cell) -> None:
        """Raise BlueprintError if a target lies outside an area of size (L, W, H)."""
        for target in self.targets:
            if not all(c < n for c, n in zip(target.cell, (*size[:2], size[2] + 1), strict=True)):
                message = f"target {target.cell} is outside the area of {size} cells"
                Source(self.path).fail(target.line, message)


def design_in(grid: Grid, name: str | Path = "world") -> Design:
    """Return the design of what stands in a world: blocks and slopes, not cars and flags."""
    targets = [
        Target(kind, (x, y, z))
        for kind in TARGET_KEYS.values()
        for x, y, z in np.argwhere(grid.kind == kind).tolist()
    ]
    return Design(Path(name), tuple(targets))


def read_design(path: str | Path) -> Design:
    """Read and check a goal file, or a shipped one by its name, such as ``strip_goal``.

    Raises BlueprintError with file, line and key for anything that is wrong.
    """
    path = find(path, "goals")
    source, keys = parse_keys(path, read_text(path), list(TARGET_KEYS))
    targets: list[Target] = []
    lines: dict[Cell, int] = {}
    for key, kind in TARGET_KEYS.items():
        if key not in keys.items:
            continue
        names = ["x", "y", "z"]
        for i, entry in enumerate(source.entries(keys.items[key], key, ["id", *names], names)):
            x, y, z = (
                source.integer(entry.items[name], f"{key}[{i}].{name}", int(name == "z"), MAX_SIDE)
                for name in names
            )
            cell = (x, y, z)
            if cell in lines:
                taken = f"cell {cell} is a target already, see line {lines[cell]}"
                source.fail(entry.line, f"key '{key}[{i}]': {taken}")
            lines[cell] = entry.line
            targets.append(Target(kind, cell, entry.line))
    if not targets:
        source.fail(None, f"no targets; allowed: at least one entry in {', '.join(TARGET_KEYS)}")
    design = Design(path, tuple(targets))
    for body in design.of_kind(Kind.BODY):
        try:
            design.body_yaw(body)
        except KeyError:
            source.fail(lines[body], f"key 'unfolded_body': no entry of 'unfolded_foot' beside {body}")
    return design
