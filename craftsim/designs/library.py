"""A small library of buildings, each with its sizes as arguments, in cells.

Nothing floats: a block stands on the ground or on a block, so that an opening is one to the sky. What a car cannot
reach from its neighbour cells can still be built in an order that fills it from the far end (docs/how-to/design.md).
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Sequence
from typing import Final

from craftsim.designs.ranges import DESIGN_SIDE
from craftsim.discrete.files.design import Design
from craftsim.discrete.grid import Cell
from craftsim.errors import InputError, suggestion
from craftsim.storage.limits import DESIGN_CELLS

_AWAY: Final = 2
"""Yaw of a ramp that is driven up towards +x: downhill is -x."""
_WIDTH: Final = 3
"""Width of a letter in cells; it is five high."""
_FONT: Final = {
    "ABCDEFGHIJKLMNOPQRS": """
### ##. ### ##. ### ### ### #.# ### ..# #.# #.. #.# ##. ### ### ### ### ###
#.# #.# #.. #.# #.. #.. #.. #.# .#. ..# #.# #.. ### #.# #.# #.# #.# #.# #..
### ##. #.. #.# ##. ##. #.# ### .#. ..# ##. #.. ### #.# #.# ### #.# ##. ###
#.# #.# #.. #.# #.. #.. #.# #.# .#. #.# #.# #.. #.# #.# #.# #.. ### #.# ..#
#.# ##. ### ##. ### #.. ### #.# ### ### #.# ### #.# #.# ### #.. ..# #.# ###
""",
    "TUVWXYZ0123456789 ": """
### #.# #.# #.# #.# #.# ### ### .#. ### ### #.# ### ### ### ### ### ...
.#. #.# #.# #.# #.# #.# ..# #.# ##. ..# ..# #.# #.. #.. ..# #.# #.# ...
.#. #.# #.# ### .#. .#. .#. #.# .#. ### .## ### ### ### ..# ### ### ...
.#. #.# #.# ### #.# .#. #.. #.# .#. #.. ..# ..# ..# #.# .#. #.# ..# ...
.#. ### .#. #.# #.# .#. ### ### ### ### ### ..# ### ### .#. ### ### ...
""",
}
"""The rows of some letters beside each other, from the top."""
WRITABLE_SIGNS: Final = frozenset("".join(_FONT))
"""Characters that can be written."""


def wall(length: int = 6, height: int = 2, thickness: int = 1) -> Design:
    """Return a straight wall."""
    return Design.of("wall", _box(length, thickness, height))


def platform(length: int = 4, width: int = 3, height: int = 1) -> Design:
    """Return a floor of blocks, as many levels high as it says."""
    return Design.of("platform", _box(length, width, height))


def ring(length: int = 5, width: int = 5, height: int = 1) -> Design:
    """Return a wall around a court."""
    _at_least("ring", 3, length=length, width=width)
    return Design.of("ring", _around(length, width, height))


def house(length: int = 5, width: int = 5, height: int = 2) -> Design:
    """Return the four walls of a house with a door of one cell in the front; as all openings it has none above it."""
    _at_least("house", 3, length=length, width=width)
    door = (length // 2, 0)
    cells = _around(length, width, height)
    return Design.of("house", [cell for cell in cells if cell[:2] != door])


def arch(span: int = 3, rise: int = 4, height: int = 1) -> Design:
    """Return an arch that lies on the floor: two legs, and what joins them at the far end."""
    _at_least("arch", 2, rise=rise)
    cells = _around(span + 2, rise, height)
    return Design.of("arch", (cell for cell in cells if cell[1] or not 0 < cell[0] <= span))


def pyramid(base: int = 5) -> Design:
    """Return a pyramid with a square base, each level two cells narrower: a base of 5 takes 35 blocks."""
    cells = []
    for z in range((base + 1) // 2):
        side = base - 2 * z
        for x, y, _ in _box(side, side, 1):
            cells.append((x + z, y + z, z + 1))
    return Design.of("pyramid", cells)


def stair(steps: int = 2, width: int = 2) -> Design:
    """Return a stair with a ramp for each step, one after the other in the first row.

    Who unfolds an upper ramp leaves along the rows beside it, so that a stair of more steps is two cells wide at least.
    """
    if steps > 1:
        _at_least("stair", 2, width=width)
    ramps = [((3 * z + 1, 0, z + 1), _AWAY) for z in range(steps)]
    return Design.of("stair", _cells_of_stair(steps, width), ramps)


def bridge(length: int = 3, width: int = 1) -> Design:
    """Return a bridge of one level with a ramp at either end of each row: ``barrier`` of a start puts walls beside it.

    An unloaded car drives through below it, a loaded one over it.
    """
    deck = ((x + 2, y, 1) for x, y, _ in _box(length, width, 1))
    ramps = []
    for y in range(width):
        ramps.append(((1, y, 1), _AWAY))
        ramps.append(((length + 2, y, 1), _AWAY - 2))
    return Design.of("bridge", deck, ramps)


def tower(side: int = 2, height: int = 2) -> Design:
    """Return a square tower with a ramp onto its first level."""
    return Design.of(
        "tower", ((x + 2, y, z) for x, y, z in _box(side, side, height)), [((1, 0, 1), _AWAY)]
    )


def letters(text: str, height: int = 1) -> Design:
    """Return a text that lies on the floor, in letters and digits of 3 x 5 cells.

    Raises InputError for other signs, and for a text without any.
    """
    unknown = sorted({*text.upper()} - WRITABLE_SIGNS)
    if unknown or not text.strip():
        problem = "no text"
        if unknown:
            problem = f"no '{unknown[0]}'"
        raise InputError(
            f"letters: there is {problem}; allowed: A to Z, 0 to 9 and blanks, such as --text CAR"
        )
    if len(text) * (_WIDTH + 1) > DESIGN_SIDE.high:
        raise InputError(
            f"letters: {len(text)} letters; allowed: at most {int(DESIGN_SIDE.high) // (_WIDTH + 1)}"
        )
    return Design.of("letters", _cells_of_text(text.upper(), height))


BUILDINGS: Final[dict[str, Callable[..., Design]]] = {
    function.__name__: function
    for function in (wall, platform, ring, house, arch, pyramid, stair, bridge, tower, letters)
}
"""The buildings by name."""


def sizes_of(name: str) -> dict[str, int]:
    """Return the sizes that a building takes, in order, with what they are unless given."""
    parameters = inspect.signature(BUILDINGS[name]).parameters.values()
    return {
        parameter.name: parameter.default for parameter in parameters if parameter.name != "text"
    }


def make_design(name: str, size: Sequence[int] = (), text: str | None = None) -> Design:
    """Return a building of the library; sizes are in the order of :func:`sizes_of`, and those left out as there.

    Raises InputError for a name, a number of sizes, a size or a text that there cannot be.
    """
    if name not in BUILDINGS:
        raise InputError(
            f"no design '{name}'{suggestion(name, BUILDINGS)}; there are {', '.join(BUILDINGS)}"
        )
    names = sizes_of(name)
    if len(size) > len(names):
        raise InputError(f"{name}: {len(size)} sizes; it has {len(names)}: {', '.join(names)}")
    if (text is None) == (name == "letters"):
        raise InputError(f"{name}: {'needs a --text' if text is None else 'has no --text'}")
    sizes = {**names, **dict(zip(names, size, strict=False))}
    for size_name, number in sizes.items():
        DESIGN_SIDE.check(f"{name}: {size_name}", number)
    if text is None:
        return BUILDINGS[name](**sizes)
    return letters(text, **sizes)


def _cells_of_text(text: str, height: int) -> Iterator[Cell]:
    """Yield the cells of letters beside each other."""
    for i, sign in enumerate(text):
        for x, y in cells_of(sign):
            for z in range(1, height + 1):
                yield x + (_WIDTH + 1) * i, y, z


def cells_of(sign: str) -> list[tuple[int, int]]:
    """Return the (x, y) of a letter's cells, y up."""
    cells = []
    for signs, picture in _FONT.items():
        if sign not in signs:
            continue
        first = (_WIDTH + 1) * signs.index(sign)
        for y, row in enumerate(reversed(picture.strip().split("\n"))):
            for x in range(_WIDTH):
                if row[first + x] == "#":
                    cells.append((x, y))
    return cells


def _cells_of_stair(steps: int, width: int) -> Iterator[Cell]:
    """Yield the cells of a stair's blocks, the lowest level first."""
    for z in range(1, steps + 1):
        for x in range(3 * z - 1, 3 * steps):
            for y in range(width):
                yield x, y, z


def _box(length: int, width: int, height: int) -> list[Cell]:
    """Return the cells of a box of blocks."""
    if length * width * height > DESIGN_CELLS:
        raise InputError(
            f"{length} x {width} x {height} are {length * width * height} blocks; allowed: at most {DESIGN_CELLS}"
        )
    cells = []
    for z in range(1, height + 1):
        for x in range(length):
            for y in range(width):
                cells.append((x, y, z))
    return cells


def _around(length: int, width: int, height: int) -> list[Cell]:
    """Return the cells of a wall around a court."""
    cells = []
    for x, y, z in _box(length, width, height):
        if x in (0, length - 1) or y in (0, width - 1):
            cells.append((x, y, z))
    return cells


def _at_least(name: str, lowest: int, **sizes: int) -> None:
    for size_name, number in sizes.items():
        if number < lowest:
            raise InputError(f"{name}: {size_name} is {number}; allowed: at least {lowest}")
