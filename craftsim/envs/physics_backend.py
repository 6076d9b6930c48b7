"""The backend in contact physics: skills act, and the world that is seen is the one read from poses."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from craftsim.checking.joint import CarStep, JointSite, JointStep
from craftsim.discrete.actions import Action
from craftsim.discrete.grid import Cell, Grid
from craftsim.discrete.planning.planner import Planner
from craftsim.discrete.readback import Placed
from craftsim.discrete.rules import Rules
from craftsim.discrete.tasks.worlds import Worlds
from craftsim.envs.backend import Tick
from craftsim.envs.pictures import Pictures
from craftsim.models.config import SimulationConfig
from craftsim.models.noise import EXACT, SensorNoise
from craftsim.models.randomization import DomainRandomization, RandomizedSite
from craftsim.models.sensing import Sensors
from craftsim.models.site import Site, SiteState
from craftsim.skills.executor import Executor
from craftsim.skills.gains import Gains, load_gains


class PhysicsBackend:
    """A Site on which all cars' skills run to their end in every tick."""

    def __init__(
        self,
        rules: Rules,
        helper_depth: int | None,
        noise: SensorNoise | None = None,
        randomization: DomainRandomization | None = None,
        config: SimulationConfig | None = None,
        goals: Sequence[Cell] = (),
        *,
        gains: Gains | None = None,
        machines: Any = None,
        observers: Sequence[Callable[[Site], None]] = (),
        pictures: Pictures | None = None,
    ) -> None:
        """Prepare for episodes; :class:`craftsim.envs.options.Options` explains the arguments."""
        self.rules, self.noise, self.randomization, self.config = rules, noise or EXACT, randomization, config
        self.goals = goals
        self._gains = gains or load_gains()
        # What is not given is left to the Site's own default.
        self._of_site = {} if machines is None else {"machines": machines}
        self._pictures = pictures or Pictures()
        self._observers = (self._pictures.watch, *observers)
        self._planner = None if helper_depth is None else Planner(rules, helper_depth)
        self._start: Grid | None = None
        self._rested: SiteState | None = None
        self.world: JointSite

    def start(self, grid: Grid, rng: np.random.Generator) -> Grid:
        """Begin an episode; a Site is compiled only when the start is another than the last one's."""
        if self._start is None or not self._start.same_visible(grid):
            self._site = Site(
                grid, self.config, self.goals, reset=self.randomization is None, **self._of_site
            )
            self._varied = RandomizedSite(self._site)
            self._rested = self._site.save() if self.randomization is None else None
            self._start = grid.copy()
        if self._rested is not None:
            self._site.restore(self._rested)
        elif self.randomization is not None:
            self._varied.draw(self.randomization, rng)
        sensors = Sensors(self._site, self.noise, rng)
        executor = Executor(self._site, self._gains, sensors=sensors)
        executor.observers.extend(self._observers)
        self._pictures.begin(self._site)
        self.world = JointSite(self._site, self.rules, executor)
        return self.world.grid

    def tick(self, worlds: Worlds, actions: NDArray[np.int64], order: NDArray[np.int64]) -> Tick:
        """Run all cars' skills to their end, each as early as the others allow, and read the world from poses."""
        step = self.world.step(self._primitives(worlds.queue[0], actions, order))
        queue = worlds.queue[0].copy()
        worlds.put(0, step.reading.grid)
        worlds.queue[0] = queue
        legal = np.zeros(len(actions), np.bool_)
        told: list[dict[str, Any]] = [{} for _ in actions]
        for done in step.cars:
            legal[done.car] = done.legal
            told[done.car] = _tell(step, done, step.reading.cars[done.car])
            if not done.applied:
                worlds.queue[0, done.car] = -1  # what was planned starts from where the car is not
        # A simulation that has broken down has started over: what is read then is no consequence of what was done.
        broken = ("the simulation broke down",) if self._site.diverged else ()
        return Tick(legal, step.duration_s, broken + step.reading.problems, tuple(told))

    def _primitives(
        self, queue: NDArray[np.int8], actions: NDArray[np.int64], order: NDArray[np.int64]
    ) -> list[tuple[int, Action]]:
        """Return (car, primitive) in acting order, each as the action helper, if it is on, makes it of an action."""
        joint = [(int(car), Action(actions[car])) for car in order]
        if self._planner is None:
            return joint
        grid, primitives = self.world.grid, []
        for car, action in joint:
            due = self._planner.due(grid, queue, car, action)
            primitives.append((car, due))
            grid = self.rules.apply(grid, car, due)
        return primitives

    def picture(self, grid: Grid, goal: Cell | None) -> NDArray[np.uint8]:
        """Return what the camera sees."""
        return self._pictures.picture()

    def pictures(self, grid: Grid, goal: Cell | None) -> list[NDArray[np.uint8]]:
        """Return the pictures of the motion since the last call."""
        return self._pictures.taken()

    def show(self, grid: Grid, goal: Cell | None) -> None:
        """Open MuJoCo's viewer; it follows the simulation from now on. Raises InputError without a display."""
        self._pictures.show()

    def close(self) -> None:
        """Close the viewer and the renderer."""
        self._pictures.close()


def _tell(step: JointStep, done: CarStep, placed: Placed) -> dict[str, Any]:
    """Return what physics has to tell of one car's action; docs/envs.md lists the keys."""
    outcome = done.outcome
    return {
        "outcome": "not started" if outcome is None else str(outcome),
        "reason": None if outcome is None or outcome.reason is None else str(outcome.reason),
        "action_duration_s": 0.0 if outcome is None else outcome.duration_s,
        "in_place": done.in_place,
        "car_error_m": placed.offset_m,
        "heading_error_rad": placed.heading_rad,
        "finding": str(step.verdict.finding),
        "disagreement": step.verdict.differences,
    }
