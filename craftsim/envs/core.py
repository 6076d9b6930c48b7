"""One episode at a time of a task, on the grid or in physics: what every form of the environment has in common."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.files.blueprint import read_blueprint
from craftsim.discrete.grid import Grid
from craftsim.discrete.rules import Rules
from craftsim.envs.actions import checked_actions, illegal
from craftsim.envs.backends import Backend, make_backend
from craftsim.envs.observations import Observation
from craftsim.envs.options import Options
from craftsim.envs.spaces import observed
from craftsim.errors import InputError, suggestion
from craftsim.tasks import Task, as_task
from craftsim.tasks.asynchronous import make_episodes
from craftsim.tasks.episodes import Episodes
from craftsim.tasks.kernel import ROW
from craftsim.tasks.observation import car_vectors
from craftsim.tasks.starts import Starts
from craftsim.workers.copying import Copyable

if TYPE_CHECKING:
    from craftsim.checking.attempt import Attempt

_ONE: Final = np.zeros(1, np.int64)
"""The row of the only episode."""
_STARTS: Final = ("grid", "blueprint", "design")
_RESET_FIRST: Final = "call reset() before anything else"


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
            raise InputError(
                f"the seed is {seed!r}; allowed: None, or whole numbers from 0"
            ) from error
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

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> list[dict[str, Any]]:
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
            setting = self.options.rule_set, self.options.helper_depth, start, self.rules.registered
            self._episodes = make_episodes(
                self.task, self._rng, 1, *setting, timing=self.options.timing
            )
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
            raise InputError(
                "the options 'grid' and 'blueprint' both say where to start; give one of them"
            )
        if path is not None:
            if not isinstance(path, str | Path):
                raise InputError(
                    f"the option 'blueprint' must be a path, not a {type(path).__name__}"
                )
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
        chosen = checked_actions(actions, (self.n_cars,), self.form.n_actions)[None]
        episodes = self.episodes
        offered = self.masks[None]
        acting, queued = self.form.begin(episodes, chosen)
        self.order = order = self._rng.permutation(self.n_cars)
        """(n,): the cars in the order in which they act."""
        before = episodes.worlds_before()
        tick = self.backend.tick(episodes, acting[0], order)
        applied = tick.applied[None]
        transition = None
        if before is not None:
            transition = episodes.transition(
                before,
                acting,
                applied,
                np.array([tick.durations_s]),
                np.array([tick.duration_s]),
                tick.attempts,
                tick.contacts,
                tick.problems,
            )
        steps = episodes.score(applied, order[None], transition, not tick.problems)
        success = bool(steps.success[0])
        over = bool(steps.done[0])
        self._look()
        self._show()
        wrong = illegal(chosen, applied, offered, queued)[0]
        shared = {"success": success, "duration_s": tick.duration_s, "problems": tick.problems}
        attempts = tick.attempts or (None,) * self.n_cars
        infos = []
        for car, mask in enumerate(self.masks.copy()):
            infos.append(
                {
                    "action_mask": mask,
                    "illegal": bool(wrong[car]),
                    **shared,
                    **info_of(attempts[car]),
                }
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
