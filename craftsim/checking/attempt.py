"""Attempts: one action tried in physics, judged against limits that were set beforehand, in a form that JSON knows."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

from craftsim.checking.checked_run import ActionRecord
from craftsim.checking.settings import Thresholds
from craftsim.discrete.grid import Kind
from craftsim.discrete.rules.table import ACTIONS
from craftsim.discrete.verdict import Finding

_SHOWN: Final = 2
"""How many hazards, and how many contacts, a reason names."""


class Result(StrEnum):
    """What came of an attempt."""

    AS_PREDICTED = "as predicted"
    FAILED = "failed"
    SIDE_EFFECT = "side effect"
    """It did what was predicted, and something else moved or changed."""
    UNSAFE = "unsafe"
    """Something tipped, fell, or hit harder than it may."""


@dataclass(frozen=True)
class Attempt:
    """One action tried in physics; made of what JSON knows."""

    tick: int
    car: int
    action: str
    """Name of the primitive action."""
    verb: str
    """The same whatever the map direction: LIFT, DROP, FOLD, UNFOLD, ROTATE_LEFT, ROTATE_RIGHT, MOVE or STOP."""
    level: int
    """The car's level before the action."""
    load: str
    """What it carried before the action: none, block, flag or fslope."""
    slope: bool
    """Whether it starts on a slope, or should end on one."""
    legal: bool
    """By the rule set in use."""
    result: str
    finding: str
    """Of the verdict."""
    skill: str
    """What the skill says."""
    reason: str
    """What went wrong physically, in one line; empty when it went as predicted."""
    differences: tuple[str, ...]
    car_error_m: float
    heading_error_rad: float
    height_error_m: float
    placed_error_m: float | None
    others_moved_m: float
    duration_s: float
    peak_force_n: float


def attempt_of(record: ActionRecord, limits: Thresholds) -> Attempt:
    """Judge one action by the limits."""
    result = result_of(record, limits)
    return Attempt(
        tick=record.tick,
        car=record.car,
        action=record.action.name,
        verb=ACTIONS[record.action].verb,
        level=record.level,
        load="none" if record.load == Kind.AIR else record.load.name.lower(),
        slope=record.sloping,
        legal=record.legal,
        result=str(result),
        finding=str(record.verdict.finding),
        skill=str(record.outcome) if _performed(record) else "not performed",
        reason="" if result is Result.AS_PREDICTED else _reason(record, limits),
        differences=record.verdict.differences,
        car_error_m=record.car_error_m,
        heading_error_rad=abs(record.car_heading_error_rad),
        height_error_m=abs(record.car_height_error_m),
        placed_error_m=record.placed_error_m,
        others_moved_m=record.others_moved_m,
        duration_s=record.outcome.duration_s,
        peak_force_n=record.peak_force_n,
    )


def result_of(record: ActionRecord, limits: Thresholds) -> Result:
    """Return what came of an action; what is unsafe is so even if all ended as predicted."""
    if record.verdict.finding is Finding.UNSAFE:
        return Result.UNSAFE
    own = [name for name, _ in excesses(record, limits) if name != "others moved"]
    if own or not record.effect or record.outcome.reason is not None:
        return Result.FAILED
    if record.verdict.agrees and record.others_moved_m <= limits.others_m:
        return Result.AS_PREDICTED
    spoilt = record.verdict.finding in (Finding.NOT_EXECUTED, Finding.UNSETTLED, Finding.DIVERGED)
    problems = record.verdict.differences if record.verdict.finding is Finding.UNREADABLE else ()
    concerned = any(line.startswith(f"{name} ") for line in problems for name in record.own)
    return Result.FAILED if spoilt or concerned else Result.SIDE_EFFECT


def excesses(record: ActionRecord, limits: Thresholds) -> Iterator[tuple[str, str]]:
    """Yield the name of each error that is over its limit, or that is no number, with a description."""
    if not record.car_error_m <= limits.car_m:
        yield "car error", _beyond("the car is", record.car_error_m, limits.car_m, "mm off")
    if not abs(record.car_heading_error_rad) <= limits.heading_rad:
        turn = abs(record.car_heading_error_rad)
        yield "heading error", _beyond("the car is turned by", turn, limits.heading_rad, "mrad")
    if not abs(record.car_height_error_m) <= limits.height_m:
        yield (
            "height error",
            _beyond("the car's height is", abs(record.car_height_error_m), limits.height_m, "mm off"),
        )
    if record.placed_error_m is not None and not record.placed_error_m <= limits.placed_m:
        yield (
            "placed error",
            _beyond("the thing is set down", record.placed_error_m, limits.placed_m, "mm off"),
        )
    if not record.others_moved_m <= limits.others_m:
        yield (
            "others moved",
            _beyond(f"{record.moved} was moved by", record.others_moved_m, limits.others_m, "mm"),
        )


def _beyond(what: str, value: float, limit: float, unit: str) -> str:
    return f"{what} {1e3 * value:.1f} {unit} (allowed {1e3 * limit:.1f})"


def _performed(record: ActionRecord) -> bool:
    return record.outcome.reason is not None or record.outcome.duration_s > 0


def _reason(record: ActionRecord, limits: Thresholds) -> str:
    """Return what happened physically: hazards, contacts, the skill's own reason; what is off only without these."""
    if not _performed(record):
        return record.verdict.differences[0]
    parts = [hazard.text for hazard in record.hazards[:_SHOWN]]
    told = {hazard.machines for hazard in record.hazards}
    contacts = [c for c in record.touched if (c.first, c.second) not in told]
    contacts.sort(key=lambda c: c.first not in record.own and c.second not in record.own)
    parts += [f"{c.first} touched {c.second} ({c.peak_n:.0f} N)" for c in contacts[:_SHOWN]]
    if record.outcome.reason is not None:
        parts.append(str(record.outcome))
    parts += [text for name, text in excesses(record, limits) if name == "others moved" or not parts]
    return "; ".join(parts or record.verdict.differences[:1])
