"""How a tick of all cars happens: what a backend does, and the one that follows the rules of the grid."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.files.design import Design
from craftsim.discrete.grid import Cell, Grid
from craftsim.discrete.schedule import car_durations
from craftsim.discrete.tasks import Task
from craftsim.discrete.tasks.episodes import Episodes
from craftsim.envs.options import Options

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


class Backend(Protocol):
    """One world in which ticks happen.

    The world as it is seen is kept in a batch of one of :class:`Episodes`, with the queue of the action helper.
    """

    def start(self, grid: Grid, rng: np.random.Generator, design: Design | None = None) -> Grid:
        """Begin an episode as a grid says and return the world as it is seen; ``rng`` draws what is imperfect.

        ``design`` is given where each episode has its own: it is marked for people, and changes nothing else.
        """

    def tick(self, episodes: Episodes, actions: NDArray[np.int64], order: NDArray[np.int64]) -> Tick:
        """Let all cars act, ``actions`` (n,) by car in the ``order`` (n,), and bring what is seen up to date."""

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
    """A grid world under the rules: nothing fails, and time is looked up."""

    def start(self, grid: Grid, rng: np.random.Generator, design: Design | None = None) -> Grid:
        """Begin an episode; there is nothing to draw."""
        return grid

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
        return GridBackend()
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
        simulation=options.config or SimulationConfig.of(machines.drive),
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
    )
