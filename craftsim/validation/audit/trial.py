"""One trial of the audit, and the items of a whole one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np

from craftsim.audit.plan import PlanRow, distribute_trials
from craftsim.audit.situation import Situation
from craftsim.checking.episode import Recipe, do, run_up
from craftsim.checking.setup import Seed, Setup, compile_world, set_up
from craftsim.discrete.files.blueprint import blueprint_text
from craftsim.errors import StartError
from craftsim.experiments.experiment import Done, Item
from craftsim.models.world import PhysicsWorld

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

    @property
    def placed(self) -> Situation:
        """The situation at the place on the map where all its trials are."""
        return self.situation.placed(np.random.default_rng([self.seed, self.situation.digest]))


def items_of(rows: Sequence[PlanRow], trials: int, seed: int, setup: Setup) -> list[Item]:
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
    placed = trial.placed
    seed = Seed((trial.seed, trial.situation.digest, trial.number))
    return Recipe(blueprint_text(placed.grid), placed.steps(trial.legal), trial.setup, seed)


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
    return _physics(trial.situation, trial.seed, trial.setup)


def why_not_standing(trial: Trial) -> tuple[str, ...]:
    """Return how the world of a trial, at rest and at nominal physics, differs from what was drawn; or nothing."""
    return _problems(trial.situation, trial.seed, trial.setup)


@lru_cache(maxsize=1)
def _physics(situation: Situation, seed: int, setup: Setup) -> PhysicsWorld:
    return compile_world(Trial(situation, True, 0, seed, setup).placed.grid, setup)


@lru_cache(maxsize=1)
def _problems(situation: Situation, seed: int, setup: Setup) -> tuple[str, ...]:
    grid = Trial(situation, True, 0, seed, setup).placed.grid
    world = _physics(situation, seed, setup)
    try:
        reading = set_up(grid, Setup(simulation=setup.simulation), reuse=world, watch_contacts=False).reading
    except StartError as error:
        return (str(error),)
    if reading.problems or reading.grid.same_visible(grid):
        return reading.problems
    return ("the world reads otherwise than it was drawn",)
