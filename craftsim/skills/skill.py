"""What every skill is: a resumable controller with a start, steps, and a typed outcome."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

from craftsim.models.parameters import Machines, SmartcarParameters
from craftsim.models.sensing import CarMeasurement, PerWheel
from craftsim.skills.gains import Gains
from craftsim.skills.outcome import Outcome, Reason

GRAVITY = 9.81


@dataclass(frozen=True)
class Terrain:
    """What the map says of the ground of a move: how far it raises the car's nose in the first and in the last cell."""

    start_rad: float = 0.0
    end_rad: float = 0.0

    @property
    def sloping(self) -> bool:
        """Whether the move starts or ends on a slope."""
        return bool(self.start_rad or self.end_rad)


@dataclass(frozen=True)
class SkillSetup:
    """What a skill is given of the car that it controls, of its world and of its tuning."""

    machine: SmartcarParameters
    """The car's own figures."""
    machines: Machines
    """The figures of what it handles."""
    gains: Gains
    period_s: float
    """Control period."""
    terrain: Terrain = Terrain()
    """The ground of a move."""


@dataclass(frozen=True)
class Command:
    """What a car commands its motors for one control period."""

    wheels: PerWheel = (0.0, 0.0, 0.0, 0.0)
    """In rad/s."""
    board: float = 0.0
    """m/s, up positive."""
    hinge: float = 0.0
    """rad/s of the docked slope's hinge, folding positive."""


class Skill(ABC):
    """A controller of one action of one car.

    Call :meth:`start` once, then :meth:`step` each control period and apply the command, until :attr:`outcome` is not
    None. Time is counted in steps, so a skill that is not stepped for a while goes on where it was.
    """

    def __init__(self, setup: SkillSetup) -> None:
        """Prepare for this car, world and tuning."""
        self.setup = setup
        self.period_s = setup.period_s
        self._limits = limits = setup.gains.health
        self._felt_load_n = (
            setup.machine.board_mass_kg + setup.machines.lightest_load_kg * limits.load_share
        ) * GRAVITY
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

    def feels_load(self, now: CarMeasurement) -> bool:
        """Return whether the raised board feels a good share of the lightest load's weight beyond its own."""
        return now.board_m > self._limits.board_raised and now.board_force_n > self._felt_load_n

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
        elif max(abs(now.pitch), abs(now.roll)) > self._limits.tipped:
            self._fail(Reason.TIPPED, f"pitch {now.pitch:+.2f} rad, roll {now.roll:+.2f} rad")

    def _check_load(self, now: CarMeasurement) -> None:
        """Fail when the board has not felt its load for a while: shorter dips come from bumps and acceleration."""
        self._unloaded_s = 0.0 if self.feels_load(now) else self._unloaded_s + self.period_s
        if self._unloaded_s > self._limits.load_lost:
            self._fail(Reason.LOAD_LOST, f"the board feels {now.board_force_n:.1f} N")
