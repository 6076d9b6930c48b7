"""Neighbours of actions: their clearance from the swept volume, and the legality of the action beside them.

Each action is set up with nothing but what it needs, and then with each possible thing or car at each place near it.
Those that matter are in a table of the package, since they take a minute (``scripts/neighbours.py`` writes it again).
"""

from __future__ import annotations

import csv
import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from importlib.resources import files
from itertools import product
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from craftsim.audit.situation import (
    BACK,
    DIRECTION_NAMES,
    FORWARD,
    LEFT,
    Builder,
    ImpossibleError,
    Row,
    Situation,
)
from craftsim.audit.swept import Clearance, Convex, Solids, convexes_of, sweep
from craftsim.discrete.actions import ACTIONS
from craftsim.discrete.geometry import CELL_PITCH_M, LEVEL_HEIGHT_M
from craftsim.discrete.grid import CarField, CarRow, Cell, Grid, Kind, Piece, beside, grid_of
from craftsim.discrete.kinds import Action
from craftsim.discrete.rules import Rules, RuleSet, has_room
from craftsim.mjcf.machines import Machines
from craftsim.models.composition import PlacedPart, placements

_WINDOW: Final = (13, 13, 6)
"""Size of the world: larger than the range of any rule around the car in its middle."""
_LEVEL: Final = 2
"""Level of the acting car, or of the foot of its ramp, with room for neighbours above and below."""
HOME: Final = (6, 6, _LEVEL)
"""Cell of the acting car, which heads +x; on a ramp the cell below it."""
_MARGIN: Final = 3
"""Free columns around a tried world, since the map's border acts as a wall."""
OVERLAP_M: Final = 0.001
"""A neighbour that overlaps deeper at the start is impossible."""
_SAMPLED_M: Final = 0.0001
"""Error of the swept volume due to sampling."""
_BRUSH_MM: Final = 1.0
"""A neighbour that overlaps less may be passed."""
_REACH: Final = 2
_LEVELS: Final = (-1, 0, 1, 2)
_LOADS: Final = {"none": Kind.AIR, "block": Kind.BLOCK, "slope": Kind.FSLOPE}
NAME: Final = "neighbours.csv"


def bare_situations() -> Iterator[Situation]:
    """Yield each action with nothing but what it needs, without mirror images and flags (shaped like blocks)."""
    for load in _LOADS:
        yield _bare("ROTATE_LEFT", Action.ROTATE_LEFT, load, [])
        for direction, action in (
            (FORWARD, Action.MOVE_RIGHT),
            (LEFT, Action.MOVE_FORWARD),
            (BACK, Action.MOVE_LEFT),
        ):
            floor = Piece(Kind.BLOCK, beside((0, 0, -1), direction))
            yield _bare(f"MOVE-{DIRECTION_NAMES[direction]}", action, load, [floor])
        # The three moves up a ramp and the three down.
        for names, yaw, first, below, levels, halves in (
            (("onto-foot", "up", "off-top"), BACK, 2, 0, (0, 0, 1), (0, 1, 2)),
            (("onto-top", "down", "off-foot"), FORWARD, 1, 3, (1, 1, 0), (0, 2, 1)),
        ):
            for stage, name in enumerate(names):
                body = (first - stage, 0, 0)
                ramp = [Piece(Kind.BODY, body, yaw), Piece(Kind.BLOCK, beside(body, yaw + 2))]
                ramp.append(Piece(Kind.BLOCK, (below - stage, 0, -1)))
                yield _bare(
                    f"MOVE-{name}", Action.MOVE_RIGHT, load, ramp, levels[stage], halves[stage]
                )
    for load, yaw in (("block", 0), ("slope", BACK)):
        lifted = Piece(_LOADS[load], (0, 0, 0), yaw)
        yield _bare("LIFT", Action.LIFT, load, [lifted])
        yield _bare("DROP", Action.DROP, load, [])
    for kind, action in ((Kind.FSLOPE, Action.UNFOLD), (Kind.BODY, Action.FOLD)):
        landing = Piece(Kind.BLOCK, (-1, 0, -1))
        yield _bare(action.name, action, "", [Piece(kind, (0, 0, 0), BACK), landing])


def _bare(
    name: str, action: Action, load: str, pieces: Sequence[Piece], level: int = 0, half: int = 0
) -> Situation:
    """Return an action among pieces, whose cells and level are relative to the car's."""
    carried = Kind.AIR
    if load and name != "LIFT":
        carried = _LOADS[load]
    x, y, _, *state = _car(FORWARD, carried, half)
    world = Builder()
    _add(world, pieces, [(x, y, level, *state)], HOME)
    return Situation(Row(name, load=load), world.grid((0, 0), _WINDOW), (action,))


def _add(world: Builder, pieces: Sequence[Piece], cars: Sequence[CarRow], at: Cell) -> None:
    """Add pieces and cars, moved by a cell, with blocks below them; walls may float.

    Raises ImpossibleError if two of them share a cell, or one would float.
    """
    moved = _moved(pieces, at)
    rows = [(*_sum(row[:3], at), *row[3:]) for row in cars]
    for piece in moved:
        world.put(piece)
    world.cars += rows
    if len({row[:3] for row in world.cars}) < len(world.cars):
        raise ImpossibleError("two cars would share a cell")
    for piece in moved:
        if piece.kind == Kind.WALL:
            continue
        for cell in _solid_cells(piece):
            world.support(cell)
    for x, y, z, _, _, _, half in rows:
        if half == 0:
            world.support((x, y, z))
            if world.cells.get((x, y, z), (Kind.AIR, 0))[0] == Kind.FOOT:
                raise ImpossibleError("a car in a foot's cell is on the slope")


def _solid_cells(piece: Piece) -> tuple[Cell, ...]:
    """Return the cells of a piece without that of a gear."""
    if piece.kind == Kind.BODY:
        return piece.cells
    return (piece.cell,)


def _moved(pieces: Iterable[Piece], by: Cell) -> list[Piece]:
    return [piece._replace(cell=_sum(piece.cell, by)) for piece in pieces]


def _sum(a: Sequence[int], b: Cell) -> Cell:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


class _Occupant(NamedTuple):
    """A possible neighbour: things or a car, in cell (0, 0, 0)."""

    kind: str
    """Such as ``block`` or ``car+fslope``."""
    stance: str = ""
    """Orientation, such as ``along`` or ``gear-uphill-low``."""
    side: str = ""
    pieces: tuple[Piece, ...] = ()
    cars: tuple[CarRow, ...] = ()
    bearer: tuple[Piece, ...] = ()

    @property
    def name(self) -> str:
        """Such as ``block``, ``fslope-left`` or ``car+block-low-back``."""
        return "-".join(filter(None, (self.kind, self.stance, self.side)))

    @property
    def mirrored(self) -> str:
        """Name of its mirror image."""
        return self._replace(side={"left": "right", "right": "left"}.get(self.side, self.side)).name

    def places(self) -> Iterator[Cell]:
        """Yield its places near a car in column (0, 0); levels are relative to the car's lower one."""
        # A piece of several cells is near if any of them is.
        cells = []
        for piece in self.pieces:
            for cell in _solid_cells(piece):
                cells.append(cell)
        cells += [(x, y, z) for x, y, z, *_ in self.cars]
        spread = range(-_REACH - 1, _REACH + 2)
        for dx, dy, dz in product(spread, spread, _LEVELS):
            if any(max(abs(x + dx), abs(y + dy)) <= _REACH for x, y, _ in cells):
                yield dx, dy, dz

    def added(self, world: Builder, at: Cell) -> tuple[Grid, Grid]:
        """Return the world with it at a place near the acting car, and the same with only its supports.

        Raises ImpossibleError if it cannot stand there.
        """
        extended = world.copy()
        cell = _sum(at, HOME)
        _add(extended, (*self.bearer, *self.pieces), self.cars, cell)
        grid = extended.grid((0, 0), _WINDOW)
        for piece in _moved(self.pieces, cell):
            for occupied in _solid_cells(piece):
                del extended.cells[occupied]
        extended.cars = extended.cars[: len(world.cars)]
        return grid, extended.grid((0, 0), _WINDOW)


def occupants() -> Iterator[_Occupant]:
    """Yield all occupants; flags are left out, since they have the shape of blocks."""
    origin = (0, 0, 0)
    for kind in (Kind.BLOCK, Kind.WALL):
        yield _Occupant(kind.name.lower(), pieces=(Piece(kind, origin),))
    # Along or across: front and back of a car are equally long.
    yield _Occupant("car", "along", cars=(_car(0, Kind.AIR),))
    yield _Occupant("car", "across", cars=(_car(1, Kind.AIR),))
    yield _Occupant("car+block", cars=(_car(0, Kind.BLOCK),))
    for yaw, side in enumerate(DIRECTION_NAMES):
        back = (yaw + 2) % 4
        ramps = {
            "low": (1, (Piece(Kind.BODY, beside(origin, back), yaw),)),
            "high": (2, (Piece(Kind.BODY, (0, 0, -1), yaw),)),
        }
        yield _Occupant("fslope", "", side, (Piece(Kind.FSLOPE, origin, yaw),))
        yield _Occupant("ramp", "", side, (Piece(Kind.BODY, origin, yaw),))
        yield _Occupant("car+fslope", "", side, cars=(_car(back, Kind.FSLOPE),))
        for name, gear, heading, load in (
            ("car", "", yaw, Kind.AIR),
            ("car+block", "", yaw, Kind.BLOCK),
            ("car+fslope", "gear-downhill-", back, Kind.FSLOPE),
            ("car+fslope", "gear-uphill-", yaw, Kind.FSLOPE),
        ):
            for place, (half, ramp) in ramps.items():
                cars = (_car(heading, load, half),)
                yield _Occupant(name, gear + place, side, cars=cars, bearer=ramp)


def _car(yaw: int, load: Kind, half: int = 0) -> CarRow:
    load_yaw = 0
    if load == Kind.FSLOPE:
        load_yaw = (yaw + 2) % 4
    return 0, 0, 0, yaw, load, load_yaw, half


class Neighbour(NamedTuple):
    """A possible neighbour of a bare situation."""

    situation: Situation
    occupant: _Occupant
    at: Cell
    """Its cell, for a slope that of the body; the level is relative to the acting car's lower one."""
    clearance: Clearance | None
    """Least distance between the moving solids and the occupant over the path; None beyond the margin."""
    grid: Grid
    """The world with both; the acting car is car 0."""
    grid_without: Grid
    """The world without the neighbour, but with what it stands on."""

    @property
    def closest(self) -> str:
        """The solids that come closest."""
        if self.clearance is None:
            return ""
        return f"{self.clearance.mine} and {self.clearance.theirs}"

    def legal(self, rules: Rules) -> tuple[bool, bool]:
        """Return whether the rules allow the action beside it, and without it."""
        (action,) = self.situation.acts
        return rules.legal(self.grid, 0, action), rules.legal(self.grid_without, 0, action)


def margin_m(machines: Machines) -> float:
    """Return the distance below which a neighbour matters: less than that of things in neighbouring cells.

    A load passes a block with a gap of 2.5 mm, less 0.1 mm; situations with tight room show that this is enough.
    """
    return CELL_PITCH_M - max(machines.block.side_m, machines.slope.side_m) - _SAMPLED_M


def neighbours(machines: Machines, of: Collection[str] = ()) -> Iterator[Neighbour]:
    """Yield the possible neighbours of each bare situation of these verbs, or of all, without mirror images.

    Of several cars the geometry of the first is used.
    """
    machines = replace(machines, cars=machines.cars[:1])
    margin = margin_m(machines)
    bodies = {occupant: bodies_of(occupant, machines) for occupant in occupants()}
    for situation in bare_situations():
        if of and ACTIONS[situation.acts[0]].verb not in of:
            continue
        bare = situation.grid
        world = Builder.of(situation.grid)
        symmetric = situation.row.action not in ("ROTATE_LEFT", "MOVE-left")
        volume = sweep(situation, machines)
        start = Solids(_convexes(placements(bare, machines), machines))
        car_cell = tuple(bare.cars[0, : CarField.YAW])
        for occupant, (body, bearer, block) in bodies.items():
            for at in occupant.places():
                if symmetric and (at[1], occupant.name) < (-at[1], occupant.mirrored):
                    continue
                shift = shift_of(at)
                if _overlaps(start, body, shift) or (
                    bearer is not None and _overlaps(start, bearer, shift)
                ):
                    continue
                try:
                    grid, grid_without = occupant.added(world, at)
                except ImpossibleError:
                    continue
                if grid.kind[car_cell] not in (bare.kind[car_cell], Kind.GEAR):
                    continue
                stacks = np.argwhere((grid_without.kind == Kind.BLOCK) & (bare.kind != Kind.BLOCK))
                if any(_overlaps(start, block, shift_of(cell - HOME)) for cell in stacks):
                    continue
                yield Neighbour(
                    situation,
                    occupant,
                    at,
                    volume.clearance(body, margin, shift),
                    grid,
                    grid_without,
                )


def shift_of(at: Sequence[int] | NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the displacement of a neighbour from the acting car's cell in metres."""
    return np.array([at[0] * CELL_PITCH_M, at[1] * CELL_PITCH_M, at[2] * LEVEL_HEIGHT_M])


def _overlaps(start: Solids, body: Solids, shift: NDArray[np.float64]) -> bool:
    return start.clearance(body, -OVERLAP_M, shift) is not None


def bodies_of(occupant: _Occupant, machines: Machines) -> tuple[Solids, Solids | None, Solids]:
    """Return the solids of an occupant, of its bearer, and of a block, in the acting car's cell."""
    cars = [(*_sum(row[:3], HOME), *row[3:]) for row in occupant.cars]
    placed = placements(
        grid_of(_moved((*occupant.bearer, *occupant.pieces), HOME), cars, _WINDOW), machines
    )
    block = placements(grid_of([Piece(Kind.BLOCK, HOME)], [], _WINDOW), machines)
    n = len(placed) - len(occupant.bearer)
    bearer = None
    if occupant.bearer:
        bearer = Solids(_convexes(placed[n:], machines))
    return Solids(_convexes(placed[:n], machines)), bearer, Solids(_convexes(block, machines))


def _convexes(parts: Iterable[PlacedPart], machines: Machines) -> list[Convex]:
    """Return the convex solids of some parts."""
    convexes = []
    for placement in parts:
        convexes += convexes_of(placement, machines)
    return convexes


def read_table() -> list[dict[str, str]]:
    """Return the rows of the stored table."""
    text = files("craftsim.data").joinpath(NAME).read_text(encoding="utf-8")
    return list(csv.DictReader(text.splitlines()))


def place_of(row: Mapping[str, str]) -> Cell:
    """Return the cell of a neighbour in a row of the table."""
    return int(row["dx"]), int(row["dy"]), int(row["dz"])


def nearby(rule_set: RuleSet, of: Collection[str] = ()) -> list[tuple[Situation, bool, Row]]:
    """Return the neighbourhoods of these verbs, or of all, with their legality and the rows in which they are counted.

    Each has one neighbour that matters by geometry or by a rule. Neighbours that physics cannot tell apart are merged:
    those of one kind in any orientation, in the way of the same action by the same solids to a tenth of a millimetre,
    and with the same legality. Neighbours of a kind that are in the way, or forbidden and close, are one row, and so
    are all out of reach; each that is allowed although it is close is a row of its own. For the physical rules, starts
    without room for a load are left out, since no play leads to them: in three of them a block that leans on a ramp
    overlaps the gear of another car's slope by 0.8 mm.
    """
    rules = Rules(rule_set)
    bare = {
        situation.id: (situation, Builder.of(situation.grid)) for situation in bare_situations()
    }
    occupants_by_name = {occupant.name: occupant for occupant in occupants()}
    neighbourhoods: dict[tuple[object, ...], tuple[Situation, bool, Row]] = {}
    for entry in read_table():
        situation, world = bare[entry["situation"]]
        occupant = occupants_by_name[entry["occupant"]]
        at = place_of(entry)
        (action,) = situation.acts
        if of and ACTIONS[action].verb not in of:
            continue
        grid, grid_without = occupant.added(world, at)
        legal = rules.legal(grid, 0, action)
        if not legal and not rules.legal(grid_without, 0, action):
            continue
        if legal and rule_set == "physical" and not has_room(grid):
            continue
        key = (situation.row, occupant.kind, occupant.stance, legal, *_physics_key(entry))
        if key not in neighbourhoods:
            clearance = None
            if entry["clearance_mm"]:
                clearance = float(entry["clearance_mm"])
            row = situation.row._replace(
                near=occupant.name, column=f"{at[0]},{at[1]}", above=str(at[2])
            )
            neighbourhood = Situation(row, _cropped(grid), (action,), clearance_mm=clearance)
            neighbourhoods[key] = (
                neighbourhood,
                legal,
                _counted_row(neighbourhood, occupant.kind, legal),
            )
    return list(neighbourhoods.values())


_SIDES: Final = re.compile(r"_(f|r)?[lr]\b|_(left|right|front|back)\b")


def _physics_key(entry: Mapping[str, str]) -> tuple[object, ...]:
    """Return what distinguishes neighbours in physics: clearance and solids or, out of reach, the place."""
    if not entry["clearance_mm"]:
        return entry["occupant"], place_of(entry)
    return entry["clearance_mm"], _SIDES.sub("", entry["closest"])


def _counted_row(neighbourhood: Situation, kind: str, legal: bool) -> Row:
    """Return the row in which a neighbourhood is counted: its own if the action is allowed close by."""
    if legal:
        rule = "allowed"
    else:
        rule = "forbidden"
    row = neighbourhood.row._replace(near=kind, column="", above="")
    if neighbourhood.clearance_mm is None:
        return row._replace(near="any", kind=f"{rule} out of reach")
    if neighbourhood.clearance_mm < -_BRUSH_MM:
        return row._replace(kind=f"{rule} in the way")
    if legal:
        return neighbourhood.row
    return row._replace(kind="forbidden close by")


def _cropped(grid: Grid) -> Grid:
    """Return a world with :data:`_MARGIN` empty columns around it."""
    occupied = np.vstack([np.argwhere(grid.kind > Kind.GROUND), grid.cars[:, : CarField.YAW]])
    low = occupied.min(axis=0) - _MARGIN
    high = occupied.max(axis=0) + 1 + _MARGIN
    length, width, _ = (high - low).tolist()
    return Builder.of(grid).grid(
        (int(low[0]), int(low[1])), (length, width, int(occupied[:, 2].max()) + 1)
    )
