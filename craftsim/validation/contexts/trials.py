"""Trials: one action in one context in physics, and many of them over worker processes.

Every trial derives its own generators from (seed, index), so that results are equal bit for bit at any number of
workers, and one trial can be repeated alone.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Final

import numpy as np

from craftsim.discrete.grid import CarField
from craftsim.validation.attempts.attempt import excesses
from craftsim.validation.attempts.checked_run import ActionRecord, CheckedSite
from craftsim.validation.contexts.survey import Context, make_world
from craftsim.validation.replays.recipe import Recipe, Seed, Step, set_up
from craftsim.validation.settings import NOMINAL, WITH_NOISE, Thresholds, TrialSettings
from craftsim.validation.workers import in_order

__all__ = [
    "NOMINAL",
    "WITH_NOISE",
    "Thresholds",
    "Trial",
    "TrialRecord",
    "TrialSettings",
    "plan_trials",
    "prepare",
    "recipe_of",
    "run_trial",
    "run_trials",
]

_BATCH: Final = 4
"""Trials that a worker takes at once: few, so that results come steadily."""


@dataclass(frozen=True)
class TrialRecord:
    """What came of one trial; errors in metres and radians."""

    index: int
    context: str
    seed: int
    action: str
    outcome: str
    """Of the skill, with its reason and detail when it failed."""
    verdict: str
    differences: tuple[str, ...]
    car_error_m: float
    heading_error_rad: float
    placed_error_m: float | None
    others_moved_m: float
    duration_s: float
    reasons: tuple[str, ...]
    """Why the trial counts as failed; empty when it succeeded."""

    @property
    def succeeded(self) -> bool:
        """Whether the skill succeeded, the verdict agrees, and every error is within its threshold."""
        return not self.reasons

    def line(self) -> str:
        """Return the record as one line of JSON."""
        return json.dumps({**asdict(self), "succeeded": self.succeeded}, sort_keys=True)


@dataclass(frozen=True)
class Trial:
    """What to try: a context under an index, which with the seed decides all that is drawn."""

    index: int
    context: Context


def plan_trials(contexts: Sequence[Context], n: int, seed: int) -> list[Trial]:
    """Spread ``n`` trials evenly over contexts: pass after pass over all of them, each in an order of its own."""
    order: list[int] = []
    for turn in range(-(-n // len(contexts)) if contexts else 0):
        order += np.random.default_rng([seed, turn, len(contexts)]).permutation(len(contexts)).tolist()
    return [Trial(index, contexts[which]) for index, which in enumerate(order[:n])]


def prepare(trial: Trial, seed: int, settings: TrialSettings = NOMINAL) -> CheckedSite:
    """Return the world of a trial before its action, as :func:`run_trial` makes it."""
    world, physics, senses = (np.random.default_rng(s) for s in _sequence(trial, seed).spawn(3))
    return set_up(make_world(trial.context, world), settings, physics=physics, senses=senses)


def recipe_of(trial: Trial, seed: int, settings: TrialSettings = NOMINAL) -> Recipe:
    """Return the recipe of a trial: performing it gives what :func:`run_trial` judges."""
    world, physics, senses = _sequence(trial, seed).spawn(3)
    grid = make_world(trial.context, np.random.default_rng(world))
    action = trial.context.action(int(grid.cars[0, CarField.YAW]))
    recipe = Recipe.of(grid, (Step.single(0, 0, action),), settings)
    return replace(recipe, physics=Seed.of(physics), senses=Seed.of(senses))


def run_trial(trial: Trial, seed: int, settings: TrialSettings = NOMINAL) -> TrialRecord:
    """Make the trial's world, perform its action, and judge it."""
    checked = prepare(trial, seed, settings)
    drawn = make_world(trial.context, np.random.default_rng(_sequence(trial, seed).spawn(1)[0]))
    stands = not checked.reading.problems and checked.reading.grid.same_visible(drawn)
    start = () if stands else ("the world does not stand as drawn", *checked.reading.problems)
    action = trial.context.action(int(drawn.cars[0, 3]))
    record = checked.perform(0, 0, action)
    return TrialRecord(
        index=trial.index,
        context=trial.context.id,
        seed=seed,
        action=action.name,
        outcome=str(record.outcome),
        verdict=str(record.verdict.finding),
        differences=(*start, *record.verdict.differences),
        car_error_m=record.car_error_m,
        heading_error_rad=abs(record.car_heading_error_rad),
        placed_error_m=record.placed_error_m,
        others_moved_m=record.others_moved_m,
        duration_s=record.outcome.duration_s,
        reasons=tuple(_reasons(record, settings.thresholds, stands)),
    )


def run_trials(
    trials: Sequence[Trial], seed: int, settings: TrialSettings = NOMINAL, workers: int = 1
) -> Iterator[TrialRecord]:
    """Yield the records of trials in their order, as soon as each is known."""
    yield from in_order(partial(run_trial, seed=seed, settings=settings), trials, workers, _BATCH)


def _sequence(trial: Trial, seed: int) -> np.random.SeedSequence:
    return np.random.SeedSequence([seed, trial.index])


def _reasons(record: ActionRecord, limits: Thresholds, stands: bool) -> Iterator[str]:
    """Name what is wrong with a trial, the cause before its consequences."""
    if not stands:
        yield "start"
    if record.outcome.reason is not None:
        yield str(record.outcome.reason)
    if not record.verdict.agrees:
        yield str(record.verdict.finding)
    yield from (name for name, _ in excesses(record, limits))
