"""Running skills of many cars in lock-step on one Site."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.kernel.jit import records
from craftsim.discrete.kinds import Action
from craftsim.models.measuring import CarMeasurement, Motors, Records, measurement_of
from craftsim.models.sensing import EXACT, SensorNoise, Sensors
from craftsim.models.world import Site
from craftsim.skills.control import step_cars
from craftsim.skills.fleet import Fleet, SiteFleet
from craftsim.skills.gains import Gains, load_gains
from craftsim.skills.ground import GROUND
from craftsim.skills.holding import on_incline
from craftsim.skills.leading import leads
from craftsim.skills.localisation import Localiser
from craftsim.skills.outcome import Outcome, Reason
from craftsim.skills.recovery import Tries
from craftsim.skills.skill import CompiledSkill, Skill, SkillSetup, Terrain, n_past
from craftsim.skills.state import COMMAND, CONSTANTS, HOLD, IDLE, NO_TASK, OWN, TASK

Observer = Callable[[Site], None]
Guard = Callable[[], bool]
"""Returns whether something unsafe has happened."""


class Executor:
    """Performs actions on a Site: any number of cars act at the same time, each until its skill has ended.

    Example:
        >>> import craftsim
        >>> site = craftsim.Site(craftsim.Grid.empty((3, 1, 1), n_cars=1))
        >>> outcome = craftsim.Executor(site).run({0: craftsim.Action.ROTATE_LEFT})[0]
        >>> outcome.succeeded
        True
    """

    def __init__(
        self,
        site: Site,
        gains: Gains | None = None,
        observer: Observer | None = None,
        sensors: Sensors | None = None,
        motors: Motors | None = None,
        assumed: SensorNoise = EXACT,
        fleet: Fleet | None = None,
    ) -> None:
        """Run on a Site with these gains, sensors and motors (exact and prompt ones unless given).

        ``assumed`` is what the cars take the noise of their localisation to be, whatever that of the sensors is; with
        none they take each measured pose as it is.

        ``observer`` is called after every control period; :attr:`observers` takes more of them.

        ``fleet`` are robots that are driven in place of the Site's cars: the Site then says what they and their world
        are like, and it is theirs to change.
        """
        self.site = site
        self.gains = gains or load_gains()
        self.observers: list[Observer] = [] if observer is None else [observer]
        self.step_observer: Callable[[], None] | None = None
        """Called after every physics step."""
        self.guard: Guard | None = None
        """Asked after every control period: a yes stops all cars, and ends their actions."""
        self.fleet: Fleet = fleet or SiteFleet(site, sensors, motors)
        period = site.config.control_period_s
        self._setups = [SkillSetup(car.parameters, site.machines, self.gains, period) for car in site.cars]
        self._localiser = (
            None
            if assumed.exact_pose
            else Localiser(
                assumed, period, [car.parameters for car in site.cars], self.gains.localisation, site.size
            )
        )
        n = len(site.cars)
        self._constants = records(n, CONSTANTS)
        for car, setup in enumerate(self._setups):
            self._constants[car] = setup.constants[0]
        self._tasks, self._commands = records(n, TASK), records(n, COMMAND)
        self._past = np.zeros((n, n_past(self.gains, period)))
        self._grounds = records(n, GROUND)
        self._docked = np.full(n, -1)
        """The slope that each car commands, -1 for none."""
        wires = self.fleet.wires
        self._arrays = (
            *(self._tasks, self._past, self._constants, self._commands, wires.cars, wires.plugs),
            *(self._docked, leads(n, period), self._grounds, wires.speeds, wires.share, wires.ctrl),
        )
        """What the compiled laws work on."""
        self._skills: dict[int, Skill] = {}
        self._tries: dict[int, Tries] = {}
        self._own: list[int] = []
        """The cars whose skills are in Python."""
        self._look()
        for car in range(n):
            self._park(car, self.readings())

    def run(
        self, actions: Mapping[int, Action], terrain: Mapping[int, Terrain] | None = None
    ) -> dict[int, Outcome]:
        """Perform one action for each given car, and return the outcomes by car; other cars are left at rest.

        ``terrain`` gives the ground of the moves that are not on the flat, by car.
        """
        for car, action in actions.items():
            self.begin(car, action, (terrain or {}).get(car))
        outcomes: dict[int, Outcome] = {}
        while self.busy:
            outcomes |= self.advance()
        return outcomes

    @property
    def busy(self) -> frozenset[int]:
        """The cars whose actions have not ended."""
        return frozenset(self._skills)

    def readings(self) -> Records:
        """Return what the cars believe to measure, shape (n,) of READING; the array is used again by the next ones."""
        return self.fleet.read() if self._localiser is None else self._localiser.readings

    @property
    def commands(self) -> Records:
        """What the cars were told last, shape (n,) of COMMAND; the array is used again by the next ones."""
        return self._commands

    @property
    def floor_is_uneven(self) -> bool:
        """Whether a car has felt that the floor, which is that of all, is uneven; no floor becomes even again."""
        return bool(self._grounds["uneven"].any())

    def paths(self) -> NDArray[np.float64]:
        """Return where on its path each car should be now, (n, 3): x and y in metres, and heading in radians; nan
        for those not driving."""
        path: NDArray[np.float64] = self._tasks["drive"]["path"]
        return path.copy()

    def begin(self, car: int, action: Action, terrain: Terrain | None = None) -> None:
        """Let an idle car start an action; it runs as :meth:`advance` is called."""
        assert car not in self._skills, f"car {car} is busy"
        if not self._skills:
            self.fleet.attend()
            self._feel()
        setup = self._setups[car].carefully() if self.floor_is_uneven else self._setups[car]
        setup = setup if terrain is None else setup.on(terrain)
        self._tries[car], skill = Tries.begin(action, setup, self._view(car))
        self._start(car, skill)

    def _feel(self) -> None:
        """Let the cars rest as long as they lean and are not sure of it."""
        uneven = self.gains.uneven
        for _ in range(round(uneven.tilt_time / self.site.config.control_period_s)):
            readings, grounds = self.readings(), self._grounds
            lean = np.hypot(readings["pitch"], readings["roll"])
            leaning = (grounds["n_read"] == 0) & (uneven.tilt < lean) & (lean < self.gains.hold.level)
            if self.floor_is_uneven or self.fleet.lost or not (leaning | (grounds["doubtful"] > 0)).any():
                return
            self.advance()

    def _start(self, car: int, skill: Skill) -> None:
        skill.start(self._view(car))
        self._skills[car] = skill
        self._constants[car] = skill.setup.constants[0]
        if isinstance(skill, CompiledSkill) and skill.runs_compiled:
            skill.move_to(self._tasks[car : car + 1], self._past[car : car + 1])
        else:
            self._tasks[car]["law"] = OWN
            self._own.append(car)

    def advance(self) -> dict[int, Outcome]:
        """Step every running skill, let one control period pass, and return the outcomes of those that have ended.

        Cars that stand on an incline are held.
        """
        readings = self.readings()
        for car in self._own:
            command = self._skills[car].step(measurement_of(readings[car]))
            self._commands[car] = (command.wheels, command.board, command.hinge)
        n_ended = step_cars(readings, *self._arrays)
        ended = self._end(readings) if self._own or n_ended else {}
        self.fleet.advance(self.step_observer)
        self._look()
        for observer in self.observers:
            observer(self.site)
        if self._skills and self.fleet.lost:
            ended |= self._stop_all(Reason.DISCONNECTED, self.fleet.lost)
        if self._skills and self.guard is not None and self.guard():
            ended |= self._stop_all(Reason.STOPPED)
        return ended

    def _end(self, readings: Records) -> dict[int, Outcome]:
        """Let go of the skills that have ended, and return their outcomes."""
        ended = {}
        for car, skill in list(self._skills.items()):
            if car not in self._own:
                skill.conclude()
            if skill.outcome is None:
                continue
            following = self._tries[car].next(skill.outcome)
            del self._skills[car]
            self._park(car, readings)
            if following is None:
                ended[car] = self._tries.pop(car).outcome(skill.outcome)
            else:
                self._start(car, following)
        return ended

    def _stop_all(self, reason: Reason, detail: str = "") -> dict[int, Outcome]:
        stopped = {car: Outcome(reason, skill.elapsed_s, detail) for car, skill in self._skills.items()}
        self._skills.clear()
        self._tries.clear()
        for car in stopped:
            self._commands[car] = np.zeros((), COMMAND)
            self.fleet.stop(car, self._docked[car])
            self._park(car, self.readings())
        return stopped

    def _park(self, car: int, readings: Records) -> None:
        """Leave a car alone, or hold it where it stands on an incline."""
        if car in self._own:
            self._own.remove(car)
        now = readings[car]
        self._tasks[car] = NO_TASK
        self._tasks[car]["law"] = HOLD if on_incline(now["pitch"], now["roll"], self.gains.hold) else IDLE

    def _look(self) -> None:
        if self._localiser is not None:
            self._localiser.update(self.fleet.read())

    def _view(self, car: int) -> CarMeasurement:
        return measurement_of(self.readings()[car])
