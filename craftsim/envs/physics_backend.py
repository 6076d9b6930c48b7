"""The backend in contact physics: skills act, and the world that is seen is the one read from poses."""

from __future__ import annotations

import hashlib
import os
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from craftsim.checking.attempt import Attempt
from craftsim.checking.judge import Judge
from craftsim.checking.recipe import Recipe, Step, begin, in_order
from craftsim.checking.recovery import MOST_SEATED, loads_to_seat
from craftsim.checking.setup import Seed, Setup, compile_world, set_up, setup_of
from craftsim.discrete.files.blueprint import blueprint_text
from craftsim.discrete.files.design import Design
from craftsim.discrete.grid import Cell, Grid
from craftsim.discrete.kinds import Action
from craftsim.discrete.rules import Rules
from craftsim.discrete.schedule import ScheduledAction
from craftsim.envs.options import MOTION_FPS, Options
from craftsim.envs.ticks import Ended, Tick
from craftsim.errors import InputError
from craftsim.models.config import SimulationConfig
from craftsim.rendering.images import CameraImages, camera_number
from craftsim.rendering.offscreen import make_renderer
from craftsim.rendering.trajectory import SUFFIX, Recorder, SeenWorld
from craftsim.rendering.viewer import VIEWER_HOST, VIEWER_PORT, has_viser
from craftsim.rendering.viewer.page import AS_IT_GOES
from craftsim.rendering.viewer.views import LiveView
from craftsim.skills.library import check_cars
from craftsim.storage.extras import install_command
from craftsim.storage.folders import output_directory
from craftsim.tasks import Task
from craftsim.tasks.episodes import Episodes
from craftsim.workers.copying import Copyable

if TYPE_CHECKING:
    import mujoco
    from mujoco.viewer import Handle

    from craftsim.models.world import PhysicsWorld


Picture = NDArray[np.uint8]
"""Shape (height, width, 3), red green blue."""
_DIGITS: Final = 8
"""Of the digest that tells a recorded episode from others."""


def _has_display() -> bool:
    """Return whether windows can be opened here."""
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


class Pictures(Copyable):
    """Looks at one PhysicsWorld after the other; call :meth:`watch` after every control period.

    A copy opens a renderer and a viewer of its own when it needs them.
    """

    _bound = ("_renderer", "_viewer")

    def __init__(self, options: Options) -> None:
        self.camera = options.render_camera or "overview"
        self.size = options.render_size or (640, 480)
        self.motion = options.shows_motion
        self._physics: PhysicsWorld | None = None
        self._kept: list[Picture] = []
        self._due_s = 0.0
        self._bind()

    def _bind(self) -> None:
        self._renderer: mujoco.Renderer | None = None
        self._viewer: Handle | None = None

    def begin(self, physics: PhysicsWorld) -> None:
        """Look at a world from now on, at the start of an episode; raises InputError for a camera that it lacks."""
        if physics is not self._physics:
            self.close()
            seen_world = SeenWorld(physics)
            self._number = camera_number(seen_world.model, self.camera)
            self._physics = physics
            self._seen = seen_world
        self._kept.clear()
        self._due_s = physics.time_s

    def watch(self, physics: PhysicsWorld) -> None:
        """Keep the viewer up to date, and a picture where its moment has come."""
        if self._viewer is not None:
            self._seen.now()
            self._viewer.sync()
        # The allowance is for sums of time steps that end a rounding error before a picture's moment.
        if self.motion and physics.time_s >= self._due_s - 1e-6:
            self._kept.append(self.picture())
            self._due_s += 1 / MOTION_FPS

    def picture(self) -> Picture:
        """Return what the camera sees now."""
        if self._renderer is None:
            self._renderer = make_renderer(self._seen.model, self.size)
        self._renderer.update_scene(self._seen.now(), self._number)
        picture: Picture = self._renderer.render()
        return picture

    def taken(self) -> list[Picture]:
        """Return the pictures of the motion since the last call, or one of now where nothing has moved since."""
        pictures = self._kept or [self.picture()]
        self._kept = []
        return pictures

    def show(self) -> None:
        """Open MuJoCo's viewer; it follows the simulation from now on. Raises InputError without a display."""
        if self._viewer is None:
            if not _has_display():
                raise InputError(
                    "render_mode 'human' needs a display, or the viewer in the browser, and there is neither here; try "
                    f"'rgb_array' or 'ansi', or {install_command('view')}"
                )
            import mujoco.viewer

            self._viewer = mujoco.viewer.launch_passive(self._seen.model, self._seen.now())
        self._viewer.sync()

    def close(self) -> None:
        """Close the viewer and the renderer."""
        if self._viewer is not None:
            self._viewer.close()
        if self._renderer is not None:
            self._renderer.close()
        self._viewer = self._renderer = None


def setup_from(options: Options, n_cars: int) -> Setup:
    """Return the configuration of the physics that options ask for. Raises InputError for skills of other cars."""
    check_cars(options.skills or (), n_cars)
    setup = setup_of(
        options.randomization or "none",
        options.rule_set,
        options.gains,
        options.machines,
        options.noise,
        options.assumed,
        options.drive,
        options.skills,
    )
    simulation = options.config or SimulationConfig()
    return replace(setup, simulation=simulation, recovers=options.recovers)


class PhysicsBackend(Copyable):
    """A PhysicsWorld on which all cars' skills run to their end in every tick."""

    judge: Judge
    ticks: list[tuple[Attempt, ...]]
    """The attempts of the episode's ticks in acting order, or of what ended at one time."""
    n_seated: int
    """Number of loads in this episode that sat off their seats, were set down and lifted again."""

    def __init__(
        self, setup: Setup, options: Options | None = None, task: Task | None = None
    ) -> None:
        """Prepare for episodes.

        Args:
            setup: configuration of the physics, the noise, the skills and the judge.
            options: what is watched, shown, imaged and recorded; the physics is that of the setup.
            task: whose goal is marked, and of which trajectories and images are.
        """
        self.setup = setup
        self._options = options or Options()
        options = self._options
        if task is not None:
            self.goals: tuple[Cell, ...] = tuple(task.goal_cells)
        else:
            self.goals = ()
        if options.helper_depth is None:
            self._helper = None
        else:
            self._helper = Rules(setup.rules)
        self._pictures = Pictures(options)
        self._recorded = 0  # episodes
        if options.record is None:
            self._folder = None
        else:
            self._folder = output_directory(options.record)
        if task is None:
            self._task = ""
            self._design = None
        else:
            self._task = task.name
            self._design = task.design
        self._recorder: Recorder | None = None  # of an episode that is to be written
        self._images: CameraImages | None = None
        if task is not None:
            images = options.images
            if images is not None:
                self._images = CameraImages(
                    images.cameras(task.layout.n_cars), images.size, images.kinds
                )
        self._start: Grid | None = None
        self._view: LiveView | None = None
        self._seed: Seed
        self._team_actions: list[
            list[tuple[int, Action]]
        ]  # what was done in each tick, or begun at one time
        self._starts_s: list[
            float
        ]  # when these began, where actions begin one by one; empty otherwise

    def start(self, grid: Grid, rng: np.random.Generator, design: Design | None = None) -> Grid:
        """Begin an episode; a world is compiled only when the start or what is marked differs from the last one's."""
        self._end_record()
        seed = Seed.drawn(rng)
        if design is None:
            marked = self.goals
        else:
            marked = tuple(design.floor)
        options = self._options
        if options.robots is not None:
            self.judge = options.robots(grid, self.setup, seed, marked)
        else:
            if self._start is None or not self._start.same_visible(grid) or marked != self.goals:
                self._world = compile_world(grid, self.setup, marked)
            self.judge = set_up(grid, self.setup, seed, marked, self._world, options.check_contacts)
        self._start = grid.copy()
        self.goals = marked
        if options.render_mode is not None:
            self.judge.executor.observers.append(self._pictures.watch)
        self.judge.executor.observers += options.observers
        self._seed = seed
        self.n_seated = 0
        self._team_actions = []
        self._starts_s = []
        self.ticks = []
        self._pictures.begin(self.judge.physics)
        if self._folder is not None:
            self._design = design or self._design
            self._recorder = Recorder()
            self._recorder.begin(self.judge)
        if self._view is not None:
            self._show_in(self._view)
        return self.judge.grid

    @property
    def recipe(self) -> Recipe:
        """How the episode starts, and all its ticks so far: it is re-run bit for bit from this.

        Actions that began one by one are one step, which also runs to their ends what still runs.
        """
        assert self._start is not None, "no episode has begun"
        steps = tuple(
            Step.of_ticks(number, team_action)
            for number, team_action in enumerate(self._team_actions)
        )
        if self._starts_s:
            steps = (
                replace(Step.of_ticks(0, *self._team_actions), starts_s=tuple(self._starts_s)),
            )
        return Recipe(blueprint_text(self._start), steps, self.setup, self._seed, self.goals)

    def tick(
        self, episodes: Episodes, actions: NDArray[np.int64], order: NDArray[np.int64]
    ) -> Tick:
        """Run all cars' skills to their end, each as early as the others allow, and read the world from poses."""
        began_s = self.judge.physics.time_s
        number = len(self.ticks)
        team_action = self._primitives(episodes.queue[0], actions, order)
        attempts = self.judge.perform_tick(team_action, tick=number)
        self.ticks.append(attempts)
        self._team_actions.append(team_action)
        if self.setup.recovers:
            for car, seating in self._loads_to_seat().items():
                for action in seating:
                    self._team_actions.append([(car, action)])
                    seated = self.judge.perform_tick([(car, action)], tick=len(self.ticks))
                    self.ticks.append(seated)
        episodes.put(0, self.judge.grid)
        legal = np.zeros(len(actions), np.bool_)
        for attempt in attempts:
            legal[attempt.car] = attempt.legal
            if _strayed(attempt):
                episodes.queue[
                    0, attempt.car
                ] = -1  # what was planned starts from where the car is not
        by_car = {attempt.car: attempt for attempt in attempts}
        tried = tuple(by_car.get(car) for car in range(len(actions)))
        log = self.judge.log
        return Tick(
            applied=legal,
            duration_s=round(self.judge.physics.time_s - began_s, 6),
            durations_s=tuple(0.0 if attempt is None else attempt.duration_s for attempt in tried),
            problems=self.judge.problems,
            attempts=tried,
            contacts=None if log is None else tuple(log.contacts),
        )

    def begin(
        self, car: int, action: Action, before: NDArray[np.integer], after: NDArray[np.integer]
    ) -> None:
        """Let the car's skill begin, on what the judge itself takes to be committed."""
        self._begin(car, action)

    def _begin(self, car: int, action: Action) -> None:
        now_s = self.judge.physics.time_s
        if now_s not in self._starts_s[-1:]:
            self._starts_s.append(now_s)
            self._team_actions.append([])
        self._team_actions[-1].append((car, action))
        begin(self.judge, car, action, len(self._starts_s) - 1)

    def _seat_loads(self) -> tuple[Attempt, ...]:
        """Lift loads again that sit off their seats; return what of other cars ends meanwhile."""
        of_others: list[Attempt] = []
        for car, actions in self._loads_to_seat().items():
            for action in actions:
                if not self.judge.rules.legal(self.judge.committed, car, action):
                    break
                self._begin(car, action)
                while car in self.judge.running:
                    ended = self.judge.next()
                    self.ticks.append(ended)
                    of_others += [attempt for attempt in ended if attempt.car != car]
        return tuple(of_others)

    def _loads_to_seat(self) -> dict[int, tuple[Action, ...]]:
        """Return what cars are to do about their loads now, and count them."""
        actions_by_car = loads_to_seat(self.judge)
        if self.n_seated + len(actions_by_car) > MOST_SEATED:
            return {}
        self.n_seated += len(actions_by_car)
        return actions_by_car

    def refuse(self, car: int, action: Action, committed: Grid) -> Attempt:
        """Return the attempt of an action that the rules forbid, and that is not performed."""
        step = ScheduledAction(len(self._starts_s), car, action, committed, committed)
        return self.judge.refuse(step)

    def advance(self, until_s: float | None = None) -> Ended:
        """Run to the next ending, or to a time, and read the world from poses."""
        attempts = self.judge.next(until_s)
        if attempts:
            self.ticks.append(attempts)
        if self.setup.recovers:
            attempts += self._seat_loads()
        log = self.judge.log
        contacts = None
        if log is not None:
            names = self.judge.handled
            contacts = tuple(
                touch for touch in log.contacts if not names.isdisjoint((touch.first, touch.second))
            )
        return Ended(
            self.judge.physics.time_s,
            self.judge.confirmed,
            {attempt.car: _strayed(attempt) for attempt in attempts},
            self.judge.problems,
            dict(self.judge.executor.fleet.lost_cars),
            {attempt.car: attempt for attempt in attempts},
            contacts,
        )

    def _primitives(
        self, queue: NDArray[np.int8], actions: NDArray[np.int64], order: NDArray[np.int64]
    ) -> list[tuple[int, Action]]:
        """Return (car, primitive) in acting order, each as the action helper, if it is on, makes it of an action."""
        team_action = [(int(car), Action(actions[car])) for car in order]
        if self._helper is None:
            return team_action
        grid = self.judge.grid
        primitives = []
        for car, action in team_action:
            due = self._helper.due(grid, queue, car, action)
            primitives.append((car, due))
            grid = self.judge.rules.apply(grid, car, due)
        return primitives

    def images(self) -> dict[str, NDArray[Any]]:
        """Return what the cameras see now, by kind, one entry a camera; empty without any."""
        if self._images is None:
            return {}
        return self._images.take(self.judge.physics)

    def picture(self, *_: Any) -> Picture:
        """Return what the camera sees."""
        return self._pictures.picture()

    def pictures(self, *_: Any) -> list[Picture]:
        """Return the pictures of the motion since the last call."""
        return self._pictures.taken()

    def show(self, *_: Any) -> None:
        """Show the world to people, who follow the simulation from now on: in MuJoCo's viewer, or without a display in
        the browser. Raises InputError where neither works."""
        if _has_display() or not has_viser():
            self._pictures.show()
        elif self._view is None:
            view = LiveView.anywhere()
            print(f"Watch at {view.address}", flush=True)
            self.follow(view)

    def follow(self, view: LiveView) -> None:
        """Show this episode, if one has begun, and all later ones in the browser."""
        self._view = view
        if self._start is not None:
            self._show_in(view)

    def _show_in(self, view: LiveView) -> None:
        view.follow(self.judge, "", self.goals, self._attempts)

    def _attempts(self) -> list[Attempt]:
        attempts = []
        for tick in self.ticks:
            for attempt in tick:
                attempts.append(attempt)
        return attempts

    def close(self) -> None:
        """Close viewers and renderers, and write what is recorded."""
        self._end_record()
        if self._images is not None:
            self._images.close()
        self._pictures.close()
        if self._view is not None:
            self._view.close()
            self._view = None

    def _end_record(self) -> None:
        """Write what was recorded of an episode, unless nothing was done in it or it is written.

        Its name tells it from others in the folder: by what was drawn for it and what was done in it.
        """
        if self._folder is None or self._recorder is None:
            return
        while self.judge.running:
            self.advance()
        recorder = self._recorder
        self._recorder = None
        attempts = self._attempts()
        if attempts:
            recipe = self.recipe
            digest = hashlib.sha256(repr(recipe).encode()).hexdigest()
            name = f"episode-{self._recorded:04d}-{digest[:_DIGITS]}"
            ordered = in_order(recipe.steps, attempts)
            written = recorder.trajectory(f"{self._task}, {name}", recipe, ordered, self._design)
            written.write(self._folder / f"{name}{SUFFIX}")
            self._recorded += 1


def _strayed(attempt: Attempt) -> bool:
    """Return whether an action ended elsewhere than its rules say."""
    return attempt.skill != "succeeded" or attempt.read != attempt.predicted


def view(
    env: Any, host: str = VIEWER_HOST, port: int = VIEWER_PORT, speed: str = AS_IT_GOES
) -> LiveView:
    """Show a running environment in the browser: PettingZoo's, Gymnasium's, or what wraps one, in physics.

    Args:
        env: the environment, before or after its reset.
        host: address to listen on, of this machine alone unless another is given.
        port: of that address; 0 takes one that is free.
        speed: the page's choice of the speed at first: ``as it goes``, ``1 x`` and so on.

    Raises InputError for what is no environment of craftsim in physics, where viser is missing, and for an address or
    a port that cannot be had.

    Example:
        >>> import craftsim
        >>> env = craftsim.parallel_env("strip")
        >>> with craftsim.view(env, port=0) as page:
        ...     observations, infos = env.reset(seed=0)
        >>> page.address.startswith("http://127.0.0.1:")
        True
    """
    inner = env
    while inner is not None and not hasattr(inner, "core"):
        inner = getattr(inner, "env", None)
    backend = getattr(getattr(inner, "core", None), "backend", None)
    if not isinstance(backend, PhysicsBackend):
        raise InputError(
            f"{env!r} cannot be viewed; allowed: an environment of craftsim with backend='physics', a single one"
        )
    opened = LiveView(host, port, speed)
    backend.follow(opened)
    return opened
