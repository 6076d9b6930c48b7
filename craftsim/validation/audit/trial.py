"""One trial of the audit, and the items of a whole one."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Final

import numpy as np

from craftsim.checking.attempt import Result
from craftsim.checking.recipe import Recipe, Seed, Step, perform
from craftsim.checking.settings import TrialSettings
from craftsim.discrete.files.saving import blueprint_text
from craftsim.discrete.grid import Grid
from craftsim.discrete.readback import read_grid
from craftsim.discrete.rules import RuleSet
from craftsim.models.config import SimulationConfig
from craftsim.models.randomization import RandomizedSite
from craftsim.models.sensing import read_poses
from craftsim.models.site import Site
from craftsim.skills.gains import load_gains
from craftsim.validation.audit.intended import intended
from craftsim.validation.audit.rows import Row, Situation, action_in, distribute_trials, world_of
from craftsim.validation.audit.scenes import Scene
from craftsim.validation.campaign import Done, Item

BATCH: Final = 20
"""Items that a worker takes at once: those of a few situations, so that each world is compiled about once."""
TIMEOUT_S: Final = 120.0


@dataclass(frozen=True)
class Job:
    """One trial, as it goes to a worker."""

    situation: Situation
    legal: bool
    number: int
    """Which trial of the situation it is; with the seed it decides the physics and the noise."""
    seed: int
    rules: RuleSet
    settings: TrialSettings


def items_of(
    rows: Sequence[Row], trials: int, seed: int, rules: RuleSet, settings: TrialSettings
) -> list[Item]:
    """Return the items of an audit: at least ``trials`` for each row; one, that tries nothing, without a prediction."""
    items = []
    for row in rows:
        if row.no_prediction:
            items.append(Item(row.name, row.name, seed, None))
            continue
        for situation, number in distribute_trials(row, trials):
            job = Job(situation, row.legal, number, seed, rules, settings)
            items.append(Item(f"{situation.id}#{number}", row.name, seed, job, context=situation.id))
    return items


def recipe_of(job: Job) -> Recipe:
    """Return what a trial does: performing it gives what :func:`try_it` judges."""
    world, step = _start(job.situation, job.legal, job.seed, job.rules)
    physics, sensors = np.random.SeedSequence([job.seed, _digest(job.situation), job.number]).spawn(2)
    return Recipe(
        world,
        (step,),
        job.settings,
        job.rules,
        Seed.of(physics),
        Seed.of(sensors),
        _gains(),
    )


_gains = cache(load_gains)


def try_it(job: Job | None) -> Done:
    """Try one action, or one tick, and judge it; nothing for no job, and nothing in a world that does not stand."""
    if job is None:
        return Done(agrees=True)
    varied, problems = _site(job.situation, job.legal, job.seed, job.rules, job.settings.simulation)
    if problems:
        return Done(agrees=True, extra={"does_not_stand": list(problems)})
    attempts = perform(recipe_of(job), varied).attempts
    as_predicted = all(attempt.result == Result.AS_PREDICTED for attempt in attempts)
    return Done(agrees=as_predicted == job.legal, attempts=attempts)


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
def _site(
    situation: Situation, legal: bool, seed: int, rules: RuleSet, simulation: SimulationConfig
) -> tuple[RandomizedSite, tuple[str, ...]]:
    """Return a Site of a situation to use again and again, and how it differs from what was drawn."""
    grid, _ = _world(situation, legal, seed, rules)
    site = Site(grid, simulation)
    reading = read_grid(read_poses(site), site.size, site.walls)
    if reading.problems or reading.grid.same_visible(grid):
        return RandomizedSite(site), reading.problems
    return RandomizedSite(site), ("the world reads otherwise than it was drawn",)


def _digest(situation: Situation) -> int:
    return int.from_bytes(hashlib.sha256(situation.id.encode()).digest()[:8])
