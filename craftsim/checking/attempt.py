"""Attempts: actions tried in physics and judged against limits fixed beforehand, as JSON values."""

from __future__ import annotations

import html
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING, Any, Final, Literal, NamedTuple

from craftsim.checking.contacts import Contact, Hazard
from craftsim.compiled.arrays import Floats
from craftsim.discrete.actions import ACTIONS
from craftsim.discrete.grid import CarField, Grid, Kind
from craftsim.discrete.readback import (
    PLACE_TOLERANCE_M,
    Reading,
    describe_car,
    describe_differences,
    find_changes,
)
from craftsim.discrete.schedule import ScheduledAction
from craftsim.skills.outcome import Outcome
from craftsim.storage.records import record

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
    FAILED = "failed"
    SIDE_EFFECT = "side effect"
    """The predicted effect occurred, and something else moved or changed."""
    UNSAFE = "unsafe"
    """Something tipped or fell, or a contact force exceeded its limit."""
    SOLVER = "numerics"
    """Not as predicted, and the simulation diverged or its solver did not converge: inconclusive."""


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
    "numerics": Verdict.SOLVER,  # no convergence, or forces that nothing could have produced: this proves nothing
    "diverged": Verdict.SOLVER,
}
"""The verdict for each finding, for an action whose own effect is as predicted."""
AGREES: Final = Cause("agrees")


@dataclass(frozen=True, repr=False)
class Attempt:
    """One action tried in physics: the skill's Outcome and the judge's :class:`Verdict`, as JSON values.

    Errors are those at the action's end.

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
    car_error_m: float
    """Distance of the car from its cell's centre."""
    heading_error_rad: float
    height_error_m: float
    placed_error_m: float | None
    """Distance of what was set down, folded or unfolded from its cell's centre; None for other actions."""
    bystander_displacement_m: float
    """Largest displacement of a bystander: a thing that no action of that time concerns."""
    start_s: float
    """Simulated time since the world was set up."""
    duration_s: float
    peak_force_n: float
    """The largest force between two machines, the ground included, during the action."""
    capped_steps: int
    """Physics steps that reached ``SimulationConfig.solver_iterations``."""
    tries: int
    """Number of tries of the skill."""
    tilt_error_rad: float | None
    """Lean of the car against level or the incline. This and the following are None where they are not finite."""
    seat_error_m: float | None
    """Distance of the load from its seat on the board at the end; None without a load."""
    thing_heading_rad: float | None
    """Heading error of the handled thing: against the grid if set down, folded or unfolded, against the car if carried;
    None without one."""
    thing_tilt_rad: float | None
    """Lean of the same, or, if larger, the distance of its hinge from its stop."""
    thing_height_m: float | None
    """Height of the same above its floor or seat."""
    reach_m: float | None
    """Excess reach of the same towards a neighbouring cell."""
    bystander_reach_m: float | None
    """Excess reach of a bystander, unless an earlier action left it so."""
    bystander_tilt_rad: float | None
    """Lean or hinge error of a bystander, unless an earlier action left it so."""
    bystander_turn_rad: float | None
    """Largest rotation of a bystander about any axis."""
    drift_m: float | None
    """Largest distance of a bystander, at any time since the action began, from where it was last put."""
    drift_rad: float | None
    """The same for its rotation."""

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
        return self.result == Verdict.AS_PREDICTED


@record()
class Thresholds:
    """Limits of the errors of an action that agrees with its prediction; fixed before a run.

    Things in neighbouring cells are 2.5 mm apart: a cell is 322.5 mm wide, a block or slope 320. So each may use half
    of the gap, 1.25 mm, for all its errors together: position, heading times half a cell, and lean times a level
    (:attr:`craftsim.discrete.readback.CellFit.reach_m`). That is ``placed_m``, for things set down, carried or
    standing; a car alone is much narrower than its cell. A heading error of ``placed_heading_rad`` uses 0.8 mm of the
    1.25.

    Raises InputError for a value that is not finite.
    """

    car_m: float = 0.001
    """Distance of the car from its cell's centre."""
    heading_rad: float = 0.003
    placed_m: float = 0.00125
    """Distance from the cell's centre of a thing set down, folded or unfolded; distance of a load from its seat; excess
    reach of these and of bystanders."""
    bystander_m: float = 0.001
    """Displacement of bystanders from the action's start to its end, and at any time from where they were last put."""
    height_m: float = 0.002
    """Height error of the car, of a thing set down, and of a load."""
    tilt_rad: float = 0.010
    """Lean of the car and of all things against level or the incline, and distance of a slope's hinge from its stop.
    Over the 0.2 m between a car's axles it equals ``height_m``."""
    placed_heading_rad: float = 0.005
    """Heading error of a thing set down, folded or unfolded, and of a load against its car."""
    bystander_rad: float = 0.004
    """Rotation of bystanders about any axis, over the same times: a corner at 0.23 m then moves by 0.9 mm."""
    force: float = 1.0
    """Contact force between two machines, as a share of the largest force that weights and motors of the nominal
    machines can exert (:func:`craftsim.checking.contacts.impact_limit_n`)."""


BOUNDED_ERRORS: Final = {
    "car_error_m": ("car_m", "the car is {} off"),
    "heading_error_rad": ("heading_rad", "the car is turned by {}"),
    "height_error_m": ("height_m", "the car's height is {} off"),
    "tilt_error_rad": ("tilt_rad", "the car leans by {}"),
    "placed_error_m": ("placed_m", "the thing is set down {} off"),
    "seat_error_m": ("placed_m", "the load is {} off its seat"),
    "thing_heading_rad": ("placed_heading_rad", "the thing is turned by {}"),
    "thing_tilt_rad": ("tilt_rad", "the thing leans, or its hinge stands, {} off"),
    "thing_height_m": ("height_m", "the thing's height is {} off"),
    "reach_m": ("placed_m", "the thing is {} too near to a neighbouring cell"),
    "bystander_displacement_m": ("bystander_m", "{name} was moved by {}"),
    "bystander_turn_rad": ("bystander_rad", "{name} was turned by {}"),
    "drift_m": ("bystander_m", "{name} was {} away from where it was left"),
    "drift_rad": ("bystander_rad", "{name} was turned {} away from how it was left"),
    "bystander_reach_m": ("placed_m", "{name} is {} too near to a neighbouring cell"),
    "bystander_tilt_rad": ("tilt_rad", "{name} leans, or its hinge stands, {} off"),
}
"""For each error, a field of :class:`Attempt`: its limit, a field of :class:`Thresholds`, and its text for a reason. In
the order of reasons: those of the car first."""
BYSTANDER_ERRORS: Final = tuple(
    error for error, (_, words) in BOUNDED_ERRORS.items() if "{name}" in words
)
"""Errors of what an action does not concern."""


@dataclass
class Watched:
    """An action being judged: the world at its start and the measurements at its end.

    It becomes an :class:`Attempt`, which holds texts and numbers alone, once all that runs with it has ended.
    """

    step: ScheduledAction
    legal: bool
    start_s: float
    capped_steps: int
    """Unconverged steps: of the PhysicsWorld before the action, at its end those of the action."""
    poses: Floats
    """(n, 7) poses of cars and objects; for an object moved by an action that ended meanwhile, its pose after that."""
    reading: Reading
    handled: list[int]
    """Rows of the objects that the action handles, in ``poses``."""
    names: tuple[str, ...]
    """Names of the car and these objects."""
    below: list[int]
    """Rows of the objects below the car: a stack sways under it until it is at rest."""
    cars: set[int]
    """Cars that act meanwhile, its own included."""
    movable: set[int]
    """Rows of the objects that may move: those handled by this action and by concurrent ones."""
    outcome: Outcome | None = None
    """Outcome of the skill; None if it was never started."""
    differences: tuple[str, ...] = ()
    """Differences in the part of the world that the action changes."""
    read: str = ""
    readable: bool = False
    """Whether the world could be read as a grid at the action's end."""
    errors: dict[str, Any] = field(default_factory=dict)
    """Value, or None, by field of :data:`BOUNDED_ERRORS`."""
    bystanders: dict[str, str] = field(default_factory=dict)
    """Name of the bystander with the largest error, by field; empty without bystanders."""
    strayed_m: float | None = None
    """Largest lateral distance of the car from its path; None on an even floor."""
    contacts: tuple[Contact, ...] = ()
    """Unexpected contacts of the car and what it handles, largest force first."""
    hazards: tuple[Hazard, ...] = ()
    peak_force_n: float = 0.0

    @property
    def applied(self) -> bool:
        """Whether the skill succeeded and the part of the world that it changes reads as predicted."""
        return not self.differences and self.outcome is not None and self.outcome.succeeded

    @property
    def stops_plan(self) -> bool:
        """Whether a plan that stops at the first failure stops here."""
        moved_m: float = self.errors["bystander_displacement_m"]
        return not self.applied or moved_m > PLACE_TOLERANCE_M

    def is_named_in(self, lines: Iterable[str]) -> bool:
        """Return whether a line begins with the name of the car or of a thing that the action handles."""
        beginnings = tuple(f"{name} " for name in self.names)
        return any(line.startswith(beginnings) for line in lines)

    def exceeded(self, limits: Thresholds) -> list[str]:
        """Return the errors above their limits, or not finite."""
        exceeded = []
        for error, (limit, _) in BOUNDED_ERRORS.items():
            value = self.errors[error]
            # nan is not below any limit.
            if value is not None and not value <= getattr(limits, limit):
                exceeded.append(error)
        return exceeded

    def excesses(self, limits: Thresholds, of_bystanders: bool) -> list[str]:
        """Describe the errors above their limits: one distance and one angle of each bystander."""
        texts: dict[Any, str] = {}
        for error in self.exceeded(limits):
            if (error in BYSTANDER_ERRORS) is not of_bystanders:
                continue
            limit, words = BOUNDED_ERRORS[error]
            if error.endswith("_m"):
                unit = "mm"
            else:
                unit = "mrad"
            name = self.bystanders.get(error, "")
            excess = words.format(f"{1e3 * self.errors[error]:.2f} {unit}", name=name)
            text = f"{excess} (allowed {1e3 * getattr(limits, limit):.2f})"
            key: Any = error
            if name:
                key = name, unit
            texts.setdefault(key, text)
        return list(texts.values())[:_SHOWN]


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
        reason="" if verdict is Verdict.AS_PREDICTED else _reason_of(watched, cause, limits),
        differences=cause.differences,
        predicted=describe_car(step.after, step.car),
        read=watched.read,
        **watched.errors,
        start_s=watched.start_s,
        duration_s=0.0 if outcome is None else round(outcome.duration_s, 6),
        peak_force_n=watched.peak_force_n,
        capped_steps=watched.capped_steps,
        tries=0 if outcome is None else outcome.tries,
    )


def verdict_of(watched: Watched, cause: Cause, limits: Thresholds) -> Verdict:
    """Return the verdict on an action. Hazards make it unsafe even if the reading is as predicted.

    A disagreement after an unconverged step is attributed to the solver.
    """
    exceeded = watched.exceeded(limits)
    verdict = VERDICTS[cause.finding]
    if verdict not in (Verdict.UNSAFE, Verdict.SOLVER):
        unreadable = cause.finding == "unreadable" and watched.is_named_in(cause.differences)
        if not watched.applied or unreadable or not set(exceeded) <= set(BYSTANDER_ERRORS):
            verdict = Verdict.FAILED
        elif verdict is Verdict.AS_PREDICTED and exceeded:
            verdict = Verdict.SIDE_EFFECT
    if watched.capped_steps and verdict is not Verdict.AS_PREDICTED:
        return Verdict.SOLVER
    return verdict


def _reason_of(watched: Watched, cause: Cause, limits: Thresholds) -> str:
    """Return the reason of a failure: hazards, exceeded limits, the skill's report or differences, then contacts."""
    outcome = watched.outcome
    if outcome is None:
        return cause.differences[0]
    parts: list[str] = []
    if VERDICTS[cause.finding] is Verdict.SOLVER:
        parts.append(cause.differences[0])
    elif watched.capped_steps:
        parts.append(capped_text(watched.capped_steps))
    parts += [text for _, text in watched.hazards[:_SHOWN]]
    excesses = []
    if watched.applied:
        excesses = watched.excesses(limits, of_bystanders=False)
    if outcome.succeeded:
        parts += excesses
    else:
        parts.append(str(outcome))
    parts += watched.excesses(limits, of_bystanders=True)
    if not parts:
        parts += cause.differences[:1]
    if watched.strayed_m and (excesses or not watched.applied):
        parts.append(f"the car strayed {1e3 * watched.strayed_m:.1f} mm from its path")
    in_hazards = {machines for machines, _ in watched.hazards}
    contacts = [
        contact for contact in watched.contacts if (contact.first, contact.second) not in in_hazards
    ]
    for contact in contacts[:_SHOWN]:
        parts.append(f"{contact.first} touched {contact.second} ({contact.peak_n:.0f} N)")
    return "; ".join(parts)


def capped_text(steps: int) -> str:
    """Return the text for unconverged steps."""
    return f"the solver did not converge in {steps} physics step{'s' * (steps != 1)}"
