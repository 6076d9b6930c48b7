"""Do our rules do what CraftEnv did? Replays recordings and compares everything that they tell."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.grid import CarField, Grid, Kind
from craftsim.discrete.kernel.state import Correction
from craftsim.discrete.kinds import Action
from craftsim.discrete.records.schema import TASKS, Record
from craftsim.discrete.records.traces import recorded_grid
from craftsim.discrete.rules import Helper, Rules
from craftsim.discrete.tasks.batches import NO_TARGETS
from craftsim.discrete.tasks.measures import FlagNearness
from craftsim.discrete.tasks.observation import Layout
from craftsim.discrete.tasks.rewards import CodeBarrier
from craftsim.discrete.tasks.task import Task, make_task
from craftsim.discrete.tasks.worlds import Worlds

QUIRK_TAGS: Final = frozenset({"devdep", "overwrite", "lost", "shared", "unfold_on_car", "unsupport"})
"""Tags of records in which something happened that only the published rule set follows."""


@dataclass(frozen=True)
class Mismatch:
    """One thing in which a record and our rules differ."""

    where: str
    """Episode, tick and line."""
    what: str
    expected: str
    got: str
    before: Grid
    after_expected: Grid | None = None
    after_got: Grid | None = None


@dataclass
class Tally:
    """What was looked at so far."""

    records: int = 0
    skipped: int = 0
    """Records with a quirk tag, which the physical rule set need not follow."""
    corrected: int = 0
    """Ticks in which a correction of the physical rule set changes what is legal or what follows."""
    checks: Counter[str] = field(default_factory=Counter)
    """By what was compared."""
    mismatches: Counter[str] = field(default_factory=Counter)
    """By what was compared, as ``checks``."""
    actions: Counter[str] = field(default_factory=Counter)
    """Actions taken, by name."""
    applied: Counter[str] = field(default_factory=Counter)
    """Of these, the ones that were legal."""
    action_mismatches: Counter[str] = field(default_factory=Counter)
    """Actions, by name, whose applied flag or plan differs, or that a wrong mask entry is about."""
    first: list[Mismatch] = field(default_factory=list)
    """The first mismatches, up to the number to keep."""


def bits(row: Iterable[Any]) -> str:
    """Return booleans as a string of 0 and 1."""
    return "".join("1" if value else "0" for value in row)


@cache
def _task(name: str) -> Task:
    return make_task(TASKS[name], reward="published_code")


class Checker:
    """Compares records with a rule set and keeps the tally."""

    def __init__(self, rules: Rules, keep: int = 5) -> None:
        self.rules = rules
        self.keep = keep
        self.tally = Tally()
        self.exact = rules.rule_set == "published"
        self.uncorrected = Rules(rules.rule_set, Correction.derived_marks)
        """The physical rules before physics corrected them: nothing but the bookkeeping differs from published."""
        self._planner = Helper(rules)

    def check(self, line: int, record: Record) -> None:
        """Compare one record, of a tick or of plans."""
        self.tally.records += 1
        if not self.exact and QUIRK_TAGS & set(record.get("tags", ())):
            self.tally.skipped += 1
            return
        where = f"episode {record.get('ep', '?')} tick {record.get('t', '?')} (line {line})"
        before = recorded_grid(record["size"], record["before"])
        if "joint" in record:
            if not self.exact and self._is_corrected(record["joint"], before):
                self.tally.corrected += 1
                return
            self._tick(where, record, before)
        if "depth" in record:
            self._plans(where, record, before)

    def _is_corrected(self, joint: list[tuple[int, int]], before: Grid) -> bool:
        """Return whether a correction changes what is legal at the start of a tick, or what the tick leads to."""
        both = []
        for rules in (self.rules, self.uncorrected):
            after, applied = rules.tick(before, joint)
            both.append((rules.mask(before).tolist(), applied.tolist(), after))
        (mask, applied, after), (plain_mask, plain_applied, plain_after) = both
        return not (mask == plain_mask and applied == plain_applied and after.same_visible(plain_after))

    def _compare(self, where: str, what: str, expected: Any, got: Any, before: Grid, **grids: Grid) -> bool:
        self.tally.checks[what] += 1
        if expected == got:
            return True
        self.tally.mismatches[what] += 1
        if len(self.tally.first) < self.keep:
            self.tally.first.append(Mismatch(where, what, str(expected), str(got), before, **grids))
        return False

    def _masks(
        self, where: str, what: str, expected: list[str], got: NDArray[np.bool_], before: Grid
    ) -> None:
        for car, (wanted, row) in enumerate(zip(expected, got, strict=True)):
            if not self._compare(f"{where} car {car}", what, wanted, bits(row), before):
                wrong = [a.name for a, w, g in zip(Action, wanted, bits(row), strict=True) if w != g]
                self.tally.action_mismatches.update(wrong)

    def _tick(self, where: str, record: Record, before: Grid) -> None:
        self._masks(where, "mask", record["mask"], self.rules.mask(before), before)
        after, applied = self.rules.tick(before, record["joint"])
        expected = recorded_grid(record["size"], record["after"])
        grids = {"after_expected": expected, "after_got": after}
        for (car, action), wanted, got in zip(record["joint"], record["applied"], applied, strict=True):
            name = Action(action).name
            self.tally.actions[name] += 1
            self.tally.applied[name] += int(got)
            if not self._compare(
                f"{where} car {car} {name}", "applied", bool(wanted), bool(got), before, **grids
            ):
                self.tally.action_mismatches[name] += 1
        for what, wanted, got in _states(expected, after, self.exact):
            self._compare(where, what, wanted, got, before, **grids)
        if "task" in record:
            for what, wanted, got in _episode(record, before, after):
                self._compare(where, what, wanted, got, before, **grids)

    def _plans(self, where: str, record: Record, before: Grid) -> None:
        if self._planner.depth != record["depth"]:
            self._planner = Helper(self.rules, record["depth"])
        planner = self._planner
        masks = [car["mask"] for car in record["cars"]]
        self._masks(where, "reachable", masks, planner.reachable(before), before)
        for car, entry in enumerate(record["cars"]):
            for key, wanted in entry["plans"].items():
                action = Action(int(key))
                plan = planner.plan_move(before, car, action)
                got = None if plan is None else [int(step) for step in plan]
                self.tally.actions[action.name] += 1
                if not self._compare(f"{where} car {car} {action.name}", "plan", wanted, got, before):
                    self.tally.action_mismatches[action.name] += 1


def _objects(grid: Grid) -> list[tuple[Any, ...]]:
    cells = np.argwhere((grid.kind != Kind.AIR) & (grid.kind != Kind.GROUND))
    return [(Kind(grid.kind[tuple(c)]).name, *map(int, c), int(grid.yaw[tuple(c)])) for c in cells]


def _marks(grid: Grid) -> list[tuple[int, ...]]:
    """Return the cells whose marks are not those that follow from what is there: x, y, z, top, back."""
    derived = grid.copy()
    derived.derive_marks()
    odd = np.argwhere((grid.occupant != derived.occupant) | (grid.landing != derived.landing))
    return [(*map(int, c), int(grid.occupant[tuple(c)]), int(grid.landing[tuple(c)])) for c in odd]


def _states(expected: Grid, got: Grid, exact: bool) -> Iterator[tuple[str, Any, Any]]:
    """Yield what of two worlds is compared; equal arrays are not spelled out."""
    same = np.array_equal(expected.kind, got.kind) and np.array_equal(expected.yaw, got.yaw)
    yield ("objects", True, True) if same else ("objects", _objects(expected), _objects(got))
    yield "cars", expected.cars.tolist(), got.cars.tolist()
    if exact:
        same = expected.same_marks(got)
        yield ("marks", True, True) if same else ("marks", _marks(expected), _marks(got))


def _episode(record: Record, before: Grid, after: Grid) -> Iterator[tuple[str, Any, Any]]:
    """Yield reward, done and observation as recorded and as ours."""
    task = _task(record["task"])
    reward, layout = task.reward, _layout(record, task, before)
    if "goal" in record:
        x, y, z = record["goal"]
        reward = CodeBarrier(FlagNearness((x, y, z)))
    potential = [reward.measure.of(grid) for grid in (before, after)]
    given = np.array([record.get("hit_before", False)])
    got, _ = reward.of_tick(np.array(potential[:1]), np.array(potential[1:]), np.array([record["t"]]), given)
    yield "reward", float(record["reward"]), float(got[0])
    limited = replace(task, max_steps=record["max_steps"])
    yield "done", record["done"], bool(limited.over(np.array(record["t"]), np.array(False)))
    rows = Worlds(Rules("published"), [after]).entity_rows(layout, NO_TARGETS)[0]
    yield "observation", record["obs"], rows.tolist()


def _layout(record: Record, task: Task, before: Grid) -> Layout:
    """Return the layout of a recorded observation: the task's, or one that is counted."""
    goal = tuple(record["goal"]) if "goal" in record else None
    layout = replace(task.layout, n_cars=before.n_cars, goal=goal)
    if layout.n_rows == len(record["obs"]):
        return layout
    here = np.concatenate([before.kind.ravel(), before.cars[:, CarField.LOAD]])
    n_slopes = int(np.isin(here, (Kind.FSLOPE, Kind.BODY)).sum())
    return replace(layout, n_slopes=n_slopes, n_blocks=int((here == Kind.BLOCK).sum()))
