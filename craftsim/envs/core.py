"""One episode at a time of a task, on the grid or in physics: what every form of the environment has in common."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.files.blueprint import read_blueprint
from craftsim.discrete.files.design import Design
from craftsim.discrete.grid import Cell, Grid
from craftsim.discrete.kernel.events import moment
from craftsim.discrete.kinds import Action
from craftsim.discrete.rules import Rules
from craftsim.discrete.schedule import car_durations, situation
from craftsim.envs.actions import checked, illegal
from craftsim.envs.observations import Observation, observed
from craftsim.envs.options import RENDER_FPS, RENDER_MODES, Options
from craftsim.errors import InputError, suggestion
from craftsim.tasks import Task, as_task
from craftsim.tasks.asynchronous import Timing, make_episodes
from craftsim.tasks.episodes import Episodes
from craftsim.tasks.kernel import ROW
from craftsim.tasks.observation import car_vectors
from craftsim.tasks.rewards import Reward
from craftsim.tasks.starts import Starts
from craftsim.workers.copying import Copyable

if TYPE_CHECKING:
    from craftsim.checking.attempt import Attempt
    from craftsim.envs.physics_backend import PhysicsBackend

Backend: TypeAlias = "GridBackend | PhysicsBackend"
"""One world in which ticks happen, or actions begin one by one.

The world as it is seen is kept in a batch of one of :class:`Episodes`, with the queue of the action helper.
"""
_ONE: Final = np.zeros(1, np.int64)
_STARTS: Final = ("grid", "blueprint", "design")
"""The row of the only episode."""
_RESET_FIRST: Final = "call reset() before anything else"


@dataclass(frozen=True)
class Tick:
    """The result of a tick."""

    applied: NDArray[np.bool_]  # (n,): by car, whether the rules allowed its action when its turn came
    duration_s: float  # simulated time
    durations_s: tuple[float, ...]  # by car: how long its action took
    problems: tuple[str, ...] = ()  # why the world cannot be read as a grid any more; empty when it can
    attempts: tuple[Attempt | None, ...] = ()  # by car: the judge's finding; empty on the grid
    contacts: tuple[Any, ...] | None = None  # what touched what; None where that is not logged


@dataclass(frozen=True)
class Ended:
    """The actions that end next in an asynchronous world; not a :class:`Tick`, because others still run."""

    time_s: float  # simulated time since the world was set up
    confirmed: Grid  # what is so: without what actions have changed that still run
    failed: Mapping[
        int, bool
    ]  # by car whose action has ended: without effect? Empty where the time came first
    problems: tuple[str, ...] = ()  # as of a tick
    lost: Mapping[int, str] = field(default_factory=dict)  # by car: why it cannot be driven any more
    attempts: Mapping[int, Attempt] = field(default_factory=dict)  # by car whose action has ended, in physics
    contacts: tuple[Any, ...] | None = None  # of these cars and what they handled; None: not logged


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

    def tick(self, episodes: Episodes, actions: NDArray[np.int64], order: NDArray[np.int64]) -> Tick:
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


def make_backend(task: Task, options: Options) -> Backend:
    """Return the backend that the options of an environment ask for."""
    if options.backend == "grid":
        return GridBackend(Rules(options.rule_set), options.timing)
    if options.images is not None or options.render_mode in ("rgb_array", "rgb_array_list"):
        from craftsim.rendering.offscreen import choose_backend

        choose_backend()
    from craftsim.envs.physics_backend import PhysicsBackend, setup_from

    return PhysicsBackend(setup_from(options, task.layout.n_cars), options, task)


def info_of(attempt: Attempt | None) -> dict[str, Any]:
    """Return what a car's info has of the attempt at its action; nothing on the grid, where none is judged.

    docs/reference/environments.md lists the keys.
    """
    if attempt is None:
        return {}
    return {
        "result": attempt.result,
        "reason": attempt.reason,
        "outcome": attempt.skill,
        "finding": attempt.finding,
        "disagreement": attempt.differences,
        "action_duration_s": attempt.duration_s,
        "car_error_m": attempt.car_error_m,
        "heading_error_rad": attempt.heading_error_rad,
        "bystander_displacement_m": attempt.bystander_displacement_m,
    }


CoreStep = tuple[float, bool, bool, list[dict[str, Any]]]
"""The result of a tick: the reward, shared by all cars; terminated, where the work is done and the task ends with that;
truncated, where the time is up, or the world cannot be read as a grid any more; and the infos by car."""


class Core(Copyable):
    """A task on a backend: resets, ticks, rewards, ends of episodes, seeds and the order in which cars act."""

    def __init__(self, task: Task | str, options: Options, backend: Backend | None = None) -> None:
        """Prepare; the first episode begins with :meth:`reset`. ``backend`` replaces the one of the options."""
        self.task = as_task(task)
        self.options = options
        self.n_cars = self.task.layout.n_cars
        self.backend = backend or make_backend(self.task, options)
        self.rules = Rules(options.rule_set, actions=options.actions)
        self.form = options.action_form(self.task)
        self.played = self.task
        """The task of the running episode: the task, or where each has a design of its own, the one with that."""
        self._episodes: Episodes | None = None
        self._seen: Observation | None = None
        self._runs = False
        self.pictures: list[NDArray[np.uint8]] = []
        self._seed(None)

    def _seed(self, seed: int | None) -> None:
        # The backend draws from a generator of its own, so that both backends see the same starts and orders.
        try:
            spawned = np.random.SeedSequence(seed).spawn(2)
        except (TypeError, ValueError) as error:
            raise InputError(f"the seed is {seed!r}; allowed: None, or whole numbers from 0") from error
        self._rng, self._backend_rng = (np.random.default_rng(s) for s in spawned)

    @property
    def episodes(self) -> Episodes:
        """The episode, a batch of one: the world as it is seen, with the queues of the action helper.

        Raises InputError before the first reset.
        """
        if self._episodes is None:
            raise InputError(_RESET_FIRST)
        return self._episodes

    @property
    def grid(self) -> Grid:
        """A copy of the world as it is seen."""
        return self.episodes.grid(0)

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> list[dict[str, Any]]:
        """Begin an episode and return the infos by car.

        Without a seed the generators go on. ``options`` may give the start: ``blueprint``, the path of a start file, or
        ``grid``, a Grid; other keys are ignored. The goal stays the task's; where each episode has a design of its own,
        a given start needs one, the option ``design``, a Design. Raises InputError for a seed that is none and for a
        start that does not fit the task.
        """
        if seed is not None:
            self._seed(seed)
        self.played = self._episode_of(options or {})
        start = self.played.draw_starts(self._rng, 1)
        design = None
        if self.task.draws_designs:
            design = self.played.design
        read_grid = self.backend.start(start.grid(0), self._backend_rng, design)
        start = Starts(read_grid[None], start.designs)
        if self._episodes is None:
            setting = self.options.rule_set, self.options.helper_depth, start, self.rules.own
            self._episodes = make_episodes(self.task, self._rng, 1, *setting, timing=self.options.timing)
        else:
            self._episodes.begin(_ONE, start)
        self._runs = True
        self._look()
        self.pictures.clear()
        self._show()
        return [{"action_mask": mask} for mask in self.masks.copy()]

    def _episode_of(self, options: dict[str, Any]) -> Task:
        """Return the task of a new episode, from which its start is drawn."""
        for name in options.keys() - _STARTS:  # other words are another's, as in PettingZoo's tests
            close = suggestion(str(name), _STARTS)
            if close:
                raise InputError(f"reset has no option '{name}'{close}")
        grid = options.get("grid")
        path = options.get("blueprint")
        if grid is None and path is None:
            return self.task.for_episode(self._rng)
        if grid is not None and path is not None:
            raise InputError("the options 'grid' and 'blueprint' both say where to start; give one of them")
        if path is not None:
            if not isinstance(path, str | Path):
                raise InputError(f"the option 'blueprint' must be a path, not a {type(path).__name__}")
            grid = read_blueprint(Path(path)).grid(self._rng, self.task.placement)
        if not isinstance(grid, Grid):
            raise InputError(f"the option 'grid' must be a Grid, not a {type(grid).__name__}")
        return self.task.starting_from([grid], options.get("design"))

    def _look(self) -> None:
        """Take note that there is something new to observe."""
        self._seen = None
        self.images: Observation = self.backend.images()  # of all cameras, by kind

    @property
    def seen(self) -> Observation:
        """What an agent of all cars observes, images aside; hand out copies, for the next tick is judged by these."""
        if self._seen is None:
            batch = observed(self.episodes, self.form, self.options.local_view)
            self._seen = {key: array[0] for key, array in batch.items()}
        return self._seen

    @property
    def masks(self) -> NDArray[np.int8]:
        """(n, n_actions): what each car is offered."""
        return self.seen["action_mask"]

    def vectors(self) -> NDArray[np.int32]:
        """Return (n, length): each car's observation, its own row first."""
        return car_vectors(self.seen["observation"].reshape(-1, ROW), self.n_cars)

    def state(self) -> NDArray[np.int32]:
        """Return the global state: all rows, flattened, shape (13 * n_observed,). Raises InputError before a reset."""
        state: NDArray[np.int32] = self.seen["observation"].copy()
        return state

    def require_episode(self) -> None:
        """Raise InputError where no episode runs."""
        if not self._runs:
            if self._episodes is None:
                over = "no episode has begun"
            else:
                over = "the episode is over"
            raise InputError(f"{over}; call reset() to begin one")

    def step(self, actions: Any) -> CoreStep:
        """Let all cars act once; ``actions`` (n,) by car. What the rules forbid counts as STOP and is flagged.

        Raises InputError where no episode runs, and for actions of another shape or that are no numbers from 0 to 14,
        or more with registered actions.
        """
        self.require_episode()
        chosen = checked(actions, (self.n_cars,), self.form.n_actions)[None]
        episodes = self.episodes
        offered = self.masks[None]
        acting, queued = self.form.begin(episodes, chosen)
        self.order = order = self._rng.permutation(self.n_cars)
        """(n,): the cars in the order in which they act."""
        before = None
        if not isinstance(self.task.reward, Reward):
            before = self.grid
        tick = self.backend.tick(episodes, acting[0], order)
        transitions = []
        if before is not None:
            judged: Any = {"attempts": tick.attempts, "contacts": tick.contacts, "problems": tick.problems}
            times = np.array(tick.durations_s), tick.duration_s
            transitions.append(episodes.transition(0, before, acting[0], tick.applied, *times, **judged))
        steps = episodes.score(tick.applied[None], order[None], not tick.problems, transitions)
        success = bool(steps.success[0])
        over = bool(steps.done[0])
        self._look()
        self._show()
        wrong = illegal(chosen, tick.applied[None], offered, queued)[0]
        shared = {"success": success, "duration_s": tick.duration_s, "problems": tick.problems}
        attempts = tick.attempts or (None,) * self.n_cars
        infos = []
        for car, mask in enumerate(self.masks.copy()):
            infos.append(
                {"action_mask": mask, "illegal": bool(wrong[car]), **shared, **info_of(attempts[car])}
            )
        terminated, truncated = self._ends(success, over or bool(tick.problems))
        reward = float(steps.reward[0]) - self.options.time_weight * tick.duration_s
        return reward, terminated, truncated, infos

    def _ends(self, success: bool, over: bool) -> tuple[bool, bool]:
        """Return whether an episode is terminated, and whether it is truncated."""
        terminated = success and self.task.ends_on_success
        self._runs = not (terminated or over)
        return terminated, over and not terminated

    def _show(self) -> None:
        mode = self.options.render_mode
        goal = self.task.layout.goal
        if mode == "human":
            self.backend.show(self.grid, goal)
        elif mode == "rgb_array_list":
            self.pictures += self.backend.pictures(self.grid, goal)


class SingleWorld(Copyable):
    """What the forms of one world share, whatever their interface.

    A copy (``copy.deepcopy``, or a pickle in any process) is an environment of its own in the same state, random
    generators included; it renders with a renderer of its own.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 (as Gymnasium declares it)
        "render_modes": list(RENDER_MODES),
        "render_fps": RENDER_FPS,
    }

    def __init__(self, task: Task | str, options: Options, backend: Backend | None = None) -> None:
        """Prepare a task; the first episode begins with ``reset()``. ``backend`` replaces the one of the options."""
        kind = Core
        if options.execution == "asynchronous":
            from craftsim.envs.asynchronous import AsynchronousCore

            kind = AsynchronousCore
        self.core = kind(task, options, backend)
        self.metadata = type(self).metadata | {"render_fps": options.render_fps}
        self.render_mode: str | None = options.render_mode

    @property
    def grid(self) -> Grid:
        """A copy of the world as it is seen."""
        return self.core.grid

    def render(self) -> Any:
        """Return a picture (height, width, 3) (``rgb_array``), several (``rgb_array_list``) or text (``ansi``).

        ``rgb_array_list`` returns the pictures since the last call, or since the reset if that was later; ``human``
        shows every tick by itself.
        """
        core = self.core
        goal = self.core.task.layout.goal
        if self.render_mode == "rgb_array":
            return core.backend.picture(core.grid, goal)
        if self.render_mode == "rgb_array_list":
            pictures = core.pictures
            core.pictures = []
            return pictures
        if self.render_mode != "ansi":
            return None
        from rich.console import Console

        from craftsim.discrete.drawing import world_text

        text = StringIO()
        console = Console(file=text, force_terminal=True, color_system="standard", highlight=False, width=200)
        console.print(world_text(core.grid, goal), end="")
        return text.getvalue()

    def close(self) -> None:
        """Release what rendering holds, and write what is recorded."""
        self.core.backend.close()
