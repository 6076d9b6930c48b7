"""Recipes of episodes in physics, the steps of which they are made, and a limit of their time.

A recipe is all that is needed to repeat an episode, as JSON values. It always starts from a reset, because MuJoCo's
state vector is not the whole state: trees sleep, and skills, estimators and noise have states of their own. Replays
check that the world before the last step is the same (:mod:`craftsim.experiments.bundle`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from craftsim.checking.attempt import Attempt
from craftsim.checking.judge import Judge
from craftsim.checking.setup import SEED_0, Seed, Setup, judge_on, nominal_gains, set_up
from craftsim.discrete.actions import action_names, footprint
from craftsim.discrete.files.blueprint import Blueprint, blueprint_text, parse_blueprint
from craftsim.discrete.grid import Cell, Grid
from craftsim.discrete.kinds import Action, TeamAction
from craftsim.discrete.rules import RuleSet
from craftsim.discrete.schedule import Concurrency, Constraints, ScheduledAction
from craftsim.errors import InputError, suggestion
from craftsim.models.composition import check_extent
from craftsim.models.sensing import Sensors
from craftsim.models.world import PhysicsWorld
from craftsim.skills.gains import Gains
from craftsim.skills.library import SkillChoice, own_skills
from craftsim.storage.limits import RECIPE_ACTIONS, STEP_ACTIONS
from craftsim.storage.records import Listed
from craftsim.storage.writing import LEFT_OUT_IF_EMPTY


@dataclass(frozen=True)
class Act:
    """The action of one car as a recipe's file has it: by its name, which holds in every process."""

    car: int
    action: str
    """Name of a primitive action."""

    def __post_init__(self) -> None:
        names = action_names()
        if self.action not in names:
            close = suggestion(self.action, names)
            raise InputError(f"unknown action '{self.action}'{close}; there are {', '.join(names)}")


@dataclass(frozen=True)
class Step:
    """One action; or, with an ``order``, one tick of many cars, or a whole plan."""

    ticks: Listed[Listed[Act]]
    """In each tick every car acts once at most, in acting order."""
    order: Concurrency | None = None
    """None for a single action."""
    intended: str | None = None
    """The world, as a blueprint, that a single forbidden action should lead to."""
    number: int = 0
    """Number of the first tick."""
    after: Listed[tuple[tuple[int, int], tuple[int, int]]] = ()
    """Order constraints of a plan: an action's (tick, car), and that of one that must have ended before it; ticks count
    from the first of the step."""
    starts_s: Listed[float] = field(default=(), metadata={LEFT_OUT_IF_EMPTY: True})
    """Simulated time at which each tick begins, whatever still runs; empty if actions begin by the order."""

    def __post_init__(self) -> None:
        if self.order is None and len(self.acts) != 1:
            raise InputError(f"a step without an order has one action, not {len(self.acts)}")
        if len(self.acts) > STEP_ACTIONS:
            count = len(self.acts)
            raise InputError(
                f"a step of {count} actions; allowed: at most {STEP_ACTIONS} at one time"
            )
        if any(len({act.car for act in tick}) < len(tick) for tick in self.ticks):
            raise InputError("a car acts twice in one tick; allowed: once")
        if self.order is not None and self.intended is not None:
            raise InputError(
                "only a single action, in a step without an order, can have an intended world"
            )
        if self.starts_s and (self.order is None or len(self.starts_s) != len(self.ticks)):
            counts = f"{len(self.starts_s)} times for {len(self.ticks)} ticks"
            raise InputError(f"{counts}; allowed: one a tick, with an order")

    @property
    def acts(self) -> tuple[Act, ...]:
        """All actions."""
        acts = []
        for tick in self.ticks:
            for act in tick:
                acts.append(act)
        return tuple(acts)

    @property
    def intended_grid(self) -> Grid | None:
        """The intended world, if any. Raises BlueprintError for an invalid one."""
        if self.intended is None:
            return None
        return _grid(self.intended)

    @classmethod
    def single(cls, tick: int, car: int, action: Action, intended: Grid | None = None) -> Step:
        """Return the step of one action, with the intended world of a forbidden one."""
        world = None
        if intended is not None:
            world = blueprint_text(intended)
        return cls(((Act(car, action.name),),), None, world, tick)

    @classmethod
    def of_ticks(
        cls,
        tick: int,
        *ticks: TeamAction,
        order: Concurrency = "concurrent",
        after: Constraints | None = None,
    ) -> Step:
        """Return the step of many cars: one tick, or several as one schedule; ``tick`` numbers the first one."""
        acts = tuple(_acts_of(team_action) for team_action in ticks)
        pairs = tuple(
            (later, earlier)
            for later, earlier_acts in (after or {}).items()
            for earlier in earlier_acts
        )
        return cls(acts, order, None, tick, pairs)


def _acts_of(team_action: TeamAction) -> tuple[Act, ...]:
    return tuple(Act(car, action.name) for car, action in team_action)


@dataclass(frozen=True)
class Recipe:
    """The configuration and the actions of an episode; the last step is the one of interest."""

    world: str
    """The start as a blueprint without random parts."""
    steps: Listed[Step] = ()
    setup: Setup = field(default_factory=Setup)
    seed: Seed = SEED_0
    """Seed of the randomization and of the sensors' noise."""
    goals: Listed[Cell] = ()
    """Cells that get a marker without contact."""

    @property
    def grid(self) -> Grid:
        """The start. Raises BlueprintError for an invalid world."""
        return _grid(self.world)

    def then(self, *steps: Step) -> Recipe:
        """Return this recipe with more steps at its end."""
        return replace(self, steps=(*self.steps, *steps))


@lru_cache(maxsize=2)
def _blueprint(text: str) -> Blueprint:
    """Parse a world; many trials start from the same one."""
    return parse_blueprint(text, "world of a recipe")


def _grid(text: str) -> Grid:
    return _blueprint(text).grid(np.random.default_rng(0))


def run_up(recipe: Recipe, reuse: PhysicsWorld | None = None) -> Judge:
    """Return the world of a recipe before its last step; ``reuse`` as of :func:`set_up`."""
    judge = start(recipe, reuse)
    for step in recipe.steps[:-1]:
        perform_step(judge, step)
    return judge


def start(recipe: Recipe, reuse: PhysicsWorld | None = None) -> Judge:
    """Return the world of a recipe before its first step. Raises InputError for an invalid recipe."""
    grid = check_recipe(recipe)
    return set_up(grid, recipe.setup, recipe.seed, recipe.goals, reuse)


def check_recipe(recipe: Recipe) -> Grid:
    """Return the start of a recipe. Raises InputError for an invalid world or invalid steps."""
    grid = recipe.grid
    check_extent(grid, recipe.goals)
    acts = []
    for step in recipe.steps:
        for act in step.acts:
            acts.append(act)
    if len(acts) > RECIPE_ACTIONS:
        raise InputError(f"a recipe of {len(acts)} actions; allowed: at most {RECIPE_ACTIONS}")
    for act in acts:
        if not 0 <= act.car < grid.n_cars:
            raise InputError(
                f"there is no car {act.car}: the world has {grid.n_cars}, counted from 0"
            )
    for step in recipe.steps:
        intended = step.intended_grid or grid
        if (intended.size, intended.n_cars) != (grid.size, grid.n_cars):
            raise InputError(
                "the intended world of a step has another size, or other cars, than the start"
            )
    return grid


def perform_step(judge: Judge, step: Step) -> tuple[Attempt, ...]:
    """Do one step and return an attempt for each action. Raises InputError if one cannot begin at its time."""
    if step.order is None:
        act = step.acts[0]
        return (judge.perform(act.car, Action[act.action], step.intended_grid, step.number),)
    if step.starts_s:
        return _perform_at(judge, step)
    after: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for later, earlier in step.after:
        after.setdefault(later, []).append(earlier)
    ticks = []
    for tick in step.ticks:
        ticks.append([(act.car, Action[act.action]) for act in tick])
    attempts = judge.perform_plan(ticks, step.order, after)
    return tuple(replace(attempt, tick=attempt.tick + step.number) for attempt in attempts)


def _perform_at(judge: Judge, step: Step) -> tuple[Attempt, ...]:
    attempts: list[Attempt] = []
    for tick, (acts, start_s) in enumerate(
        zip(step.ticks, step.starts_s, strict=True), step.number
    ):
        # Actions begin between two control periods, at the nearest time.
        while judge.physics.time_s < start_s - judge.physics.config.control_period_s / 2:
            attempts += judge.next(start_s)
        for act in acts:
            begin(judge, act.car, Action[act.action], tick)
    while judge.running:
        attempts += judge.next()
    return in_order([step], attempts)


def in_order(steps: Iterable[Step], attempts: Iterable[Attempt]) -> tuple[Attempt, ...]:
    """Return attempts in the order of the steps' actions, however they have ended."""
    place: dict[tuple[int, int], int] = {}
    for step in steps:
        for tick, acts in enumerate(step.ticks, step.number):
            for act in acts:
                place[tick, act.car] = len(place)
    return tuple(sorted(attempts, key=lambda attempt: place[attempt.tick, attempt.car]))


def begin(judge: Judge, car: int, action: Action, tick: int = 0) -> None:
    """Let a car begin an action while others run; :meth:`Judge.next` runs it.

    Raises InputError for a car that acts, and for an action that the rules forbid in the committed world.
    """
    if car in judge.running:
        raise InputError(
            f"car {car} cannot begin {action.name}: its {judge.running[car].action.name} runs"
        )
    world = judge.committed
    after, legal = judge.rules.tick(world, [(car, action)])
    if not legal[0]:
        raise InputError(str(judge.rules.explain(world, car, action)))
    judge.begin(
        ScheduledAction(tick, car, action, world, after, footprint(world, after, car, action))
    )


class _KeptJudge(NamedTuple):
    """The judge of a PhysicsWorld between calls of :func:`perform`, and what it was made with."""

    judge: Judge
    setup: Setup
    sensors: Sensors | None
    state: bytes
    """The state of the PhysicsWorld after the last call (:func:`_state_of`)."""


def perform(
    physics: PhysicsWorld,
    car: int,
    action: Action | str,
    *,
    rules: RuleSet = "physical",
    gains: Gains | None = None,
    sensors: Sensors | None = None,
    skills: SkillChoice | None = None,
) -> Attempt:
    """Perform one action of one car on a PhysicsWorld, and judge it by the resulting poses.

    The world goes on from its present state. A forbidden action is not performed; the attempt says why. One judge keeps
    watch over a PhysicsWorld until its next reset or restore: small displacements of one thing in many calls add up.

    Args:
        physics: the world.
        car: number of the car that acts.
        action: what it does, or its name.
        rules: the rule set that predicts.
        gains: of the skills; the nominal ones unless given.
        sensors: of the cars; exact ones unless given.
        skills: of your own in place of built-in ones, as :class:`craftsim.Executor` takes them.

    Raises:
        InputError: there is no such car or action, or solids overlapped at the PhysicsWorld's start.

    Example:
        >>> import craftsim
        >>> physics = craftsim.PhysicsWorld(craftsim.Grid.empty((3, 1, 1), n_cars=1))
        >>> attempt = craftsim.perform(physics, 0, "MOVE_RIGHT")
        >>> attempt.agrees, attempt.read
        (True, '1,0,1 +x')
    """
    if not isinstance(physics, PhysicsWorld):
        raise InputError(
            f"actions are performed on a PhysicsWorld, not on a {type(physics).__name__}"
        )
    if not 0 <= car < len(physics.cars):
        raise InputError(
            f"there is no car {car}: the world has {len(physics.cars)}, counted from 0"
        )
    if isinstance(action, str):
        action = Action[Act(car, action).action]
    gains = gains or nominal_gains()
    named_skills = own_skills(skills)
    setup = Setup(rules, gains=gains, machines=physics.machines, skills=named_skills)
    judge = _judge_of(physics, setup, sensors)
    attempt = judge.perform(car, action)
    physics.judge = _KeptJudge(judge, setup, sensors, _state_of(physics))
    return attempt


def _judge_of(physics: PhysicsWorld, setup: Setup, sensors: Sensors | None) -> Judge:
    """Return the judge that a PhysicsWorld keeps, so that small displacements add up over calls.

    With another setup, or where the world has changed since the last call, or that was interrupted, it is a new one
    that knows all places: the cars of the old one would believe to be where they were.
    """
    kept: _KeptJudge | None = physics.judge
    if (
        kept is not None
        and kept.setup == setup
        and kept.sensors is sensors
        and kept.state == _state_of(physics)
    ):
        return kept.judge
    judge = judge_on(physics, setup, sensors)
    if kept is not None:
        judge.take_over(kept.judge)
    physics.judge = _KeptJudge(judge, setup, sensors, b"")
    return judge


def _state_of(physics: PhysicsWorld) -> bytes:
    """Return what tells the state of a PhysicsWorld from another one: its time and positions."""
    data = physics.data
    return np.append(data.qpos, data.time).tobytes()


OnAttempts = Callable[[tuple[Attempt, ...]], None]
"""Called after each step of an episode."""
Watch = Callable[[Judge], OnAttempts]
"""Looks on while an episode runs: called with the world at its start, and returns what is called after each step."""


def unwatched(judge: Judge) -> OnAttempts:
    """Look at nothing."""
    return lambda attempts: None


class OverrunError(InputError):
    """Something takes more simulated time than allowed."""


def limit_time(judge: Judge, most_s: float, name: str) -> Callable[[], float]:
    """Limit the simulated time of what is done next in a world; return a function that returns the time passed.

    Control periods are counted, because the clock starts over when the simulation diverges.
    """
    n_periods = 0
    period_s = judge.physics.config.control_period_s

    def passed_s() -> float:
        return n_periods * period_s

    def count(physics: PhysicsWorld) -> None:
        nonlocal n_periods
        n_periods += 1
        if passed_s() > most_s:
            raise OverrunError(f"{name} has not finished after {most_s:.4g} s of simulated time")

    judge.executor.observers.append(count)
    return passed_s
