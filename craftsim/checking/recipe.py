"""Recipes: all that it takes to do something in physics again, in a form that JSON knows.

A recipe always starts from a reset. MuJoCo's state vector leaves out which trees sleep and what it keeps of them, and
skills, localisers and noise have states of their own; a start and the actions since say it all, and nothing can be
forgotten. That the world before the last step is the same again is checked, not assumed
(:mod:`craftsim.validation.replays.bundle`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Final

import numpy as np

from craftsim.checking.attempt import Attempt
from craftsim.checking.checked_site import CheckedSite
from craftsim.checking.settings import Setup
from craftsim.checking.world import SEED_0, Seed, set_up
from craftsim.discrete.files.blueprint import Blueprint, blueprint_text, parse_blueprint
from craftsim.discrete.grid import Cell, Grid
from craftsim.discrete.kinds import Action
from craftsim.discrete.schedule import Concurrency, Constraints
from craftsim.errors import InputError, suggestion
from craftsim.models.extent import check_extent
from craftsim.models.world import Site
from craftsim.storage.limits import RECIPE_ACTIONS, STEP_ACTIONS

_NAMES: Final = [action.name for action in Action]


@dataclass(frozen=True)
class Act:
    """What one car is to do. Raises InputError for an action that there is not."""

    car: int
    action: str
    """Name of a primitive action."""

    def __post_init__(self) -> None:
        if self.action not in _NAMES:
            raise InputError(
                f"unknown action '{self.action}'{suggestion(self.action, _NAMES)}; there are {', '.join(_NAMES)}"
            )


@dataclass(frozen=True)
class Step:
    """What is done at one time: one action, or with an ``order`` one tick of many cars, or a whole plan.

    Raises InputError for several actions without an order, for an intended world with one, for a car that acts twice
    in a tick, and for more actions than allowed.
    """

    ticks: tuple[tuple[Act, ...], ...]
    """In each tick every car acts once at most, in the order given."""
    order: Concurrency | None = None
    """Which actions may run at the same time; None performs a single action by itself."""
    intended: str | None = None
    """The world, as a blueprint, that a single action should lead to although the rules forbid it."""
    number: int = 0
    """Of the first tick."""
    after: tuple[tuple[tuple[int, int], tuple[int, int]], ...] = ()
    """Order constraints of a plan: an action's (tick, car), and that of one that must have ended before it; ticks count
    from the first of the step."""

    def __post_init__(self) -> None:
        if self.order is None and len(self.acts) != 1:
            raise InputError(f"a step without an order has one action, not {len(self.acts)}")
        if len(self.acts) > STEP_ACTIONS:
            raise InputError(
                f"a step of {len(self.acts)} actions; allowed: at most {STEP_ACTIONS} at one time"
            )
        if any(len({act.car for act in tick}) < len(tick) for tick in self.ticks):
            raise InputError("a car acts twice in one tick; allowed: once")
        if self.order is not None and self.intended is not None:
            raise InputError("only a single action, in a step without an order, can have an intended world")

    @property
    def acts(self) -> tuple[Act, ...]:
        """All actions."""
        return tuple(act for tick in self.ticks for act in tick)

    @property
    def intended_grid(self) -> Grid | None:
        """The intended world, where there is one. Raises BlueprintError for one that is none."""
        return None if self.intended is None else _grid(self.intended)

    @classmethod
    def single(cls, tick: int, car: int, action: Action, intended: Grid | None = None) -> Step:
        """Return the step of one action; ``intended`` is what a forbidden one should lead to."""
        world = None if intended is None else blueprint_text(intended)
        return cls(((Act(car, action.name),),), None, world, tick)

    @classmethod
    def joint(
        cls,
        tick: int,
        *ticks: Sequence[tuple[int, Action]],
        order: Concurrency = "concurrent",
        after: Constraints | None = None,
    ) -> Step:
        """Return the step of many cars: one tick, or several as one schedule with its order constraints.

        ``tick`` numbers the first one.
        """
        acts = tuple(tuple(Act(car, action.name) for car, action in joint) for joint in ticks)
        pairs = tuple((act, other) for act, others in (after or {}).items() for other in others)
        return cls(acts, order, None, tick, pairs)


@dataclass(frozen=True)
class Recipe:
    """How to make a world in physics, and what to do in it; the last step is the one of interest."""

    world: str
    """The start as a blueprint that leaves nothing to chance."""
    steps: tuple[Step, ...] = ()
    setup: Setup = field(default_factory=Setup)
    seed: Seed = SEED_0
    """Of the draw of the physics and of the sensors' noise."""
    goals: tuple[Cell, ...] = ()
    """Cells that get a marker without contact."""

    @property
    def grid(self) -> Grid:
        """The start. Raises BlueprintError for a world that is none."""
        return _grid(self.world)

    def then(self, *steps: Step) -> Recipe:
        """Return this recipe with more steps at its end."""
        return replace(self, steps=(*self.steps, *steps))


def _grid(text: str) -> Grid:
    return _blueprint(text).grid(np.random.default_rng(0))


@lru_cache(maxsize=2)
def _blueprint(text: str) -> Blueprint:
    """Return the blueprint of a world, or of an intended one; many trials start from the same."""
    return parse_blueprint(text, "world of a recipe")


def run_up(recipe: Recipe, reuse: Site | None = None) -> CheckedSite:
    """Return the world of a recipe before its last step; ``reuse`` as of :func:`set_up`."""
    checked = start(recipe, reuse)
    for step in recipe.steps[:-1]:
        do(checked, step)
    return checked


def start(recipe: Recipe, reuse: Site | None = None) -> CheckedSite:
    """Return the world of a recipe before its first step; ``reuse`` as of :func:`set_up`.

    Raises InputError where something in the recipe does not fit together.
    """
    grid = check_recipe(recipe)
    return set_up(grid, recipe.setup, recipe.seed, recipe.goals, reuse)


def check_recipe(recipe: Recipe) -> Grid:
    """Return the start of a recipe; raise InputError for a world that physics does not take, and for wrong steps."""
    grid = recipe.grid
    check_extent(grid, recipe.goals)
    acts = [act for step in recipe.steps for act in step.acts]
    if len(acts) > RECIPE_ACTIONS:
        raise InputError(f"a recipe of {len(acts)} actions; allowed: at most {RECIPE_ACTIONS}")
    for act in acts:
        if not 0 <= act.car < grid.n_cars:
            raise InputError(f"there is no car {act.car}: the world has {grid.n_cars}, counted from 0")
    for step in recipe.steps:
        intended = step.intended_grid or grid
        if (intended.size, intended.n_cars) != (grid.size, grid.n_cars):
            raise InputError("the intended world of a step has another size, or other cars, than the start")
    return grid


def do(checked: CheckedSite, step: Step) -> tuple[Attempt, ...]:
    """Do one step and return an attempt for each of its actions."""
    if step.order is None:
        act = step.acts[0]
        return (checked.perform(act.car, Action[act.action], step.intended_grid, step.number),)
    ticks = [[(act.car, Action[act.action]) for act in tick] for tick in step.ticks]
    after: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for later, earlier in step.after:
        after.setdefault(later, []).append(earlier)
    attempts = checked.perform_plan(ticks, step.order, after)
    return tuple(replace(attempt, tick=attempt.tick + step.number) for attempt in attempts)
