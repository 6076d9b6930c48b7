"""What every skill is: a resumable controller with a start, steps, and a typed outcome."""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from craftsim.discrete.kernel.jit import records
from craftsim.models.measuring import READING, CarMeasurement, Floats, PerWheel, Records, write_reading
from craftsim.models.parameters import Machines, SmartcarParameters
from craftsim.skills.gains import Gains, careful
from craftsim.skills.health import check_health
from craftsim.skills.outcome import Outcome, Reason
from craftsim.skills.state import COMMAND, NO_TASK, OWN, TASK, constants_of, outcome_of

Law = Callable[[Records, Records, Floats, Records, Records, int], None]
"""A compiled controller: (readings, tasks, past, constants, commands, car); it reads and writes what is the car's."""


@dataclass(frozen=True)
class Terrain:
    """What the map says of a move: by how much the ground raises the car's nose in its two cells, and the room."""

    start_rad: float = 0.0
    end_rad: float = 0.0
    tight: bool = False
    """Whether the way leads under something, or takes a load past something."""

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
    constants: Records = field(init=False, repr=False, compare=False)
    """(1,) CONSTANTS of :mod:`craftsim.skills.state`, not to be written to: all of these for compiled controllers."""

    def __post_init__(self) -> None:
        constants = constants_of(self.machine, self.machines, self.gains, self.period_s)
        object.__setattr__(self, "constants", constants)

    def on(self, terrain: Terrain) -> SkillSetup:
        """Return the same for a move on other ground."""
        if terrain == self.terrain:
            return self
        setup = copy.copy(self)
        object.__setattr__(setup, "terrain", terrain)
        return setup

    def carefully(self) -> SkillSetup:
        """Return the same for driving as slowly as on an uneven floor."""
        return replace(self, gains=careful(self.gains))


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
        self.outcome: Outcome | None = None
        self.task = records(1, TASK)
        """(1,) TASK: what the skill remembers."""
        self.task[0] = NO_TASK
        self.task[0]["law"] = OWN
        self._reading = records(1, READING)
        self._read: CarMeasurement | None = None
        """What ``_reading`` holds."""

    @property
    def elapsed_s(self) -> float:
        """Simulated time in which it was stepped."""
        return float(self.task[0]["elapsed_s"])

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
            self.task[0]["elapsed_s"] += self.period_s
            if self.outcome is None:
                return command
        return Command()

    @abstractmethod
    def _control(self, now: CarMeasurement) -> Command:
        """Return the next command, or end the skill by :meth:`_succeed` or :meth:`_fail`."""

    def feels_load(self, now: CarMeasurement) -> bool:
        """Return whether the raised board feels a good share of the lightest load's weight beyond its own."""
        self._take(now)
        check_health(self._reading, self.task, self.setup.constants, 0)
        return bool(self.task[0]["feels_load"])

    def _take(self, now: CarMeasurement) -> None:
        """Write a measurement into the record that compiled code reads, if it is not there yet."""
        if now is not self._read:
            write_reading(now, self._reading)
            self._read = now

    def _succeed(self) -> None:
        self.outcome = Outcome(None, self.elapsed_s)

    def _fail(self, reason: Reason, detail: str) -> None:
        self.outcome = Outcome(reason, self.elapsed_s, detail)

    def _check_health(self, now: CarMeasurement) -> None:
        self._take(now)
        check_health(self._reading, self.task, self.setup.constants, 0)
        self.conclude()

    def conclude(self) -> None:
        """Take over the outcome of a task that compiled code has ended."""
        self.outcome = outcome_of(self.task[0]) or self.outcome


class CompiledSkill(Skill):
    """A skill whose controller is compiled: an executor runs it for all cars at once, without this object."""

    def __init__(self, setup: SkillSetup, law: Law, number: int) -> None:
        """Prepare for this car, world and tuning.

        Args:
            setup: what it is given.
            law: its controller.
            number: by which the executor's compiled loop knows the law (:mod:`craftsim.skills.control`).
        """
        super().__init__(setup)
        self._law = law
        self.task[0]["law"] = number
        self.past = np.zeros((1, n_past(setup.gains, setup.period_s)))
        """(1, :func:`n_past`): what the law remembers of the last periods."""
        self._command = records(1, COMMAND)

    def _control(self, now: CarMeasurement) -> Command:
        self._take(now)
        self._command[0] = ((0.0, 0.0, 0.0, 0.0), 0.0, 0.0)
        self._law(self._reading, self.task, self.past, self.setup.constants, self._command, 0)
        self.conclude()
        command = self._command[0]
        fl, fr, rl, rr = command["wheels"].tolist()
        return Command((fl, fr, rl, rr), float(command["board"]), float(command["hinge"]))

    @property
    def runs_compiled(self) -> bool:
        """Whether nothing of its steps is a subclass's own."""
        own = type(self)
        return own._control is CompiledSkill._control and own.step is Skill.step

    def move_to(self, tasks: Records, past: Floats) -> None:
        """Remember in other arrays of the same shapes from now on."""
        # Copying an array of records as a whole would take NumPy ten times as long.
        tasks[0], past[0] = self.task[0], self.past[0]
        self.task, self.past = tasks, past


def n_past(gains: Gains, period_s: float) -> int:
    """Return over how many control periods laws remember a number: over the time in which a hinge must be still."""
    return round(gains.hinge.still_time / period_s) + 1
