"""What a record of a recording may be: the keys that we compare, the others are passed over."""

from __future__ import annotations

from functools import cache
from typing import Annotated, Any, Final, Literal, NotRequired

from pydantic import ConfigDict, FailFast, Field, GetPydanticSchema, TypeAdapter, ValidationError
from pydantic_core import CoreSchema, core_schema
from typing_extensions import TypedDict

from craftsim.discrete.files.blueprint import MAX_SIDE
from craftsim.discrete.kinds import Kind
from craftsim.discrete.tasks.observation import ROW
from craftsim.errors import InputError
from craftsim.storage.limits import RECORDED_CARS, RECORDED_DEPTH, RECORDED_TICKS
from craftsim.storage.mistakes import first_mistake

KIND_NAMES: Final = {
    "wall": Kind.WALL,
    "block": Kind.BLOCK,
    "flag": Kind.FLAG,
    "fslope": Kind.FSLOPE,
    "gear": Kind.GEAR,
    "body": Kind.BODY,
    "foot": Kind.FOOT,
}

TASKS: Final = {
    "strip_shaped": "strip",
    "block_shaped": "block",
    "simple_twolayer": "simple_two_story",
    "complex_twolayer": "complex_two_story",
    "free_building": "free_building",
    "breaking_barrier": "breaking_barrier",
}
"""Our names of the tasks that recordings name."""

Record = dict[str, Any]
"""A checked record."""

KindName = Literal["wall", "block", "flag", "fslope", "gear", "body", "foot"]
TaskKey = Literal[
    "strip_shaped",
    "block_shaped",
    "simple_twolayer",
    "complex_twolayer",
    "free_building",
    "breaking_barrier",
]


def _thing_schema(*_: Any) -> CoreSchema:
    """Return the schema of a kind, x, y, z and, where it has one, a yaw; a union of two tuples takes twice as long."""
    number = core_schema.int_schema(ge=-2, le=MAX_SIDE + 1)
    items: list[CoreSchema] = [core_schema.literal_schema(list(KIND_NAMES)), *[number] * 4]
    return core_schema.tuple_schema(items, variadic_item_index=4, min_length=4, max_length=5)


Place = Annotated[int, Field(ge=-2, le=MAX_SIDE + 1)]
Yaw = Annotated[int, Field(ge=0, le=3)]
Flag = Annotated[int, Field(ge=0, le=1)]
ActionNumber = Annotated[int, Field(ge=0, le=14)]
Ticks = Annotated[int, Field(ge=0, le=RECORDED_TICKS)]
CarNumber = Annotated[int, Field(ge=0, lt=RECORDED_CARS)]
Mask = Annotated[str, Field(pattern="^[01]{15}$")]
Thing = Annotated[tuple[Any, ...], GetPydanticSchema(_thing_schema)]
Row = Annotated[list[int], Field(min_length=ROW, max_length=ROW)]
Plan = Annotated[list[ActionNumber], Field(max_length=RECORDED_DEPTH + 1)]


class RecordedCar(TypedDict):
    """A car of a recorded state."""

    x: Place
    y: Place
    z: Place
    yaw: Yaw
    load: KindName | None
    load_yaw: Yaw | None
    slope: Annotated[int, Field(ge=0, le=2)]


class RecordedMarks(TypedDict):
    """The marks that do not follow from what is there."""

    on: Annotated[
        list[tuple[Place, Place, Place, Annotated[int, Field(ge=-2, lt=RECORDED_CARS)]]], FailFast()
    ]
    back: Annotated[list[tuple[Place, Place, Place, Flag]], FailFast()]


class RecordedState(TypedDict):
    """A world."""

    objs: Annotated[list[Thing], FailFast()]
    cars: Annotated[list[RecordedCar], FailFast(), Field(max_length=RECORDED_CARS)]
    dev: RecordedMarks


class RecordedPlans(TypedDict):
    """What one car can reach, and how."""

    mask: Mask
    plans: dict[Literal["6", "7", "8", "9"], Plan | None]


class RecordKeys(TypedDict):
    """A record: of a tick, of plans, or of both."""

    __pydantic_config__ = ConfigDict(strict=True, extra="ignore", allow_inf_nan=False)  # type: ignore[misc]

    size: tuple[int, int, int]
    before: RecordedState
    ep: NotRequired[Annotated[str, Field(pattern="^[A-Za-z0-9_.:/ -]{0,80}$")]]
    t: NotRequired[Ticks]
    tags: NotRequired[Annotated[list[Annotated[str, Field(max_length=40)]], FailFast()]]
    joint: NotRequired[Annotated[list[tuple[CarNumber, ActionNumber]], FailFast()]]
    mask: NotRequired[Annotated[list[Mask], FailFast()]]
    applied: NotRequired[Annotated[list[Flag], FailFast()]]
    after: NotRequired[RecordedState]
    task: NotRequired[TaskKey]
    goal: NotRequired[tuple[Place, Place, Place]]
    hit_before: NotRequired[bool]
    reward: NotRequired[float]
    done: NotRequired[bool]
    max_steps: NotRequired[Ticks]
    obs: NotRequired[Annotated[list[Row], FailFast()]]
    depth: NotRequired[Annotated[int, Field(ge=0, le=RECORDED_DEPTH)]]
    cars: NotRequired[Annotated[list[RecordedPlans], FailFast()]]


_NEEDS: Final = {
    "joint": ("mask", "applied", "after"),
    "task": ("joint", "t", "reward", "done", "max_steps", "obs"),
    "depth": ("cars",),
}
"""What else a record with a key must have."""


@cache
def _adapter() -> TypeAdapter[Any]:
    return TypeAdapter(RecordKeys)


def parse_record(line: bytes) -> Record:
    """Return the record of a line; raise InputError, with the key, for what is none."""
    try:
        record: Record = _adapter().validate_json(line)
    except ValidationError as error:
        raise InputError(f"not a record: {first_mistake(error)}") from None
    if "joint" not in record and "depth" not in record:
        raise InputError("not a record: it needs 'joint', of a tick, or 'depth', of plans")
    for key, needed in _NEEDS.items():
        if key in record and (missing := [name for name in needed if name not in record]):
            raise InputError(f"not a record: with '{key}' it needs '{missing[0]}'")
    n_cars = len(record["before"]["cars"])
    _check_lengths(record, n_cars)
    if any(car >= n_cars for car, _ in record.get("joint", ())):
        raise InputError(f"not a record: key 'joint' names a car that is not there; there are {n_cars}")
    return record


def _check_lengths(record: Record, n_cars: int) -> None:
    lengths = [("mask", n_cars), ("applied", len(record.get("joint", ()))), ("cars", n_cars)]
    if "after" in record:
        lengths.append(("after.cars", n_cars))
    for key, length in lengths:
        found = record["after"]["cars"] if key == "after.cars" else record.get(key)
        if found is not None and len(found) != length:
            raise InputError(f"not a record: key '{key}' has {len(found)} entries; allowed: {length}")
