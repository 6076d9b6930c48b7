"""Attempts: actions tried in physics and judged against limits fixed beforehand, as JSON values."""

from __future__ import annotations

import html
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Any, Final, Literal, NamedTuple

from craftsim.checking.measurements import LIMITED, MeasuredValues, Measurement
from craftsim.checking.thresholds import Thresholds
from craftsim.checking.watched import Watched
from craftsim.discrete.actions import ACTIONS
from craftsim.discrete.grid import CarField, Grid, Kind
from craftsim.discrete.readback import (
    Reading,
    describe_car,
    describe_differences,
    find_changes,
)

if TYPE_CHECKING:
    from pandas import DataFrame

SAME_TIME_S: Final = 1e-6
"""Largest difference of times that are the same: those of a world are sums of time steps, so that they are a little
off what is written down."""
_SHOWN: Final = 2
"""Hazards, and contacts, named in a reason."""


class Verdict(StrEnum):
    """The judge's verdict on an action."""

    AS_PREDICTED = "as predicted"
    """The grid read from poses is the predicted one, and every error is within its limit."""
    RETRIED = "as predicted, retried"
    """The same, after a second try of the skill."""
    FAILED = "failed"
    SIDE_EFFECT = "side effect"
    """The predicted effect occurred, and something else moved or changed."""
    UNSAFE = "unsafe"
    """Something tipped or fell, or a contact force exceeded its limit."""
    NUMERICS = "numerics"
    """Not as predicted, and the simulation diverged or its solver did not converge: inconclusive."""


AGREEING: Final = (Verdict.AS_PREDICTED, Verdict.RETRIED)
"""Verdicts on an action that agrees with its prediction."""

Finding = Literal[
    "agrees",
    "not executed",
    "wrong place",
    "side effect",
    "unreadable",
    "unsafe",
    "unsettled",
    "numerics",
    "diverged",
]
"""Findings of the comparison of prediction and reading."""


class Cause(NamedTuple):
    """The cause of a verdict."""

    finding: Finding
    differences: tuple[str, ...] = ()
    """Differences between reading and prediction, in words."""


VERDICTS: Final[Mapping[Finding, Verdict]] = {
    "agrees": Verdict.AS_PREDICTED,
    "not executed": Verdict.FAILED,
    "wrong place": Verdict.SIDE_EFFECT,
    "side effect": Verdict.SIDE_EFFECT,
    "unreadable": Verdict.SIDE_EFFECT,
    "unsafe": Verdict.UNSAFE,
    "unsettled": Verdict.FAILED,  # something still moves although no motor is commanded
    "numerics": Verdict.NUMERICS,  # no convergence, or forces that nothing could have produced: this proves nothing
    "diverged": Verdict.NUMERICS,
}
"""The verdict for each finding, for an action whose own effect is as predicted."""
AGREES: Final = Cause("agrees")


@dataclass(frozen=True)
class _Judgement:
    """What was tried, what the rules predict, what was read, and the verdict."""

    tick: int
    car: int
    action: str
    """Name of the primitive action."""
    verb: str
    """The action without its map direction: LIFT, DROP, FOLD, UNFOLD, ROTATE_LEFT, ROTATE_RIGHT, MOVE or STOP."""
    level: int
    """The car's level before the action."""
    load: str
    """The load before the action: none, block, flag or fslope."""
    slope: bool
    """Whether it starts, or should end, on a slope."""
    legal: bool
    """Whether the rule set in use allows it."""
    performed: bool
    """Whether the skill was started; not for a forbidden action, or one that depends on a failed one."""
    result: str
    """A :class:`Verdict`."""
    finding: str
    """The finding, a key of :data:`VERDICTS`."""
    skill: str
    """The skill's report: succeeded, or failed with a reason."""
    reason: str
    """The physical cause of a failure, in one line; empty if as predicted."""
    differences: tuple[str, ...]
    """Differences between reading and prediction."""
    predicted: str
    """The predicted acting car: cell, heading, load, place on a slope."""
    read: str
    """The acting car as read from its pose."""
    start_s: float
    """Simulated time since the world was set up."""


@dataclass(frozen=True, repr=False)
class Attempt(MeasuredValues, _Judgement):
    """One action tried in physics: the skill's Outcome and the judge's :class:`Verdict`, as JSON values.

    Values are those at the action's end unless they say otherwise; None where nothing, or nothing finite, was measured.

    Example:
        >>> import craftsim
        >>> physics = craftsim.PhysicsWorld(craftsim.Grid.empty((3, 1, 1), n_cars=1))
        >>> attempt = craftsim.perform(physics, 0, "LIFT")
        >>> attempt.result, attempt.performed
        ('failed', False)
        >>> list(attempt.to_frame()["reason"])
        ['the rules forbid it: there is nothing to lift in (0, 0, 1)']
    """

    def has_begun(self, time_s: float) -> bool:
        """Return whether it begins at a time or before; times that differ by SAME_TIME_S are the same."""
        return self.start_s <= time_s + SAME_TIME_S

    def has_ended(self, time_s: float) -> bool:
        """Return whether it ends at a time or before; times that differ by SAME_TIME_S are the same."""
        return self.start_s + self.duration_s <= time_s + SAME_TIME_S

    @classmethod
    def of(cls, fields: Mapping[str, Any]) -> Attempt:
        """Return an attempt from JSON values."""
        return cls(**{**fields, "differences": tuple(fields["differences"])})

    def to_frame(self) -> DataFrame:
        """Return a table with one row: the fields."""
        from pandas import DataFrame

        return DataFrame([asdict(self)])

    def __repr__(self) -> str:
        errors = f"{1e3 * self.car_error_m:.2f} mm, {1e3 * self.heading_error_rad:.2f} mrad, {self.duration_s:.2f} s"
        if self.agrees:
            text = errors
        else:
            text = self.reason
        return f"Attempt(car {self.car} {self.action}: {self.result}; {text})"

    def _repr_html_(self) -> str:
        if self.agrees:
            colour = "green"
        else:
            colour = "firebrick"
        texts = {name: html.escape(str(value)) for name, value in asdict(self).items()}
        fields = "".join(f"<tr><th>{name}<td>{value}" for name, value in texts.items())
        head = html.escape(f"car {self.car} {self.action}: {self.result}")
        return f"<b style='color:{colour}'>{head}</b><table>{fields}</table>"

    @property
    def agrees(self) -> bool:
        """Whether the result is as predicted, within all limits."""
        return self.result in AGREEING


def compare_reading(before: Grid, predicted: Grid, reading: Reading) -> Cause:
    """Compare the reading after an action with the predicted Grid; ``before`` is the Grid at its start."""
    if reading.problems:
        return Cause("unreadable", reading.problems)
    read = reading.grid
    if read.same_visible(predicted):
        return AGREES
    differences = tuple(describe_differences(predicted, read))
    if read.same_visible(before):
        return Cause("not executed", differences)
    predicted_changes = find_changes(before, predicted)
    read_changes = find_changes(before, read)
    for is_predicted, has_changed in zip(predicted_changes, read_changes, strict=True):
        if (has_changed & ~is_predicted).any():
            return Cause("side effect", differences)
    return Cause("wrong place", differences)


def attempt_of(watched: Watched, cause: Cause, limits: Thresholds) -> Attempt:
    """Return the attempt of a measured action."""
    step = watched.step
    outcome = watched.outcome
    row = step.before.cars[step.car]
    after = step.after.cars[step.car]
    load = int(row[CarField.LOAD])
    verdict = verdict_of(watched, cause, limits)
    return Attempt(
        tick=step.tick,
        car=step.car,
        action=step.action.name,
        verb=ACTIONS[step.action].verb,
        level=int(row[CarField.Z]),
        load=Kind(load).name.lower() if load else "none",
        slope=bool(row[CarField.SLOPE] or after[CarField.SLOPE]),
        legal=watched.legal,
        performed=outcome is not None,
        result=verdict.value,
        finding=cause.finding,
        skill="not performed" if outcome is None else str(outcome),
        reason="" if verdict in AGREEING else _reason_of(watched, cause, limits),
        differences=cause.differences,
        predicted=describe_car(step.after, step.car),
        read=watched.read,
        start_s=watched.start_s,
        **watched.measured,
    )


def verdict_of(watched: Watched, cause: Cause, limits: Thresholds) -> Verdict:
    """Return the verdict on an action. Hazards make it unsafe even if the reading is as predicted.

    A disagreement after an unconverged step is attributed to the solver.
    """
    exceeded = _exceeded(watched, limits)
    verdict = VERDICTS[cause.finding]
    if verdict not in (Verdict.UNSAFE, Verdict.NUMERICS):
        unreadable = cause.finding == "unreadable" and watched.is_named_in(cause.differences)
        if (
            not watched.applied
            or unreadable
            or any(row.of not in ("bystander", "contact") for row in exceeded)
        ):
            verdict = Verdict.FAILED
        elif verdict is Verdict.AS_PREDICTED and exceeded:
            verdict = Verdict.SIDE_EFFECT
    if verdict is not Verdict.AS_PREDICTED:
        return Verdict.NUMERICS if watched.capped_steps else verdict
    if watched.measured["tries"] > 1:
        return Verdict.RETRIED
    return verdict


def _reason_of(watched: Watched, cause: Cause, limits: Thresholds) -> str:
    """Return the reason of a failure: hazards, exceeded limits, the skill's report or differences, then contacts."""
    outcome = watched.outcome
    if outcome is None:
        return cause.differences[0]
    parts: list[str] = []
    if VERDICTS[cause.finding] is Verdict.NUMERICS:
        parts.append(cause.differences[0])
    elif watched.capped_steps:
        parts.append(capped_text(watched.capped_steps))
    parts += [text for _, text in watched.hazards[:_SHOWN]]
    excesses = []
    if watched.applied:
        excesses = _excesses(watched, limits, of_bystanders=False)
    if outcome.succeeded:
        parts += excesses
    else:
        parts.append(str(outcome))
    parts += _excesses(watched, limits, of_bystanders=True)
    if not parts:
        parts += cause.differences[:1]
    way_m = watched.measured["way_m"]
    if limits.place_m < way_m <= limits.way_m and (excesses or not watched.applied):
        parts.append(f"the car strayed {1e3 * way_m:.1f} mm from its path")
    in_hazards = {machines for machines, _ in watched.hazards}
    contacts = [
        contact for contact in watched.contacts if (contact.first, contact.second) not in in_hazards
    ]
    for contact in contacts[:_SHOWN]:
        parts.append(f"{contact.first} touched {contact.second} ({contact.peak_n:.0f} N)")
    return "; ".join(parts)


def _exceeded(watched: Watched, limits: Thresholds) -> list[Measurement]:
    """Return the measurements above their limits, or not finite."""
    exceeded = []
    for measurement in LIMITED:
        value = watched.measured[measurement.name]
        # nan is not below any limit.
        if value is not None and not value <= measurement.limit_in(limits):
            exceeded.append(measurement)
    return exceeded


def _excesses(watched: Watched, limits: Thresholds, of_bystanders: bool) -> list[str]:
    """Describe the measurements above their limits: of each bystander one in each unit."""
    texts: dict[Any, str] = {}
    for measurement in _exceeded(watched, limits):
        if (measurement.of == "bystander") is not of_bystanders:
            continue
        unit = measurement.unit
        excess = measurement.excess.format(unit.text(watched.measured[measurement.name]))
        allowed = f"{unit.factor * measurement.limit_in(limits):.2f}"
        key: Any = measurement.name
        if of_bystanders:
            bystander = watched.bystanders[measurement.name]
            excess = f"{bystander} {excess}"
            key = bystander, unit
        texts.setdefault(key, f"{excess} (allowed {allowed})")
    return list(texts.values())[:_SHOWN]


def capped_text(steps: int) -> str:
    """Return the text for unconverged steps."""
    return f"the solver did not converge in {steps} physics step{'s' * (steps != 1)}"
