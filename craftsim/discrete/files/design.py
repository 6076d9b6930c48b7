"""Designs: the cells that a finished building must fill, from a goal file in CraftEnv's format."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path
from typing import Annotated, Any, Final, NoReturn

from craftsim.discrete.files.shipped import find_file
from craftsim.discrete.grid import MAX_SIDE, Cell, Grid, Kind, Piece, beside
from craftsim.errors import BlueprintError
from craftsim.storage.limits import DESIGN_CELLS, Range
from craftsim.storage.records import Loc, key_words, record
from craftsim.storage.yaml import dump, read_document

_TARGET_KEYS: Final = {
    "block": Kind.BLOCK,
    "folded_slope": Kind.FSLOPE,
    "unfolded_body": Kind.BODY,
    "unfolded_foot": Kind.FOOT,
}
ANY_YAW: Final = -1


@dataclass(frozen=True)
class Design:
    """A checked goal file, or what :meth:`of` makes without one."""

    path: Path
    """The file; of a design without one its name."""
    targets: tuple[Piece, ...]
    """Single cells, bodies and feet apart, with what each must hold; the yaw is ANY_YAW where any will do."""
    lines: tuple[int, ...] = field(default=(), compare=False, repr=False)
    """Lines of the targets in the file."""

    @classmethod
    def of(
        cls, name: str | Path, blocks: Iterable[Cell] = (), ramps: Iterable[tuple[Cell, int]] = ()
    ) -> Design:
        """Return a design that is in no file, of blocks in some cells and ramps, each the cell of its body and its yaw.

        Raises BlueprintError for two things in one cell, for what lies outside of the largest area, and for more cells
        than a goal file can list.
        """

        def fail(message: str) -> NoReturn:
            raise BlueprintError(f"{name}: {message}")

        slopes = list(islice(ramps, DESIGN_CELLS))
        places = [
            *((Kind.BLOCK, cell) for cell in islice(blocks, DESIGN_CELLS + 1)),
            *((Kind.BODY, cell) for cell, _ in slopes),
            *((Kind.FOOT, beside(cell, yaw)) for cell, yaw in slopes),
        ]
        if not 0 < len(places) <= DESIGN_CELLS:
            number = "no cells"
            if places:
                number = f"more than {DESIGN_CELLS} cells"
            fail(f"{number}; allowed: 1 to {DESIGN_CELLS}")
        filled: set[Cell] = set()
        for _, cell in places:
            x, y, z = cell
            if not (0 <= x < MAX_SIDE and 0 <= y < MAX_SIDE and 1 <= z <= MAX_SIDE):
                fail(f"cell {cell} is outside of the largest area, {MAX_SIDE} cells a side")
            if cell in filled:
                fail(f"two things in the cell {cell}; allowed: one")
            filled.add(cell)
        targets = _turned(places)
        yaws = {target.cell: target.yaw for target in targets}
        for cell, yaw in slopes:
            if yaws[cell] != yaw:
                neighbour = beside(cell, yaws[cell])
                fail(
                    f"the body {cell} has another slope's foot beside it, {neighbour}, as a file would read it"
                )
        return cls(Path(name), targets)

    @property
    def size(self) -> Cell:
        """(L, W, H): the smallest area that holds it."""
        x, y, z = (max(target.cell[axis] for target in self.targets) for axis in range(3))
        return x + 1, y + 1, z

    @property
    def floor(self) -> list[Cell]:
        """The cells of targets on the floor: the building's plan."""
        return [target.cell for target in self.targets if target.cell[2] == 1]

    @property
    def content(self) -> dict[str, Any]:
        """The targets as JSON, independent of the file, for digests."""
        return {
            "targets": [{"kind": target.kind.name, "cell": target.cell} for target in self.targets]
        }

    def moved(self, dx: int, dy: int) -> Design:
        """Return the same building somewhere else."""
        moved = ((kind, (x + dx, y + dy, z), yaw) for kind, (x, y, z), yaw in self.targets)
        return replace(self, targets=tuple(map(Piece._make, moved)))

    def floating(self) -> list[Cell]:
        """Return the cells of targets that have neither ground nor a target block below them."""
        blocks = {*self.of_kind(Kind.BLOCK)}
        floating = []
        for target in self.targets:
            x, y, z = target.cell
            if z > 1 and (x, y, z - 1) not in blocks:
                floating.append(target.cell)
        return floating

    def finished(self, size: Cell | None = None) -> Grid:
        """Return a world that holds the finished building and nothing else; raises as :meth:`check_fits`."""
        size = size or self.size
        self.check_fits(size)
        grid = Grid.empty(size)
        for kind, cell, yaw in self.targets:
            grid.kind[cell] = kind
            grid.yaw[cell] = max(yaw, 0)
        grid.derive_marks()
        return grid

    def of_kind(self, kind: Kind) -> list[Cell]:
        """Return the target cells of one kind in the order of the file."""
        return [target.cell for target in self.targets if target.kind == kind]

    def hits(self, grid: Grid) -> Iterator[tuple[Piece, bool]]:
        """Yield each target and whether its cell holds its kind with its yaw; what is carried is in no cell."""
        for kind, cell, yaw in self.targets:
            hit = grid.inside(cell) and grid.kind[cell] == kind and yaw in (ANY_YAW, grid.yaw[cell])
            yield Piece(kind, cell, yaw), bool(hit)

    def satisfied(self, grid: Grid) -> bool:
        """Return whether every target is hit."""
        return all(hit for _, hit in self.hits(grid))

    def check_fits(self, size: Cell) -> None:
        """Raise BlueprintError if a target lies outside an area of size (L, W, H)."""
        for i, target in enumerate(self.targets):
            if not all(c < n for c, n in zip(target.cell, (*size[:2], size[2] + 1), strict=True)):
                if self.lines:
                    source = f"{self.path}:{self.lines[i]}"
                else:
                    source = str(self.path)
                raise BlueprintError(
                    f"{source}: target {target.cell} is outside the area of {size} cells"
                )


def _turned(places: Sequence[tuple[Kind, Cell]]) -> tuple[Piece, ...]:
    """Return the targets: a body points to the first foot beside it, and that has its yaw."""
    feet = {cell for kind, cell in places if kind == Kind.FOOT}
    yaws: dict[Cell, int] = {}
    for kind, cell in places:
        if kind == Kind.BODY:
            for yaw in range(4):
                foot = beside(cell, yaw)
                if foot in feet:
                    yaws[cell] = yaw
                    yaws.setdefault(foot, yaw)
                    break
    return tuple(Piece(kind, cell, yaws.get(cell, ANY_YAW)) for kind, cell in places)


def design_in(grid: Grid, name: str | Path = "world") -> Design:
    """Return the design of what stands in a world: blocks and slopes, not cars and flags."""
    places = []
    for kind in _TARGET_KEYS.values():
        for piece in grid.pieces(kind):
            places.append((kind, piece.cell))
    return Design(Path(name), _turned(places))


@record(kw_only=True)
class _Entry:
    id: Any = None
    x: Annotated[int, Range(0, MAX_SIDE)]
    y: Annotated[int, Range(0, MAX_SIDE)]
    z: Annotated[int, Range(1, MAX_SIDE)]


@record(kw_only=True)
class _File:
    block: tuple[_Entry, ...] | None = None
    folded_slope: tuple[_Entry, ...] | None = None
    unfolded_body: tuple[_Entry, ...] | None = None
    unfolded_foot: tuple[_Entry, ...] | None = None


def read_design(path: str | Path) -> Design:
    """Read and check a goal file, or a shipped one by its name, such as ``strip_goal``.

    Raises BlueprintError with file, line and key for anything that is wrong.
    """
    document = read_document(find_file(path, "goals"), BlueprintError)
    file = document.to(_File)
    places: dict[Cell, tuple[Kind, Loc]] = {}
    for key, kind in _TARGET_KEYS.items():
        for i, entry in enumerate(getattr(file, key) or ()):
            cell = (entry.x, entry.y, entry.z)
            loc = (key, i)
            if cell in places:
                line = document.lines[places[cell][1]]
                document.fail(
                    loc, f"{key_words(loc)}: cell {cell} is a target already, see line {line}"
                )
            places[cell] = kind, loc
    if not places:
        document.fail((), f"no targets; allowed: at least one entry in {', '.join(_TARGET_KEYS)}")
    targets = _turned([(kind, cell) for cell, (kind, _) in places.items()])
    for target in targets:
        if target.kind == Kind.BODY and target.yaw == ANY_YAW:
            missing = f"key 'unfolded_body': no entry of 'unfolded_foot' beside {target.cell}"
            document.fail(places[target.cell][1], missing)
    lines = tuple(document.lines[loc] for _, loc in places.values())
    return Design(document.path, targets, lines)


def design_text(design: Design) -> str:
    """Return the text of a design's goal file."""
    lists = {}
    for key, kind in _TARGET_KEYS.items():
        lists[key] = [
            {"id": i, "x": x, "y": y, "z": z} for i, (x, y, z) in enumerate(design.of_kind(kind))
        ]
    return dump({key: entries for key, entries in lists.items() if entries})
