"""The backend in contact physics: skills act, and the world that is seen is the one read from poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from craftsim.checking.attempt import Attempt
from craftsim.checking.episode import Recipe, Step, begin
from craftsim.checking.judge import Judge
from craftsim.checking.setup import Seed, SetUp, Setup, compile_world, set_up
from craftsim.discrete.files.blueprint import blueprint_text
from craftsim.discrete.files.design import Design
from craftsim.discrete.grid import Cell, Grid
from craftsim.discrete.kinds import Action
from craftsim.discrete.rules import Rules
from craftsim.discrete.tasks.episodes import Episodes
from craftsim.envs.core import Core, Ended, Tick
from craftsim.envs.recording import EpisodeRecords, Pictures, has_display
from craftsim.errors import InputError
from craftsim.rendering.images import CameraImages
from craftsim.rendering.viewer import LOOPBACK, PORT, has_viser
from craftsim.rendering.viewer.page import AS_IT_GOES
from craftsim.rendering.viewer.views import LiveView
from craftsim.skills.executor import Observer


class PhysicsBackend:
    """A PhysicsWorld on which all cars' skills run to their end in every tick."""

    def __init__(
        self,
        setup: Setup,
        helper_depth: int | None = None,
        goals: Sequence[Cell] = (),
        observers: Sequence[Observer] = (),
        watch_contacts: bool = False,
        pictures: Pictures | None = None,
        records: EpisodeRecords | None = None,
        images: CameraImages | None = None,
        robots: SetUp | None = None,
    ) -> None:
        """Prepare for episodes.

        Args:
            setup: configuration of the physics, the noise, the skills and the judge.
            helper_depth: search depth of the action helper; None is without it.
            goals: cells to mark.
            observers: called with the PhysicsWorld after every control period.
            watch_contacts: whether the judge logs contacts, 3 % of the time; unsafe actions then end at once.
            pictures: shows the world to people.
            records: writes down what moves in each episode.
            images: takes what cars observe by cameras.
            robots: sets up a world whose cars are robots elsewhere; their contacts are not watched.
        """
        self.setup, self.goals = setup, tuple(goals)
        self.observers, self.watch_contacts = observers, watch_contacts
        self._helper = None if helper_depth is None else Rules(setup.rules)
        self._start: Grid | None = None
        self._pictures, self._records, self._images = pictures or Pictures(), records, images
        self._view: LiveView | None = None
        self._robots = robots
        self.judge: Judge
        self._seed: Seed
        self._joints: list[list[tuple[int, Action]]]
        """What the cars have done in each tick of the episode, or begun at one time of it."""
        self._starts_s: list[float]
        """When these began, where actions begin one by one; empty otherwise."""
        self.ticks: list[tuple[Attempt, ...]]
        """The attempts of the episode's ticks in acting order, or of what ended at one time."""

    def start(self, grid: Grid, rng: np.random.Generator, design: Design | None = None) -> Grid:
        """Begin an episode; a world is compiled only when the start or what is marked differs from the last one's."""
        self._end_record()
        seed = Seed.drawn(rng)
        marked = self.goals if design is None else tuple(design.floor)
        if self._robots is not None:
            self.judge = self._robots(grid, self.setup, seed, marked)
        else:
            if self._start is None or not self._start.same_visible(grid) or marked != self.goals:
                self._world = compile_world(grid, self.setup, marked)
            self.judge = set_up(grid, self.setup, seed, marked, self._world, self.watch_contacts)
        self._start, self.goals = grid.copy(), marked
        self.judge.executor.observers += [self._pictures.watch, *self.observers]
        self._seed, self._joints, self._starts_s, self.ticks = seed, [], [], []
        self._pictures.begin(self.judge.physics)
        if self._records is not None:
            self._records.begin(self.judge, design)
        if self._view is not None:
            self._show_in(self._view)
        return self.judge.grid

    @property
    def recipe(self) -> Recipe:
        """How the episode starts, and all its ticks so far: it is re-run bit for bit from this.

        Actions that began one by one are one step, which also runs to their ends what still runs.
        """
        assert self._start is not None, "no episode has begun"
        steps = tuple(Step.joint(number, joint) for number, joint in enumerate(self._joints))
        if self._starts_s:
            steps = (replace(Step.joint(0, *self._joints), starts_s=tuple(self._starts_s)),)
        return Recipe(blueprint_text(self._start), steps, self.setup, self._seed, self.goals)

    def tick(self, episodes: Episodes, actions: NDArray[np.int64], order: NDArray[np.int64]) -> Tick:
        """Run all cars' skills to their end, each as early as the others allow, and read the world from poses."""
        began_s, number = self.judge.physics.time_s, len(self.ticks)
        joint = self._primitives(episodes.queue[0], actions, order)
        attempts = self.judge.perform_tick(joint, tick=number)
        self.ticks.append(attempts)
        self._joints.append(joint)
        episodes.put(0, self.judge.grid)
        legal = np.zeros(len(actions), np.bool_)
        infos: list[dict[str, Any]] = [{} for _ in actions]
        for attempt in attempts:
            legal[attempt.car] = attempt.legal
            infos[attempt.car] = _info(attempt)
            if _strayed(attempt):
                episodes.queue[0, attempt.car] = -1  # what was planned starts from where the car is not
        by_car = {attempt.car: attempt for attempt in attempts}
        tried = tuple(by_car.get(car) for car in range(len(actions)))
        log = self.judge.log
        return Tick(
            applied=legal,
            duration_s=round(self.judge.physics.time_s - began_s, 6),
            durations_s=tuple(0.0 if attempt is None else attempt.duration_s for attempt in tried),
            problems=self.judge.problems,
            of_car=tuple(infos),
            attempts=tried,
            contacts=None if log is None else tuple(log.contacts),
        )

    def begin(
        self, car: int, action: Action, before: NDArray[np.integer], after: NDArray[np.integer]
    ) -> None:
        """Let the car's skill begin, on what the judge itself takes to be committed."""
        now_s = self.judge.physics.time_s
        if now_s not in self._starts_s[-1:]:
            self._starts_s.append(now_s)
            self._joints.append([])
        self._joints[-1].append((car, action))
        begin(self.judge, car, action, len(self._starts_s) - 1)

    def advance(self, until_s: float | None = None) -> Ended:
        """Run to the next ending, or to a time, and read the world from poses."""
        attempts = self.judge.next(until_s)
        if attempts:
            self.ticks.append(attempts)
        return Ended(
            self.judge.physics.time_s,
            tuple(attempt.car for attempt in attempts),
            self.judge.confirmed,
            {attempt.car: _info(attempt) | {"failed": _strayed(attempt)} for attempt in attempts},
            self.judge.problems,
            dict(self.judge.executor.fleet.lost_cars),
        )

    def _primitives(
        self, queue: NDArray[np.int8], actions: NDArray[np.int64], order: NDArray[np.int64]
    ) -> list[tuple[int, Action]]:
        """Return (car, primitive) in acting order, each as the action helper, if it is on, makes it of an action."""
        joint = [(int(car), Action(actions[car])) for car in order]
        if self._helper is None:
            return joint
        grid, primitives = self.judge.grid, []
        for car, action in joint:
            due = self._helper.due(grid, queue, car, action)
            primitives.append((car, due))
            grid = self.judge.rules.apply(grid, car, due)
        return primitives

    def images(self) -> dict[str, NDArray[Any]]:
        """Return what the cameras see now, by kind, one entry a camera; empty without any."""
        physics = self.judge.physics
        return {} if self._images is None else self._images.take(physics)

    def picture(self, grid: Grid, goal: Cell | None) -> NDArray[np.uint8]:
        """Return what the camera sees."""
        return self._pictures.picture()

    def pictures(self, grid: Grid, goal: Cell | None) -> list[NDArray[np.uint8]]:
        """Return the pictures of the motion since the last call."""
        return self._pictures.taken()

    def show(self, grid: Grid, goal: Cell | None) -> None:
        """Show the world to people, who follow the simulation from now on: in MuJoCo's viewer, or without a display in
        the browser. Raises InputError where neither works."""
        if has_display() or not has_viser():
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
        view.follow(self.judge, "", self.goals, lambda: [attempt for tick in self.ticks for attempt in tick])

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
        if self._records is not None and self._start is not None:
            while self.judge.running:
                self.advance()
            self._records.end(self.recipe, [attempt for tick in self.ticks for attempt in tick])


def _strayed(attempt: Attempt) -> bool:
    """Return whether an action ended elsewhere than its rules say."""
    return attempt.skill != "succeeded" or attempt.read != attempt.predicted


def _info(attempt: Attempt) -> dict[str, Any]:
    """Return what the judge found of one car's action; docs/reference/environments.md lists the keys."""
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


def view(env: Any, host: str = LOOPBACK, port: int = PORT, speed: str = AS_IT_GOES) -> LiveView:
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
    while inner is not None and not isinstance(getattr(inner, "core", None), Core):
        inner = getattr(inner, "env", None)
    if inner is None or not isinstance(inner.core.backend, PhysicsBackend):
        raise InputError(
            f"{env!r} cannot be viewed; allowed: an environment of craftsim with backend='physics', a single one"
        )
    opened = LiveView(host, port, speed)
    inner.core.backend.follow(opened)
    return opened
