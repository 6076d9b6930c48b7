"""What every skill is: a resumable controller with a start, steps, and a typed outcome."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

from craftsim.models.parameters import BLOCK, SMARTCAR
from craftsim.models.sensing import CarMeasurement, PerWheel
from craftsim.skills.outcome import Outcome, Reason

GRAVITY = 9.81
_TIPPED_RAD = 0.45
_FELT_LOAD_N = (SMARTCAR.board_mass_kg + BLOCK.mass_kg / 2) * GRAVITY
_RAISED_M = 0.015
_LOST_S = 0.3


@dataclass(frozen=True)
class Command:
    """What a car tells its motors for one control period."""

    wheels: PerWheel = (0.0, 0.0, 0.0, 0.0)
    """In rad/s."""
    board: float = 0.0
    """m/s, up positive."""
    hinge: float = 0.0
    """rad/s of the docked slope's hinge, folding positive."""


def feels_load(now: CarMeasurement) -> bool:
    """Return whether the raised board feels at least half a block's weight beyond its own."""
    return now.board_m > _RAISED_M and now.board_force_n > _FELT_LOAD_N


class Skill(ABC):
    """A controller of one action of one car.

    Call :meth:`start` once, then :meth:`step` each control period and apply the command, until :attr:`outcome` is not
    None. Time is counted in steps, so a skill that is not stepped for a while goes on where it was.
    """

    def __init__(self, period_s: float) -> None:
        """Prepare for a control period in seconds."""
        self.period_s = period_s
        self.elapsed_s = 0.0
        self.outcome: Outcome | None = None
        self._unloaded_s = 0.0

    def start(self, now: CarMeasurement) -> None:
        """Derive the goal from what the car measures now; a car in no state to act ends the skill at once."""
        self._check_health(now)
        if self.outcome is None:
            self._begin(now)

    @abstractmethod
    def _begin(self, now: CarMeasurement) -> None:
        """Derive the goal from plausible measurements."""

    def step(self, now: CarMeasurement) -> Command:
        """Return the command for the next control period; sets :attr:`outcome` when the skill has ended."""
        if self.outcome is None:
            self._check_health(now)
        if self.outcome is None:
            command = self._control(now)
            self.elapsed_s += self.period_s
            if self.outcome is None:
                return command
        return Command()

    @abstractmethod
    def _control(self, now: CarMeasurement) -> Command:
        """Return the next command, or end the skill by :meth:`_succeed` or :meth:`_fail`."""

    def _succeed(self) -> None:
        self.outcome = Outcome(None, self.elapsed_s)

    def _fail(self, reason: Reason, detail: str) -> None:
        self.outcome = Outcome(reason, self.elapsed_s, detail)

    def _check_health(self, now: CarMeasurement) -> None:
        # A sum is finite only if all its terms are.
        pose = now.x + now.y + now.z + now.heading + now.pitch + now.roll
        joints = now.board_m + now.board_force_n + (now.hinge_rad or 0.0) + sum(now.wheel_speeds)
        if not math.isfinite(pose + joints):
            self._fail(Reason.DIVERGED, "a measurement is not finite")
        elif max(abs(now.pitch), abs(now.roll)) > _TIPPED_RAD:
            self._fail(Reason.TIPPED, f"pitch {now.pitch:+.2f} rad, roll {now.roll:+.2f} rad")

    def _check_load(self, now: CarMeasurement) -> None:
        """Fail when the board has not felt its load for a while: shorter dips come from bumps and acceleration."""
        self._unloaded_s = 0.0 if feels_load(now) else self._unloaded_s + self.period_s
        if self._unloaded_s > _LOST_S:
            self._fail(Reason.LOAD_LOST, f"the board feels {now.board_force_n:.1f} N")
