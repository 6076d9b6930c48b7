"""Running skills of many cars in lock-step on one Site."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

from craftsim.discrete.actions import Action
from craftsim.models.motors import Motors
from craftsim.models.noise import EXACT, SensorNoise
from craftsim.models.sensing import CarMeasurement, Sensors
from craftsim.models.site import Site
from craftsim.skills.gains import Gains, load_gains
from craftsim.skills.holding import Hold, on_incline
from craftsim.skills.library import make_skill
from craftsim.skills.localisation import Localiser
from craftsim.skills.mecanum import Mecanum
from craftsim.skills.outcome import Outcome, Reason
from craftsim.skills.skill import Command, Skill, SkillSetup, Terrain

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
    ) -> None:
        """Run on a Site with these gains, sensors and motors (exact and prompt ones unless given).

        ``assumed`` is what the cars take the noise of their localisation to be, whatever that of the sensors is; with
        none they take each measured pose as it is.

        ``observer`` is called after every control period; :attr:`observers` takes more of them.
        """
        self.site = site
        self.gains = gains or load_gains()
        self.observers: list[Observer] = [] if observer is None else [observer]
        self.step_observer: Callable[[], None] | None = None
        """Called after every physics step."""
        self.guard: Guard | None = None
        """Asked after every control period: a yes stops all cars, and ends their actions."""
        self.sensors = sensors or Sensors(site)
        self.motors = motors or Motors(site)
        period = site.config.control_period_s
        self._setups = [SkillSetup(car.parameters, site.machines, self.gains, period) for car in site.cars]
        self._localisers = (
            []
            if assumed.exact_pose
            else [
                Localiser(assumed, period, Mecanum(car.parameters), self.gains.localisation)
                for car in site.cars
            ]
        )
        self._skills: dict[int, Skill] = {}
        self._holds: dict[int, Hold] = {}
        self._docked: dict[int, int] = {}
        self._views: list[CarMeasurement] = []
        self._look()
        for car in range(len(site.cars)):
            self._park(car, self._view(car))

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

    def begin(self, car: int, action: Action, terrain: Terrain | None = None) -> None:
        """Let an idle car start an action; it runs as :meth:`advance` is called."""
        assert car not in self._skills, f"car {car} is busy"
        setup = self._setups[car]
        skill = make_skill(action, replace(setup, terrain=terrain) if terrain is not None else setup)
        skill.start(self._view(car))
        self._skills[car] = skill
        self._holds.pop(car, None)

    def advance(self) -> dict[int, Outcome]:
        """Step every running skill, let one control period pass, and return the outcomes of those that have ended.

        Cars that stand on an incline are held.
        """
        ended: dict[int, Outcome] = {}
        for car, hold in self._holds.items():
            now = self._view(car)
            self._apply(car, Command(wheels=hold.step(now)), now.slope)
        for car, skill in list(self._skills.items()):
            now = self._view(car)
            self._apply(car, skill.step(now), now.slope)
            if skill.outcome is not None:
                ended[car] = skill.outcome
                del self._skills[car]
                self._park(car, now)
        self.site.advance(self.step_observer)
        self.sensors.observe()
        self._look()
        for observer in self.observers:
            observer(self.site)
        if self._skills and self.guard is not None and self.guard():
            ended |= self._stop_all()
        return ended

    def _stop_all(self) -> dict[int, Outcome]:
        stopped = {car: Outcome(Reason.STOPPED, skill.elapsed_s) for car, skill in self._skills.items()}
        self._skills.clear()
        for car in stopped:
            self._apply(car, Command(), self._docked.get(car))
            self._park(car, self._view(car))
        return stopped

    def _park(self, car: int, now: CarMeasurement) -> None:
        if on_incline(now, self.gains.hold):
            self._holds[car] = Hold(self.gains.hold, self.site.config.control_period_s)

    def _look(self) -> None:
        self._views = [loc.update(self.sensors.measure(car)) for car, loc in enumerate(self._localisers)]

    def _view(self, car: int) -> CarMeasurement:
        return self._views[car] if self._views else self.sensors.measure(car)

    def _apply(self, car: int, command: Command, slope: int | None) -> None:
        self.motors.drive(car, command.wheels)
        self.site.move_board(car, command.board)
        # A slope that loses its car loses the command.
        last = self._docked.get(car, slope)
        if last is not None and last != slope:
            self.site.turn_hinge(last, 0.0)
        if slope is not None:
            self._docked[car] = slope
            self.site.turn_hinge(slope, command.hinge)
        else:
            self._docked.pop(car, None)
