"""Rules as PDDL, and the world and goal of a task as a problem, for planners that others have written.

Actions are those of a car in a cell, typed STRIPS with the car as the parameter; what never changes is worked out here.
Preconditions are positive, since many planners take no others; so what a cell has not is a predicate, too. Learned
rules are further preconditions; one that names several cells splits an action into one for each cell in which it may
fail to match. Worlds without slopes can be written: there cars stay on their levels, and loads lean nowhere.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Final

import numpy as np

from craftsim.discrete.grid import CarField, Cell, Grid, Kind, beside
from craftsim.discrete.kernel import patterns as bits
from craftsim.discrete.kinds import MOVE_DIRECTION, Action, PlanTick
from craftsim.discrete.learned import CAR_STATES, Variant, variants
from craftsim.discrete.rules import Rules
from craftsim.errors import InputError
from craftsim.storage.folders import output_directory
from craftsim.storage.writing import write_whole
from craftsim.tasks import Task

_LOADS: Final = ("none", "block", "flag")
_DIRECTIONS: Final = ("east", "north", "west", "south")
"""Names of the grid yaws."""
_MOVES: Final = {direction: action for action, direction in MOVE_DIRECTION.items()}
_HEADINGS: Final = ("ahead", "left", "back", "right")
_MOST_SPLIT: Final = 256
"""Actions into which learned rules may split one."""
_THINGS: Final = {1: "air", 1 << bits.BLOCK_BIT: "block", 1 << bits.FLAG_BIT: "flag"}
"""What a cell may have at some time, by its bit."""
_CARS: Final = {1 << bits.CAR_BIT: "unloaded-car", 4 << bits.CAR_BIT: "loaded-car"}
"""The same of other cars."""
_FIXED: Final = {Kind.GROUND: 4, Kind.WALL: 8}
_PREDICATES: Final = (
    *("air", "block", "flag", "bears"),
    *("no-air", "no-block", "no-flag", "no-unloaded-car", "no-loaded-car"),
)
"""Predicates of cells; a cell that bears has a block. Without ``no-`` there is none of cars, for theirs is at-cell."""
_NAME: Final = re.compile(r"\(?\s*([a-z0-9-]+)\s+car-(\d+)\s*\)?", re.IGNORECASE)


@dataclass
class _GroundAction:
    """An action of any car in a cell."""

    name: str
    needs: set[str] = field(default_factory=set)
    effects: list[str] = field(default_factory=list)


class _Exporter:
    """Writes the actions of cars in a world."""

    def __init__(self, grid: Grid, rules: Rules) -> None:
        self.grid = grid
        self.variants: list[Variant] = []
        if rules.learned is not None:
            for rule in rules.learned.rules:
                self.variants += variants(rule)
        self.cells = set[Cell]()
        """Cells that predicates name."""

    def actions(self) -> Iterator[_GroundAction]:
        """Yield the actions of cars on the levels on which there are cars."""
        length, width, _ = self.grid.size
        levels = sorted(set(self.grid.cars[:, CarField.Z].tolist()))
        for z, x, y in product(levels, range(length), range(width)):
            if self._fixed((x, y, z)) == 0:
                for yaw, load in product(range(4), _LOADS):
                    yield from self._of_car((x, y, z), yaw, load)

    def _of_car(self, cell: Cell, yaw: int, load: str) -> Iterator[_GroundAction]:
        at = {
            f"(at-cell ?c {_name(cell)})",
            f"(heads ?c {_DIRECTIONS[yaw]})",
            f"(carries-{load} ?c)",
        }
        for direction, action in sorted(_MOVES.items()):
            heading = (yaw - direction) % 4
            for thing in ("air", "block", "flag"):
                move = self._move(cell, direction, heading, load, thing)
                if move is not None:
                    yield from self._learned(
                        "MOVE", action, move, at, cell, direction, heading, load
                    )
        for action, turn in ((Action.ROTATE_LEFT, 1), (Action.ROTATE_RIGHT, -1)):
            needs = set[str]()
            if load != "none":
                around = [beside(cell, direction) for direction in range(4)]
                if any(self._fixed(neighbour) for neighbour in around):
                    continue
                for neighbour in around:
                    needs |= {self._has("air", neighbour), self._has("no-loaded-car", neighbour)}
            effects = [
                f"(not (heads ?c {_DIRECTIONS[yaw]}))",
                f"(heads ?c {_DIRECTIONS[(yaw + turn) % 4]})",
            ]
            turned = _GroundAction("", needs, effects)
            yield from self._learned(action.name, action, turned, at, cell, yaw, 0, load)
        if load == "none":
            for thing in ("block", "flag"):
                lift = self._exchanged(cell, thing, is_lift=True)
                yield from self._learned("LIFT", Action.LIFT, lift, at, cell, yaw, 0, load)
        elif cell[2] <= self.grid.size[2]:
            drop = self._exchanged(cell, load, is_lift=False)
            yield from self._learned("DROP", Action.DROP, drop, at, cell, yaw, 0, load)

    def _move(
        self, cell: Cell, direction: int, heading: int, load: str, thing: str
    ) -> _GroundAction | None:
        """Return a move into a cell with this thing; None where that is never allowed."""
        target = beside(cell, direction)
        below = (target[0], target[1], target[2] - 1)
        is_under = thing != "air"
        is_sideways = heading % 2 == 1
        if self._fixed(target) or (is_under and (is_sideways or load != "none")):
            return None
        if self._fixed(below) not in (0, _FIXED[Kind.GROUND]):
            return None
        needs = {
            self._has(thing, target),
            self._has("no-unloaded-car", target),
            self._has("no-loaded-car", target),
        }
        if self._fixed(below) == 0:
            needs.add(self._has("bears", below))
        if is_sideways:
            needs.add(self._has("air", cell))
        word = "loaded"
        if load == "none":
            word = "unloaded"
        effects = [
            f"(not (at-cell ?c {_name(cell)}))",
            f"(at-cell ?c {_name(target)})",
            self._has(f"no-{word}-car", cell),
            f"(not {self._has(f'no-{word}-car', target)})",
        ]
        return _GroundAction(f"-{thing}", needs, effects)

    def _exchanged(self, cell: Cell, thing: str, is_lift: bool) -> _GroundAction:
        """Return the lift, or the drop, of a thing in a cell."""
        in_cell = [
            self._has(thing, cell),
            self._has("no-air", cell),
            self._has("no-loaded-car", cell),
        ]
        in_cell.append("(carries-none ?c)")
        on_car = [
            self._has(f"no-{thing}", cell),
            self._has("air", cell),
            self._has("no-unloaded-car", cell),
            f"(carries-{thing} ?c)",
        ]
        if thing == "block":
            in_cell.append(self._has("bears", cell))
        needs = {self._has("air", cell)}
        gone, new = on_car, in_cell
        if is_lift:
            gone, new = in_cell, on_car
            needs = {self._has(thing, cell)}
            above = (cell[0], cell[1], cell[2] + 1)
            if self._fixed(above) == 0:
                for predicate in ("no-block", "no-flag", "no-unloaded-car", "no-loaded-car"):
                    needs.add(self._has(predicate, above))
        return _GroundAction(f"-{thing}", needs, [*(f"(not {fact})" for fact in gone), *new])

    def _learned(
        self,
        verb: str,
        action: Action,
        plain: _GroundAction,
        at: set[str],
        cell: Cell,
        frame: int,
        heading: int,
        load: str,
    ) -> Iterator[_GroundAction]:
        """Yield an action with what learned rules ask for, once for each way in which none of them matches."""
        level = "floor"
        if cell[2] > 1:
            level = "above"
        state = CAR_STATES.index(
            {"load": load, "stance": "flat", "level": level, "heading": _HEADINGS[heading]}
        )
        ways: list[list[frozenset[str]]] = []
        for variant in self.variants:
            if bits.VERBS[variant.verb] == verb and state in variant.states:
                alternatives = self._alternatives(variant, cell, frame)
                if alternatives is not None:
                    ways.append(alternatives)
        n_split = int(np.prod([len(alternatives) for alternatives in ways], initial=1))
        if n_split > _MOST_SPLIT:
            raise InputError(
                f"the learned rules split {action.name} in {cell} into {n_split} actions; allowed: {_MOST_SPLIT}"
            )
        for number, chosen in enumerate(product(*ways)):
            needs = at | plain.needs
            for alternative in chosen:
                needs = needs | alternative
            if not _contradicts(needs):
                words = [action.name.lower().replace("_", "-") + plain.name, load]
                words += [_DIRECTIONS[frame], _HEADINGS[heading], _name(cell)]
                if n_split > 1:
                    words.append(str(number))
                yield _GroundAction("-".join(words), needs, plain.effects)

    def _alternatives(
        self, variant: Variant, cell: Cell, frame: int
    ) -> list[frozenset[str]] | None:
        """Return the ways in which a pattern does not match; None where it never does."""
        alternatives = []
        dx, dy = ((1, 0), (0, 1), (-1, 0), (0, -1))[frame]
        for forward, aside, up, allowed in variant.cells:
            x = cell[0] + forward * dx - aside * dy
            y = cell[1] + forward * dy + aside * dx
            place = (x, y, cell[2] + up)
            fixed = self._fixed(place)
            if fixed & allowed:
                continue
            absent = set()
            if fixed == 0:
                for bit, predicate in (*_THINGS.items(), *_CARS.items()):
                    is_self = place == cell and bit in _CARS
                    if allowed & bit and not is_self:
                        absent.add(self._has(f"no-{predicate}", place))
            if not absent:
                return None
            alternatives.append(frozenset(absent))
        return alternatives

    def _fixed(self, cell: Cell) -> int:
        """Return the bit of what a cell always has: nothing beside the map, ground, a wall; 0 for what may change."""
        x, y, z = cell
        length, width, height = self.grid.size
        if not (0 <= x < length and 0 <= y < width) or z < 0:
            return 1 << bits.OUTSIDE_BIT
        if z > height:
            return 0
        return _FIXED.get(Kind(self.grid.kind[cell]), 0)

    def _has(self, predicate: str, cell: Cell) -> str:
        self.cells.add(cell)
        return f"({predicate} {_name(cell)})"


def _contradicts(needs: set[str]) -> bool:
    """Return whether a cell would have to have something and not to have it."""
    for need in needs:
        predicate, _, place = need[1:-1].partition(" ")
        if f"(no-{predicate} {place})" in needs:
            return True
    return False


def _name(cell: Cell) -> str:
    return "c-" + "-".join(map(str, cell))


def write_pddl(task: Task, rules: Rules, out: Path) -> tuple[Path, Path]:
    """Write ``domain.pddl`` and ``problem.pddl`` of a task under some rules into a folder, and return their paths.

    Raises InputError for a world or a goal with slopes, a task that builds nothing, and ``physical``, whose corrections
    are code.
    """
    grid = task.draw(np.random.default_rng(0))
    if rules.rule_set == "physical" or (
        rules.learned is not None and rules.learned.base == "physical"
    ):
        raise InputError(
            "the corrections of physical are code; PDDL is written for published and for what is learned on it"
        )
    if (
        np.isin(grid.kind, (Kind.FSLOPE, Kind.BODY)).any()
        or (grid.cars[:, CarField.LOAD] == Kind.FSLOPE).any()
    ):
        raise InputError(f"task '{task.name}' has slopes, for which PDDL is not written yet")
    if task.design is None:
        raise InputError(f"task '{task.name}' has no design, so that there is nothing to plan for")
    exporter = _Exporter(grid, rules)
    actions = list(exporter.actions())
    goals = []
    for piece in task.design.targets:
        if piece.kind not in (Kind.BLOCK, Kind.FLAG):
            raise InputError(f"task '{task.name}' builds slopes, for which PDDL is not written yet")
        goals.append(f"({piece.kind.name.lower()} {_name(piece.cell)})")
        exporter.cells.add(piece.cell)
    folder = output_directory(out)
    domain = folder / "domain.pddl"
    problem = folder / "problem.pddl"
    write_whole(domain, _domain(actions, exporter.cells))
    write_whole(problem, _problem(grid, exporter.cells, goals))
    return domain, problem


def _domain(actions: Iterable[_GroundAction], cells: Iterable[Cell]) -> str:
    lines = [
        "(define (domain craftsim)",
        "  (:requirements :strips :typing)",
        "  (:types car cell direction)",
        f"  (:constants {' '.join(_DIRECTIONS)} - direction",
        f"    {' '.join(map(_name, sorted(cells)))} - cell)",
        "  (:predicates (at-cell ?c - car ?x - cell) (heads ?c - car ?d - direction)",
        f"    {' '.join(f'(carries-{load} ?c - car)' for load in _LOADS)}",
        f"    {' '.join(f'({predicate} ?x - cell)' for predicate in _PREDICATES)})",
    ]
    for action in actions:
        lines += [
            f"  (:action {action.name}",
            "    :parameters (?c - car)",
            f"    :precondition (and {' '.join(sorted(action.needs))})",
            f"    :effect (and {' '.join(action.effects)}))",
        ]
    return "\n".join([*lines, ")", ""])


def _problem(grid: Grid, cells: Iterable[Cell], goals: Sequence[str]) -> str:
    cars = [f"car-{car}" for car in range(grid.n_cars)]
    facts = []
    loaded_by_cell: dict[Cell, bool] = {}
    for car, (x, y, z, yaw, load, *_) in enumerate(grid.cars.tolist()):
        word = "none"
        if load:
            word = Kind(load).name.lower()
        loaded_by_cell[x, y, z] = load != Kind.AIR
        facts += [
            f"(at-cell car-{car} {_name((x, y, z))})",
            f"(heads car-{car} {_DIRECTIONS[yaw]})",
        ]
        facts.append(f"(carries-{word} car-{car})")
    for cell in sorted(cells):
        facts += _facts_of(grid, cell, loaded_by_cell)
    return "\n".join(
        [
            "(define (problem task)",
            "  (:domain craftsim)",
            f"  (:objects {' '.join(cars)} - car)",
            f"  (:init {' '.join(facts)})",
            f"  (:goal (and {' '.join(goals)})))",
            "",
        ]
    )


def _facts_of(grid: Grid, cell: Cell, loaded_by_cell: Mapping[Cell, bool]) -> Iterator[str]:
    """Yield what a cell has and has not at the start."""
    kind = grid.kind_at(cell)
    thing = {Kind.AIR: "air", Kind.BLOCK: "block", Kind.FLAG: "flag"}[kind]
    yield f"({thing} {_name(cell)})"
    if kind == Kind.BLOCK:
        yield f"(bears {_name(cell)})"
    for other_thing in ("air", "block", "flag"):
        if other_thing != thing:
            yield f"(no-{other_thing} {_name(cell)})"
    if loaded_by_cell.get(cell) is not True:
        yield f"(no-loaded-car {_name(cell)})"
    if loaded_by_cell.get(cell) is not False:
        yield f"(no-unloaded-car {_name(cell)})"


def plan_of_pddl(lines: Iterable[str]) -> tuple[PlanTick, ...]:
    """Return the plan in a planner's solution, an action a line and tick. Raises InputError for a line that is none."""
    names = sorted((action.name.lower().replace("_", "-"), action) for action in Action)
    ticks = []
    for number, line in enumerate(lines, start=1):
        text = line.partition(";")[0].strip()
        if not text:
            continue
        match = _NAME.fullmatch(text)
        actions = []
        if match is not None:
            actions = [action for name, action in names if match[1].lower().startswith(f"{name}-")]
        if match is None or not actions:
            raise InputError(
                f"line {number} of the solution is no action of the domain: '{text[:80]}'"
            )
        action = max(actions, key=lambda action: len(action.name))
        ticks.append(((int(match[2]), action),))
    return tuple(ticks)
