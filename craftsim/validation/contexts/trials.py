"""Trials: one action in one context in physics, and many of them over worker processes.

Every trial derives its own generators from (seed, index), so that results are equal bit for bit at any number of
workers, and one trial can be repeated alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Final

import numpy as np

from craftsim.checking.attempt import excesses
from craftsim.checking.checked_run import ActionRecord, CheckedSite
from craftsim.checking.recipe import Recipe, Seed, Step, set_up
from craftsim.checking.settings import NOMINAL, WITH_NOISE, Thresholds, TrialSettings
from craftsim.discrete.grid import CarField
from craftsim.validation.campaign import Done, Item
from craftsim.validation.contexts.context import Context
from craftsim.validation.contexts.survey import make_world

__all__ = [
    "BATCH",
    "NOMINAL",
    "TIMEOUT_S",
    "WITH_NOISE",
    "Thresholds",
    "Trial",
    "TrialResult",
    "TrialSettings",
    "do_trial",
    "items_of",
    "plan_trials",
    "prepare",
    "recipe_of",
    "run_trial",
]

BATCH: Final = 4
"""Trials that a worker takes at once: few, so that results come steadily."""
TIMEOUT_S: Final = 120.0
"""After which a trial counts as hanging; most take about a second."""


@dataclass(frozen=True)
class TrialResult:
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


@dataclass(frozen=True)
class Trial:
    """What to try: a context under an index, which with the seed decides all that is drawn."""

    index: int
    context: Context


def plan_trials(contexts: Sequence[Context], n: int, seed: int) -> list[Trial]:
    """Distribute ``n`` trials evenly over contexts: pass after pass over all of them, each in an order of its own."""
    order: list[int] = []
    for turn in range(-(-n // len(contexts)) if contexts else 0):
        order += np.random.default_rng([seed, turn, len(contexts)]).permutation(len(contexts)).tolist()
    return [Trial(index, contexts[which]) for index, which in enumerate(order[:n])]


def prepare(trial: Trial, seed: int, settings: TrialSettings = NOMINAL) -> CheckedSite:
    """Return the world of a trial before its action, as :func:`run_trial` makes it."""
    world, physics, sensors = (np.random.default_rng(s) for s in _sequence(trial, seed).spawn(3))
    return set_up(make_world(trial.context, world), settings, physics=physics, sensors=sensors)


def recipe_of(trial: Trial, seed: int, settings: TrialSettings = NOMINAL) -> Recipe:
    """Return the recipe of a trial: performing it gives what :func:`run_trial` judges."""
    world, physics, sensors = _sequence(trial, seed).spawn(3)
    grid = make_world(trial.context, np.random.default_rng(world))
    action = trial.context.action(int(grid.cars[0, CarField.YAW]))
    recipe = Recipe.of(grid, (Step.single(0, 0, action),), settings)
    return replace(recipe, physics=Seed.of(physics), sensors=Seed.of(sensors))


def run_trial(trial: Trial, seed: int, settings: TrialSettings = NOMINAL) -> TrialResult:
    """Make the trial's world, perform its action, and judge it."""
    checked = prepare(trial, seed, settings)
    drawn = make_world(trial.context, np.random.default_rng(_sequence(trial, seed).spawn(1)[0]))
    stands = not checked.reading.problems and checked.reading.grid.same_visible(drawn)
    start = () if stands else ("the world does not stand as drawn", *checked.reading.problems)
    action = trial.context.action(int(drawn.cars[0, 3]))
    record = checked.perform(0, 0, action)
    return TrialResult(
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


def items_of(trials: Sequence[Trial], seed: int) -> list[Item]:
    """Return trials as items of a campaign, grouped by their action."""
    return [
        Item(f"{t.context.id}#{t.index}", t.context.id.split("/")[0], seed, t, context=t.context.id)
        for t in trials
    ]


def do_trial(trial: Trial, seed: int, settings: TrialSettings) -> Done:
    """Do the work of an item; ``extra`` is the :class:`TrialResult`."""
    result = run_trial(trial, seed, settings)
    return Done(agrees=result.succeeded, extra=asdict(result))


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
