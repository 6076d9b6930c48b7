"""Running skills of many cars in lock-step on one PhysicsWorld."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from craftsim.compiled.arrays import Records
from craftsim.compiled.jit import records
from craftsim.discrete.kinds import Action
from craftsim.discrete.readback import nearest_yaw
from craftsim.models.measuring import CarMeasurement, Motors
from craftsim.models.sensing import EXACT, SensorNoise, Sensors, measurement_of
from craftsim.models.world import PhysicsWorld
from craftsim.skills import library
from craftsim.skills.estimator import PoseEstimator, assume_delay, likeliest_delay
from craftsim.skills.fleet import Fleet, PhysicsFleet
from craftsim.skills.gains import Gains, gains_of_car, load_gains
from craftsim.skills.laws import LAG_STEP_S, step_cars
from craftsim.skills.library import Performer, SkillChoice, Tries
from craftsim.skills.outcome import Outcome, Reason
from craftsim.skills.setup import SkillSetup, Terrain
from craftsim.skills.skill import Skill, begin_task, cell_middle, start_own, step_own
from craftsim.skills.state import (
    CAR,
    COMMAND,
    HOLD,
    IDLE,
    N_LAGS,
    NO_TASK,
    OWN,
    n_angles,
    outcome_of,
)
from craftsim.workers.copying import Copyable

_ASSUMED_LAG: Final = (1.0, 3.0)
"""Prior mean and standard deviation of a motor's lag, in steps between candidates."""

Observer = Callable[[PhysicsWorld], None]
Guard = Callable[[], bool]
"""Returns whether something unsafe has happened."""


class Executor(Copyable):
    """Performs actions on a PhysicsWorld: any number of cars act at the same time, each until its skill has ended.

    A copy, or a pickle, is bound to a copy of the PhysicsWorld, and goes on with the running skills.

    Example:
        >>> import craftsim
        >>> physics = craftsim.PhysicsWorld(craftsim.Grid.empty((3, 1, 1), n_cars=1))
        >>> outcome = craftsim.Executor(physics).run({0: craftsim.Action.ROTATE_LEFT})[0]
        >>> outcome.succeeded
        True
    """

    _bound = ("_step_cars",)

    def __init__(
        self,
        physics: PhysicsWorld,
        gains: Gains | None = None,
        observer: Observer | None = None,
        sensors: Sensors | None = None,
        motors: Motors | None = None,
        assumed: SensorNoise = EXACT,
        fleet: Fleet | None = None,
        skills: SkillChoice | None = None,
        recovers: bool = False,
    ) -> None:
        """Run on a PhysicsWorld.

        Args:
            physics: the world.
            gains: of the skills; the nominal ones unless given. Each car has its own of those that follow from its
                parameters (:func:`craftsim.skills.gains.gains_of_car`).
            observer: called after every control period; :attr:`observers` takes more.
            sensors: exact ones unless given.
            motors: without lag unless given.
            assumed: the localisation noise that the cars assume; with none they use measured poses unfiltered.
            fleet: robots to drive in place of the world's cars; they update the world.
            skills: your own, in place of built-in ones: ``{Action.LIFT: MyLift}`` with a subclass of
                :class:`~craftsim.skills.skill.Skill`, or ``{0: {Action.LIFT: MyLift}}`` for one car.
            recovers: whether a car whose action has failed for good goes back to where it began.

        Raises InputError for an invalid skill.
        """
        self.physics = physics
        self.gains = gains or load_gains()
        if observer is None:
            self.observers: list[Observer] = []
        else:
            self.observers = [observer]
        self.step_observer: Callable[[], None] | None = None
        """Called after every physics step."""
        self.guard: Guard | None = None
        """Called after every control period; True stops all cars and ends their actions."""
        self.fleet: Fleet = fleet or PhysicsFleet(physics, sensors, motors)
        n = len(physics.cars)
        period = physics.config.control_period_s
        user_skills = library.own_skills(skills)
        if isinstance(skills, Mapping | str):
            library.check_cars(user_skills, n)
        self._performers = library.performers(user_skills, n)
        machines = [car.parameters for car in physics.cars]
        self._setups = []
        for machine in machines:
            own_gains = gains_of_car(self.gains, machine, physics.machines)
            self._setups.append(SkillSetup(machine, physics.machines, own_gains, period))
        self._estimator = None
        if not assumed.exact_pose:
            self._estimator = PoseEstimator(
                assumed, period, machines, self.gains.localisation, physics.size
            )
        self._cars = records(n, CAR)
        for car, setup in zip(self._cars, self._setups, strict=True):
            car["known"] = setup.constants[0]
            assume_delay(car["lag"]["mismatches"], *_ASSUMED_LAG)
            car["lag"]["steps"], _ = likeliest_delay(car["lag"]["mismatches"])
            shares = (1 - math.exp(-period / (k * LAG_STEP_S)) for k in range(1, N_LAGS))
            car["lag"]["shares"] = [1.0, *shares]
        self._angles = np.zeros((n, n_angles(self.gains, period)))
        self._bind()
        self.recovers = recovers
        """Whether a car whose action has failed for good goes back."""
        self._tries: dict[int, Tries] = {}
        """By car, while its action runs."""
        self._own: dict[int, Skill] = {}
        """By car, while a skill in Python runs."""
        if self._estimator is not None:
            self._estimator.update(self.fleet.read())
        for car in range(n):
            self._park(car, self.readings())

    def _bind(self) -> None:
        self._step_cars = partial(step_cars, self._cars, self._angles)

    def run(
        self, actions: Mapping[int, Action], terrain: Mapping[int, Terrain] | None = None
    ) -> dict[int, Outcome]:
        """Perform one action for each given car, on some ``terrain`` or on the flat, and return the outcomes by car."""
        for car, action in actions.items():
            self.begin(car, action, (terrain or {}).get(car))
        outcomes: dict[int, Outcome] = {}
        while self.busy:
            outcomes |= self.advance()
        return outcomes

    @property
    def busy(self) -> frozenset[int]:
        """The cars whose actions have not ended."""
        return frozenset(self._tries)

    def readings(self) -> Records:
        """Return the measurements with estimated poses, shape (n,) of READING; the next call overwrites them.

        They are for the time at which the next command begins.
        """
        if self._estimator is None:
            return self.fleet.ahead(self.fleet.read())
        return self.fleet.ahead(self._estimator.readings)

    @property
    def commands(self) -> Records:
        """The last commands of the cars, shape (n,) of COMMAND; the next period overwrites them."""
        commands: Records = self._cars["command"]
        return commands

    @property
    def floor_is_uneven(self) -> bool:
        """Whether any car has ever found the floor to be uneven."""
        return bool(self._cars["floor"]["uneven"].any())

    def paths(self) -> NDArray[np.float64]:
        """Return each car's set point on its path, (n, 3): x and y in metres, heading in radians; nan without one."""
        path: NDArray[np.float64] = self._cars["task"]["drive"]["path"]
        return path.copy()

    def begin(self, car: int, action: Action, terrain: Terrain | None = None) -> None:
        """Start an action of an idle car; :meth:`advance` runs it. Raises InputError for an action without a skill."""
        assert car not in self._tries, f"car {car} is busy"
        if not self._tries:
            self.fleet.attend()
            self._feel()
        self.fleet.begin(car)
        uneven = self.floor_is_uneven
        if uneven and self._estimator is not None:
            self._estimator.expect_loose(self.gains.uneven.loose)
        if uneven:
            setup = self._setups[car].carefully()
        else:
            setup = self._setups[car]
        if terrain is not None:
            setup = setup.on(terrain)
        performers = self._performers[car]
        measurement = measurement_of(self.readings()[car])
        performers.setdefault(action, library.begin_of(action))
        home = cell_middle(measurement, nearest_yaw(measurement.heading)[0])
        tries = Tries(action, setup, performers, home, recovers=self.recovers)
        self._start(car, *tries.first(), measurement)
        self._tries[car] = tries

    def _feel(self) -> None:
        """Wait while the floor estimate is undecided."""
        uneven = self.gains.uneven
        floors = self._cars["floor"]
        for _ in range(round(uneven.tilt_time / self.physics.config.control_period_s)):
            readings = self.readings()
            lean = np.hypot(readings["pitch"], readings["roll"])
            leaning = (
                (floors["n_read"] == 0) & (uneven.tilt < lean) & (lean < self.gains.hold.level)
            )
            if (
                self.floor_is_uneven
                or self.fleet.lost
                or not (leaning | (floors["suspected"] > 0)).any()
            ):
                return
            self.advance()

    def _start(
        self, car: int, performer: Performer, setup: SkillSetup, measurement: CarMeasurement
    ) -> None:
        record = self._cars[car]
        self._angles[car] = 0.0
        record["known"] = setup.constants[0]
        record["task"] = NO_TASK
        if isinstance(performer, type):
            self._own[car] = start_own(performer, setup, measurement)
            record["task"]["law"] = OWN
        else:
            begin_task(performer, setup, measurement, record["task"])

    def advance(self) -> dict[int, Outcome]:
        """Run all skills for one control period, idle cars held on inclines; return the outcomes of what has ended."""
        readings = self.readings()
        for car, skill in self._own.items():
            command = step_own(skill, measurement_of(readings[car]))
            self._cars["command"][car] = (command.wheels, command.board, command.hinge)
        n_ended = self._step_cars(readings)
        ended = {}
        if self._own or n_ended:
            ended = self._end(readings)
        self.fleet.command(self._cars)
        self.fleet.advance(self.step_observer)
        if self._estimator is not None:
            self._estimator.update(self.fleet.read())
        for observer in self.observers:
            observer(self.physics)
        if self._tries and self.fleet.lost:
            ended |= self._stop(self._tries, Reason.DISCONNECTED, self.fleet.lost)
        for car, reason in self.fleet.lost_cars.items():
            ended |= self._stop(self._tries.keys() & {car}, Reason.DISCONNECTED, reason)
        if self._tries and self.guard is not None and self.guard():
            ended |= self._stop(self._tries, Reason.STOPPED)
        return ended

    def _end(self, readings: Records) -> dict[int, Outcome]:
        """Go on to the next try where a skill has ended, and return the outcomes of the actions that are over."""
        ended = {}
        for car, tries in list(self._tries.items()):
            user_skill = self._own.get(car)
            if user_skill is None:
                outcome = outcome_of(self._cars[car]["task"])
            else:
                outcome = user_skill.outcome
            if outcome is None:
                continue
            following = tries.next(outcome)
            self._park(car, readings)
            if following is None:
                ended[car] = self._tries.pop(car).outcome(outcome)
            else:
                self._tries[car] = self._tries.pop(car)
                self._start(car, *following, measurement_of(self.readings()[car]))
        return ended

    def _stop(self, cars: Iterable[int], reason: Reason, detail: str = "") -> dict[int, Outcome]:
        stopped = {}
        for car in list(cars):
            user_skill = self._own.get(car)
            record = self._cars[car]
            if user_skill is None:
                elapsed_s = float(record["task"]["elapsed_s"])
            else:
                elapsed_s = user_skill.elapsed_s
            stopped[car] = self._tries.pop(car).stopped(Outcome(reason, elapsed_s, detail))
            record["command"] = np.zeros((), COMMAND)
            self.fleet.stop(car)
            self._park(car, self.readings())
        return stopped

    def _park(self, car: int, readings: Records) -> None:
        """Leave a car alone, or hold it where it stands on an incline."""
        self._own.pop(car, None)
        reading = readings[car]
        task = self._cars[car]["task"]
        hold = self.gains.hold
        drive = self.gains.drive
        self._cars[car]["task"] = NO_TASK
        task["sure"] = reading["position_std_m"] < drive.position_certainty
        inclined = hold.level < max(abs(reading["pitch"]), abs(reading["roll"])) < hold.tipped
        if inclined:
            task["law"] = HOLD
        else:
            task["law"] = IDLE
        task["held"] = reading["x"], reading["y"], reading["heading"]
