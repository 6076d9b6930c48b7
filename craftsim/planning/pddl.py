"""Rules as PDDL, and the world and goal of a task as a problem, for planners that others have written.

Actions are those of a car in a cell, typed STRIPS with the car as the parameter; what never changes is worked out here.
Preconditions are positive, since many planners take no others; so what a cell has not is a predicate, too. An action
that is legal in several cases is written once for each. Left out is what no play of the world can lead to, even if
nothing ever went away.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from itertools import chain
from pathlib import Path
from typing import Final

import numpy as np

from craftsim.discrete.files.design import ANY_YAW
from craftsim.discrete.grid import Cell, Grid, Kind
from craftsim.discrete.kinds import NAMES, Action, PlanTick
from craftsim.discrete.rules import Rules
from craftsim.errors import InputError
from craftsim.planning.undecided import UndecidedWorld
from craftsim.planning.variables import (
    PROPERTIES,
    YAW_NAMES,
    LegalCase,
    Stance,
    Variable,
    conceivable,
    merged,
    own_things,
    stance_of,
    things_mask,
    variables_of,
)
from craftsim.storage.folders import output_directory
from craftsim.storage.writing import write_whole
from craftsim.tasks import Task

_MOST_CASES: Final = 256
"""Actions into which one action of a car in a cell may be split."""
_ACTIONS: Final = tuple(action for action in Action if action < Action.STOP)
_NAME: Final = re.compile(r"\(?\s*([a-z0-9-]+)\s+car-(\d+)\s*\)?", re.IGNORECASE)


class PddlExport:
    """A world, with all that play of it may lead to, as PDDL."""

    def __init__(self, grid: Grid, rules: Rules) -> None:
        """Find all actions of a world.

        Raises InputError for rules that split an action into too many, and for cars that no play can bring where they
        are: with a load in a thing, or below a slope without heading uphill.
        """
        self._possible = variables_of(grid)
        """The bits that variables may come to have."""
        self._cases: dict[tuple[Stance, Action], list[LegalCase]] = {}
        new = {_start_of(grid, car) for car in range(grid.n_cars)}
        world = UndecidedWorld(grid, rules, conceivable(grid))
        while new:
            for stance in sorted(new):
                for action in _ACTIONS:
                    self._cases[stance, action] = self._find(world, stance, action)
            new = self._reached()
        self._actions = dict(self._named_cases())
        self._predicates = self._asked_for()

    def _find(self, world: UndecidedWorld, stance: Stance, action: Action) -> list[LegalCase]:
        cases = world.cases(stance, action)
        if cases is None:
            raise InputError(
                f"the rules leave too many cases to {action.name} in {stance.cell} to be written as PDDL"
            )
        return cases

    def _is_possible(self, case: LegalCase) -> bool:
        return all(
            self._possible.get(variable, 1) & mask for variable, mask in case.conditions.items()
        )

    def _reached(self) -> set[Stance]:
        """Add what the cases lead to that may come about, and return the cars that come about then and are new."""
        found = {stance for stance, _ in self._cases}
        new = set()
        grows = True
        while grows:
            grows = False
            for case in filter(self._is_possible, chain.from_iterable(self._cases.values())):
                if case.after not in found:
                    new.add(case.after)
                for variable, bit in case.effects.items():
                    before = self._possible.get(variable, 1)
                    if not before & bit:
                        grows = True
                        self._possible[variable] = before | bit
        return new

    def _named_cases(self) -> Iterator[tuple[str, tuple[Stance, LegalCase]]]:
        """Yield the actions by their names."""
        for (stance, action), conceived in self._cases.items():
            cases = merged(filter(self._is_possible, conceived), self._possible)
            if len(cases) > _MOST_CASES:
                raise InputError(
                    f"the rules split {action.name} in {stance.cell} into {len(cases)} actions; allowed: {_MOST_CASES}"
                )
            words = [
                action.name.lower().replace("_", "-"),
                _load(stance),
                YAW_NAMES[stance.car.yaw],
            ]
            words += [_place(stance), _name(stance.cell)]
            for number, case in enumerate(cases):
                own_words = words
                if len(cases) > 1:
                    own_words = [*words, str(number)]
                yield "-".join(own_words), (stance, case)

    def _asked_for(self) -> dict[Variable, set[str]]:
        """Return the predicates that preconditions have, by variable."""
        predicates: dict[Variable, set[str]] = {}
        for _, case in self._actions.values():
            for variable, mask in case.conditions.items():
                predicates.setdefault(variable, set()).update(self._predicates_of(variable, mask))
        return predicates

    def _predicates_of(self, variable: Variable, mask: int) -> list[str]:
        """Return the predicates that say that a variable has one of some values; none if it always has."""
        possible = self._possible.get(variable, 1)
        mask &= possible
        if mask == possible:
            return []
        values = PROPERTIES[variable.name]
        if mask.bit_count() == 1:
            return [values[mask.bit_length() - 1]]
        others = possible & ~mask
        return [f"not-{values[bit]}" for bit in range(len(values)) if others >> bit & 1]

    def facts(self, grid: Grid) -> Iterator[str]:
        """Yield the facts of a world that play of the first one has led to."""
        for car in range(grid.n_cars):
            yield from _facts_of_car(stance_of(grid, car), f"car-{car}")
        values = variables_of(grid)
        for variable in sorted(self._predicates):
            true, _ = self._facts_of(variable, values.get(variable, 1))
            yield from true

    def _facts_of(self, variable: Variable, value: int) -> tuple[list[str], list[str]]:
        """Return which facts about a variable are true, and which are not, as it has a value."""
        name = PROPERTIES[variable.name][value.bit_length() - 1]
        true = []
        false = []
        for predicate in sorted(self._predicates.get(variable, ())):
            fact = f"({predicate} {_name(variable.cell)})"
            other = predicate.removeprefix("not-")
            if (other == name) == (other == predicate):
                true.append(fact)
            else:
                false.append(fact)
        return true, false

    def goal(self, variable: Variable, mask: int) -> list[str]:
        """Return the facts of a goal: that a variable has one of some values. Raises InputError if it never has."""
        if not self._possible.get(variable, 1) & mask:
            raise InputError(
                f"by the rules nothing can bring to {variable.cell} what is to be built there"
            )
        predicates = self._predicates_of(variable, mask)
        self._predicates.setdefault(variable, set()).update(predicates)
        return [f"({predicate} {_name(variable.cell)})" for predicate in predicates]

    def domain(self) -> str:
        """Return the domain as a file has it, for what goals were asked for."""
        cells = {variable.cell for variable in self._predicates}
        cells |= {stance.cell for stance, _ in self._cases}
        car_predicates = {"at-cell ?c - car ?x - cell"}
        for stance, _ in self._cases:
            for predicate in _words_of_car(stance):
                car_predicates.add(f"{predicate} ?c - car")
        cell_predicates = set().union(*self._predicates.values())
        lines = [
            "(define (domain craftsim)",
            "  (:requirements :strips :typing)",
            "  (:types car cell)",
            f"  (:constants {' '.join(map(_name, sorted(cells)))} - cell)",
            "  (:predicates",
        ]
        for predicate in sorted(car_predicates):
            lines.append(f"    ({predicate})")
        for predicate in sorted(cell_predicates):
            lines.append(f"    ({predicate} ?x - cell)")
        lines[-1] += ")"
        for name, (stance, case) in self._actions.items():
            conditions = _facts_of_car(stance, "?c")
            for variable, mask in sorted(case.conditions.items()):
                place = _name(variable.cell)
                conditions += [f"({p} {place})" for p in self._predicates_of(variable, mask)]
            lines += [
                f"  (:action {name}",
                "    :parameters (?c - car)",
                f"    :precondition (and {' '.join(conditions)})",
                f"    :effect (and {' '.join(self._effects(stance, case))}))",
            ]
        return "\n".join([*lines, ")", ""])

    def _effects(self, stance: Stance, case: LegalCase) -> Iterator[str]:
        before = _facts_of_car(stance, "?c")
        after = _facts_of_car(case.after, "?c")
        for old, new in zip(before, after, strict=True):
            if old != new:
                yield f"(not {old})"
                yield new
        for variable, bit in sorted(case.effects.items()):
            if case.conditions.get(variable, self._possible.get(variable, 1)) != bit:
                true, false = self._facts_of(variable, bit)
                yield from (f"(not {fact})" for fact in false)
                yield from true


def _start_of(grid: Grid, car: int) -> Stance:
    """Return a car. Raises InputError for one that no play can bring there."""
    stance = stance_of(grid, car)
    x, y, z = stance.cell
    if z <= grid.size[2]:
        kind, yaw = grid.cells[x, y, z, :2].tolist()
        if not things_mask(Kind(kind), (yaw,)) & own_things(stance):
            raise InputError(
                f"car {car} in {stance.cell} is below {NAMES[Kind(kind)]}; allowed in PDDL: no load below a thing, "
                "and below a slope a car that heads uphill"
            )
    return stance


def _name(cell: Cell) -> str:
    return "c-" + "-".join(map(str, cell))


def _load(stance: Stance) -> str:
    car = stance.car
    if car.load == Kind.AIR:
        return "none"
    name = Kind(car.load).name.lower()
    if car.load == Kind.FSLOPE:
        name += f"-{YAW_NAMES[car.load_yaw]}"
    return name


def _place(stance: Stance) -> str:
    if stance.car.slope == 0:
        return "flat"
    return ("foot", "body")[stance.car.slope - 1] + f"-{YAW_NAMES[stance.downhill]}"


def _words_of_car(stance: Stance) -> tuple[str, str, str]:
    """Return a car's heading, its load, and the ramp that it is on."""
    heading = f"heads-{YAW_NAMES[stance.car.yaw]}"
    return heading, f"carries-{_load(stance)}", f"on-{_place(stance)}"


def _facts_of_car(stance: Stance, car: str) -> list[str]:
    """Return the facts about a car of some name."""
    facts = [f"(at-cell {car} {_name(stance.cell)})"]
    for word in _words_of_car(stance):
        facts.append(f"({word} {car})")
    return facts


def write_pddl(task: Task, rules: Rules, out: Path) -> tuple[Path, Path]:
    """Write ``domain.pddl`` and ``problem.pddl`` of a task under some rules into a folder, and return their paths.

    Raises InputError for a task that builds nothing, and for rules that split an action into too many.
    """
    targets = _targets(task)
    grid = task.draw(np.random.default_rng(0))
    export = PddlExport(grid, rules)
    goals: list[str] = []
    for variable, mask in targets.items():
        goals += export.goal(variable, mask)
    cars = " ".join(f"car-{car}" for car in range(grid.n_cars))
    problem_lines = [
        "(define (problem task)",
        "  (:domain craftsim)",
        f"  (:objects {cars} - car)",
        f"  (:init {' '.join(export.facts(grid))})",
        f"  (:goal (and {' '.join(goals)})))",
        "",
    ]
    folder = output_directory(out)
    domain = folder / "domain.pddl"
    problem = folder / "problem.pddl"
    write_whole(domain, export.domain())
    write_whole(problem, "\n".join(problem_lines))
    return domain, problem


def _targets(task: Task) -> dict[Variable, int]:
    """Return what a task wants in cells: the bits of which each has one."""
    if task.design is not None:
        targets: dict[Variable, int] = {}
        for piece in task.design.targets:
            yaws: tuple[int, ...] = (piece.yaw,)
            if piece.yaw == ANY_YAW:
                yaws = (0, 1, 2, 3)
            targets[Variable("thing", piece.cell)] = things_mask(piece.kind, yaws)
        return targets
    if task.success == "flag_at_goal" and task.goal_cell is not None:
        return {Variable("thing", task.goal_cell): things_mask(Kind.FLAG, (0,))}
    raise InputError(f"task '{task.name}' has no design, so that there is nothing to plan for")


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
