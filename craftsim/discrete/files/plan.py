"""Plans: which car does what in which tick, as text that people read and write.

One action a line, ``tick car ACTION``; ``#`` starts a comment. Ticks never go back; within a tick the cars
act in the order of their lines. Cars that a tick does not name stay as they are.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from importlib.resources import as_file, files
from pathlib import Path
from typing import Final, NoReturn

from craftsim.discrete.actions import Action
from craftsim.discrete.errors import BlueprintError, PlanError, suggestion
from craftsim.discrete.files.documents import read_text

MAX_TICK: Final = 100_000

_NUMBER: Final = re.compile(r"[0-9]{1,9}")
_NAMES: Final = [action.name for action in Action]


@dataclass(frozen=True)
class Plan:
    """A checked plan."""

    path: Path
    ticks: tuple[tuple[tuple[int, Action], ...], ...]
    """For each tick the (car, action) pairs in acting order; a tick may be empty."""


def shipped_plan(name: str) -> Path:
    """Return the path of a shipped plan, named as the task that it builds."""
    with as_file(files("craftsim") / "data" / "plans" / f"{name}.plan") as path:
        return path


def read_plan(path: str | Path, n_cars: int) -> Plan:
    """Read and check a plan for a world with ``n_cars`` cars; raise PlanError with file and line."""
    path = Path(path)

    def fail(line: int | None, message: str) -> NoReturn:
        raise PlanError(f"{path}:{line}: {message}" if line is not None else f"{path}: {message}")

    def number(text: str, line: int, what: str, limit: int) -> int:
        if not _NUMBER.fullmatch(text):
            fail(line, f"{what} '{text[:40]}' must be a whole number from 0 to {limit}")
        if int(text) > limit:
            fail(line, f"{what} {int(text)} is out of range, allowed: 0 to {limit}")
        return int(text)

    try:
        text = read_text(path)
    except BlueprintError as error:
        raise PlanError(str(error)) from None
    ticks: list[list[tuple[int, Action]]] = []
    for line, content in enumerate(text.split("\n"), start=1):
        words = content.split("#", 1)[0].split()
        if not words:
            continue
        if len(words) != 3:
            fail(line, f"{len(words)} words, but a line is: tick car ACTION")
        tick = number(words[0], line, "tick", MAX_TICK)
        if tick + 1 < len(ticks):
            fail(line, f"tick {tick} comes after tick {len(ticks) - 1}; allowed: {len(ticks) - 1} or later")
        if not _NUMBER.fullmatch(words[1]) or int(words[1]) >= n_cars:
            cars = f"there are cars 0 to {n_cars - 1}" if n_cars else "there are no cars"
            fail(line, f"no car '{words[1][:40]}'; {cars}")
        car = int(words[1])
        if words[2] not in _NAMES:
            hint = suggestion(words[2][:80], _NAMES)
            fail(line, f"unknown action '{words[2][:40]}'{hint}; allowed: {', '.join(_NAMES)}")
        ticks.extend([] for _ in range(tick + 1 - len(ticks)))
        if any(car == other for other, _ in ticks[tick]):
            fail(line, f"car {car} acts twice in tick {tick}; allowed: once")
        ticks[tick].append((car, Action[words[2]]))
    if not ticks:
        fail(None, "no actions; a line is: tick car ACTION")
    return Plan(path, tuple(tuple(tick) for tick in ticks))
