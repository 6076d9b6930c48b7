"""Rule sets on single worlds: what is legal, why not, what follows; and the action helper."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from string import Formatter
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from craftsim.compiled.jit import seldom
from craftsim.discrete.actions import (
    act_registered,
    as_registered,
    carry_out,
    is_registered,
    registered_columns,
    registered_reason,
)
from craftsim.discrete.grid import CarField, Cell, Grid, Kind, beside, cell_of
from craftsim.discrete.kernel import batch
from craftsim.discrete.kernel import codes as code
from craftsim.discrete.kernel.batch import NO_HELPER
from craftsim.discrete.kernel.codes import N_ACTIONS
from craftsim.discrete.kernel.search import due_of, search_buffers
from craftsim.discrete.kernel.state import NO_PATTERNS, World
from craftsim.discrete.kinds import MOVE_DIRECTION, NAMES, Action, Correction, RuleSetName
from craftsim.discrete.learned import LearnedRules, as_rule_set, pattern_cells
from craftsim.discrete.learned import RuleSet as RuleSet
from craftsim.errors import check_choice

RULE_SETS: Final[dict[RuleSetName, Correction]] = {
    "published": Correction(0),
    "physical": ~Correction(0),
}
"""The corrections of each rule set. What physics shows to be wrong is one more correction, read in its rule."""

DEFAULT_DEPTH: Final = 10
"""Search depth of CraftEnv's environment; its published training settings use 20."""

_search_buffers: Final = lru_cache(maxsize=2)(search_buffers)
"""They may take 50 MB for each map size."""
_NO_SPACE: Final = search_buffers((1, 1, 1))
_masks = seldom(batch.masks)
_step = seldom(batch.step)
enforce = seldom(batch.apply_actions)


class Rules:
    """A rule set at work on single worlds; grids passed in are never changed.

    Methods raise ValueError for a car that a world does not have.

    Example:
        >>> import craftsim
        >>> rules = craftsim.Rules("physical")
        >>> grid = craftsim.Grid.empty((3, 1, 1), n_cars=1)
        >>> rules.legal(grid, 0, craftsim.Action.MOVE_RIGHT), rules.legal(grid, 0, craftsim.Action.LIFT)
        (True, False)
        >>> rules.apply(grid, 0, craftsim.Action.MOVE_RIGHT).cars[0, :3].tolist()
        [1, 0, 1]
    """

    def __init__(
        self,
        rule_set: RuleSet | str | Path = "physical",
        corrections: Correction | None = None,
        actions: Iterable[Action | str] = (),
    ) -> None:
        """Make a rule set.

        Args:
            rule_set: its name, a YAML file of learned rules, or learned rules themselves.
            corrections: others than its own, to see what a single one changes.
            actions: registered actions, or their names, that masks have a further column for, in this order. Those that
                are not named are judged and carried out all the same where one asks for them.
        """
        self.rule_set: RuleSet = as_rule_set(rule_set)
        self.learned: LearnedRules | None = None
        self.patterns = NO_PATTERNS
        """What learned rules forbid beyond the corrections, for compiled code."""
        if isinstance(self.rule_set, LearnedRules):
            self.learned = self.rule_set
            self.patterns = self.rule_set.patterns
        if corrections is None:
            corrections = corrections_of(self.rule_set)
        self.corrections = corrections
        self.registered = as_registered(tuple(actions))
        self.actions = (*Action, *self.registered)
        """The actions of the columns of masks."""

    def mask(self, grid: Grid) -> NDArray[np.bool_]:
        """Return the legality of the 15 actions of each car, shape (n_cars, 15), all judged on this state.

        Registered actions that the rules were made with have further columns.
        """
        out = np.empty((1, grid.n_cars, N_ACTIONS), np.bool_)
        _masks(*self._world(grid[None]), _NO_SPACE, NO_HELPER, out)
        return registered_columns(out, grid[None], self.corrections, self.registered)[0]

    def legal(self, grid: Grid, car: int, action: int) -> bool:
        """Return whether one car could do one action now."""
        _check_car(grid, car)
        if is_registered(action):
            return not registered_reason(grid, self.corrections, car, action)
        return _reason(*self._world(grid), car, int(action)) == code.LEGAL

    def explain(self, grid: Grid, car: int, action: int) -> Explanation:
        """Return which rule forbids an action of a car now, in words, with the cells concerned; or that it is legal.

        ``str()`` of it is one line, such as ``LIFT is forbidden: something stands on (3, 2, 1): a block``. Raises
        ValueError for a car or an action that there is not.
        """
        _check_car(grid, car)
        return explain(grid, self, car, Action(action))

    def apply(self, grid: Grid, car: int, action: int) -> Grid:
        """Return the world after one car's action; an illegal action changes nothing."""
        return self.tick(grid, [(car, action)])[0]

    def enforce(self, grid: Grid, car: int, action: int) -> Grid:
        """Return the world as an action's effect would change it, whether the action is legal or not."""
        _check_car(grid, car)
        after = grid.copy()
        if is_registered(action):
            carry_out(after, car, action)
        else:
            turns = np.array([[[car]], [[int(action)]]])
            enforce(*self._world(after[None]), *turns)
        return after

    def tick(
        self, grid: Grid, team_action: Sequence[tuple[int, int]]
    ) -> tuple[Grid, NDArray[np.bool_]]:
        """Let cars act one after the other, each judged on what the earlier ones left.

        ``team_action`` is a TeamAction, or has the numbers of actions. Returns the world after the tick and, by action,
        whether it was legal when its turn came.
        """
        for car, _ in team_action:
            _check_car(grid, car)
        after = grid.copy()
        applied = np.zeros((1, len(team_action)), np.bool_)
        if any(is_registered(action) for _, action in team_action):
            for i, (car, action) in enumerate(team_action):
                if is_registered(action):
                    applied[0, i] = act_registered(after, self.corrections, car, action)
                else:
                    after, applied[0, i : i + 1] = self.tick(after, [(car, action)])
            return after, applied[0]
        turns, acts = np.array(team_action, np.int64).reshape(-1, 2).T.copy()[:, None]
        _step(*self._world(after[None]), turns, acts, applied)
        return after, applied[0]

    def reachable(self, grid: Grid, depth: int = DEFAULT_DEPTH) -> NDArray[np.bool_]:
        """Return (n_cars, 15): legal actions, and moves that are not legal but that the action helper has a plan for.

        With the helper a MOVE means "get to the neighbour cell", by whatever moves and turns lead there. ``mask`` says
        what a car can do at once; the two are never mixed.
        """
        out = np.empty((1, grid.n_cars, N_ACTIONS), np.bool_)
        batch.masks(*self._world(grid[None]), _search_buffers(grid.size), depth, out)
        return registered_columns(out, grid[None], self.corrections, self.registered)[0]

    def plan_move(
        self, grid: Grid, car: int, action: Action, depth: int = DEFAULT_DEPTH
    ) -> tuple[Action, ...] | None:
        """Return the primitives that a MOVE stands for now, or None if the helper finds no way."""
        if action not in MOVE_DIRECTION:
            raise ValueError(f"{action!r} is not one of the four moves")
        _check_car(grid, car)
        steps = np.full((grid.n_cars, depth + 1), -1, np.int8)
        due = self._search(grid, steps, car, action)
        if due == Action.STOP:
            return None
        return tuple(map(Action, steps[car][steps[car] >= 0].tolist()))

    def due(self, grid: Grid, queue: NDArray[np.int8], car: int, action: Action) -> Action:
        """Return the primitive that an action stands for now, and leave in ``queue`` what is to follow it.

        As a batch's steps choose it, for physical execution. ``queue`` is that of :func:`empty_queue`.
        """
        due = self._search(grid, queue, car, action)
        queue[car, :-1] = queue[car, 1:].copy()
        queue[car, -1] = -1
        return due

    def _world(self, grid: Grid) -> World:
        """Return a world, or a batch of them, with what decides on legality, for compiled code."""
        return grid.world(self.corrections, self.patterns)

    def _search(self, grid: Grid, queue: NDArray[np.int8], car: int, action: Action) -> Action:
        """Return the primitive that is due; a plan that is made for that stays in the queue as a whole."""
        world = self._world(grid)
        depth = queue.shape[1] - 1
        return Action(
            due_of(world, car, int(action), queue[car], _search_buffers(grid.size), depth)
        )


def corrections_of(rule_set: RuleSet) -> Correction:
    """Return the corrections that a rule set makes to the published rules. Raises InputError for what is none."""
    if not isinstance(rule_set, LearnedRules):
        check_choice("rule set", rule_set, RULE_SETS)
        return RULE_SETS[rule_set]
    corrections = RULE_SETS[rule_set.base]
    for name in rule_set.corrections:
        corrections |= Correction[name]
    return corrections


def empty_queue(n_cars: int, depth: int) -> NDArray[np.int8]:
    """Return (n_cars, depth + 1): what the action helper still has to do for each car, nothing yet (-1).

    It is there for everybody to see, and a reset empties it.

    Raises ValueError for a negative search depth.
    """
    if depth < 0:
        raise ValueError(f"the search depth is {depth}; allowed: 0 or more")
    return np.full((n_cars, depth + 1), -1, np.int8)


def _check_car(grid: Grid, car: int) -> None:
    """Raise ValueError if a world has no such car: compiled code would read past its arrays."""
    if not 0 <= car < grid.n_cars:
        raise ValueError(f"no car {car}; the world has {grid.n_cars}, counted from 0")


def has_room(grid: Grid) -> bool:
    """Return whether what each car carries is clear of all else by the rules: else no play of them leads there."""
    world = grid.world(RULE_SETS["physical"])
    return all(batch.load_has_room(world, car) for car in range(grid.n_cars))


# Why an action is forbidden, in words. The published rules' reasons come first. Where only a correction of the physical
# set forbids, it is also said which single thing or car nearby is in the way: one without which the action is legal.

_reason = seldom(batch.reason)
_NEAR: Final = 3
"""Largest distance, in columns and in levels, of a thing that a correction looks at."""


@dataclass(frozen=True)
class _RuleReason:
    """A row of the table."""

    words: str
    """Its fields are places of :data:`_PLACES`: ``{place}`` is their cell, ``{place:what}`` what is there, see
    :meth:`_Case.format_field`. ``{car}`` is the car that the reason names, ``{load}`` the own load."""
    cells: tuple[str, ...] = ("own",)
    """The places concerned."""
    correction: Correction | None = None
    """The correction that forbids it where the published rules do not."""
    heading: str = ""
    """Heading of docs/rules.md under which the correction is explained."""


def _stands_on(place: str) -> _RuleReason:
    return _RuleReason(
        f"something stands on {{{place}}}: {{{place}:occupant}}", (place, f"above {place}")
    )


def _corrects(correction: str, heading: str, words: str) -> _RuleReason:
    return _RuleReason(words, correction=Correction[correction], heading=heading)


REASONS: Final[dict[int, _RuleReason]] = {
    code.NEVER: _RuleReason("cars do not move diagonally"),
    code.ON_SLOPE: _RuleReason("on a slope a car can only move forward"),
    code.CARRIES: _RuleReason("the car carries {load}"),
    code.CARRIES_NOTHING: _RuleReason("the car carries nothing"),
    code.NOTHING_TO_LIFT: _RuleReason("there is nothing to lift in {own}{own:if any}"),
    code.THING_ON_TOP: _stands_on("own"),
    code.ABOVE_TOP_LEVEL: _RuleReason(
        "{own} is above the top level, where nothing can be put down"
    ),
    code.NO_RAMP_HERE: _RuleReason("there is no unfolded slope in {own}: {own:what}"),
    code.CAR_ON_OWN_FOOT: _RuleReason("car {car} is on the foot in {foot}", ("foot",)),
    code.NO_SLOPE_HERE: _RuleReason("there is no folded slope in {own}: {own:what}"),
    code.FOOT_BLOCKED: _RuleReason("the foot has no room in {foot}: {foot:what}", ("foot",)),
    code.FOOT_UNSUPPORTED: _RuleReason(
        "the foot has nothing to stand on in {under foot}: {under foot:what}", ("foot",)
    ),
    code.LANDING_BELOW_FOOT: _RuleReason("{under foot} is the landing of a ramp", ("under foot",)),
    code.LANDING_BELOW_BODY: _RuleReason("{under own} is the landing of a ramp", ("under own",)),
    code.TURN_UNDER_SLOPE: _RuleReason("a car cannot turn under {own:what} in {own}"),
    code.LOAD_HITS_THING: _RuleReason("the load would hit {side:what} in {side}", ("side",)),
    code.SLOPE_HITS_CORNER: _RuleReason(
        "the slope would hit {corner:what} in {corner}", ("corner",)
    ),
    code.LOAD_HITS_LOAD: _RuleReason("the load would hit that of car {car} in {other}", ("other",)),
    code.LOAD_HITS_GEAR: _RuleReason(
        "the load would hit the gear that car {car} carries in {other gear}", ("other gear",)
    ),
    code.FORWARD_ONLY: _RuleReason("from under {own:what} in {own} a car can only move forward"),
    code.NOT_SIDEWAYS: _RuleReason("from under {own:what} in {own} a car cannot move sideways"),
    code.NO_FLOOR: _RuleReason(
        "there is nothing to stand on in {under target}: {under target:what}", ("target",)
    ),
    code.IN_THE_WAY: _RuleReason("{target:what} is in {target}", ("target",)),
    code.CAR_THERE: _RuleReason("car {car} is in {target}", ("target",)),
    code.GEAR_THERE: _RuleReason("another car carries a gear in {target}", ("target",)),
    code.GEAR_NO_ROOM: _RuleReason(
        "the gear of the load has no room in {swept}: {swept:blocker}", ("swept",)
    ),
    code.LOAD_NOT_UNDER: _RuleReason(
        "a load does not fit under {target:what} in {target}", ("target",)
    ),
    code.ENTERED_SIDEWAYS: _RuleReason(
        "{target:what} in {target} cannot be entered sideways", ("target",)
    ),
    code.HIGH_SIDE_ONLY: _RuleReason(
        "{target:what} in {target} is entered backwards, from its high side only", ("target",)
    ),
    code.LOAD_NOT_THROUGH_GEAR: _RuleReason(
        "a load does not pass {target:what} in {target}", ("target",)
    ),
    code.NO_DESCENT_FROM: _RuleReason("from a cell with {own:what} no ramp is driven down"),
    code.DOWN_FORWARD_ONLY: _RuleReason(
        "the ramp in {under target} is driven down forward, in its own direction, only",
        ("under target",),
    ),
    code.THING_ON_BODY_BELOW: _stands_on("under target"),
    code.CAR_ON_FOOT_BELOW: _RuleReason(
        "car {car} is on the foot of the ramp in {under second}", ("under second",)
    ),
    code.NO_FLOOR_AT_END: _RuleReason(
        "the ramp ends in {under third}, where there is nothing to stand on", ("under third",)
    ),
    code.THING_AT_END: _stands_on("under under third"),
    code.NO_ASCENT_FROM: _RuleReason("from a cell with {own:what} no ramp is driven up"),
    code.UP_FORWARD_ONLY: _RuleReason(
        "the ramp in {target} is driven up forward, from its low end, only", ("target",)
    ),
    code.CAR_ON_FOOT: _RuleReason("car {car} is on the foot of the ramp in {target}", ("target",)),
    code.THING_ON_BODY: _stands_on("second"),
    code.NO_LANDING: _RuleReason("the ramp has no landing in {third}: {third:what}", ("third",)),
    code.CAR_ON_LANDING: _RuleReason(
        "car {car} is on the landing, in {above third}", ("above third",)
    ),
    code.NO_ROOM_ON_LANDING: _RuleReason(
        "there is no room above the landing, in {above third}: {above third:what}", ("above third",)
    ),
    code.FLAP_HITS: _corrects("swinging_flap", "flap", "the flap would meet something on its way"),
    code.TURNING_LOAD_HITS: _corrects(
        "turning_load",
        "turning-load",
        "the load would hit a car, or a load that leans, as it turns",
    ),
    code.LEANING_LOAD_HITS: _corrects(
        "leaning_load", "leaning-load", "a load that leans on a ramp would meet something"
    ),
    code.OTHER_RAMP: _corrects(
        "own_ramp", "own-ramp", "on a ramp a car goes on along that ramp only"
    ),
    code.RAMP_UNDER_GEAR: _corrects(
        "ramp_below_gear",
        "through-a-gear",
        "a ramp below a gear is driven down in its own direction only",
    ),
    code.REACHING_LOAD_HITS: _corrects(
        "reaching_load",
        "reaching-load",
        "something would meet a load that reaches in from another level",
    ),
    code.WALL_OVERHEAD: _corrects("overhead_wall", "overhead-wall", "there is a wall overhead"),
    code.GEARS_CROSS: _corrects(
        "crossing_gear", "crossing-gear", "the gear of the slope would cross something"
    ),
    code.UNDER_THING_AT_END: _corrects(
        "run_out",
        "run-out",
        "who comes down a ramp does not drive under what stands right behind its foot",
    ),
}
"""Reasons why an action is forbidden, by code; published rules first, then corrections."""

unexplained = set(range(1, code.PATTERN_MATCHES)) - REASONS.keys()
if unexplained:
    raise RuntimeError(
        f"code {min(unexplained)} of craftsim/discrete/kernel/codes.py has no words in craftsim/discrete/rules.py"
    )


@dataclass(frozen=True)
class Explanation:
    """The reason why an action is forbidden, or that it is legal; ``str()`` gives it in one line."""

    action: Action
    reason: str = ""
    """The reason in words; empty if the action is legal."""
    correction: Correction | None = None
    """The correction that forbids it; None where the published rules do, too, and where a learned rule does."""
    cells: tuple[Cell, ...] = ()
    """The cells concerned."""
    heading: str = ""
    """Heading of docs/rules.md under which the correction is explained."""
    learned: str = ""
    """Name of the learned rule that forbids it."""

    def __str__(self) -> str:
        if self.legal:
            return f"{self.action.name} is legal"
        return f"{self.action.name} is forbidden: {self.why}"

    @property
    def legal(self) -> bool:
        """Whether nothing forbids it."""
        return not self.reason

    @property
    def why(self) -> str:
        """The reason, and the correction with its place in the docs where one forbids the action."""
        if self.correction is None:
            return self.reason
        return f"{self.reason} ({self.correction.name}, docs/rules.md#{self.heading})"


def explain(grid: Grid, rules: Rules, car: int, action: Action) -> Explanation:
    """Return why an action of a car is forbidden by some rules, or that it is legal."""
    corrections = rules.corrections
    if is_registered(action):
        words = registered_reason(grid, corrections, car, action)
        if not words:
            return Explanation(action)
        return Explanation(action, words, None, (cell_of(grid, car),))

    def why(grid: Grid) -> int:
        return _reason(*grid.world(corrections, rules.patterns), car, int(action))

    result = why(grid)
    if result == code.LEGAL:
        return Explanation(action)
    if result & ((1 << code.DETAIL_BITS) - 1) == code.PATTERN_MATCHES and rules.learned is not None:
        rule = rules.learned.rules[result >> code.DETAIL_BITS]
        cells = pattern_cells(grid, rule, car, action)
        words = f"the learned rule '{rule.name}' forbids it: {rule}"
        return Explanation(action, words, None, cells, "", rule.name)
    reason = REASONS[result & ((1 << code.DETAIL_BITS) - 1)]
    case = _Case(grid, car, action, result >> code.DETAIL_BITS)
    if reason.correction is None:
        cells = tuple(case.place(name) for name in reason.cells)
        return Explanation(action, case.format(reason.words), None, cells)
    obstacles = list(_in_the_way(grid, car, lambda without: why(without) == code.LEGAL))
    words = reason.words
    if obstacles:
        words += ": " + "; ".join(text for _, text in obstacles)
    cells = tuple(dict.fromkeys(cell for cell, _ in obstacles)) or (case.place("own"),)
    return Explanation(action, words, reason.correction, cells, reason.heading)


def _in_the_way(grid: Grid, car: int, legal: Callable[[Grid], bool]) -> Iterator[tuple[Cell, str]]:
    """Yield each thing and each other car nearby without which the action is legal, with its cell."""
    x, y, z = cell_of(grid, car)
    for other_car, row in enumerate(grid.cars.tolist()):
        cell = cell_of(grid, other_car)
        if other_car == car or max(abs(cell[0] - x), abs(cell[1] - y)) > _NEAR:
            continue
        without = grid.copy()
        without.cars[other_car, CarField.Z] += grid.size[2] + 1 + _NEAR
        if legal(without):
            load = ""
            if row[CarField.LOAD] != Kind.AIR:
                load = f" with {NAMES[Kind(row[CarField.LOAD])]}"
            yield cell, f"car {other_car}{load} is in {cell}"
    first = np.maximum((x - _NEAR, y - _NEAR, z - 1), (0, 0, 1))
    kinds_near = grid.kind[first[0] : x + _NEAR + 1, first[1] : y + _NEAR + 1, first[2] : z + 3]
    for cell in map(tuple, (np.argwhere(kinds_near != Kind.AIR) + first).tolist()):
        without = grid.copy()
        without.kind[cell] = Kind.AIR
        if cell != (x, y, z) and legal(without):
            yield cell, f"{NAMES[Kind(grid.kind[cell])]} is in {cell}"


class _Case(Formatter):
    """A forbidden action, which writes a reason's words."""

    def __init__(self, grid: Grid, car: int, action: Action, detail: int) -> None:
        self.grid = grid
        self.car = car
        self.detail = detail
        *_, self.yaw, self.load, self.load_yaw, _ = grid.cars[car].tolist()
        self.own = cell_of(grid, car)
        self.direction = MOVE_DIRECTION.get(action, 0)
        if action == Action.ROTATE_LEFT:
            self.turn = 1
        else:
            self.turn = -1

    def get_field(self, field_name: str, args: object, kwargs: object) -> tuple[Any, str]:
        """Return what a field of the words stands for: a car's number, a load's name or the cell of a place."""
        if field_name == "car":
            return self.detail, field_name
        if field_name == "load":
            return NAMES[Kind(self.load)], field_name
        return self.place(field_name), field_name

    def format_field(self, value: Any, format_spec: str) -> str:
        """Return a field's text: after a place ``what`` is there, ``if any``, its ``occupant``, or a ``blocker``."""
        if not format_spec:
            return str(value)
        x, y, z = cell = value
        length, width, _ = self.grid.size
        inside = 0 <= x < length and 0 <= y < width
        # Above the map there is air.
        named = "the end of the map"
        if inside:
            named = NAMES[self.grid.kind_at(cell)]
        if format_spec == "if any":
            if named == "nothing":
                return ""
            return f": {named}"
        if format_spec == "occupant":
            if self.detail >= 0:
                return f"car {self.detail}"
            above = self.format_field((x, y, z + 1), "what")
            if above == "nothing":
                return "so says its mark, left by past events"
            return above
        if format_spec == "blocker":
            for car in range(self.grid.n_cars):
                if car != self.car and cell_of(self.grid, car) == cell:
                    return f"car {car}"
            if named == "nothing":
                return "a gear that another car carries"
            return named
        return named

    def place(self, name: str) -> Cell:
        """Return the cell of a place."""
        side, _, inner = name.partition(" ")
        if side == "above":
            x, y, z = self.place(inner)
            return x, y, z + 1
        if side == "under":
            x, y, z = self.place(inner)
            return x, y, z - 1
        return _PLACES[name](self)


def _ahead(case: _Case, cells: int) -> Cell:
    """Return the cell so many ahead in the direction of a move."""
    if cells:
        return beside(_ahead(case, cells - 1), case.direction)
    return case.own


_PLACES: Final[dict[str, Callable[[_Case], Cell]]] = {
    "own": lambda case: case.own,
    "foot": lambda case: beside(case.own, int(case.grid.yaw[case.own])),
    "side": lambda case: beside(case.own, case.detail),
    "corner": lambda case: beside(beside(case.own, case.load_yaw), case.load_yaw + case.turn),
    "other": lambda case: cell_of(case.grid, case.detail),
    "other gear": lambda case: beside(
        case.place("other"), int(case.grid.cars[case.detail, CarField.LOAD_YAW])
    ),
    "swept": lambda case: beside(beside(case.own, case.yaw + 2), case.direction),
    "target": lambda case: _ahead(case, 1),
    "second": lambda case: _ahead(case, 2),
    "third": lambda case: _ahead(case, 3),
}
"""The places that reasons name; ``above`` and ``under`` may precede each.

``foot`` is that of the slope in the own cell, ``side`` and ``other`` are named by the reason's detail, ``swept`` is
passed by the gear of a carried slope, the last three lie in the direction of a move.
"""
