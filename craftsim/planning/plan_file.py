"""Plans: which car does what in which tick, as text that people read and write.

One action a line, ``tick car ACTION``; ``#`` starts a comment. Ticks never go back; within a tick the cars
act in the order of their lines. Cars that a tick does not name stay as they are. After the action may stand order
constraints, ``8 2 MOVE_RIGHT after 0:7 1:7``: it starts when car 0's action of tick 7 and car 1's have ended.

A list of actions, to be tried one after the other, has only ``car ACTION`` a line.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, NamedTuple, NoReturn

from craftsim.discrete.actions import action_names
from craftsim.discrete.files.shipped import find_file
from craftsim.discrete.kinds import Action, PlanTick, TeamAction
from craftsim.discrete.schedule import Constraints, Schedule
from craftsim.errors import InputError, PlanError, suggestion
from craftsim.storage.limits import TEXT
from craftsim.storage.reading import read_text
from craftsim.storage.writing import write_whole

_MAX_TICK: Final = 100_000

_NUMBER: Final = re.compile(r"[0-9]{1,9}")
_REFERENCE: Final = re.compile(r"([0-9]{1,9}):([0-9]{1,9})")
_LINE: Final = "tick car ACTION, or tick car ACTION after CAR:TICK ..."


@dataclass(frozen=True)
class Plan:
    """A checked plan.

    Example:
        >>> import craftsim
        >>> plan = craftsim.read_plan("strip", n_cars=2)
        >>> [(car, action.name) for car, action in plan.ticks[0]]
        [(0, 'MOVE_RIGHT'), (1, 'MOVE_RIGHT')]
    """

    path: Path
    ticks: tuple[PlanTick, ...]
    """The actions of the cars, tick by tick."""
    after: Constraints = field(default_factory=dict, hash=False)
    """Order constraints: by the (tick, car) of an action those of other cars' earlier ones that must have ended."""


def read_plan(path: str | Path, n_cars: int) -> Plan:
    """Read and check a plan, or a shipped one by its name, for a world with ``n_cars`` cars.

    Raises PlanError with file and line.

    Example:
        >>> import craftsim
        >>> len(craftsim.read_plan("strip", n_cars=2).ticks)
        11
    """
    ticks: list[list[tuple[int, Action]]] = []
    after: dict[tuple[int, int], tuple[tuple[int, int], ...]] = {}
    acts: set[tuple[int, int]] = set()
    path, lines = _lines(path, _LINE)
    for line in lines:
        if len(line.words) != 3 and line.words[3:4] != ["after"]:
            line.fail(f"{len(line.words)} words, but a line is: {_LINE}")
        tick = line.tick()
        if tick + 1 < len(ticks):
            last = len(ticks) - 1
            line.fail(f"tick {tick} comes after tick {last}; allowed: {last} or later")
        car, action = line.act(line.words[1:3], n_cars)
        if len(line.words) > 3:
            after[tick, car] = line.after(car, acts)
        ticks.extend([] for _ in range(tick + 1 - len(ticks)))
        if any(car == acting for acting, _ in ticks[tick]):
            line.fail(f"car {car} acts twice in tick {tick}; allowed: once")
        ticks[tick].append((car, action))
        acts.add((tick, car))
    return Plan(path, tuple(tuple(tick) for tick in ticks), after)


def read_actions(path: str | Path, n_cars: int) -> Plan:
    """Read and check a list of actions, ``car ACTION`` a line, as a plan of one action a tick.

    Raises PlanError with file and line.
    """
    path, lines = _lines(path, "car ACTION")
    actions = []
    for line in lines:
        if len(line.words) != 2:
            line.fail(f"{len(line.words)} words, but a line is: car ACTION")
        actions.append((line.act(line.words, n_cars),))
    return Plan(path, tuple(actions))


def plan_text(ticks: Iterable[TeamAction], after: Constraints | None = None) -> str:
    """Return the text of a plan; ``after`` as of :class:`Plan`."""
    lines = []
    for tick, team_action in enumerate(ticks):
        for car, action in team_action:
            line = f"{tick} {car} {Action(action).name}"
            constraints = (after or {}).get((tick, car), ())
            if constraints:
                line += " after"
            for earlier_tick, earlier_car in constraints:
                line += f" {earlier_car}:{earlier_tick}"
            lines.append(f"{line}\n")
    return "".join(lines)


def write_plan(
    ticks: Plan | Iterable[TeamAction], path: str | Path, schedule: Schedule | None = None
) -> None:
    """Write a plan, or its ticks, into a file that :func:`read_plan` reads; the file is whole or not there.

    Args:
        ticks: the plan.
        path: of the file.
        schedule: of this plan, whose order constraints are written; those of the plan itself unless given.

    Raises InputError for a plan without any action, and if the file cannot be written.

    Example:
        >>> import craftsim
        >>> craftsim.write_plan([[(0, craftsim.Action.MOVE_RIGHT)]], folder / "mine.plan")
        >>> craftsim.read_plan(folder / "mine.plan", n_cars=1).ticks
        (((0, <Action.MOVE_RIGHT: 9>),),)
    """
    after: Constraints = {}
    if isinstance(ticks, Plan):
        after = ticks.after
        ticks = ticks.ticks
    if schedule is not None:
        after = schedule.constraints()
    text = plan_text(ticks, after)
    if not text:
        raise InputError(f"{path}: the plan has no actions")
    write_whole(path, text)


class _Line(NamedTuple):
    path: Path
    number: int
    words: list[str]

    def fail(self, message: str) -> NoReturn:
        raise PlanError(f"{self.path}:{self.number}: {message}")

    def tick(self) -> int:
        text = self.words[0]
        if not _NUMBER.fullmatch(text):
            self.fail(f"tick '{text[:40]}' must be a whole number from 0 to {_MAX_TICK}")
        if int(text) > _MAX_TICK:
            self.fail(f"tick {int(text)} is out of range, allowed: 0 to {_MAX_TICK}")
        return int(text)

    def act(self, words: list[str], n_cars: int) -> tuple[int, Action]:
        car, name = words
        if not _NUMBER.fullmatch(car) or int(car) >= n_cars:
            cars = "there are no cars"
            if n_cars:
                cars = f"there are cars 0 to {n_cars - 1}"
            self.fail(f"no car '{car[:40]}'; {cars}")
        names = action_names()
        if name not in names:
            hint = suggestion(name[:80].upper(), names)
            self.fail(f"unknown action '{name[:40]}'{hint}; allowed: {', '.join(names)}")
        return int(car), Action[name]

    def after(self, car: int, acts: Collection[tuple[int, int]]) -> tuple[tuple[int, int], ...]:
        """Return the order constraints of ``car``; ``acts`` are the (tick, car) of the lines before."""
        if not self.words[4:]:
            self.fail(f"'after' names no action; a line is: {_LINE}")
        constraints: list[tuple[int, int]] = []
        for word in self.words[4:]:
            match = _REFERENCE.fullmatch(word)
            if match is None:
                self.fail(f"after '{word[:40]}', but an action is named CAR:TICK, such as 0:7")
            earlier_car = int(match[1])
            earlier_tick = int(match[2])
            if earlier_car == car:
                self.fail(
                    f"after '{word}', but car {car} waits for its own actions anyway; leave it out"
                )
            if (earlier_tick, earlier_car) not in acts:
                self.fail(
                    f"after '{word}', but no line before this one is of car {earlier_car} in tick {earlier_tick}"
                )
            if (earlier_tick, earlier_car) in constraints:
                self.fail(f"after '{word}' stands twice; allowed: once")
            constraints.append((earlier_tick, earlier_car))
        return tuple(constraints)


def _lines(path: str | Path, form: str) -> tuple[Path, list[_Line]]:
    """Return the path of a file, and its lines that have words, one or more; ``form`` says what a line is."""
    try:
        path = find_file(path, "plans")
        text = read_text(path, TEXT)
    except InputError as error:
        raise PlanError(str(error)) from None
    lines = []
    for number, line in enumerate(text.split("\n"), start=1):
        words = line.split("#", 1)[0].split()
        if words:
            lines.append(_Line(path, number, words))
    if not lines:
        raise PlanError(f"{path}: no actions; a line is: {form}")
    return path, lines
