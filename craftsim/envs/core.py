"""One episode at a time of a task, on either backend: what every form of the environment has in common."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.errors import InputError, suggestion
from craftsim.discrete.files.blueprint import read_blueprint
from craftsim.discrete.grid import Cell, Grid
from craftsim.discrete.rules import Rules, RuleSet
from craftsim.discrete.tasks import Task, as_task
from craftsim.discrete.tasks.observation import car_vectors
from craftsim.discrete.tasks.starts import check_start
from craftsim.discrete.tasks.worlds import Worlds
from craftsim.envs.actions import checked, illegal
from craftsim.envs.backend import Backend
from craftsim.envs.grid_backend import GridBackend

if TYPE_CHECKING:
    from craftsim.models.config import SimulationConfig
    from craftsim.models.noise import SensorNoise
    from craftsim.models.randomization import DomainRandomization

BackendName = Literal["physics", "grid"]
RenderMode = Literal["rgb_array", "human", "ansi"]
RENDER_MODES: Final[tuple[str, ...]] = get_args(RenderMode)
RENDER_FPS: Final = 2
"""Pictures a second in films that Gymnasium's wrappers make: one a tick, which is about what a move takes."""

_RESET_FIRST: Final = "call reset() before anything else"


@dataclass(frozen=True)
class Options:
    """How an environment works, on top of its task; docs/envs.md explains each. Raises InputError for a bad value."""

    backend: BackendName = "physics"
    rule_set: RuleSet = "physical"
    helper_depth: int | None = None
    """Search depth of the action helper; None is without it."""
    time_weight: float = 0.0
    """What a simulated second costs."""
    render_mode: RenderMode | None = None
    noise: SensorNoise | None = None
    """Noise of the cars' sensors and motors; physics only."""
    randomization: DomainRandomization | None = None
    """How far the physics of each episode is drawn from the nominal one; physics only."""
    config: SimulationConfig | None = None
    """How the physics is computed; physics only."""

    def __post_init__(self) -> None:
        choices = {"backend": get_args(BackendName), "render_mode": (None, *RENDER_MODES)}
        for name, allowed in choices.items():
            value = getattr(self, name)
            if value not in allowed:
                words = [str(word) for word in allowed]
                raise InputError(
                    f"unknown {name} '{value}'{suggestion(str(value), words)}; there are {', '.join(words)}"
                )
        depth, weight = self.helper_depth, self.time_weight
        if depth is not None and not (isinstance(depth, int) and depth >= 0):
            raise InputError(f"helper_depth is {depth!r}; allowed: None, or 0 and more")
        if not (isinstance(weight, int | float) and 0 <= weight < math.inf):
            raise InputError(f"time_weight is {weight!r}; allowed: 0 and more, and finite")
        for name in ("noise", "randomization", "config"):
            if self.backend == "grid" and getattr(self, name) is not None:
                raise InputError(
                    f"the grid backend knows no '{name}'; leave it out, or take backend='physics'"
                )

    @classmethod
    def named(cls, **options: Any) -> Options:
        """Return options given by name; raises InputError for a name that is none of them."""
        known = [field.name for field in fields(cls)]
        for name in options:
            if name not in known:
                raise InputError(
                    f"unknown option '{name}'{suggestion(name, known)}; there are {', '.join(known)}"
                )
        return cls(**options)

    def make_backend(self, task: Task) -> Backend:
        """Return the backend; only here does the physics get imported."""
        if self.backend == "grid":
            return GridBackend()
        if self.render_mode == "rgb_array":
            from craftsim.rendering.backend import choose_backend

            choose_backend()
        from craftsim.checking.settings import Setup, nominal_gains
        from craftsim.envs.physics_backend import PhysicsBackend
        from craftsim.models.config import SimulationConfig
        from craftsim.models.noise import EXACT, SensorNoise
        from craftsim.models.randomization import DomainRandomization

        kinds = {"noise": SensorNoise, "randomization": DomainRandomization, "config": SimulationConfig}
        for name, kind in kinds.items():
            value = getattr(self, name)
            if value is not None and not isinstance(value, kind):
                raise InputError(f"the option '{name}' must be a {kind.__name__}, not {value!r}")
        setup = Setup(
            rules=self.rule_set,
            noise=self.noise or EXACT,
            randomization=self.randomization,
            simulation=self.config or SimulationConfig(),
            gains=nominal_gains(),
        )
        return PhysicsBackend(setup, self.helper_depth, task.goal_cells)


@dataclass(frozen=True)
class CoreStep:
    """What a tick brought."""

    reward: float
    """Shared by all cars."""
    terminated: bool
    """The work is done, and the task ends with that."""
    truncated: bool
    """The time is up, or the world cannot be read as a grid any more."""
    infos: list[dict[str, Any]]
    """By car."""


class Core:
    """A task on a backend: resets, ticks, rewards, ends of episodes, seeds and the order in which cars act."""

    def __init__(self, task: Task | str, options: Options, backend: Backend | None = None) -> None:
        """Prepare; the first episode begins with :meth:`reset`. ``backend`` replaces the one of the options."""
        self.task = as_task(task)
        self.options = options
        self.layout = self.task.layout
        self.n_cars = self.layout.n_cars
        self.backend = backend or options.make_backend(self.task)
        self.rules = Rules(options.rule_set)
        self._success = self.task.success_measure
        self._worlds: Worlds | None = None
        self._runs = False
        self._seed(None)

    def _seed(self, seed: int | None) -> None:
        # The backend draws from a generator of its own, so that both backends see the same starts and orders.
        try:
            spawned = np.random.SeedSequence(seed).spawn(2)
        except (TypeError, ValueError) as error:
            raise InputError(f"the seed is {seed!r}; allowed: None, or whole numbers from 0") from error
        self._rng, self._backend_rng = (np.random.default_rng(s) for s in spawned)

    @property
    def worlds(self) -> Worlds:
        """The world as it is seen, a batch of one, with the queues of the action helper."""
        if self._worlds is None:
            raise InputError(_RESET_FIRST)
        return self._worlds

    @property
    def grid(self) -> Grid:
        """A copy of the world as it is seen."""
        return self.worlds.grid(0)

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> list[dict[str, Any]]:
        """Begin an episode and return the infos by car.

        Without a seed the generators go on. ``options`` may give the start: ``blueprint``, the path of a start file, or
        ``grid``, a Grid; other keys are ignored. The goal stays the task's. Raises InputError for a seed that is none
        and for a start that does not fit the task.
        """
        if seed is not None:
            self._seed(seed)
        seen = self.backend.start(self._draw(options or {}), self._backend_rng)
        if self._worlds is None:
            self._worlds = Worlds(self.rules, [seen], self.options.helper_depth)
        self._worlds.put(0, seen)
        self._t = np.zeros(1, np.int64)
        self._paid = np.zeros(1, np.bool_)
        self._runs = True
        self._worth = self.task.reward.measure.of_worlds(self._worlds.arrays)
        self._look()
        self._show()
        return [{"action_mask": self.masks[car]} for car in range(self.n_cars)]

    def _draw(self, options: dict[str, Any]) -> Grid:
        grid, path = options.get("grid"), options.get("blueprint")
        if grid is None and path is None:
            return self.task.draw(self._rng)
        if grid is not None and path is not None:
            raise InputError("the options 'grid' and 'blueprint' both say where to start; give one of them")
        if path is not None:
            if not isinstance(path, str | Path):
                raise InputError(f"the option 'blueprint' must be a path, not a {type(path).__name__}")
            grid = read_blueprint(Path(path)).grid(self._rng, self.task.placement)
        if not isinstance(grid, Grid):
            raise InputError(f"the option 'grid' must be a Grid, not a {type(grid).__name__}")
        check_start(self.task, grid)
        return grid.copy()

    def _look(self) -> None:
        """Bring what the cars observe up to date: fresh arrays, that the caller may keep."""
        self.masks: NDArray[np.int8] = self.worlds.offered()[0].view(np.int8)
        """(n, 15): what each car is offered; STOP, which then does nothing, where the rules leave it nothing."""
        self.rows: NDArray[np.int32] = self.worlds.entity_rows(self.layout)[0]
        """(n_rows, 13): what is where."""

    def vectors(self) -> NDArray[np.int32]:
        """Return (n, length): each car's observation, its own row first."""
        return car_vectors(self.rows, self.n_cars)

    def state(self) -> NDArray[np.int32]:
        """Return the global state: all rows, flattened, shape (13 * n_rows,). Raises InputError before a reset."""
        if self._worlds is None:
            raise InputError(_RESET_FIRST)
        return self.rows.ravel().copy()

    def require_episode(self) -> None:
        """Raise InputError where no episode runs."""
        if not self._runs:
            over = "no episode has begun" if self._worlds is None else "the episode is over"
            raise InputError(f"{over}; call reset() to begin one")

    def step(self, actions: Any) -> CoreStep:
        """Let all cars act once; ``actions`` (n,) by car. What the rules forbid counts as STOP and is flagged.

        Raises InputError where no episode runs, and for actions of another shape or that are no numbers from 0 to 14.
        """
        self.require_episode()
        told = checked(actions, (self.n_cars,))
        offered, helped = self.masks, self.options.helper_depth is not None
        queued = self.worlds.queue[0, :, 0] >= 0 if helped else None
        order = self._rng.permutation(self.n_cars)
        tick = self.backend.tick(self.worlds, told, order)
        arrays = self.worlds.arrays
        after = self._worth if tick.problems else self.task.reward.measure.of_worlds(arrays)
        reward, self._paid = self.task.reward.pay(self._worth, after, self._t, self._paid)
        success = not tick.problems and bool(self._success.of_worlds(arrays)[0])
        over = bool(self.task.over(self._t, np.array([success]))[0])
        self._worth, self._t = after, self._t + 1
        self._look()
        self._show()
        wrong = illegal(told, tick.applied, offered, queued)
        shared = {"success": success, "duration_s": tick.duration_s, "problems": tick.problems}
        extras = tick.of_car or ({},) * self.n_cars
        infos = [
            {"action_mask": self.masks[car], "illegal": bool(wrong[car]), **shared, **extras[car]}
            for car in range(self.n_cars)
        ]
        terminated = success and self.task.ends_on_success
        truncated = not terminated and (over or bool(tick.problems))
        self._runs = not (terminated or truncated)
        return CoreStep(
            reward=float(reward[0]) - self.options.time_weight * tick.duration_s,
            terminated=terminated,
            truncated=truncated,
            infos=infos,
        )

    def render(self) -> NDArray[np.uint8] | str | None:
        """Return what ``render_mode`` says: a picture (height, width, 3), text, or nothing if it is shown already."""
        mode, goal = self.options.render_mode, self.layout.goal
        if mode == "rgb_array":
            return self.backend.picture(self.grid, goal)
        if mode == "ansi":
            return _ansi(self.grid, goal)
        return None

    def _show(self) -> None:
        if self.options.render_mode == "human":
            self.backend.show(self.grid, self.layout.goal)

    def close(self) -> None:
        """Release what rendering holds."""
        self.backend.close()


def _ansi(grid: Grid, goal: Cell | None) -> str:
    from rich.console import Console

    from craftsim.discrete.drawing import world_text

    text = StringIO()
    Console(file=text, force_terminal=True, color_system="standard", highlight=False, width=200).print(
        world_text(grid, goal), end=""
    )
    return text.getvalue()
