"""The backend on the grid: a world under the rules."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.files.design import Design
from craftsim.discrete.grid import Cell, Grid
from craftsim.discrete.kernel.events import moment
from craftsim.discrete.kinds import Action
from craftsim.discrete.rules import Rules
from craftsim.discrete.schedule import car_durations, situation
from craftsim.envs.ticks import Ended, Tick
from craftsim.tasks.asynchronous import Timing
from craftsim.tasks.episodes import Episodes
from craftsim.workers.copying import Copyable

if TYPE_CHECKING:
    from craftsim.checking.attempt import Attempt


class GridBackend(Copyable):
    """A grid world under the rules: nothing fails unless asked for, and time is looked up."""

    def __init__(self, rules: Rules | None = None, timing: Timing | None = None) -> None:
        """Prepare for episodes; asynchronous ones need the rules, and say how long things take."""
        self._rules = rules or Rules("physical")
        self._timing = timing or Timing()

    def start(self, grid: Grid, rng: np.random.Generator, design: Design | None = None) -> Grid:
        """Begin an episode as a grid says and return the world as it is seen; ``rng`` draws what is imperfect.

        ``design`` is given where each episode has its own: it is marked for people, and changes nothing else.
        """
        self._rng = rng
        self._confirmed = grid.copy()
        self._now_s = 0.0
        self._running: dict[int, tuple[float, Action, bool]] = {}
        return grid

    def begin(
        self, car: int, action: Action, before: NDArray[np.integer], after: NDArray[np.integer]
    ) -> None:
        """Let an idle car begin a legal action now, while others may be in the middle of theirs.

        ``before`` and ``after`` (7,) are the car in the committed world: the confirmed one with the effects of what
        runs.
        """
        timing = self._timing
        column = situation(before, after)
        factor = timing.factors(self._rng, ())
        fails = bool(timing.fails(self._rng, ()))
        end_s = moment(self._now_s + float(timing.nominal_s[action, column] * factor))
        self._running[car] = end_s, action, fails

    def refuse(self, car: int, action: Action, committed: Grid) -> Attempt | None:
        """Return no attempt of an action that the rules forbid in the committed world: nothing is judged."""
        return None

    def advance(self, until_s: float | None = None) -> Ended:
        """Let time pass to the next ending, or to a simulated time; without one, something must run."""
        ends = [end_s for end_s, _, _ in self._running.values()]
        self._now_s = min(ends if until_s is None else [*ends, until_s])
        failed = {}
        for car, (end_s, action, fails) in list(self._running.items()):
            if end_s <= self._now_s:
                del self._running[car]
                failed[car] = fails
                if not fails:
                    self._confirmed = self._rules.enforce(self._confirmed, car, action)
        if failed and self._rules.rule_set == "physical":
            self._confirmed.derive_marks()
        return Ended(self._now_s, self._confirmed, failed)

    def tick(
        self, episodes: Episodes, actions: NDArray[np.int64], order: NDArray[np.int64]
    ) -> Tick:
        """Let all cars act, ``actions`` (n,) by car in the ``order`` (n,), and bring what is seen up to date."""
        before = episodes.grids.cars[0].copy()
        applied = episodes.act(actions[None], order[None])[0]
        seconds = car_durations(before, episodes.grids.cars[0], actions, applied)
        return Tick(applied, float(seconds.max(initial=0.0)), tuple(seconds.tolist()))

    def images(self) -> dict[str, NDArray[Any]]:
        """Return the images of all cameras now, by kind; empty where no images are observed."""
        return {}

    def picture(self, grid: Grid, goal: Cell | None) -> NDArray[np.uint8]:
        """Return the world as a picture, shape (height, width, 3): its levels side by side."""
        from craftsim.rendering.grid_picture import world_image

        return world_image(grid, goal)

    def pictures(self, grid: Grid, goal: Cell | None) -> list[NDArray[np.uint8]]:
        """Return pictures of what has happened since the last call, the latest last; one or more."""
        return [self.picture(grid, goal)]

    def show(self, grid: Grid, goal: Cell | None) -> None:
        """Show the world to a person, as coloured text."""
        from rich.console import Console

        from craftsim.discrete.drawing import world_text

        Console(highlight=False).print(world_text(grid, goal))

    def close(self) -> None:
        """Release nothing."""
