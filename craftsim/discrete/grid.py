"""The state of grid worlds as integer arrays: one world, or with a leading axis many."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from craftsim.compiled.jit import seldom
from craftsim.discrete.geometry import DIRECTIONS
from craftsim.discrete.kernel.state import NO_PATTERNS, Patterns, World, derive_marks
from craftsim.discrete.kinds import CARRIED, NAMES, CarField, CellField, Kind
from craftsim.errors import InputError

KINDS_WITH_YAW: Final = (Kind.FSLOPE, Kind.GEAR, Kind.BODY, Kind.FOOT)

SECOND_PART: Final = {Kind.FSLOPE: Kind.GEAR, Kind.BODY: Kind.FOOT}
"""Kind in the next cell of a slope, in direction of its yaw."""

_MOVABLE: Final = (*CARRIED, Kind.BODY)
"""Kinds that cars can move, an unfolded slope once it is folded."""

_LOADS: Final = (Kind.AIR, *CARRIED)
_LOAD_NAMES: Final = (
    f"{', '.join(NAMES[load] for load in _LOADS[:-1])} or {NAMES[_LOADS[-1]]} "
    f"({', '.join(str(int(load)) for load in _LOADS)})"
)

MAX_SIDE: Final = 128
MAX_CELLS: Final = 131_072
MAX_CARS: Final = 256

_derive_marks = seldom(derive_marks)
_STEPS: Final = DIRECTIONS.tolist()

Cell = tuple[int, int, int]
"""(x, y, z)."""
CarRow = tuple[int, ...]
"""A row of :attr:`Grid.cars`."""

FILE_DTYPES: Final[dict[str, Any]] = {
    "kind": np.int8,
    "yaw": np.int8,
    "cars": np.int64,
    "top": np.int16,
    "back": np.bool_,
}
"""Arrays of a grid in files, see :meth:`Grid.to_arrays`."""


def beside(cell: Cell, yaw: int) -> Cell:
    """Return the next cell in direction yaw (any integer, taken modulo 4)."""
    dx, dy = _STEPS[yaw % 4]
    return cell[0] + dx, cell[1] + dy, cell[2]


def cell_of(grid: Grid, car: int) -> Cell:
    """Return the cell of a car of a single world."""
    x, y, z = grid.cars[car, : CarField.YAW].tolist()
    return x, y, z


class Piece(NamedTuple):
    """A thing in a cell: a wall, a block, a flag, a folded slope or, as BODY, an unfolded one."""

    kind: Kind
    cell: Cell
    yaw: int = 0
    """Direction of a slope: from its cell to that of its second part, downhill."""

    @property
    def cells(self) -> tuple[Cell, ...]:
        """The cells that it takes."""
        if self.kind in SECOND_PART:
            return self.cell, beside(self.cell, self.yaw)
        return (self.cell,)

    @property
    def kinds(self) -> tuple[Kind, ...]:
        """The kinds in these cells."""
        if self.kind in SECOND_PART:
            return self.kind, SECOND_PART[self.kind]
        return (self.kind,)

    @property
    def yaws(self) -> tuple[int, ...]:
        """The headings of a car below it: a slope's car heads uphill, half a turn from where it points."""
        if self.kind in SECOND_PART:
            return ((self.yaw + 2) % 4,)
        return 0, 1, 2, 3

    @property
    def load(self) -> Kind:
        """The kind of load that it is on a car."""
        if self.kind == Kind.BODY:
            return Kind.FSLOPE
        return self.kind


@dataclass(eq=False)
class Grid:
    """One world, or a batch of B with a leading axis: what is in each cell, the marks kept with it, and the cars.

    Cells are (x, y, z) with 0 <= x < L, 0 <= y < W and 0 <= z <= H; z = 0 is the ground layer, 1 the floor.

    Example:
        >>> import craftsim
        >>> grid = craftsim.Grid.empty((3, 2, 1), n_cars=1)  # the car at (0, 0, 1), heading +x
        >>> grid.kind[1, 0, 1] = craftsim.Kind.BLOCK
        >>> grid.derive_marks()
        >>> grid.size, grid.n_cars
        ((3, 2, 1), 1)
    """

    cells: NDArray[np.int16]
    """(..., L, W, H + 1, 4): fields as CellField."""
    cars: NDArray[np.int16]
    """(..., n, 7): one row a car, columns as CarField."""

    @classmethod
    def empty(cls, size: Cell, n_cars: int = 0) -> Self:
        """Return a world of size (L, W, H) with bare ground; its cars wait to be placed, all at (0, 0, 1).

        Raises InputError for a size below 1.
        """
        length, width, height = size
        if min(size) < 1:
            raise InputError(
                f"the size of a grid is {size}; allowed: 1 or more cells along each axis"
            )
        grid = cls(
            np.zeros((length, width, height + 1, len(CellField)), np.int16),
            np.zeros((n_cars, len(CarField)), np.int16),
        )
        grid.kind[:, :, 0] = Kind.GROUND
        grid.occupant[:] = -1
        grid.cars[:, CarField.Z] = 1
        return grid

    @classmethod
    def stack(cls, grids: Sequence[Grid]) -> Self:
        """Return a batch of copies of single worlds of one size and number of cars."""
        return cls(
            np.stack([grid.cells for grid in grids]), np.stack([grid.cars for grid in grids])
        )

    @property
    def kind(self) -> NDArray[np.int16]:
        """(..., L, W, H + 1): a Kind per cell; a view."""
        return self.cells[..., CellField.KIND]

    @property
    def yaw(self) -> NDArray[np.int16]:
        """(..., L, W, H + 1): 0..3 for kinds that have a yaw, else 0; a view."""
        return self.cells[..., CellField.YAW]

    @property
    def occupant(self) -> NDArray[np.int16]:
        """(..., L, W, H + 1): the mark "what is on me": -1 nothing, -2 an object, k >= 0 car k; a view."""
        return self.cells[..., CellField.OCCUPANT]

    @property
    def landing(self) -> NDArray[np.int16]:
        """(..., L, W, H + 1): the mark "I am the landing of a ramp", 0 or 1; a view."""
        return self.cells[..., CellField.LANDING]

    @property
    def size(self) -> Cell:
        """(L, W, H) in cells; H does not count the ground layer."""
        length, width, layers, _ = self.cells.shape[-4:]
        return length, width, layers - 1

    @property
    def n_cars(self) -> int:
        """Number of cars."""
        return self.cars.shape[-2]

    def __len__(self) -> int:
        """Return the number of worlds of a batch."""
        if self.cells.ndim == 4:
            raise TypeError("this is a single world, not a batch")
        return len(self.cells)

    def __bool__(self) -> bool:
        """Return that there is a world, or a batch of them, whatever its length."""
        return True

    def __getitem__(self, which: Any) -> Self:
        """Return a world of a batch, or some of them; a view where NumPy gives one."""
        return type(self)(self.cells[which], self.cars[which])

    def kind_at(self, cell: Cell) -> Kind:
        """Return what is in a cell of the map, or above the map, where there is air and a car may be."""
        if cell[2] <= self.size[2]:
            return Kind(self.cells[cell][CellField.KIND])
        return Kind.AIR

    def inside(self, cell: Cell) -> bool:
        """Return whether a cell is one of the map, the ground layer included."""
        return all(0 <= c < n for c, n in zip(cell, self.cells.shape[-4:-1], strict=True))

    def put(self, piece: Piece) -> None:
        """Put a thing into a single world, its cells without marks; a gear gives way to what stands."""
        self.cells[piece.cell] = (piece.kind, piece.yaw, -1, 0)
        for cell, kind in zip(piece.cells[1:], piece.kinds[1:], strict=True):
            if self.inside(cell) and (
                kind == Kind.FOOT or self.kind[cell] in (Kind.AIR, Kind.GEAR)
            ):
                self.cells[cell] = (kind, piece.yaw, -1, 0)

    def take(self, cell: Cell) -> Piece:
        """Take what is in a cell of a single world out of it, with its second part, and return it."""
        piece = self._piece(cell)
        for covered in piece.cells:
            if covered == cell or (
                self.inside(covered) and self.kind[covered] in SECOND_PART.values()
            ):
                self.kind[covered] = Kind.AIR
                self.yaw[covered] = 0
        return piece

    def pieces(self, *kinds: Kind) -> Iterator[Piece]:
        """Yield the things of some kinds in a single world, of all that can be moved unless given, by their cells."""
        chosen = np.zeros(len(Kind), np.bool_)
        chosen[list(kinds or _MOVABLE)] = True
        for x, y, z in np.argwhere(chosen[self.kind]).tolist():
            yield self._piece((x, y, z))

    def _piece(self, cell: Cell) -> Piece:
        kind = Kind(self.kind[cell])
        if kind in KINDS_WITH_YAW:
            return Piece(kind, cell, int(self.yaw[cell]))
        return Piece(kind, cell)

    def copy(self) -> Self:
        """Return a world that shares nothing with this one."""
        return type(self)(self.cells.copy(), self.cars.copy())

    def world(self, corrections: int = 0, patterns: Patterns = NO_PATTERNS) -> World:
        """Return the world for compiled code; it shares the arrays."""
        return World(self.cells, self.cars, int(corrections), patterns)

    def derive_marks(self) -> None:
        """Overwrite both marks with what follows from the visible state."""
        if self.cells.ndim == 4:
            _derive_marks(World(self.cells, self.cars, 0, NO_PATTERNS))
            return
        for cells, cars in zip(self.cells, self.cars, strict=True):
            _derive_marks(World(cells, cars, 0, NO_PATTERNS))

    def same_visible(self, grid: Grid) -> bool:
        """Return whether objects and cars are equal; marks are not compared."""
        mine = self.cells[..., : CellField.OCCUPANT]
        theirs = grid.cells[..., : CellField.OCCUPANT]
        return np.array_equal(mine, theirs) and np.array_equal(self.cars, grid.cars)

    def same_marks(self, grid: Grid) -> bool:
        """Return whether both marks are equal in every cell."""
        mine = self.cells[..., CellField.OCCUPANT :]
        theirs = grid.cells[..., CellField.OCCUPANT :]
        return np.array_equal(mine, theirs)

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Return copies of the arrays as files have them, by name: kind, yaw, cars, top and back (FILE_DTYPES)."""
        arrays = (self.kind, self.yaw, self.cars, self.occupant, self.landing)
        return {
            name: array.astype(dtype)
            for (name, dtype), array in zip(FILE_DTYPES.items(), arrays, strict=True)
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> Self:
        """Return the grid of arrays as :meth:`to_arrays` gives them; InputError for those not of small integers."""
        for name in FILE_DTYPES:
            array = arrays[name]
            if array.dtype.kind not in "biu":
                raise InputError(f"the array '{name}' holds {array.dtype}; allowed: integers")
            odd = array[np.abs(array.astype(np.int64)) > np.iinfo(np.int16).max]
            if odd.size:
                raise InputError(f"the array '{name}' holds {odd.flat[0]}; allowed: at most 32767")
        fields = [arrays[name] for name in ("kind", "yaw", "top", "back")]
        return cls(
            np.stack(fields, axis=-1).astype(np.int16),
            np.ascontiguousarray(arrays["cars"], np.int16),
        )


_empty: Final = lru_cache(256)(Grid.empty)
"""A survey makes tens of thousands of worlds, of few sizes."""


def grid_of(pieces: Iterable[Piece], cars: Collection[CarRow], size: Cell) -> Grid:
    """Return the grid of pieces and cars.

    A gear is left out if its cell is occupied; of two gears in a cell the one with the smaller yaw is kept.
    """
    grid = _empty(size, len(cars)).copy()
    if cars:
        grid.cars[:] = list(cars)
    filled: dict[Cell, tuple[int, int]] = {}
    for kind, cell, yaw in sorted(
        pieces, key=lambda piece: (piece.kind == Kind.FSLOPE, -piece.yaw)
    ):
        filled[cell] = (int(kind), yaw)
        second = SECOND_PART.get(kind)
        if second is not None:
            next_cell = beside(cell, yaw)
            gives_way = second == Kind.GEAR and filled.get(next_cell, (Kind.GEAR,))[0] != Kind.GEAR
            if not gives_way and grid.inside(next_cell):
                filled[next_cell] = (int(second), yaw)
    rows = np.array(
        [(*cell, *kind_and_yaw) for cell, kind_and_yaw in filled.items()], np.int16
    ).reshape(-1, 5)
    x, y, z, *_ = rows.T
    grid.cells[x, y, z, :2] = rows[:, 3:]
    grid.derive_marks()
    return grid


def turn_cell(cell: Cell, quarters: int) -> Cell:
    """Return a cell turned counterclockwise about the column (0, 0)."""
    x, y, z = cell
    for _ in range(quarters % 4):
        before = x
        x = -y
        y = before
    return x, y, z


def check_size(size: Cell, n_cars: int) -> None:
    """Raise InputError for a map that is larger than any blueprint's, or has none of its cells, or too many cars."""
    if not all(1 <= side <= MAX_SIDE for side in size) or size[0] * size[1] * size[2] > MAX_CELLS:
        raise InputError(
            f"the size is {tuple(size)}; allowed: 1 to {MAX_SIDE} each way, and at most {MAX_CELLS} cells"
        )
    if n_cars > MAX_CARS:
        raise InputError(f"{n_cars} cars; allowed: at most {MAX_CARS}")


def check_grid(grid: Grid) -> None:
    """Raise InputError, with cell or car and what is allowed, for arrays that are not those of a single world.

    The compiled rules look up what arrays hold and check nothing. What play may lead to need not make sense, and is not
    checked for it: two cars in a cell, half a slope, old marks.
    """
    for name, array in ("cells", grid.cells), ("cars", grid.cars):
        if not isinstance(array, np.ndarray) or array.dtype != np.int16:
            if isinstance(array, np.ndarray):
                dtype = array.dtype
            else:
                dtype = type(array).__name__
            raise InputError(f"the array '{name}' holds {dtype}; allowed: int16")
    cells = grid.cells.shape
    cars = grid.cars.shape
    if (len(cells), len(cars), cells[-1], cars[-1]) != (4, 2, len(CellField), len(CarField)):
        raise InputError(
            f"the arrays have the shapes {cells} and {cars}; allowed: (L, W, H + 1, {len(CellField)}) for the cells, "
            f"and (n, {len(CarField)}) for the cars"
        )
    check_size(grid.size, grid.n_cars)
    check_values(grid)


def check_values(grid: Grid) -> None:
    """Raise InputError for a cell or car that holds what no world has; the arrays are those of a single grid."""
    kind, yaw, mark, landing = np.moveaxis(grid.cells, -1, 0)
    ground_layer = np.arange(kind.shape[2]) == 0
    turned = np.isin(kind, KINDS_WITH_YAW)
    back = (landing != 0) & ((kind != Kind.BLOCK) | (landing != 1))
    cells = (
        ("kind", kind, (kind < Kind.AIR) | (kind >= len(Kind)), f"the kinds 0 to {len(Kind) - 1}"),
        (
            "kind",
            kind,
            ground_layer != (kind == Kind.GROUND),
            "ground in the layer 0, and nowhere else",
        ),
        ("yaw", yaw, (yaw < 0) | (yaw > 3 * turned), "the yaws 0 to 3 for what has one, else 0"),
        (
            "top",
            mark,
            (mark < -2) | (mark >= grid.n_cars),
            "the marks -2, -1 and the numbers of its cars",
        ),
        ("back", landing, back, "a mark as landing on blocks alone"),
    )
    for name, values, wrong, allowed in cells:
        if wrong.any():
            place = tuple(np.argwhere(wrong)[0].tolist())
            raise InputError(f"'{name}' of the cell {place} is {values[place]}; allowed: {allowed}")
    x, y, z, yaw, load, load_yaw, slope = grid.cars.T
    length, width, height = grid.size
    # A car may stand above the highest cell.
    inside = (x >= 0) & (x < length) & (y >= 0) & (y < width) & (z >= 1) & (z <= height + 1)
    if not inside.all():
        car = int(np.argmin(inside))
        at = tuple(grid.cars[car, : CarField.YAW].tolist())
        raise InputError(f"car {car} is at {at}, outside the map of size {grid.size}")
    on_slope = (slope == 0) | ((slope == 1) & (z <= height)) | ((slope == 2) & (z > 1))
    highest = 3 * (load == Kind.FSLOPE)
    cars = (
        ("yaw", yaw, (yaw < 0) | (yaw > 3), "0 to 3"),
        ("load", load, ~np.isin(load, _LOADS), _LOAD_NAMES),
        (
            "load_yaw",
            load_yaw,
            (load_yaw < 0) | (load_yaw > highest),
            "0 to 3 with a folded slope, else 0",
        ),
        ("slope", slope, ~on_slope, "0, 1 below the top level, and 2 above the floor"),
    )
    for name, values, wrong, allowed in cars:
        if wrong.any():
            car = int(np.argmax(wrong))
            raise InputError(f"'{name}' of car {car} is {values[car]}; allowed: {allowed}")
