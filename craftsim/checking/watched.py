"""Actions while they are judged: the world at their start, and at their end what is measured and read."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

from craftsim.checking.contacts import Contact, Hazard
from craftsim.compiled.arrays import Floats
from craftsim.discrete.readback import PLACE_TOLERANCE_M, Reading
from craftsim.discrete.schedule import ScheduledAction
from craftsim.skills.outcome import Outcome


@dataclass
class Watched:
    """An action being judged: the world at its start and the measurements at its end.

    It becomes an :class:`craftsim.checking.attempt.Attempt`, which holds texts and numbers alone, once all that runs
    with it has ended.
    """

    step: ScheduledAction
    legal: bool
    start_s: float
    capped_before: int
    """Unconverged steps of the PhysicsWorld before the action."""
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
    measured: dict[str, Any] = field(default_factory=dict)
    """Value, or None, by field of :class:`craftsim.checking.measurements.MeasuredValues`."""
    bystanders: dict[str, str] = field(default_factory=dict)
    """Name of the bystander with the largest value, by field; empty without bystanders."""
    contacts: tuple[Contact, ...] = ()
    """Unexpected contacts of the car and what it handles, largest force first."""
    hazards: tuple[Hazard, ...] = ()

    @property
    def applied(self) -> bool:
        """Whether the skill succeeded and the part of the world that it changes reads as predicted."""
        return not self.differences and self.outcome is not None and self.outcome.succeeded

    @property
    def capped_steps(self) -> int:
        """Unconverged steps during the action."""
        steps: int = self.measured["capped_steps"]
        return steps

    @property
    def stops_plan(self) -> bool:
        """Whether a plan that stops at the first failure stops here."""
        moved_m: float = self.measured["bystander_displacement_m"]
        return not self.applied or moved_m > PLACE_TOLERANCE_M

    def is_named_in(self, lines: Iterable[str]) -> bool:
        """Return whether a line begins with the name of the car or of a thing that the action handles."""
        beginnings = tuple(f"{name} " for name in self.names)
        return any(line.startswith(beginnings) for line in lines)
