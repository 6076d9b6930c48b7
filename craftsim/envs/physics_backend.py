"""The backend in contact physics: skills act, and the world that is seen is the one read from poses."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from craftsim.checking.joint import CarStep, JointSite, JointStep
from craftsim.discrete.actions import Action
from craftsim.discrete.errors import InputError
from craftsim.discrete.grid import Cell, Grid
from craftsim.discrete.planning.planner import Planner
from craftsim.discrete.readback import Placed
from craftsim.discrete.rules import Rules
from craftsim.discrete.tasks.worlds import Worlds
from craftsim.envs.backend import Tick
from craftsim.models.config import SimulationConfig
from craftsim.models.noise import EXACT, SensorNoise
from craftsim.models.randomization import DomainRandomization, RandomizedSite
from craftsim.models.sensing import Sensors
from craftsim.models.site import Site, SiteState
from craftsim.skills.executor import Executor
from craftsim.skills.gains import load_gains

if TYPE_CHECKING:
    from mujoco.viewer import Handle

PICTURE_SIZE: Final = (640, 480)
"""Width and height of a picture in pixels."""


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
    ) -> None:
        """Prepare for episodes with this sensor noise and domain randomization, none unless given."""
        self.rules, self.noise, self.randomization, self.config = rules, noise or EXACT, randomization, config
        self.goals = goals
        self._gains = load_gains()
        self._planner = None if helper_depth is None else Planner(rules, helper_depth)
        self._start: Grid | None = None
        self._rested: SiteState | None = None
        self._renderer: mujoco.Renderer | None = None
        self._viewer: Handle | None = None
        self.world: JointSite

    def start(self, grid: Grid, rng: np.random.Generator) -> Grid:
        """Begin an episode; a Site is compiled only when the start is another than the last one's."""
        if self._start is None or not self._start.same_visible(grid):
            self.close()
            self._site = Site(grid, self.config, self.goals, reset=self.randomization is None)
            self._varied = RandomizedSite(self._site)
            self._rested = self._site.save() if self.randomization is None else None
            self._start = grid.copy()
        if self._rested is not None:
            self._site.restore(self._rested)
        elif self.randomization is not None:
            self._varied.draw(self.randomization, rng)
        sensors = Sensors(self._site, self.noise, rng)
        executor = Executor(self._site, self._gains, self._observe, sensors)
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
        """Return what the overview camera sees."""
        if self._renderer is None:
            width, height = PICTURE_SIZE
            self._renderer = mujoco.Renderer(self._site.model, height, width)
        self._renderer.update_scene(self._site.data, "overview")
        return self._renderer.render()

    def show(self, grid: Grid, goal: Cell | None) -> None:
        """Open MuJoCo's viewer; it follows the simulation from now on. Raises InputError without a display."""
        if self._viewer is None:
            if not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
                raise InputError(
                    "render_mode 'human' needs a display, and there is none here; try 'rgb_array' or 'ansi'"
                )
            import mujoco.viewer

            self._viewer = mujoco.viewer.launch_passive(self._site.model, self._site.data)
        self._viewer.sync()

    def close(self) -> None:
        """Close the viewer and the renderer."""
        if self._viewer is not None:
            self._viewer.close()
        if self._renderer is not None:
            self._renderer.close()
        self._viewer = self._renderer = None

    def _observe(self, site: Site) -> None:
        if self._viewer is not None:
            self._viewer.sync()


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
