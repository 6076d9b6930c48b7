"""Attempts: one action tried in physics, judged against limits that were set beforehand, in a form that JSON knows."""

from __future__ import annotations

import html
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING, Any, Final, Literal, NamedTuple

from craftsim.checking.contacts import Contact, Hazard
from craftsim.discrete.actions import ACTIONS
from craftsim.discrete.grid import CarField, Grid, Kind
from craftsim.discrete.readback import Floats, Reading, changed, describe_car, describe_differences
from craftsim.discrete.schedule import ScheduledAction
from craftsim.skills.outcome import Outcome
from craftsim.storage.records import record

if TYPE_CHECKING:
    from pandas import DataFrame

_SHOWN: Final = 2
"""How many hazards, and how many contacts, a reason names."""


class Verdict(StrEnum):
    """The judge's verdict on an action."""

    AS_PREDICTED = "as predicted"
    """The grid that was read is the predicted one, and every error is within its limit."""
    FAILED = "failed"
    SIDE_EFFECT = "side effect"
    """It did what was predicted, and something else moved or changed."""
    UNSAFE = "unsafe"
    """Something tipped, fell, or hit harder than it may."""
    SOLVER = "numerics"
    """The simulation broke down or was not solved, and it did not end as predicted: this says nothing of the action."""


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
"""What is found where prediction and reading are compared."""
Cause = tuple[Finding, tuple[str, ...]]
"""What a verdict rests on: what was found, and in words what differs."""

VERDICTS: Final[Mapping[Finding, Verdict]] = {
    "agrees": Verdict.AS_PREDICTED,
    "not executed": Verdict.FAILED,
    "wrong place": Verdict.SIDE_EFFECT,
    "side effect": Verdict.SIDE_EFFECT,
    "unreadable": Verdict.SIDE_EFFECT,
    "unsafe": Verdict.UNSAFE,
    "unsettled": Verdict.FAILED,  # something still moves although no motor is commanded
    "numerics": Verdict.SOLVER,  # no convergence, or forces that nothing could have produced: this proves nothing
    "diverged": Verdict.SOLVER,
}
"""The verdict that each finding means for an action that did itself what it should."""
AGREES: Final[Cause] = ("agrees", ())


@dataclass(frozen=True, repr=False)
class Attempt:
    """One action tried in physics; made of what JSON knows. Errors are those at the action's end.

    Example:
        >>> import craftsim
        >>> physics = craftsim.PhysicsWorld(craftsim.Grid.empty((3, 1, 1), n_cars=1))
        >>> attempt = craftsim.perform(physics, 0, "LIFT")
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
    """A :class:`Verdict`."""
    finding: str
    """What the verdict rests on, a key of :data:`VERDICTS`."""
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
        return self.result == Verdict.AS_PREDICTED


@record()
class Thresholds:
    """The largest errors with which an action still agrees with its prediction; set before anything is run.

    Things in neighbouring cells stand 2.5 mm apart: a cell is 322.5 mm wide, a block or slope 320. So each may come
    nearer to the other by half of that, 1.25 mm, all taken together: place, heading times half a cell, and lean times
    a level (:attr:`craftsim.discrete.readback.CellFit.reach_m`). That is ``placed_m``, for what is set down, what is
    carried and what stands; a car alone is far narrower than its cell. A heading off by ``placed_heading_rad`` takes
    0.8 mm of the 1.25, and leaning by ``tilt_rad`` more than all of it.

    Raises InputError for what is no finite number.
    """

    car_m: float = 0.001
    """Distance of the car from its cell's centre."""
    heading_rad: float = 0.003
    placed_m: float = 0.00125
    """Of what was set down, folded or unfolded its distance from its cell's centre, and of what is carried that from
    its seat; of these, and of all that stands, how much nearer it comes to a neighbouring cell."""
    bystander_m: float = 0.001
    """Displacement of anything that the action does not concern, from the action's start to its end; and from where it
    was left by what last handled it, at any time since the action began."""
    height_m: float = 0.002
    """Of the car above the ground, of what was set down above the floor, of a load above its seat."""
    tilt_rad: float = 0.010
    """Lean of the car, and of all that stands or is carried, away from level or from the incline; and by how much a
    slope's hinge is short of its end. Over the 0.2 m between a car's axles it is ``height_m``."""
    placed_heading_rad: float = 0.005
    """Of what was set down, folded or unfolded against the grid, and of what is carried against its car."""
    bystander_rad: float = 0.004
    """Turn about any axis of the same over the same times: a corner, 0.23 m from the middle, then moves by 0.9 mm."""
    force: float = 1.0
    """The hardest that two machines may press on each other, as a share of what weights and motors of the nominal
    machines can do (:func:`craftsim.checking.contacts.impact_limit_n`)."""


class BoundedError(NamedTuple):
    """An error of an action, and the limit that it is held against."""

    field: str
    """Of :class:`Attempt`; its unit is the end of its name."""
    limit: str
    """Of :class:`~craftsim.checking.attempt.Thresholds`."""
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


@dataclass
class Watched:
    """An action, with the world as it was at its start and what was measured of it at its end."""

    index: int
    """In the schedule."""
    step: ScheduledAction
    start_s: float
    capped_steps: int
    """Of the PhysicsWorld until the start; at the end, of the action."""
    poses: Floats
    """(n, 7) of cars and objects; of what has been moved by an action that ended meanwhile, where that left it."""
    reading: Reading
    about: list[int]
    """Objects that the action is about, by their index."""
    own: tuple[str, ...]
    """The car and these, by name."""
    below: set[int]
    """Objects that the car stands and drives on: a stack sways under it until it has come to rest."""
    cars: set[int]
    """Those that act meanwhile, its own included."""
    meant: set[int]
    """Objects that may move though no acting car carries them: what the action and those beside it are about."""
    legal: bool = True
    outcome: Outcome | None = None
    """Of the skill; None where it was never begun."""
    differences: tuple[str, ...] = ()
    """What reads otherwise of what the action was to change, whatever else happened."""
    read: str = ""
    errors: dict[str, Any] = field(default_factory=dict)
    """A number, or None, by field of :data:`BOUNDED_ERRORS`."""
    bystanders: dict[str, str] = field(default_factory=dict)
    """Names of what errors of bystanders are about; empty ones where there is nothing else."""
    strayed_m: float | None = None
    """The furthest that the car was beside its path; None on an even floor."""
    contacts: tuple[Contact, ...] = ()
    """Unexpected ones of the car and what it handles, hardest first."""
    hazards: tuple[Hazard, ...] = ()
    peak_force_n: float = 0.0

    @property
    def applied(self) -> bool:
        """Whether the skill succeeded and the world reads as it should where the action changes it."""
        return not self.differences and self.outcome is not None and self.outcome.succeeded

    def exceeded(self, limits: Thresholds) -> list[BoundedError]:
        """Return the errors that are over their limits, or no numbers."""
        values = ((one, self.errors[one.field]) for one in BOUNDED_ERRORS)
        return [one for one, value in values if value is not None and not value <= getattr(limits, one.limit)]

    def excesses(self, exceeded: Iterable[BoundedError], limits: Thresholds, of_others: bool) -> list[str]:
        """Describe what is over its limit of this action or of bystanders; of each of these a distance and an angle."""
        found: dict[Any, str] = {}
        for one in exceeded:
            if one.of_bystanders is of_others:
                unit = "mm" if one.field.endswith("_m") else "mrad"
                name, value = self.bystanders.get(one.field, ""), self.errors[one.field]
                what = one.words.format(f"{1e3 * value:.2f} {unit}", name=name)
                told = f"{what} (allowed {1e3 * getattr(limits, one.limit):.2f})"
                found.setdefault((name, unit) if name else one, told)
        return list(found.values())[:_SHOWN]


def compare(before: Grid, predicted: Grid, reading: Reading) -> Cause:
    """Return what is found of one action: the Grid before it, the one the rules predict, and what was read after it."""
    if reading.problems:
        return "unreadable", reading.problems
    read = reading.grid
    if read.same_visible(predicted):
        return AGREES
    differences = tuple(describe_differences(predicted, read))
    if read.same_visible(before):
        return "not executed", differences
    meant, happened = changed(before, predicted), changed(before, read)
    others = any((found & ~wanted).any() for wanted, found in zip(meant, happened, strict=True))
    return "side effect" if others else "wrong place", differences


def attempt_of(watched: Watched, cause: Cause, limits: Thresholds) -> Attempt:
    """Return the attempt that what was measured of an action makes, by limits set beforehand."""
    step, outcome = watched.step, watched.outcome
    row, after = step.before.cars[step.car], step.after.cars[step.car]
    load = int(row[CarField.LOAD])
    exceeded = watched.exceeded(limits)
    verdict = verdict_of(watched, cause, exceeded)
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
        finding=cause[0],
        skill="not performed" if outcome is None else str(outcome),
        reason="" if verdict is Verdict.AS_PREDICTED else reason_of(watched, cause, exceeded, limits),
        differences=cause[1],
        predicted=describe_car(step.after, step.car),
        read=watched.read,
        **watched.errors,
        start_s=watched.start_s,
        duration_s=0.0 if outcome is None else round(outcome.duration_s, 6),
        peak_force_n=watched.peak_force_n,
        capped_steps=watched.capped_steps,
        tries=0 if outcome is None else outcome.tries,
    )


def verdict_of(watched: Watched, cause: Cause, exceeded: Iterable[BoundedError]) -> Verdict:
    """Return the verdict on an action; what is unsafe is so even if all ended as predicted.

    Whatever is wrong after a step in which the solver gave up is held against the solver.
    """
    finding, lines = cause
    verdict = VERDICTS[finding]
    if verdict not in (Verdict.UNSAFE, Verdict.SOLVER):
        problems = lines if finding == "unreadable" else ()
        concerned = any(line.startswith(f"{name} ") for line in problems for name in watched.own)
        if not watched.applied or concerned or any(not one.of_bystanders for one in exceeded):
            verdict = Verdict.FAILED
        elif verdict is Verdict.AS_PREDICTED and any(exceeded):
            verdict = Verdict.SIDE_EFFECT
    return Verdict.SOLVER if watched.capped_steps and verdict is not Verdict.AS_PREDICTED else verdict


def reason_of(watched: Watched, cause: Cause, exceeded: Iterable[BoundedError], limits: Thresholds) -> str:
    """Return what went wrong: first what was broken and by how much, then what the car and its load touched.

    What was broken are hazards, limits of errors, what the skill reports, or what reads otherwise than predicted.
    """
    (finding, differences), outcome = cause, watched.outcome
    if outcome is None:
        return differences[0]
    parts = [differences[0]] if VERDICTS[finding] is Verdict.SOLVER else []
    if watched.capped_steps and not parts:
        parts = [capped_text(watched.capped_steps)]
    parts += [text for _, text in watched.hazards[:_SHOWN]]
    own = watched.excesses(exceeded, limits, of_others=False) if watched.applied else []
    parts += own if outcome.succeeded else [str(outcome)]
    parts += watched.excesses(exceeded, limits, of_others=True)
    if not parts:
        parts += differences[:1]
    if watched.strayed_m and (own or not watched.applied):
        parts.append(f"the car strayed {1e3 * watched.strayed_m:.1f} mm from its path")
    known = {machines for machines, _ in watched.hazards}
    contacts = [c for c in watched.contacts if (c.first, c.second) not in known]
    parts += [f"{c.first} touched {c.second} ({c.peak_n:.0f} N)" for c in contacts[:_SHOWN]]
    return "; ".join(parts)


def capped_text(steps: int) -> str:
    """Return the reason that an unsolved step gives."""
    return f"the solver gave up in {steps} physics step{'s' * (steps != 1)}"
