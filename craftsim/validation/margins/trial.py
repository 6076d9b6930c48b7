"""One trial of a scenario, at given levels of imperfections."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from craftsim.audit.situation import Situation
from craftsim.checking.attempt import Attempt
from craftsim.checking.episode import Recipe, do, start
from craftsim.checking.setup import Seed, Setup, compile_world, imperfect
from craftsim.discrete.files.blueprint import blueprint_text
from craftsim.discrete.rules import RuleSet
from craftsim.errors import StartError
from craftsim.models.floor import Floor
from craftsim.models.randomization import Making
from craftsim.models.world import PhysicsWorld
from craftsim.validation.margins.axes import Axis
from craftsim.validation.margins.scenarios import Scenario

Level = tuple[Axis, float]
"""An imperfection and its value."""


@dataclass(frozen=True)
class TrialResult:
    """What became of a trial."""

    attempts: tuple[Attempt, ...]
    """At the last step; none in a world that cannot be."""
    reason: str
    """Why it failed; empty where all went as predicted."""


@dataclass(frozen=True, slots=True)
class Rig:
    """A scenario under a base's setup, in which levels are tried; hashable."""

    scenario: Scenario
    setup: Setup
    """Of the base."""
    seed: int

    def recipe(self, number: int, levels: Iterable[Level] = ()) -> Recipe:
        """Return what a trial does; those of one number draw the same at all levels."""
        drawn = self.setup.randomization
        for axis, value in levels:
            drawn = axis.on(drawn, value)
        situation = _situation(self.scenario, self.setup.rules)
        placed = situation.placed(np.random.default_rng(self.seed))
        seed = Seed((self.seed, situation.digest, number))
        return Recipe(blueprint_text(placed.grid), placed.steps(), imperfect(self.setup, drawn), seed)

    def attempt(self, number: int, levels: Iterable[Level] = ()) -> TrialResult:
        """Perform a trial; what counts is the last step, whatever came of the ones that lead to it."""
        recipe = self.recipe(number, levels)
        drawn = recipe.setup.randomization
        try:
            judge = start(recipe, _physics(self, drawn.floor, drawn.making))
        except StartError as error:
            return TrialResult((), str(error))
        for step in recipe.steps:
            attempts = do(judge, step)
        failed = next((attempt for attempt in attempts if not attempt.agrees), None)
        return TrialResult(attempts, "" if failed is None else f"{failed.result}: {failed.reason}")


@lru_cache(maxsize=2)
def _physics(rig: Rig, floor: Floor, making: Making) -> PhysicsWorld:
    """Return the compiled world of a rig, which all trials on the same kind of floor use again."""
    recipe = rig.recipe(0)
    drawn = replace(recipe.setup.randomization, floor=floor, making=making)
    return compile_world(recipe.grid, imperfect(recipe.setup, drawn))


@lru_cache(maxsize=2)
def _situation(scenario: Scenario, rules: RuleSet) -> Situation:
    return scenario.situation(rules)
