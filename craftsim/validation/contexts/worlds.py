"""The smallest world in which a context exists, drawn in the car's own frame.

The car stands in cell (0, 0) of its level and heads +x, so that every yaw and direction here is relative to its own:
0 forward, 1 left, 2 back, 3 right.
"""

from __future__ import annotations

from typing import Final

from craftsim.discrete.grid import KINDS_WITH_YAW, SECOND_PART, CarField, Cell, Grid, Kind, beside
from craftsim.validation.contexts.context import BACK, FORWARD, Context, Ground, Thing

STANDS_ON: Final = (Kind.WALL, Kind.BLOCK, Kind.FLAG, Kind.FSLOPE, Kind.BODY, Kind.FOOT)
"""What needs a floor or a block below it; a gear hangs on its slope."""
_FIRST_PART: Final = {second: first for first, second in SECOND_PART.items()}


class ImpossibleError(Exception):
    """A context that no world can show, with the reason in a few words."""


class Drawing:
    """Cells of a world in the making, in the car's frame; nothing is ever put where something else is."""

    def __init__(self) -> None:
        """Begin with nothing."""
        self.cells: dict[Cell, tuple[Kind, int]] = {}

    def put(self, kind: Kind, cell: Cell, yaw: int = 0) -> None:
        """Put a thing into a cell, and its second part into the next; AIR keeps a cell free."""
        if cell[2] < 1:
            raise ImpossibleError("something would be in the ground")
        turned = (kind, yaw % 4 if kind in KINDS_WITH_YAW else 0)
        if self.cells.setdefault(cell, turned) != turned:
            raise ImpossibleError("two things would share a cell")
        if kind in SECOND_PART:
            self.put(SECOND_PART[kind], beside(cell, yaw), yaw)

    def put_thing(self, thing: Thing, cell: Cell) -> None:
        """Put a thing into a cell; a gear or a foot comes with the slope that it is the second part of."""
        if thing.kind in _FIRST_PART:
            self.put(_FIRST_PART[thing.kind], beside(cell, thing.yaw + 2), thing.yaw)
        else:
            self.put(thing.kind, cell, thing.yaw)

    def support(self, cell: Cell) -> None:
        """Fill the cells below with blocks, down to the ground."""
        x, y, z = cell
        for level in range(1, z):
            there, _ = self.cells.setdefault((x, y, level), (Kind.BLOCK, 0))
            if there == Kind.AIR:
                raise ImpossibleError("something would stand on nothing")
            if there != Kind.BLOCK:
                raise ImpossibleError(f"something would stand on a {there.name.lower()}")

    def support_all(self) -> None:
        """Put everything that needs it on stacks of blocks."""
        for cell, (kind, _) in sorted(self.cells.items()):
            if kind in STANDS_ON:
                self.support(cell)

    def grid(self, context: Context, turn: int = 0, margin: tuple[int, int] = (1, 1), room: int = 1) -> Grid:
        """Return the world turned by quarters, with margins in cells before it and ``room`` cells behind it."""
        cells = {_turned(cell, turn): (kind, yaw) for cell, (kind, yaw) in self.cells.items()}
        own = (0, 0, context.level)
        reach = [*cells, own, *(beside(beside(own, d), d) for d in range(4))]
        low = [min(cell[i] for cell in reach) - margin[i] for i in range(2)]
        size = [max(cell[i] for cell in reach) + 1 + room - low[i] for i in range(2)]
        grid = Grid.empty((size[0], size[1], max(cell[2] for cell in reach) + 1), 1)
        for (x, y, z), (kind, yaw) in cells.items():
            at = x - low[0], y - low[1], z
            grid.kind[at] = kind
            grid.yaw[at] = (yaw + turn) % 4 if kind in KINDS_WITH_YAW else 0
        load_yaw = (turn + BACK) % 4 if context.load == Kind.FSLOPE else 0
        row = (-low[0], -low[1], context.level, turn % 4, context.load, load_yaw, context.ground.half)
        grid.cars[0, [CarField.X, CarField.Y, CarField.Z, CarField.YAW]] = row[:4]
        grid.cars[0, [CarField.LOAD, CarField.LOAD_YAW, CarField.SLOPE]] = row[4:]
        grid.derive_marks()
        return grid


def _turned(cell: Cell, turn: int) -> Cell:
    x, y, z = cell
    for _ in range(turn % 4):
        x, y = -y, x
    return x, y, z


def draw(context: Context) -> Drawing:
    """Draw a context without its tight neighbours.

    Raises ImpossibleError where two of its properties exclude each other.
    """
    drawing = Drawing()
    own: Cell = (0, 0, context.level)
    check_car(context.ground, context.own, context.load)
    _draw_ground(drawing, context, own)
    if context.load == Kind.FSLOPE:
        drawing.put(Kind.AIR, beside(own, BACK))
    if context.direction is not None and context.next is not None:
        _draw_next(drawing, context, own)
    if context.over.kind != Kind.AIR:
        drawing.put_thing(context.over, _over(context, own))
    if context.beyond_taken and context.verb.spec.beyond is not None:
        drawing.put(Kind.BLOCK, _after_next(own, context.verb.spec.beyond)[-1])
    drawing.support_all()
    return drawing


def check_car(ground: Ground, own: Thing, load: Kind) -> None:
    """Raise ImpossibleError where a car cannot stand like that: checked first, since it rules out most."""
    if ground.half == 1 and (own.kind, own.yaw) != (Kind.FOOT, ground.downhill):
        raise ImpossibleError("a car on a lower half is in the cell of its foot")
    if ground.half == 2 and own.kind != Kind.AIR:
        raise ImpossibleError("above a body is nothing but the car")
    if ground.half == 0 and own.kind == Kind.FOOT:
        raise ImpossibleError("a car in a foot's cell is on the slope")
    if own.kind in (Kind.FSLOPE, Kind.BODY) and own.yaw != BACK:
        raise ImpossibleError("a car enters below a slope from its high side only")
    if load != Kind.AIR and own.kind == Kind.GEAR:
        raise ImpossibleError("a load's legs would be where a gear is")
    if load != Kind.AIR and own.kind in (Kind.BLOCK, Kind.FLAG, Kind.FSLOPE, Kind.BODY):
        raise ImpossibleError("a load and what the car stands under would share a cell")


def _draw_ground(drawing: Drawing, context: Context, own: Cell) -> None:
    """Put down what the car stands on and under; half of a slope comes with a block behind it."""
    ground = context.ground
    if ground.half == 0:
        drawing.put_thing(context.own, own)
        drawing.support(own)
        if context.own.kind == Kind.FSLOPE:
            drawing.support(beside(own, BACK))
        return
    if ground.half == 1:
        body = beside(own, ground.downhill + 2)
    else:
        drawing.put(Kind.AIR, own)
        body = (own[0], own[1], own[2] - 1)
    drawing.put(Kind.BODY, body, ground.downhill)
    landing = beside(body, ground.downhill + 2)
    # Off the upper half forward the next cell decides what is below it; everywhere else a landing stands there.
    if not (ground.half == 2 and ground.downhill == BACK and context.next is not None):
        drawing.put(Kind.BLOCK, landing)
    end = beside(beside(body, ground.downhill), ground.downhill)
    if context.direction is None or end != beside(own, context.direction):
        drawing.put(Kind.AIR, end)
        drawing.support(end)


def _draw_next(drawing: Drawing, context: Context, own: Cell) -> None:
    assert context.direction is not None
    assert context.next is not None
    thing, cell = context.next, beside(own, context.direction)
    if thing.below:
        drawing.put(Kind.AIR, cell)
        body = (cell[0], cell[1], cell[2] - 1)
        drawing.put(Kind.BODY, body, thing.yaw)
        landing = beside(beside(body, thing.yaw), thing.yaw)
        drawing.put(Kind.AIR, landing)
        drawing.support(landing)
        return
    loaded, half = context.load != Kind.AIR, context.ground.half
    if loaded and thing.kind == Kind.GEAR and half == 2:
        raise ImpossibleError("a load on an incline would be where a gear is")
    if loaded and thing.kind == Kind.BODY and half == 1 and context.ground.downhill == FORWARD:
        raise ImpossibleError("a load on an incline would be where a slope is")
    drawing.put_thing(thing, cell)
    if thing.kind == Kind.FOOT and context.ground.half == 0:
        drawing.put(Kind.BLOCK, beside(beside(cell, thing.yaw + 2), thing.yaw + 2))
    if thing.kind != Kind.WALL and not _belongs_to_ramp(context):
        drawing.support(cell)


def _belongs_to_ramp(context: Context) -> bool:
    """Return whether the next cell is part of the ramp that the car is on."""
    ground = context.ground
    return ground.half == 2 and context.direction == ground.downhill


def _over(context: Context, own: Cell) -> Cell:
    """Return the cell that something stands or hangs in, over what the action is about."""
    x, y, z = own
    if context.direction is None or context.next is None:
        return x, y, z + 1
    ahead = beside(own, context.direction)
    if context.verb.spec.over:
        return ahead[0], ahead[1], z + 1
    if context.next.below:
        return beside(ahead, context.direction)
    if context.next.kind == Kind.FOOT:
        x, y, z = beside(beside(ahead, context.direction), context.direction)
        return x, y, z + 1
    if context.next.kind == Kind.BODY and context.ground.half == 1 and context.ground.downhill == BACK:
        return ahead[0], ahead[1], z + 1
    raise ImpossibleError("what is overhead does not concern this move")


def _after_next(own: Cell, way: int) -> tuple[Cell, Cell]:
    """Return the next two cells in a direction."""
    return beside(own, way), beside(beside(own, way), way)


def fillable(context: Context, drawing: Drawing) -> list[tuple[Cell, ...]]:
    """Return the columns of blocks, one a neighbour cell, that would leave only the clearance beside the way.

    Neighbours are the cells round the own one and, for a move, round the target, on the car's level there.
    """
    own: Cell = (0, 0, context.level)
    ways = [own]
    if context.direction is not None:
        x, y, z = beside(own, context.direction)
        climbs = context.ground.half == 1 and context.ground.downhill == (context.direction + 2) % 4
        falls = context.ground.half == 2 and context.ground.downhill == context.direction
        ways.append((x, y, z + climbs - falls))
    taken = set(ways)
    if context.verb.spec.beyond is not None:
        taken |= {*_after_next(own, context.verb.spec.beyond)}
    columns: list[tuple[Cell, ...]] = []
    for x, y, z in ways:
        for dx, dy in ((1, 0), (0, 1), (-1, 0), (0, -1), (1, 1), (-1, 1), (-1, -1), (1, -1)):
            column = tuple((x + dx, y + dy, level) for level in range(1, z + 1))
            free = all(drawing.cells.get(cell, (Kind.BLOCK, 0))[0] == Kind.BLOCK for cell in column)
            if free and column[-1] not in drawing.cells and not taken & set(column) and column not in columns:
                columns.append(column)
    return columns
