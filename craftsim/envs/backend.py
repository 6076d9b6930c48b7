"""How a tick of all cars happens: what a backend does, and the one that follows the rules of the grid."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.asynchronous import Timing
from craftsim.discrete.files.design import Design
from craftsim.discrete.grid import Cell, Grid
from craftsim.discrete.kernel.events import moment
from craftsim.discrete.kinds import Action
from craftsim.discrete.rules import Rules
from craftsim.discrete.schedule import car_durations, situation
from craftsim.discrete.tasks import Task
from craftsim.discrete.tasks.episodes import Episodes
from craftsim.envs.options import Options
from craftsim.errors import InputError

if TYPE_CHECKING:
    from craftsim.checking.attempt import Attempt


@dataclass(frozen=True)
class Tick:
    """The result of a tick."""

    applied: NDArray[np.bool_]
    """(n,): by car, whether the rules allowed its action when its turn came."""
    duration_s: float
    """Simulated time."""
    durations_s: tuple[float, ...]
    """By car: how long its action took."""
    problems: tuple[str, ...] = ()
    """Why the world cannot be read as a grid any more, in words; empty when it can."""
    of_car: tuple[dict[str, Any], ...] = ()
    """By car: further entries of its info; empty when there are none."""
    attempts: tuple[Attempt | None, ...] = ()
    """By car: the judge's finding; empty on the grid."""
    contacts: tuple[Any, ...] | None = None
    """What touched what; None where that is not logged."""


@dataclass(frozen=True)
class Ended:
    """The actions that end next in an asynchronous world."""

    time_s: float
    """Simulated time since the world was set up."""
    cars: tuple[int, ...]
    """Whose actions have ended; none where the time that was given came first."""
    confirmed: Grid
    """What is so: without what actions have changed that still run."""
    infos: dict[int, dict[str, Any]] = field(default_factory=dict)
    """By car that has ended: further entries of its info."""
    problems: tuple[str, ...] = ()
    """Why the world cannot be read as a grid any more, in words; empty when it can."""
    lost: Mapping[int, str] = field(default_factory=dict)
    """Why cars cannot be driven any more, by car; their actions have ended."""


class Backend(Protocol):
    """One world in which ticks happen, or actions begin one by one.

    The world as it is seen is kept in a batch of one of :class:`Episodes`, with the queue of the action helper.
    """

    def start(self, grid: Grid, rng: np.random.Generator, design: Design | None = None) -> Grid:
        """Begin an episode as a grid says and return the world as it is seen; ``rng`` draws what is imperfect.

        ``design`` is given where each episode has its own: it is marked for people, and changes nothing else.
        """

    def tick(self, episodes: Episodes, actions: NDArray[np.int64], order: NDArray[np.int64]) -> Tick:
        """Let all cars act, ``actions`` (n,) by car in the ``order`` (n,), and bring what is seen up to date."""

    def begin(self, car: int, action: Action, committed: Grid) -> None:
        """Let an idle car begin an action now, while others may be in the middle of theirs.

        It must be legal in ``committed``: the confirmed world with the effects of what runs. Raises InputError where
        actions cannot begin one by one.
        """
        raise InputError(f"actions of a {type(self).__name__} cannot begin one by one")

    def advance(self, until_s: float | None = None) -> Ended:
        """Let time pass to the next ending, or to a simulated time; without one, something must run."""
        raise InputError(f"actions of a {type(self).__name__} cannot begin one by one")

    def images(self) -> dict[str, NDArray[Any]]:
        """Return the images of all cameras now, by kind; empty where no images are observed."""

    def picture(self, grid: Grid, goal: Cell | None) -> NDArray[np.uint8]:
        """Return the world as a picture, shape (height, width, 3)."""

    def pictures(self, grid: Grid, goal: Cell | None) -> list[NDArray[np.uint8]]:
        """Return pictures of what has happened since the last call, the latest last; one or more."""

    def show(self, grid: Grid, goal: Cell | None) -> None:
        """Show the world to a person."""

    def close(self) -> None:
        """Release what is held; nothing unless overridden."""
        return


class GridBackend(Backend):
    """A grid world under the rules: nothing fails unless asked for, and time is looked up."""

    def __init__(self, rules: Rules | None = None, timing: Timing | None = None) -> None:
        """Prepare for episodes; asynchronous ones need the rules, and say how long things take."""
        self._rules, self._timing = rules or Rules("physical"), timing or Timing()

    def start(self, grid: Grid, rng: np.random.Generator, design: Design | None = None) -> Grid:
        """Begin an episode; ``rng`` draws how long actions take and which fail, where they begin one by one."""
        self._rng, self._confirmed, self._now_s = rng, grid.copy(), 0.0
        self._running: dict[int, tuple[float, Action, bool]] = {}
        return grid

    def begin(self, car: int, action: Action, committed: Grid) -> None:
        """Begin an action: draw how long it takes, and whether it fails."""
        timing, after = self._timing, self._rules.enforce(committed, car, action)
        factor, fails = timing.factors(self._rng, ()), bool(timing.fails(self._rng, ()))
        column = situation(committed.cars[car], after.cars[car])
        end_s = moment(self._now_s + float(timing.nominal_s[action, column] * factor))
        self._running[car] = end_s, action, fails

    def advance(self, until_s: float | None = None) -> Ended:
        """Let time pass to the next ending; what ends together is applied in the order in which it began."""
        ends = [end_s for end_s, _, _ in self._running.values()]
        self._now_s = min(ends if until_s is None else [*ends, until_s])
        infos = {}
        for car, (end_s, action, fails) in list(self._running.items()):
            if end_s <= self._now_s:
                del self._running[car]
                infos[car] = {"failed": fails}
                if not fails:
                    self._confirmed = self._rules.enforce(self._confirmed, car, action)
        if infos and self._rules.rule_set == "physical":
            self._confirmed.derive_marks()
        return Ended(self._now_s, tuple(infos), self._confirmed, infos)

    def tick(self, episodes: Episodes, actions: NDArray[np.int64], order: NDArray[np.int64]) -> Tick:
        """Let all cars act by the rules."""
        before = episodes.grids.cars[0].copy()
        applied = episodes.act(actions[None], order[None])[0]
        seconds = car_durations(before, episodes.grids.cars[0], actions, applied)
        return Tick(applied, float(seconds.max(initial=0.0)), tuple(seconds.tolist()))

    def images(self) -> dict[str, NDArray[Any]]:
        """Return nothing: there are no cameras."""
        return {}

    def picture(self, grid: Grid, goal: Cell | None) -> NDArray[np.uint8]:
        """Return the levels of the world side by side."""
        from craftsim.rendering.grid_picture import world_image

        return world_image(grid, goal)

    def pictures(self, grid: Grid, goal: Cell | None) -> list[NDArray[np.uint8]]:
        """Return the one picture of a tick: there is no motion between two."""
        return [self.picture(grid, goal)]

    def show(self, grid: Grid, goal: Cell | None) -> None:
        """Print the world as coloured text."""
        from rich.console import Console

        from craftsim.discrete.drawing import world_text

        Console(highlight=False).print(world_text(grid, goal))


def make_backend(task: Task, options: Options) -> Backend:
    """Return the backend that the options of an environment ask for."""
    if options.backend == "grid":
        return GridBackend(Rules(options.rule_set), options.timing)
    if options.images is not None or options.render_mode in ("rgb_array", "rgb_array_list"):
        from craftsim.rendering.offscreen import choose_backend

        choose_backend()
    from craftsim.checking.setup import Setup, nominal_gains
    from craftsim.envs.physics_backend import PhysicsBackend
    from craftsim.envs.recording import EpisodeRecords, Pictures
    from craftsim.mjcf.parameters import NOMINAL
    from craftsim.models.config import SimulationConfig
    from craftsim.models.randomization import NONE
    from craftsim.models.sensing import ASSUMED
    from craftsim.rendering.images import CameraImages
    from craftsim.skills.library import check_cars

    machines = options.machines or replace(NOMINAL, drive="reduced")
    if options.drive is not None:
        machines = replace(machines, drive=options.drive)
    randomization = options.randomization or NONE
    setup = Setup(
        rules=options.rule_set,
        randomization=randomization
        if options.noise is None
        else replace(randomization, sensors=options.noise),
        assumed=options.assumed or ASSUMED,
        simulation=options.config or SimulationConfig(),
        gains=options.gains or nominal_gains(),
        machines=machines,
        skills=options.skills or (),
    )
    n_cars, images = task.layout.n_cars, options.images
    check_cars(setup.skills, n_cars)
    return PhysicsBackend(
        setup,
        options.helper_depth,
        task.goal_cells,
        options.observers,
        options.check_contacts,
        Pictures(options.render_camera, options.render_size, options.shows_motion),
        None if options.record is None else EpisodeRecords(options.record, task.name, task.design),
        None if images is None else CameraImages(images.cameras(n_cars), images.size, images.kinds),
        options.robots,
    )
