"""Designs: the cells that a finished building must fill, from a goal file in CraftEnv's format."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from craftsim.discrete.files.blueprint import MAX_SIDE
from craftsim.discrete.files.documents import Source, parse_keys, read_text
from craftsim.discrete.files.shipped import find
from craftsim.discrete.grid import Cell, Grid, Kind, beside

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
    line: int
    """Line of the goal file that lists it."""


@dataclass(frozen=True)
class Design:
    """A checked goal file."""

    path: Path
    targets: tuple[Target, ...]

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
