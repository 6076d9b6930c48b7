"""One trial of the audit, and the items of a whole one."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np

from craftsim.checking.episode import Recipe, Step, do, run_up
from craftsim.checking.setup import Seed, Setup, compile_world, set_up
from craftsim.discrete.files.blueprint import blueprint_text
from craftsim.discrete.grid import Grid
from craftsim.discrete.rules import RuleSet
from craftsim.errors import StartError
from craftsim.models.world import PhysicsWorld
from craftsim.validation.audit.intended import intended
from craftsim.validation.audit.rows import Row, Situation, action_in, distribute_trials, world_of
from craftsim.validation.audit.scenes import Scene
from craftsim.validation.campaign import Done, Item

BATCH: Final = 20
"""Items that a worker takes at once: those of a few situations, so that each world is compiled about once."""
TIMEOUT_S: Final = 120.0


@dataclass(frozen=True, slots=True)
class Trial:
    """One trial, as it goes to a worker."""

    situation: Situation
    legal: bool
    number: int
    """Which trial of the situation it is; with the seed it decides the physics and the noise."""
    seed: int
    setup: Setup


def items_of(rows: Sequence[Row], trials: int, seed: int, setup: Setup) -> list[Item]:
    """Return the items of an audit: at least ``trials`` for each row; one, that tries nothing, without a prediction."""
    items = []
    for row in rows:
        if row.no_prediction:
            items.append(Item(row.name, row.name, seed, None))
            continue
        for situation, number in distribute_trials(row, trials):
            trial = Trial(situation, row.legal, number, seed, setup)
            items.append(Item(f"{situation.id}#{number}", row.name, seed, trial, context=situation.id))
    return items


def recipe_of(trial: Trial) -> Recipe:
    """Return what a trial does: performing it gives what :func:`try_it` judges."""
    world, step = _start(trial.situation, trial.legal, trial.seed, trial.setup.rules)
    seed = Seed((trial.seed, _digest(trial.situation), trial.number))
    return Recipe(world, (step,), trial.setup, seed)


def try_it(trial: Trial | None) -> Done:
    """Try one action, or one tick, and judge it; nothing for no trial, and nothing in a world that does not stand."""
    if trial is None:
        return Done(agrees=True)
    problems = why_not_standing(trial)
    if problems:
        return Done(agrees=True, extra={"does_not_stand": list(problems)})
    recipe = recipe_of(trial)
    attempts = do(run_up(recipe, physics_of(trial)), recipe.steps[-1])
    return Done(agrees=all(attempt.agrees for attempt in attempts) == trial.legal, attempts=attempts)


def physics_of(trial: Trial) -> PhysicsWorld:
    """Return the PhysicsWorld of a trial's situation, which its other trials use again."""
    return _physics(trial.situation, trial.legal, trial.seed, trial.setup)


def why_not_standing(trial: Trial) -> tuple[str, ...]:
    """Return how the world of a trial, at rest and at nominal physics, differs from what was drawn; or nothing."""
    return _problems(trial.situation, trial.legal, trial.seed, trial.setup)


@lru_cache(maxsize=2)
def _world(situation: Situation, legal: bool, seed: int, rules: RuleSet) -> tuple[Grid, Step]:
    """Return the world of a situation, and what is done in it."""
    if isinstance(situation, Scene):
        return situation.world(), situation.step(legal)
    grid = world_of(situation, np.random.default_rng([seed, _digest(situation)]), rules)
    action = action_in(situation, grid)
    goal = None if legal else intended(grid, 0, action)
    return grid, Step.single(0, 0, action, goal)


@lru_cache(maxsize=1)
def _start(situation: Situation, legal: bool, seed: int, rules: RuleSet) -> tuple[str, Step]:
    """Return the same with the world as text."""
    grid, step = _world(situation, legal, seed, rules)
    return blueprint_text(grid), step


@lru_cache(maxsize=1)
def _physics(situation: Situation, legal: bool, seed: int, setup: Setup) -> PhysicsWorld:
    grid, _ = _world(situation, legal, seed, setup.rules)
    return compile_world(grid, setup)


@lru_cache(maxsize=1)
def _problems(situation: Situation, legal: bool, seed: int, setup: Setup) -> tuple[str, ...]:
    grid, _ = _world(situation, legal, seed, setup.rules)
    world = _physics(situation, legal, seed, setup)
    try:
        reading = set_up(grid, Setup(simulation=setup.simulation), reuse=world, watch_contacts=False).reading
    except StartError as error:
        return (str(error),)
    if reading.problems or reading.grid.same_visible(grid):
        return reading.problems
    return ("the world reads otherwise than it was drawn",)


def _digest(situation: Situation) -> int:
    return int.from_bytes(hashlib.sha256(situation.id.encode()).digest()[:8])
