"""All situations of one car: the product of all properties.

Each combination is built as the smallest world with these properties, and dropped if that is impossible. The car is in
cell (0, 0) of its level and heads +x, so that all yaws and directions are relative to its heading.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from functools import cache, lru_cache
from itertools import chain, product
from typing import Any, Final

from craftsim.audit.situation import (
    BACK,
    DIRECTION_NAMES,
    FORWARD,
    Builder,
    ImpossibleError,
    Row,
    Situation,
)
from craftsim.discrete.actions import ACTIONS, ActionSpec, verbs
from craftsim.discrete.grid import KINDS_WITH_YAW, SECOND_PART, CarField, Cell, Kind, Piece, beside
from craftsim.discrete.kinds import Action
from craftsim.discrete.rules import Rules, RuleSet
from craftsim.errors import CraftsimError

GROUNDS: Final = {
    "flat": (0, FORWARD),
    "low-up": (1, BACK),
    "high-up": (2, BACK),
    "low-down": (1, FORWARD),
    "high-down": (2, FORWARD),
}
"""Grounds of a car: the half of a slope (0 none, 1 lower, 2 upper), and the downhill direction."""
LEVELS: Final = ("1", "2", "3")
LOAD_KINDS: Final = {
    "none": Kind.AIR,
    "block": Kind.BLOCK,
    "flag": Kind.FLAG,
    "fslope": Kind.FSLOPE,
}


def _things(*kinds: Kind) -> dict[str, tuple[Kind, int]]:
    """Return possible contents of a cell by name: kind, and yaw relative to the car's heading."""
    contents: dict[str, tuple[Kind, int]] = {}
    for kind in kinds:
        name = kind.name.lower()
        if kind not in KINDS_WITH_YAW:
            contents[name] = (kind, 0)
            continue
        for yaw, direction in enumerate(DIRECTION_NAMES):
            contents[f"{name}-{direction}"] = (kind, yaw)
    return contents


_OWN: Final = _things(Kind.AIR, Kind.BLOCK, Kind.FLAG, Kind.FSLOPE, Kind.BODY, Kind.GEAR, Kind.FOOT)
_AHEAD: Final = _OWN | _things(Kind.WALL)
_BELOW: Final = {f"above-{word}": content for word, content in _things(Kind.BODY).items()}
"""Slopes in the cell below the free target cell: a way down."""
_OVER: Final = _things(Kind.AIR, Kind.BLOCK, Kind.FLAG, Kind.GEAR)
_FIRST_PART: Final = {second: first for first, second in SECOND_PART.items()}
_STANDS_ON: Final = (Kind.WALL, Kind.BLOCK, Kind.FLAG, Kind.FSLOPE, Kind.BODY, Kind.FOOT)
"""Kinds that need ground or a block below them; a gear hangs on its slope."""


def acts() -> dict[str, tuple[ActionSpec, int | None]]:
    """Return the actions of one car by name: the row of the table of actions, and the direction of a move."""
    return _acts(tuple(map(id, ACTIONS.values())))


@lru_cache(maxsize=1)
def _acts(_: tuple[int, ...]) -> dict[str, tuple[ActionSpec, int | None]]:
    """Return the same, cached for a table of actions by the identities of its rows."""
    actions: dict[str, tuple[ActionSpec, int | None]] = {}
    for spec in (spec for spec in ACTIONS.values() if spec.performed):
        for direction in spec.ahead or (None,):
            if direction is None:
                word = spec.verb
            else:
                word = f"{spec.verb}-{DIRECTION_NAMES[direction]}"
            actions.setdefault(word, (spec, direction))
    return actions


def row_of(entry: Mapping[str, Any]) -> Row:
    """Return the row of an entry in a file: a scene, or a car on the floor with nothing around except what is given."""
    words: dict[str, Any] = {name: str(word) for name, word in entry.items()}
    words |= {"then": tuple(entry.get("then", ()))}
    if "scene" in words:
        return Row(**words)
    usual = {"level": "1", "ground": "flat", "own": "air", "load": "none", "room": "free"}
    target = {}
    if acts()[words["action"]][1] is not None:
        target = {"next": "air"}
    return Row(**(usual | target | words))


def situation_of(row: Row, rule_set: RuleSet, forbidden: bool = False) -> Situation:
    """Return the situation with these properties. Raises CraftsimError without one, and if it is ``forbidden`` unless
    allowed."""
    rules = Rules(rule_set)
    try:
        world = _built(row)
        if row.room == "tight":
            situation = _tight(row, world, rules)
        else:
            situation = _situation(row, world)
        if situation is None:
            raise ImpossibleError("no neighbour cell can be filled")
        if not forbidden and not situation.legal(rules):
            raise ImpossibleError("the rules forbid it")
    except ImpossibleError as reason:
        raise CraftsimError(f"there is no world for {row}: {reason}") from reason
    return situation


def survey(
    rule_set: RuleSet = "physical", of: tuple[str, ...] = ()
) -> tuple[tuple[Situation, bool], ...]:
    """Return the situations of these verbs, or of all, each with whether the rule set allows the action.

    Forbidden ones are only those with free neighbour cells.
    """
    allowed = []
    forbidden = []
    for verb in verbs():
        if of and verb not in of:
            continue
        allowed_of_verb, forbidden_of_verb = _survey(rule_set, verb)
        allowed += [(situation, True) for situation in allowed_of_verb]
        forbidden += [(situation, False) for situation in forbidden_of_verb]
    return tuple(allowed + forbidden)


@cache
def _survey(rule_set: RuleSet, verb: str) -> tuple[list[Situation], list[Situation]]:
    """Return the allowed situations of a verb, and the forbidden ones with free neighbour cells."""
    rules = Rules(rule_set)
    allowed = list[Situation]()
    illegal = list[Situation]()
    for situation in _roomy(verb):
        if not situation.legal(rules):
            illegal.append(situation)
            continue
        tight = _tight(situation.row._replace(room="tight"), _built(situation.row), rules)
        if tight is None:
            allowed += [situation]
        else:
            allowed += [situation, tight]
    return allowed, illegal


@cache
def _roomy(verb: str) -> list[Situation]:
    """Return all possible situations of a verb with free neighbour cells; cached for all rule sets."""
    situations = list[Situation]()
    inner = list(_inner(verb))
    for ground, content in product(GROUNDS, _OWN):
        by_load = dict[str, list[Situation]]()
        for load in LOAD_KINDS:
            # A flag has the shape of a block: these worlds differ in the load alone.
            with_load = []
            if load == "flag":
                with_load = [_with_flag(situation) for situation in by_load["block"]]
            if load != "flag":
                with suppress(ImpossibleError):
                    _check_car(ground, content, load)
                    for row in inner:
                        with suppress(ImpossibleError):
                            row = row._replace(ground=ground, own=content, load=load)
                            with_load.append(_situation(row, _built(row)))
            by_load[load] = with_load
            situations += with_load
    return situations


def _with_flag(situation: Situation) -> Situation:
    """Return the situation of a car that carries a block with a flag in its place."""
    grid = situation.grid.copy()
    grid.cars[0, CarField.LOAD] = Kind.FLAG
    return replace(situation, row=situation.row._replace(load="flag"), grid=grid)


def _inner(verb: str) -> Iterator[Row]:
    """Yield the combinations of direction, next, level, over and beyond for a verb, in a fixed order."""
    for action, (spec, direction) in acts().items():
        if spec.verb != verb:
            continue
        targets = [""]
        if direction is not None:
            targets = [*_AHEAD, *_BELOW]
        for target, level in product(targets, LEVELS):
            ramp = target.startswith(("foot", "body")) or target in _BELOW
            overs = [""]
            if ramp or spec.over:
                overs += [word for word in _OVER if word != "air"]
            beyonds = [""]
            if spec.beyond is not None:
                beyonds.append("taken")
            for over, word_beyond in product(overs, beyonds):
                yield Row(action, level, next=target, over=over, beyond=word_beyond, room="free")


def _situation(row: Row, world: Builder) -> Situation:
    """Return a situation in its smallest world, with a free margin of one column."""
    level = int(row.level)
    around = ((2, 0, level), (0, 2, level), (-2, 0, level), (0, -2, level))
    xs, ys, zs = zip(*world.cells, *around, strict=True)
    low = min(xs) - 1, min(ys) - 1
    size = max(xs) + 2 - low[0], max(ys) + 2 - low[1], max(zs) + 1
    first, *further_actions = [_action(word) for word in (row.action, *row.then)]
    return Situation(row, world.grid(low, size), (first, *further_actions), anywhere=True)


def _action(word: str) -> Action:
    """Return an action by name, for a car that heads +x."""
    spec, direction = acts()[word]
    for action, candidate in ACTIONS.items():
        is_same = candidate.verb == spec.verb and candidate.direction in (direction, None)
        if is_same and candidate.performed:
            return action
    raise ValueError(f"no action {word}")


def _built(row: Row) -> Builder:
    """Return the world of a situation with free neighbour cells.

    Raises ImpossibleError if its properties exclude each other.
    """
    car_cell: Cell = (0, 0, int(row.level))
    spec, direction = acts()[row.action]
    world = _ground(row.ground, row.own, row.load, car_cell, direction).copy()
    if direction is not None:
        _build_next(world, row, car_cell, direction)
    if row.over:
        _claim(world, _OVER[row.over], _over(row, car_cell, spec, direction))
    if row.beyond and spec.beyond is not None:
        world.claim(Piece(Kind.BLOCK, beside(beside(car_cell, spec.beyond), spec.beyond)))
    for cell, (kind, _) in sorted(world.cells.items()):
        if kind in _STANDS_ON:
            world.support(cell)
    half, _ = GROUNDS[row.ground]
    load_yaw = 0
    if row.load == "fslope":
        load_yaw = BACK
    world.cars.append((*car_cell, FORWARD, LOAD_KINDS[row.load], load_yaw, half))
    return world


def _claim(world: Builder, content: tuple[Kind, int], cell: Cell) -> None:
    """Claim the cells of a thing; a gear or a foot comes with its slope."""
    kind, yaw = content
    if kind in _FIRST_PART:
        kind = _FIRST_PART[kind]
        cell = beside(cell, yaw + 2)
    world.claim(Piece(kind, cell, yaw))


def _check_car(ground: str, content: str, load: str) -> None:
    """Raise ImpossibleError if a car cannot stand there; checked first, since this excludes most combinations."""
    half, downhill = GROUNDS[ground]
    kind, yaw = _OWN[content]
    loaded = load != "none"
    under = kind in (Kind.BLOCK, Kind.FLAG, Kind.FSLOPE, Kind.BODY)
    for impossible, reason in (
        (
            half == 1 and (kind, yaw) != (Kind.FOOT, downhill),
            "a car on a lower half is in the cell of its foot",
        ),
        (half == 2 and kind != Kind.AIR, "above a body is nothing but the car"),
        (half == 0 and kind == Kind.FOOT, "a car in a foot's cell is on the slope"),
        (
            under and kind in SECOND_PART and yaw != BACK,
            "a car enters below a slope from its high side only",
        ),
        (loaded and kind == Kind.GEAR, "a load's legs would be where a gear is"),
        (loaded and under, "a load and what the car stands under would share a cell"),
    ):
        if impossible:
            raise ImpossibleError(reason)


@lru_cache(maxsize=256)
def _ground(ground: str, word: str, load: str, car_cell: Cell, direction: int | None) -> Builder:
    """Return the world below and above the car before a move in a direction; a slope comes with a block behind it.

    Raises ImpossibleError if a car cannot stand there.
    """
    _check_car(ground, word, load)
    world = Builder()
    half, downhill = GROUNDS[ground]
    if half == 0:
        _claim(world, _OWN[word], car_cell)
        world.support(car_cell)
        if word == "fslope-back":
            world.support(beside(car_cell, BACK))
    else:
        _build_ramp(world, half, downhill, car_cell, direction)
    if load == "fslope":
        world.claim(Piece(Kind.AIR, beside(car_cell, BACK)))
    return world


def _build_ramp(
    world: Builder, half: int, downhill: int, car_cell: Cell, direction: int | None
) -> None:
    if half == 1:
        body = beside(car_cell, downhill + 2)
    else:
        body = (car_cell[0], car_cell[1], car_cell[2] - 1)
    if half == 2:
        world.claim(Piece(Kind.AIR, car_cell))
    world.claim(Piece(Kind.BODY, body, downhill))
    # Off the upper half forward the next cell decides what is below it; everywhere else a landing stands there.
    if not (half == 2 and downhill == BACK and direction is not None):
        world.claim(Piece(Kind.BLOCK, beside(body, downhill + 2)))
    end = beside(beside(body, downhill), downhill)
    if direction is None or end != beside(car_cell, direction):
        world.claim(Piece(Kind.AIR, end))
        world.support(end)


def _build_next(world: Builder, row: Row, car_cell: Cell, direction: int) -> None:
    """Add the content of a move's target cell."""
    cell = beside(car_cell, direction)
    half, downhill = GROUNDS[row.ground]
    if row.next in _BELOW:
        kind, yaw = _BELOW[row.next]
        below = (cell[0], cell[1], cell[2] - 1)
        world.claim(Piece(Kind.AIR, cell))
        world.claim(Piece(kind, below, yaw))
        landing = beside(beside(below, yaw), yaw)
        world.claim(Piece(Kind.AIR, landing))
        world.support(landing)
        return
    kind, yaw = _AHEAD[row.next]
    if row.load != "none" and kind == Kind.GEAR and half == 2:
        raise ImpossibleError("a load on an incline would be where a gear is")
    if row.load != "none" and kind == Kind.BODY and half == 1 and downhill == FORWARD:
        raise ImpossibleError("a load on an incline would be where a slope is")
    _claim(world, (kind, yaw), cell)
    if kind == Kind.FOOT and half == 0:
        world.claim(Piece(Kind.BLOCK, beside(beside(cell, yaw + 2), yaw + 2)))
    part_of_the_ramp = half == 2 and direction == downhill
    if kind != Kind.WALL and not part_of_the_ramp:
        world.support(cell)


def _over(row: Row, car_cell: Cell, spec: ActionSpec, direction: int | None) -> Cell:
    """Return the cell of the property ``over``."""
    if direction is None:
        cell = car_cell
    else:
        cell = beside(car_cell, direction)
    if direction is not None and not spec.over:
        if row.next in _BELOW:
            return beside(cell, direction)
        kind, _ = _AHEAD[row.next]
        if kind == Kind.FOOT:
            cell = beside(beside(cell, direction), direction)
        elif kind != Kind.BODY or GROUNDS[row.ground] != (1, BACK):
            raise ImpossibleError("what is overhead does not concern this move")
    return cell[0], cell[1], car_cell[2] + 1


def _tight(row: Row, world: Builder, rules: Rules) -> Situation | None:
    """Return the situation with neighbour cells filled with blocks, in turn while the action stays legal; None if no
    cell can be filled."""
    filled = world.copy()
    roomy = world.copy()
    columns = _fillable(row, world)
    roomy.cells = dict.fromkeys(chain.from_iterable(columns), (Kind.AIR, 0)) | world.cells
    tried = _situation(row, roomy)
    x0, y0 = tried.grid.cars[0, : CarField.Z].tolist()
    for column in columns:
        grid = tried.grid.copy()
        for x, y, z in column:
            grid.put(Piece(Kind.BLOCK, (x0 + x, y0 + y, z)))
        grid.derive_marks()
        filled_further = replace(tried, grid=grid)
        if filled_further.legal(rules):
            tried = filled_further
            filled.cells |= dict.fromkeys(column, (Kind.BLOCK, 0))
    if filled.cells == world.cells:
        return None
    return _situation(row, filled)


def _fillable(row: Row, world: Builder) -> list[tuple[Cell, ...]]:
    """Return the columns of blocks that can fill neighbour cells of the path.

    Neighbours are the cells around the own one and, for a move, around the target, on the car's level there.
    """
    car_cell: Cell = (0, 0, int(row.level))
    spec, direction = acts()[row.action]
    ground = GROUNDS[row.ground]
    path = [car_cell]
    if direction is not None:
        x, y, z = beside(car_cell, direction)
        path.append((x, y, z + (ground == (1, (direction + 2) % 4)) - (ground == (2, direction))))
    reserved = set(path)
    if spec.beyond is not None:
        reserved |= {
            beside(car_cell, spec.beyond),
            beside(beside(car_cell, spec.beyond), spec.beyond),
        }
    columns: list[tuple[Cell, ...]] = []
    for x, y, z in path:
        for dx, dy in ((1, 0), (0, 1), (-1, 0), (0, -1), (1, 1), (-1, 1), (-1, -1), (1, -1)):
            column = tuple((x + dx, y + dy, level) for level in range(1, z + 1))
            free = all(world.cells.get(cell, (Kind.BLOCK, 0))[0] == Kind.BLOCK for cell in column)
            if (
                free
                and column[-1] not in world.cells
                and not reserved & set(column)
                and column not in columns
            ):
                columns.append(column)
    return columns


@cache
def counted_row(row: Row, legal: bool) -> Row:
    """Return the row in which a situation is counted.

    Merged are mirror images, since the machines are symmetric; levels 2 and 3, which are both on blocks; flag and
    block, which have the same shape and mass; and the directions of a gear in the car's own cell, where it does not
    reach the car. For forbidden actions also the directions of a gear overhead, and for moves that are not forward
    everything overhead, since the car does not get there.
    """
    mirrored = _reworded(row, _mirror_words(tuple(acts())))
    return min(_merged(row, legal), _merged(mirrored, legal), key=str)


_MERGED_WORDS: Final = {"2": "2+", "3": "2+", "flag": "block"}
_GEARS: Final = {f"gear-{direction}": "gear" for direction in DIRECTION_NAMES}


def _merged(row: Row, legal: bool) -> Row:
    row = _reworded(row, _MERGED_WORDS)
    content = _GEARS.get(row.own, row.own)
    if legal:
        return row._replace(own=content)
    over = ""
    if acts()[row.action][1] in (None, FORWARD):
        over = _GEARS.get(row.over, row.over)
    return row._replace(own=content, over=over)


@lru_cache(maxsize=1)
def _mirror_words(actions: tuple[str, ...]) -> dict[Any, str]:
    sides = {"left": "right", "right": "left"}
    heads = {word.rpartition("-")[0] for word in (*actions, *_AHEAD, *_BELOW)}
    words = {}
    for head in heads:
        for side, other_side in sides.items():
            words[f"{head}-{side}"] = f"{head}-{other_side}"
    return words | {"ROTATE_LEFT": "ROTATE_RIGHT", "ROTATE_RIGHT": "ROTATE_LEFT"}


def _reworded(row: Row, words: Mapping[Any, Any]) -> Row:
    """Return a row with some words replaced."""
    return Row(*(words.get(word, word) for word in row))
