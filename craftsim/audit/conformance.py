"""Compare the rules with recordings of CraftEnv: replay each record, and count what differs.

A recording is gzip-compressed JSON lines, each a record of a tick, of plans, or of both.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Final, Literal, NamedTuple, NotRequired, TypeVar, get_args

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, FailFast, Field, TypeAdapter, ValidationError
from typing_extensions import TypedDict

from craftsim.discrete.grid import MAX_SIDE, CarField, Cell, Grid, Kind, check_size, check_values
from craftsim.discrete.kinds import Action, CellField, Correction
from craftsim.discrete.rules import Rules
from craftsim.errors import InputError
from craftsim.storage import limits
from craftsim.storage.reading import read_lines
from craftsim.storage.records import first_mistake
from craftsim.tasks.kernel import ROW
from craftsim.tasks.observation import Layout, entity_rows
from craftsim.tasks.rewards import make_reward
from craftsim.tasks.starts import targets_of
from craftsim.tasks.task import Task, make_task

QUIRK_TAGS: Final = frozenset(
    {"devdep", "overwrite", "lost", "shared", "unfold_on_car", "unsupport"}
)
"""Tags of records in which something happened that only the published rule set follows."""

_TASKS: Final = {
    "strip_shaped": "strip",
    "block_shaped": "block",
    "simple_twolayer": "simple_two_story",
    "complex_twolayer": "complex_two_story",
    "free_building": "free_building",
    "breaking_barrier": "breaking_barrier",
}
"""Our names of the tasks that recordings name."""

T = TypeVar("T")
_Listed = Annotated[list[T], FailFast()]
_TaskName = Annotated[str, Field(pattern=f"^({'|'.join(_TASKS)})$")]
KindName = Literal["wall", "block", "flag", "fslope", "gear", "body", "foot"]
Coordinate = Annotated[int, Field(ge=-2, le=MAX_SIDE + 1)]
Place = tuple[Coordinate, Coordinate, Coordinate]
Yaw = Annotated[int, Field(ge=0, le=3)]
Flag = Annotated[int, Field(ge=0, le=1)]
_Occupant = Annotated[int, Field(ge=-2, lt=limits.RECORDED_CARS)]
CarNumber = Annotated[int, Field(ge=0, lt=limits.RECORDED_CARS)]
ActionNumber = Annotated[int, Field(ge=0, le=14)]
Ticks = Annotated[int, Field(ge=0, le=limits.RECORDED_TICKS)]
_Mask = Annotated[str, Field(pattern="^[01]{15}$")]
_Row = Annotated[list[int], Field(min_length=ROW, max_length=ROW)]
_Plan = Annotated[list[ActionNumber], Field(max_length=limits.RECORDED_DEPTH + 1)]

_KINDS: Final = {name: int(Kind[name.upper()]) for name in get_args(KindName)}

_Record = dict[str, Any]
"""What :class:`_RecordKeys` allows."""


class _RecordedPiece(NamedTuple):
    kind: KindName
    x: Coordinate
    y: Coordinate
    z: Coordinate
    yaw: Coordinate = 0


class _RecordedCar(TypedDict):
    x: Coordinate
    y: Coordinate
    z: Coordinate
    yaw: Yaw
    load: KindName | None
    load_yaw: Yaw | None
    slope: Annotated[int, Field(ge=0, le=2)]


class _RecordedMarks(TypedDict):
    """The marks that do not follow from what is there."""

    on: _Listed[tuple[Coordinate, Coordinate, Coordinate, _Occupant]]
    back: _Listed[tuple[Coordinate, Coordinate, Coordinate, Flag]]


class _RecordedState(TypedDict):
    objs: _Listed[_RecordedPiece]
    cars: Annotated[_Listed[_RecordedCar], Field(max_length=limits.RECORDED_CARS)]
    dev: _RecordedMarks


class _RecordedPlans(TypedDict):
    mask: _Mask
    plans: dict[Literal["6", "7", "8", "9"], _Plan | None]


class _RecordKeys(TypedDict):
    """The keys that are compared; others are passed over."""

    __pydantic_config__ = ConfigDict(strict=True, extra="ignore", allow_inf_nan=False)  # type: ignore[misc]

    size: tuple[int, int, int]
    before: _RecordedState
    ep: NotRequired[Annotated[str, Field(pattern="^[A-Za-z0-9_.:/ -]{0,80}$")]]
    t: NotRequired[Ticks]
    tags: NotRequired[_Listed[Annotated[str, Field(max_length=40)]]]
    joint: NotRequired[_Listed[tuple[CarNumber, ActionNumber]]]
    mask: NotRequired[_Listed[_Mask]]
    applied: NotRequired[_Listed[Flag]]
    after: NotRequired[_RecordedState]
    task: NotRequired[_TaskName]
    goal: NotRequired[Place]
    hit_before: NotRequired[bool]
    reward: NotRequired[float]
    done: NotRequired[bool]
    max_steps: NotRequired[Ticks]
    obs: NotRequired[_Listed[_Row]]
    depth: NotRequired[Annotated[int, Field(ge=0, le=limits.RECORDED_DEPTH)]]
    cars: NotRequired[_Listed[_RecordedPlans]]


_NEEDS: Final = {
    "joint": ("mask", "applied", "after"),
    "task": ("joint", "t", "reward", "done", "max_steps", "obs"),
    "depth": ("cars",),
}
"""What else a record with a key must have."""


_RECORDS: Final = TypeAdapter[Any](_RecordKeys)


def parse_record(line: bytes) -> _Record:
    """Return the record of a line; raise InputError, with the key, if it is not one."""
    try:
        record: _Record = _RECORDS.validate_json(line)
    except ValidationError as error:
        raise InputError(f"not a record: {first_mistake(error)}") from None
    if "joint" not in record and "depth" not in record:
        raise InputError("not a record: it needs 'joint', of a tick, or 'depth', of plans")
    for key, needed_keys in _NEEDS.items():
        if key in record:
            missing = [name for name in needed_keys if name not in record]
            if missing:
                raise InputError(f"not a record: with '{key}' it needs '{missing[0]}'")
    n_cars = len(record["before"]["cars"])
    joint = record.get("joint", ())
    lists = {key: record.get(key) for key in ("mask", "applied", "cars")}
    if "after" in record:
        lists["after.cars"] = record["after"]["cars"]
    else:
        lists["after.cars"] = None
    for key, entries in lists.items():
        allowed = n_cars
        if key == "applied":
            allowed = len(joint)
        if entries is not None and len(entries) != allowed:
            raise InputError(
                f"not a record: key '{key}' has {len(entries)} entries; allowed: {allowed}"
            )
    if any(car >= n_cars for car, _ in joint):
        raise InputError(
            f"not a record: key 'joint' names a car that is not there; there are {n_cars}"
        )
    return record


def read_records(path: Path) -> Iterator[tuple[int, _Record]]:
    """Yield line number and content of each record; raise InputError with file and line for an invalid line."""
    number = cells = 0
    for number, line in read_lines(path, limits.RECORDING, packed=True):
        try:
            record = parse_record(line)
            check_size(record["size"], len(record["before"]["cars"]))
        except InputError as error:
            raise InputError(f"{path}:{number}: {error}") from None
        length, width, height = record["size"]
        cells += length * width * height
        if number > limits.RECORDS or cells > limits.RECORDED_CELLS:
            raise InputError(
                f"{path}:{number}: more than the {limits.RECORDS} records, with {limits.RECORDED_CELLS} cells "
                "together, that are allowed in a recording; split it"
            )
        yield number, record
    if not number:
        raise InputError(f"{path}: holds no records")


def recorded_grid(size: Cell, state: _Record) -> Grid:
    """Return the world of a recorded state, with its marks; raise InputError for an impossible one."""
    grid = Grid.empty(size, len(state["cars"]))

    def outside(key: str, *cell: int, otherwise: str = "") -> InputError:
        return InputError(
            f"key '{key}': the cell {cell} is outside the map of size {tuple(size)}{otherwise}"
        )

    for name, x, y, z, yaw in state["objs"]:
        if not grid.inside((x, y, z)) or z == 0:
            raise outside("objs", x, y, z)
        grid.kind[x, y, z] = _KINDS[name]
        grid.yaw[x, y, z] = yaw
    for row, car in zip(grid.cars, state["cars"], strict=True):
        load = 0
        if car["load"]:
            load = _KINDS[car["load"]]
        row[:] = (
            car["x"],
            car["y"],
            car["z"],
            car["yaw"],
            load,
            car["load_yaw"] or 0,
            car["slope"],
        )
    check_values(grid)
    grid.derive_marks()
    for x, y, z, mark in state["dev"]["on"]:
        if not grid.inside((x, y, z)) or mark >= grid.n_cars:
            raise outside("dev.on", x, y, z, otherwise=f" or names a car that is not there: {mark}")
        grid.occupant[x, y, z] = mark
    for x, y, z, flag in state["dev"]["back"]:
        if not grid.inside((x, y, z)) or grid.kind[x, y, z] != Kind.BLOCK:
            raise outside("dev.back", x, y, z, otherwise=" or holds no block")
        grid.landing[x, y, z] = flag
    return grid


_Comparison = tuple[str, str, Sequence[str], Any, Any]
"""Who acts; what is compared; the actions that it is about; as recorded, and as ours."""


class Checker:
    """Compares records with a rule set, and counts."""

    def __init__(self, rules: Rules, keep: int = 5) -> None:
        """Begin to count; ``keep`` says how many mismatches to keep."""
        self.rules = rules
        self.keep = keep
        self.exact = rules.rule_set == "published"
        self.uncorrected = Rules(rules.rule_set, Correction.derived_marks)
        """The physical rules before physics corrected them: nothing but the bookkeeping differs from published."""
        self.records = self.skipped = self.corrected = 0
        """Of these skipped for a quirk tag, which the physical rule set need not follow, and ticks in which a
        correction of it changes what is legal or what follows."""
        self.checks, self.mismatches = Counter[str](), Counter[str]()
        """By what was compared."""
        self.actions, self.applied = Counter[str](), Counter[str]()
        """Actions taken, by name, and of these the ones that were legal."""
        self.action_mismatches = Counter[str]()
        """Actions, by name, whose applied flag or plan differs, or that a wrong mask entry is about."""
        self.first: list[tuple[str, tuple[Grid, ...]]] = []
        """The mismatches that are kept, in words: where, what, as recorded and as ours. With the worlds before and, of
        a tick, after it: as recorded and by our rules."""

    def figures(self) -> dict[str, Any]:
        """Return all counts by name, and the sums of checks and mismatches."""
        counts = ("records", "skipped", "corrected", "checks", "mismatches", "actions", "applied")
        totals = {"total_checks": self.checks.total(), "total_mismatches": self.mismatches.total()}
        return {name: getattr(self, name) for name in (*counts, "action_mismatches")} | totals

    def check(self, line: int, record: _Record) -> None:
        """Compare one record, of a tick or of plans."""
        self.records += 1
        if not self.exact and QUIRK_TAGS & set(record.get("tags", ())):
            self.skipped += 1
            return
        place = f"episode {record.get('ep', '?')} tick {record.get('t', '?')} (line {line})"
        before = recorded_grid(record["size"], record["before"])
        if "joint" in record:
            if not self.exact and self._is_corrected(record["joint"], before):
                self.corrected += 1
                return
            after, applied = self.rules.tick(before, record["joint"])
            expected = recorded_grid(record["size"], record["after"])
            comparisons = self._tick(record, before, expected, after, applied)
            self._compare(place, comparisons, before, expected, after)
        if "depth" in record:
            self._compare(place, self._plans(record, before), before)

    def _is_corrected(self, joint: list[tuple[int, int]], before: Grid) -> bool:
        """Return whether a correction changes what is legal at the start of a tick, or what the tick leads to."""
        if not np.array_equal(self.rules.mask(before), self.uncorrected.mask(before)):
            return True
        after, applied = self.rules.tick(before, joint)
        uncorrected_after, uncorrected_applied = self.uncorrected.tick(before, joint)
        same_applied = np.array_equal(applied, uncorrected_applied)
        return not (same_applied and after.same_visible(uncorrected_after))

    def _compare(self, place: str, comparisons: Iterator[_Comparison], *grids: Grid) -> None:
        for actor, subject, actions, expected, actual in comparisons:
            self.checks[subject] += 1
            if expected != actual:
                self.mismatches[subject] += 1
                self.action_mismatches.update(actions)
                if len(self.first) < self.keep:
                    words = f"{place}{actor}: {subject}\nexpected {expected}\ngot      {actual}"
                    self.first.append((words, grids))

    def _tick(
        self, record: _Record, before: Grid, expected: Grid, after: Grid, applied: NDArray[np.bool_]
    ) -> Iterator[_Comparison]:
        yield from _masks("mask", record["mask"], self.rules.mask(before))
        for (car, number), recorded, is_applied in zip(
            record["joint"], record["applied"], applied, strict=True
        ):
            name = Action(number).name
            self.actions[name] += 1
            self.applied[name] += int(is_applied)
            yield f" car {car} {name}", "applied", (name,), bool(recorded), bool(is_applied)
        odd = (expected.kind != after.kind) | (expected.yaw != after.yaw)
        yield "", "objects", (), _objects(expected, odd), _objects(after, odd)
        yield "", "cars", (), expected.cars.tolist(), after.cars.tolist()
        if self.exact:
            if expected.same_marks(after):
                yield "", "marks", (), (), ()
            else:
                yield "", "marks", (), _marks(expected), _marks(after)
        if "task" in record:
            for subject, recorded, actual in _episode(record, before, after):
                yield "", subject, (), recorded, actual

    def _plans(self, record: _Record, before: Grid) -> Iterator[_Comparison]:
        depth = record["depth"]
        masks = [entry["mask"] for entry in record["cars"]]
        yield from _masks("reachable", masks, self.rules.reachable(before, depth))
        for car, entry in enumerate(record["cars"]):
            for key, recorded in entry["plans"].items():
                action = Action(int(key))
                plan = self.rules.plan_move(before, car, action, depth)
                self.actions[action.name] += 1
                steps = None
                if plan is not None:
                    steps = [int(step) for step in plan]
                yield f" car {car} {action.name}", "plan", (action.name,), recorded, steps


def _masks(subject: str, expected: list[str], masks: NDArray[np.bool_]) -> Iterator[_Comparison]:
    for car, (recorded, row) in enumerate(zip(expected, masks.tolist(), strict=True)):
        bits = "".join(str(int(legal)) for legal in row)
        yield (
            f" car {car}",
            subject,
            [a.name for a in Action if recorded[a] != bits[a]],
            recorded,
            bits,
        )


def _objects(grid: Grid, odd: NDArray[np.bool_]) -> list[tuple[Any, ...]]:
    """Return what is in some cells: name of its kind, x, y, z, yaw."""
    cells = map(tuple, np.argwhere(odd).tolist())
    return [(Kind(grid.kind[cell]).name, *cell, int(grid.yaw[cell])) for cell in cells]


def _marks(grid: Grid) -> list[list[int]]:
    """Return the cells whose marks are not those that follow from what is there: x, y, z, occupant, landing."""
    derived = grid.copy()
    derived.derive_marks()
    odd = np.argwhere((grid.occupant != derived.occupant) | (grid.landing != derived.landing))
    return [
        [*cell, *grid.cells[tuple(cell)][CellField.OCCUPANT :].tolist()] for cell in odd.tolist()
    ]


@cache
def _task(name: str) -> Task:
    return make_task(_TASKS[name], reward="published_code")


def _episode(record: _Record, before: Grid, after: Grid) -> Iterator[tuple[str, Any, Any]]:
    """Yield reward, done and observation as recorded and as ours."""
    task = _task(record["task"])
    layout = _layout(record, task, before)
    designs = targets_of(task.design)[None]
    reward = task.reward
    if "goal" in record:
        reward = make_reward("published_code", "flag_at_goal")
    earlier = reward.potentials(before[None], designs, layout)
    later = reward.potentials(after[None], designs, layout)
    hit_before = np.array([record.get("hit_before", False)])
    rewards = reward.score(earlier, later, np.array([record["t"]]), hit_before)
    yield "reward", float(record["reward"]), float(rewards[0])
    limited = replace(task, max_steps=record["max_steps"])
    yield "done", record["done"], bool(limited.over(np.array(record["t"]), np.array(False)))
    rows = entity_rows(after[None], layout, designs)[0]
    yield "observation", record["obs"], rows.tolist()


def _layout(record: _Record, task: Task, before: Grid) -> Layout:
    """Return the layout of a recorded observation: the task's, or one that is counted."""
    goal = None
    if "goal" in record:
        goal = tuple(record["goal"])
    layout = replace(task.layout, n_cars=before.n_cars, goal=goal)
    if layout.n_rows == len(record["obs"]):
        return layout
    kinds = np.concatenate([before.kind.ravel(), before.cars[:, CarField.LOAD]])
    n_slopes = int(np.isin(kinds, (Kind.FSLOPE, Kind.BODY)).sum())
    return replace(layout, n_slopes=n_slopes, n_blocks=int((kinds == Kind.BLOCK).sum()))
