"""Recipes: all that it takes to do something in physics again, in a form that JSON knows.

A recipe always starts from a reset. MuJoCo's state vector leaves out which trees sleep and what it keeps of them, and
skills, localisers and noise have states of their own; a start and the actions since say it all, and nothing can be
forgotten. That the world before the last step is the same again is checked, not assumed
(:mod:`craftsim.validation.replays.bundle`).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from typing import Final

import numpy as np

from craftsim.checking.attempt import Attempt, attempt_of
from craftsim.checking.checked_run import ActionRecord, CheckedSite
from craftsim.checking.settings import NOMINAL, TrialSettings
from craftsim.discrete.actions import Action
from craftsim.discrete.errors import InputError, suggestion
from craftsim.discrete.files.blueprint import Blueprint, parse_blueprint
from craftsim.discrete.files.saving import blueprint_text
from craftsim.discrete.grid import Cell, Grid
from craftsim.discrete.rules import Rules
from craftsim.discrete.rules.sets import RuleSet
from craftsim.discrete.schedule import Order
from craftsim.models.randomization import RandomizedSite
from craftsim.models.sensing import Sensors
from craftsim.models.site import Site
from craftsim.skills.executor import Executor
from craftsim.skills.gains import Gains, load_gains

_NAMES: Final = [action.name for action in Action]


@dataclass(frozen=True)
class Seed:
    """Where a random generator starts: entropy and spawn key of NumPy's SeedSequence."""

    entropy: tuple[int, ...]
    spawn_key: tuple[int, ...] = ()

    @classmethod
    def of(cls, sequence: np.random.SeedSequence) -> Seed:
        """Return the seed of a sequence, spawned or not."""
        entropy = sequence.entropy
        words = (entropy,) if isinstance(entropy, int) else tuple(entropy or ())
        return cls(tuple(int(word) for word in words), tuple(sequence.spawn_key))

    def generator(self) -> np.random.Generator:
        """Return a fresh generator."""
        return np.random.default_rng(np.random.SeedSequence(self.entropy, spawn_key=self.spawn_key))


@dataclass(frozen=True)
class Act:
    """What one car is told. Raises InputError for an action that there is not."""

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
    """What is done at one time: one action, or with an ``order`` one tick of many cars.

    Raises InputError for several actions without an order, and for an intended world with one.
    """

    tick: int
    acts: tuple[Act, ...]
    order: Order | None = None
    """Which actions may run at the same time; None performs a single action by itself."""
    intended: str | None = None
    """The world, as a blueprint, that a single action should lead to although the rules forbid it."""

    def __post_init__(self) -> None:
        if self.order is None and len(self.acts) != 1:
            raise InputError(f"a step without an order has one action, not {len(self.acts)}")
        if self.order is not None and self.intended is not None:
            raise InputError("only a single action, in a step without an order, can have an intended world")

    @classmethod
    def single(cls, tick: int, car: int, action: Action, intended: Grid | None = None) -> Step:
        """Return the step of one action; ``intended`` is what a forbidden one should lead to."""
        world = None if intended is None else blueprint_text(intended)
        return cls(tick, (Act(car, action.name),), intended=world)

    @classmethod
    def joint(cls, tick: int, joint: list[tuple[int, Action]], order: Order = "concurrent") -> Step:
        """Return the step of many cars."""
        return cls(tick, tuple(Act(car, action.name) for car, action in joint), order)


@dataclass(frozen=True)
class Recipe:
    """How to make a world in physics, and what to do in it; the last step is the one of interest."""

    world: str
    """The start as a blueprint that leaves nothing to chance."""
    steps: tuple[Step, ...]
    settings: TrialSettings = NOMINAL
    rules: RuleSet = "physical"
    physics: Seed | None = None
    """Of the draw of the physics; needed with ``settings.randomization``."""
    sensors: Seed | None = None
    """Of the noise of the sensors; needed where there is some."""
    gains: Gains = field(default_factory=load_gains)
    goals: tuple[Cell, ...] = ()
    """Cells that get a marker without contact."""

    @classmethod
    def of(cls, grid: Grid, steps: tuple[Step, ...], settings: TrialSettings = NOMINAL) -> Recipe:
        """Return the recipe that starts from a grid; :func:`dataclasses.replace` sets the rest."""
        return cls(blueprint_text(grid), steps, settings)

    def grid(self) -> Grid:
        """Return the start. Raises BlueprintError for a world that is none."""
        return _grid(self.world)


def _grid(text: str) -> Grid:
    return _blueprint(text).grid(np.random.default_rng(0))


@lru_cache(maxsize=2)
def _blueprint(text: str) -> Blueprint:
    """Return the blueprint of a world, or of an intended one; many trials start from the same."""
    return parse_blueprint(text, "world of a recipe")


def set_up(
    grid: Grid,
    settings: TrialSettings = NOMINAL,
    rules: RuleSet = "physical",
    physics: np.random.Generator | None = None,
    sensors: np.random.Generator | None = None,
    gains: Gains | None = None,
    goals: tuple[Cell, ...] = (),
    varied: RandomizedSite | None = None,
) -> CheckedSite:
    """Return a world in physics, ready for actions.

    Args:
        grid: the start.
        settings: noise, randomised physics, simulation.
        rules: the rule set that predicts.
        physics: draws the physics; needed with ``settings.randomization``.
        sensors: draws the noise; needed where there is some.
        gains: of the skills; the nominal ones unless given.
        goals: cells to mark.
        varied: a Site of an equal grid and simulation to be used again, which saves compiling; its numbers are the
            same as those of a fresh one.
    """
    if settings.randomization is not None and physics is None:
        raise InputError("randomised physics needs a seed for its draw")
    if not settings.noise.silent and sensors is None:
        raise InputError("noisy sensors need a seed")
    if varied is None:
        drawn = settings.randomization is not None
        site = Site(grid, settings.simulation, goals, reset=not drawn)
        varied = RandomizedSite(site) if drawn else None
    elif settings.randomization is None:
        varied.restore()
    if varied is not None:
        site = varied.site
        if settings.randomization is not None and physics is not None:
            varied.draw(settings.randomization, physics)
    executor = Executor(site, gains, sensors=Sensors(site, settings.noise, sensors))
    return CheckedSite(site, Rules(rules), executor)


@dataclass(frozen=True)
class Performance:
    """What came of a recipe's last step."""

    checked: CheckedSite
    records: tuple[ActionRecord, ...]
    attempts: tuple[Attempt, ...]
    """Parallel to the records."""


def prepare(recipe: Recipe, varied: RandomizedSite | None = None) -> CheckedSite:
    """Return the world of a recipe at its start; ``varied`` as of :func:`set_up`."""
    physics, sensors = (None if s is None else s.generator() for s in (recipe.physics, recipe.sensors))
    grid = recipe.grid()
    for step in recipe.steps:
        for act in step.acts:
            if not 0 <= act.car < grid.n_cars:
                raise InputError(f"there is no car {act.car}: the world has {grid.n_cars}, counted from 0")
    return set_up(grid, recipe.settings, recipe.rules, physics, sensors, recipe.gains, recipe.goals, varied)


def run_up(recipe: Recipe, varied: RandomizedSite | None = None) -> CheckedSite:
    """Return the world of a recipe before its last step."""
    checked = prepare(recipe, varied)
    for step in recipe.steps[:-1]:
        do(checked, step)
    return checked


def do_last(checked: CheckedSite, recipe: Recipe) -> Performance:
    """Do the last step of a recipe in the world that :func:`run_up` has led to."""
    records = do(checked, recipe.steps[-1])
    limits = recipe.settings.thresholds
    return Performance(checked, records, tuple(attempt_of(record, limits) for record in records))


def perform(recipe: Recipe, varied: RandomizedSite | None = None) -> Performance:
    """Do all of a recipe and return what came of its last step."""
    return do_last(run_up(recipe, varied), recipe)


def do(checked: CheckedSite, step: Step) -> tuple[ActionRecord, ...]:
    """Do one step and return a record for each of its actions."""
    acts = [(act.car, Action[act.action]) for act in step.acts]
    if step.order is not None:
        return checked.perform_together(step.tick, acts, step.order)
    intended = None if step.intended is None else _grid(step.intended)
    return (checked.perform(step.tick, *acts[0], intended),)
