"""Attempts: one action tried in physics, judged against limits that were set beforehand, in a form that JSON knows."""

from __future__ import annotations

import html
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Any, Final

from craftsim.checking.contact_log import Contact
from craftsim.checking.safety import Hazard
from craftsim.checking.settings import Thresholds
from craftsim.discrete.actions import ACTIONS
from craftsim.discrete.grid import CarField, Grid, Kind
from craftsim.discrete.readback import Reading, changed, describe_car, describe_differences
from craftsim.discrete.schedule import ScheduledAction
from craftsim.skills.outcome import Outcome

if TYPE_CHECKING:
    from pandas import DataFrame

_SHOWN: Final = 2
"""How many hazards, and how many contacts, a reason names."""


class Finding(StrEnum):
    """What the comparison of prediction and reading found."""

    AGREES = "agrees"
    NOT_EXECUTED = "not executed"
    WRONG_PLACE = "wrong place"
    SIDE_EFFECT = "side effect"
    UNREADABLE = "unreadable"
    UNSAFE = "unsafe"
    """Something tipped, fell, or hit harder than it may."""
    UNSETTLED = "unsettled"
    """Something still moves although no motor is commanded."""
    NUMERICS = "numerics"
    """The solver did not converge, or found forces that nothing could have produced: this proves nothing."""
    DIVERGED = "diverged"
    """The simulation broke down."""


@dataclass(frozen=True)
class Verdict:
    """Whether an action did what the rules predicted, and in words what differs where it did not."""

    finding: Finding
    differences: tuple[str, ...] = ()

    @property
    def agrees(self) -> bool:
        """Whether the reading equals the prediction."""
        return self.finding is Finding.AGREES


class Result(StrEnum):
    """The result of an attempt."""

    AS_PREDICTED = "as predicted"
    """The grid that was read is the predicted one, and every figure is within its limit."""
    FAILED = "failed"
    SIDE_EFFECT = "side effect"
    """It did what was predicted, and something else moved or changed."""
    UNSAFE = "unsafe"
    """Something tipped, fell, or hit harder than it may."""
    NUMERICS = "numerics"
    """The simulation broke down or was not solved, and it did not end as predicted: this says nothing of the action."""


@dataclass(frozen=True, repr=False)
class Attempt:
    """One action tried in physics; made of what JSON knows. Errors are those at the action's end.

    Example:
        >>> import craftsim
        >>> site = craftsim.Site(craftsim.Grid.empty((3, 1, 1), n_cars=1))
        >>> attempt = craftsim.perform(site, 0, "LIFT")
        >>> attempt.result, attempt.performed
        ('failed', False)
        >>> list(attempt.to_frame()["reason"])
        ['the rules forbid it: there is nothing to lift in (0, 0, 1)']
    """

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
    performed: bool
    """Whether the skill was begun: what is forbidden is not, nor what waits for something that failed."""
    result: str
    """A :class:`Result`."""
    finding: str
    """Of the verdict, a :class:`Finding`."""
    skill: str
    """What the skill reports: succeeded, or failed for a stated reason."""
    reason: str
    """What went wrong physically, in one line; empty when it went as predicted."""
    differences: tuple[str, ...]
    """What reads otherwise than predicted."""
    predicted: str
    """The acting car as the rules predict it: cell, heading, load, place on a slope."""
    read: str
    """The acting car as its pose reads."""
    car_error_m: float
    """Distance of the car from its cell's centre."""
    heading_error_rad: float
    height_error_m: float
    placed_error_m: float | None
    """Distance of what was set down, folded or unfolded from its cell's centre; None for other actions."""
    bystander_displacement_m: float
    """The furthest that anything moved which no action of that time concerns."""
    start_s: float
    """Simulated time since the world was set up."""
    duration_s: float
    peak_force_n: float
    """The largest force between any two machines, the ground included, of all that ran at the same time."""
    capped_steps: int = 0
    """Physics steps meanwhile in which the solver gave up, at ``SimulationConfig.solver_iterations``."""
    tries: int = 1
    """How often the car tried: a failed try may have been made up for by another one."""
    tilt_error_rad: float | None = None
    """How far the car leans away from level or from the incline. This and what follows are None in older records."""
    seat_error_m: float | None = None
    """Distance of what it carries at the end from its seat on the board; None where it carries nothing."""
    thing_heading_rad: float | None = None
    """Of what the action handled: against the grid where that was set down, folded or unfolded, and against the car
    where it is carried; None where it handled nothing."""
    thing_tilt_rad: float | None = None
    """Lean of the same, or by how much its hinge is short of its end where that is more."""
    thing_height_m: float | None = None
    """Height of the same above its floor or its seat."""
    reach_m: float | None = None
    """How much nearer the same comes to a neighbouring cell than it should."""
    bystander_reach_m: float | None = None
    """The same of what stands and no action of that time concerns, as far as an action before has not left it so."""
    bystander_tilt_rad: float | None = None
    """The same of the lean, or of the hinge, of such a thing."""
    bystander_turn_rad: float | None = None
    """The largest turn, about any axis, of anything that no action of that time concerns."""
    drift_m: float | None = None
    """The furthest, at any time since the action began, that such a thing was from where what last handled it left
    it."""
    drift_rad: float | None = None
    """The same of its turn."""

    @classmethod
    def of(cls, fields: Mapping[str, Any]) -> Attempt:
        """Return the attempt that was written as JSON."""
        return cls(**{**fields, "differences": tuple(fields["differences"])})

    def to_frame(self) -> DataFrame:
        """Return a table with one row: the fields."""
        from pandas import DataFrame

        return DataFrame([asdict(self)])

    def __repr__(self) -> str:
        errors = f"{1e3 * self.car_error_m:.2f} mm, {1e3 * self.heading_error_rad:.2f} mrad, {self.duration_s:.2f} s"
        text = errors if self.agrees else self.reason
        return f"Attempt(car {self.car} {self.action}: {self.result}; {text})"

    def _repr_html_(self) -> str:
        colour = "green" if self.agrees else "firebrick"
        fields = "".join(
            f"<tr><th>{name}<td>{html.escape(str(value))}" for name, value in asdict(self).items()
        )
        head = html.escape(f"car {self.car} {self.action}: {self.result}")
        return f"<b style='color:{colour}'>{head}</b><table>{fields}</table>"

    @property
    def agrees(self) -> bool:
        """Whether physics did what the rules predict, within all limits, and nothing else."""
        return self.result == Result.AS_PREDICTED


@dataclass(frozen=True)
class BoundedError:
    """An error of an action, and the limit that it is held against."""

    field: str
    """Of :class:`Attempt`; its unit is the end of its name."""
    limit: str
    """Of :class:`~craftsim.checking.settings.Thresholds`."""
    words: str
    of_bystanders: bool = False
    """Whether it is about what the action does not concern."""


BOUNDED_ERRORS: Final = (
    BoundedError("car_error_m", "car_m", "the car is {} off"),
    BoundedError("heading_error_rad", "heading_rad", "the car is turned by {}"),
    BoundedError("height_error_m", "height_m", "the car's height is {} off"),
    BoundedError("tilt_error_rad", "tilt_rad", "the car leans by {}"),
    BoundedError("placed_error_m", "placed_m", "the thing is set down {} off"),
    BoundedError("seat_error_m", "placed_m", "the load is {} off its seat"),
    BoundedError("thing_heading_rad", "placed_heading_rad", "the thing is turned by {}"),
    BoundedError("thing_tilt_rad", "tilt_rad", "the thing leans, or its hinge stands, {} off"),
    BoundedError("thing_height_m", "height_m", "the thing's height is {} off"),
    BoundedError("reach_m", "placed_m", "the thing is {} too near to a neighbouring cell"),
    BoundedError("bystander_displacement_m", "bystander_m", "{name} was moved by {}", True),
    BoundedError("bystander_turn_rad", "bystander_rad", "{name} was turned by {}", True),
    BoundedError("drift_m", "bystander_m", "{name} was {} away from where it was left", True),
    BoundedError("drift_rad", "bystander_rad", "{name} was turned {} away from how it was left", True),
    BoundedError("bystander_reach_m", "placed_m", "{name} is {} too near to a neighbouring cell", True),
    BoundedError("bystander_tilt_rad", "tilt_rad", "{name} leans, or its hinge stands, {} off", True),
)
"""All errors with their limits, in the order in which reasons name them: those of the car first."""


@dataclass(frozen=True)
class Evidence:
    """What was measured of one action at its end, before it is judged."""

    step: ScheduledAction
    legal: bool
    outcome: Outcome | None
    """Of the skill; None where it was never begun."""
    differences: tuple[str, ...]
    """What reads otherwise of what the action was to change, whatever else happened."""
    own: tuple[str, ...]
    """The car and what it handles, by name."""
    read: str
    car_error_m: float
    heading_error_rad: float
    height_error_m: float
    tilt_error_rad: float
    placed_error_m: float | None
    seat_error_m: float | None
    thing_heading_rad: float | None
    thing_tilt_rad: float | None
    thing_height_m: float | None
    reach_m: float | None
    bystander_displacement_m: float
    bystander_turn_rad: float
    drift_m: float
    drift_rad: float
    bystander_reach_m: float
    bystander_tilt_rad: float
    bystanders: Mapping[str, str]
    """Names of what each of the last six is about; empty ones where there is nothing else."""
    strayed_m: float | None
    """The furthest that the car was beside its path; None on an even floor."""
    start_s: float
    contacts: tuple[Contact, ...]
    """Unexpected ones of the car and what it handles, hardest first."""
    hazards: tuple[Hazard, ...]
    peak_force_n: float
    capped_steps: int

    @property
    def applied(self) -> bool:
        """Whether the skill succeeded and the world reads as it should where the action changes it."""
        return not self.differences and self.outcome is not None and self.outcome.succeeded


def compare(before: Grid, predicted: Grid, reading: Reading) -> Verdict:
    """Return the verdict on one action: the Grid before it, the one the rules predict, and what was read after it."""
    if reading.problems:
        return Verdict(Finding.UNREADABLE, reading.problems)
    read = reading.grid
    if read.same_visible(predicted):
        return Verdict(Finding.AGREES)
    differences = tuple(describe_differences(predicted, read))
    if read.same_visible(before):
        return Verdict(Finding.NOT_EXECUTED, differences)
    meant, happened = changed(before, predicted), changed(before, read)
    others = any((found & ~wanted).any() for wanted, found in zip(meant, happened, strict=True))
    return Verdict(Finding.SIDE_EFFECT if others else Finding.WRONG_PLACE, differences)


def judge(evidence: Evidence, verdict: Verdict, limits: Thresholds) -> Attempt:
    """Return the attempt that the evidence of an action and the verdict on it make, by limits set beforehand."""
    step, outcome = evidence.step, evidence.outcome
    row, after = step.before.cars[step.car], step.after.cars[step.car]
    load = Kind(row[CarField.LOAD])
    result = result_of(evidence, verdict, limits)
    return Attempt(
        tick=step.tick,
        car=step.car,
        action=step.action.name,
        verb=ACTIONS[step.action].verb,
        level=int(row[CarField.Z]),
        load="none" if load == Kind.AIR else load.name.lower(),
        slope=bool(row[CarField.SLOPE] or after[CarField.SLOPE]),
        legal=evidence.legal,
        performed=outcome is not None,
        result=str(result),
        finding=str(verdict.finding),
        skill="not performed" if outcome is None else str(outcome),
        reason="" if result is Result.AS_PREDICTED else reason_of(evidence, verdict, limits),
        differences=verdict.differences,
        predicted=describe_car(step.after, step.car),
        read=evidence.read,
        **{measure.field: getattr(evidence, measure.field) for measure in BOUNDED_ERRORS},
        start_s=evidence.start_s,
        duration_s=0.0 if outcome is None else round(outcome.duration_s, 6),
        peak_force_n=evidence.peak_force_n,
        capped_steps=evidence.capped_steps,
        tries=0 if outcome is None else outcome.tries,
    )


def result_of(evidence: Evidence, verdict: Verdict, limits: Thresholds) -> Result:
    """Return the result of an action; what is unsafe is so even if all ended as predicted.

    Whatever is wrong after a step in which the solver gave up is held against the solver.
    """
    result = _result_of(evidence, verdict, limits)
    unsolved = verdict.finding in (Finding.NUMERICS, Finding.DIVERGED) or evidence.capped_steps > 0
    return Result.NUMERICS if unsolved and result is not Result.AS_PREDICTED else result


def _result_of(evidence: Evidence, verdict: Verdict, limits: Thresholds) -> Result:
    if verdict.finding is Finding.UNSAFE:
        return Result.UNSAFE
    if not evidence.applied or any(_excesses(evidence, limits, of_bystanders=False)):
        return Result.FAILED
    if verdict.agrees and not any(_excesses(evidence, limits, of_bystanders=True)):
        return Result.AS_PREDICTED
    spoilt = verdict.finding in (
        Finding.NOT_EXECUTED,
        Finding.UNSETTLED,
        Finding.NUMERICS,
        Finding.DIVERGED,
    )
    problems = verdict.differences if verdict.finding is Finding.UNREADABLE else ()
    concerned = any(line.startswith(f"{name} ") for line in problems for name in evidence.own)
    return Result.FAILED if spoilt or concerned else Result.SIDE_EFFECT


def reason_of(evidence: Evidence, verdict: Verdict, limits: Thresholds) -> str:
    """Return what went wrong: first what was broken and by how much, then what the car and its load touched.

    What was broken are hazards, limits of errors, what the skill reports, or what reads otherwise than predicted.
    """
    outcome = evidence.outcome
    if outcome is None:
        return verdict.differences[0]
    parts = [verdict.differences[0]] if verdict.finding in (Finding.NUMERICS, Finding.DIVERGED) else []
    if evidence.capped_steps and not parts:
        parts = [capped_text(evidence.capped_steps)]
    parts += [hazard.text for hazard in evidence.hazards[:_SHOWN]]
    own = list(_excesses(evidence, limits, of_bystanders=False)) if evidence.applied else []
    parts += own[:_SHOWN] if outcome.succeeded else [str(outcome)]
    parts += list(_excesses(evidence, limits, of_bystanders=True))[:_SHOWN]
    if not parts:
        parts += verdict.differences[:1]
    if evidence.strayed_m and (own or not evidence.applied):
        parts.append(f"the car strayed {1e3 * evidence.strayed_m:.1f} mm from its path")
    known = {hazard.machines for hazard in evidence.hazards}
    contacts = [c for c in evidence.contacts if (c.first, c.second) not in known]
    parts += [f"{c.first} touched {c.second} ({c.peak_n:.0f} N)" for c in contacts[:_SHOWN]]
    return "; ".join(parts)


def capped_text(steps: int) -> str:
    """Return the reason that an unsolved step gives."""
    return f"the solver gave up in {steps} physics step{'s' * (steps != 1)}"


def _excesses(evidence: Evidence, limits: Thresholds, of_bystanders: bool) -> Iterator[str]:
    """Describe each error that is over its limit, or no number; of each bystander one distance and one angle."""
    described = set()
    for measure in BOUNDED_ERRORS:
        value, limit = getattr(evidence, measure.field), getattr(limits, measure.limit)
        if measure.of_bystanders is not of_bystanders or value is None or value <= limit:
            continue
        name, unit = (
            evidence.bystanders.get(measure.field, ""),
            "mm" if measure.field.endswith("_m") else "mrad",
        )
        if name and (name, unit) in described:
            continue
        described.add((name, unit))
        what = measure.words.format(f"{1e3 * value:.2f} {unit}", name=name)
        yield f"{what} (allowed {1e3 * limit:.2f})"
