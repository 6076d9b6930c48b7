"""The smallest world in which an action still fails: what stands around is taken away as long as it does.

The search is delta debugging (Zeller and Hildebrandt, Simplifying and Isolating Failure-Inducing Input, IEEE TSE
2002): halves of what stands around, then quarters, down to single pieces. What it ends with is 1-minimal: without any
single piece, and what stands on it, the action does as predicted, or the rules forbid it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass, replace
from itertools import product
from pathlib import Path
from typing import Final

from craftsim.checking.attempt import Attempt, Thresholds
from craftsim.checking.episode import OverrunError, Recipe, do, limit_time, start
from craftsim.checking.setup import SEED_0, Seed, Setup, set_up
from craftsim.discrete.files.blueprint import blueprint_text, write_blueprint
from craftsim.discrete.grid import Cell, Grid, Kind
from craftsim.discrete.kinds import MOVE_DIRECTION, Action
from craftsim.discrete.rules import Rules
from craftsim.discrete.schedule import make_schedule
from craftsim.errors import InputError
from craftsim.experiments.bundle import Bundle, read_bundle
from craftsim.experiments.experiment import Answer, Failure, Result, Trial, TrialRecord
from craftsim.experiments.session import Session
from craftsim.models.randomization import NONE
from craftsim.storage.folders import directory_within
from craftsim.storage.limits import MINIMIZE_S
from craftsim.storage.writing import write_whole
from craftsim.validation.counterexample import (
    WorldPart,
    cropped,
    distance,
    grid_of,
    lowered,
    pieces_of,
    without,
    words_of,
)

FOLDER: Final = "smallest"
"""Of the files, within that of a campaign."""
BLUEPRINT: Final = "smallest.yaml"
ACTIONS: Final = "smallest.actions"
_TIMEOUT_S: Final = 3600.0
"""After which the search for a smallest world is given up."""

MOST_TRIALS: Final = 150
"""After so many trials the search ends with the smallest world so far; as after :data:`MINIMIZE_S` of simulated time."""

OnTrial = Callable[[bool], None]
"""Called after each trial: whether the action still failed."""

_NUMBER: Final = re.compile(r"\d+(\.\d+)?")
_MARGINS: Final = ((0, 0), (1, 0), (0, 1), (1, 1), (2, 2))
"""Empty columns round the smallest world, and levels above it."""
_MOVES: Final = {way: action for action, way in MOVE_DIRECTION.items()}


@dataclass(frozen=True)
class FailingAction:
    """An action of one car in a world, in which it is legal, and the physics that it is tried in."""

    grid: Grid
    car: int
    action: Action
    setup: Setup
    seed: Seed = SEED_0


@dataclass(frozen=True)
class Smallest:
    """The smallest world that was found; the car that acts is car 0."""

    grid: Grid
    action: Action
    attempt: Attempt
    """How it fails there."""
    setup: Setup
    minimal: bool
    """Whether every piece is needed; False where the trials did not suffice."""
    trials: int

    @property
    def words(self) -> str:
        """What fails, when, and how."""
        return words_of(self.grid, self.action, self.attempt.result, Rules(self.setup.rules))


class NotReproducibleError(Exception):
    """The action by itself, from a fresh start, does not fail: why, in words."""


def failing_actions(
    recipe: Recipe, attempts: Sequence[Attempt], most_s: float = math.inf
) -> list[FailingAction]:
    """Return the legal actions of a recipe's last step that fail, each in the world right before it.

    That world is what was read before the step, and after the actions of the step that come before it, by the rules.
    Of cars that act at the same time several may be held responsible for what one of them did.

    Raises InputError where no legal action fails, and where what comes before takes longer than ``most_s`` seconds of
    simulated time.
    """
    wrong = [a for a in attempts if a.legal and a.performed and not a.agrees]
    if not wrong:
        raise InputError("no action that the rules allow fails there; only such a failure can be shrunk")
    step, judge = recipe.steps[-1], start(recipe)
    limit_time(judge, most_s, "what comes before the last step")
    for earlier in recipe.steps[:-1]:
        do(judge, earlier)
    ticks = [[(act.car, Action[act.action]) for act in tick] for tick in step.ticks]
    schedule = make_schedule(judge.grid, ticks, judge.rules, step.order or "sequential")
    before = {(step.number + s.tick, s.car): s.before for s in schedule.steps}
    return [
        FailingAction(before[a.tick, a.car], a.car, Action[a.action], recipe.setup, recipe.seed)
        for a in wrong
    ]


def minimize(
    failing: FailingAction, on_trial: OnTrial = lambda fails: None, most: int = MOST_TRIALS
) -> Smallest:
    """Return the smallest world in which an action still fails with the same result, after so many trials at most.

    It is tried without noise and with the nominal physics; where it works with these, with the setup and the seed of
    the failure. Raises DependsError for an action that works from a fresh start.
    """
    nominal = replace(failing.setup, thresholds=Thresholds(), randomization=NONE)
    trials = 0
    for setup, seed in dict.fromkeys(((nominal, SEED_0), (failing.setup, failing.seed))):
        search = _Search(replace(failing, setup=setup, seed=seed), on_trial, most - trials)
        if search.attempt is not None:
            return search.run(trials)
        trials += search.trials
    if not trials:
        raise NotReproducibleError("the world before it cannot be set up from a fresh start as it was read")
    raise NotReproducibleError(
        "tried alone from a fresh start it does as predicted: "
        "the failure depends on what went before, or on what happens at the same time"
    )


class _Search:
    """The search for one action; it remembers what was tried."""

    def __init__(self, failing: FailingAction, on_trial: OnTrial, most: int) -> None:
        self.setup, self.seed, self.rules = failing.setup, failing.seed, Rules(failing.setup.rules)
        self.on_trial, self.most, self.trials = on_trial, most, 0
        self.left_s = MINIMIZE_S
        self.known: dict[str, bool] = {}
        self.attempt: Attempt | None = None
        self.pieces, self.size = pieces_of(failing.grid, failing.car), failing.grid.size
        self.action = failing.action
        # What play led to need not be what a drawing may show; then no smaller world need be.
        self.drawn = "snapshot:" not in blueprint_text(grid_of(self.pieces, self.size))
        self.fails(self.pieces, self.size, self.action)

    def run(self, trials_before: int) -> Smallest:
        """Take away what is not needed, bring what is left down, crop the map, and return it."""
        self._remove()
        while self._simplify():
            self._remove()
        quarters, action = -self.pieces[0].yaw, self.action
        if action in MOVE_DIRECTION:
            action = _MOVES[(MOVE_DIRECTION[action] + quarters) % 4]
        heading_x = tuple(piece.turned(quarters) for piece in self.pieces)
        crops = product(((heading_x, action), (self.pieces, self.action)), _MARGINS)
        for (pieces, act), margins in crops:
            if self.fails(*cropped(pieces, *margins), act):
                break
        assert self.attempt is not None
        grid, minimal = grid_of(self.pieces, self.size), self.trials < self.most
        return Smallest(grid, self.action, self.attempt, self.setup, minimal, self.trials + trials_before)

    def fails(self, pieces: Sequence[WorldPart], size: Cell, action: Action) -> bool:
        """Return whether the action of the first piece is legal in a world and fails; remember that world if so."""
        grid = grid_of(pieces, size)
        text = blueprint_text(grid)
        key = f"{action.name} {text}"
        if key not in self.known:
            if self.trials >= self.most:
                return False
            hopeless = self.drawn and "snapshot:" in text
            self.known[key] = not hopeless and self.rules.legal(grid, 0, action) and self._try(grid, action)
        if self.known[key]:
            self.pieces, self.size, self.action = tuple(pieces), size, action
        return self.known[key]

    def _try(self, grid: Grid, action: Action) -> bool:
        judge = set_up(grid, self.setup, self.seed)
        if judge.problems or not judge.grid.same_visible(grid):
            return False
        self.trials += 1
        passed_s = limit_time(judge, self.left_s, action.name)
        try:
            attempt = judge.perform(0, action)
        except OverrunError:
            self.trials = self.most
            return False
        self.left_s -= passed_s()
        fails = not attempt.agrees and (self.attempt is None or self.attempt.result == attempt.result)
        if fails:
            self.attempt = attempt
        self.on_trial(fails)
        return fails

    def _remove(self) -> None:
        """Take away parts of what stands around, smaller and smaller ones."""
        n = 2
        while others := self._others():
            n, before = min(n, len(others)), len(self.pieces)
            for i in range(n):
                part = others[i * len(others) // n : (i + 1) * len(others) // n]
                keep = without(self.pieces, part)
                if len(keep) < len(self.pieces):
                    self.fails(keep, self.size, self.action)
            if len(self.pieces) < before:
                n = max(n - 1, 2)
            elif n == len(others):
                return
            else:
                n *= 2

    def _others(self) -> list[WorldPart]:
        """Return all but the car that acts and what it stands on, the furthest first."""
        me, *others = self.pieces
        free = (piece for piece in others if me in without(self.pieces, (piece,)))
        return sorted(free, key=lambda piece: (-distance(piece, me.cell), piece.cell, piece.kind))

    def _simplify(self) -> bool:
        """Take a load off, or bring all down by a level; return whether one of these leaves the failure."""
        for place, piece in enumerate(self.pieces):
            bare = replace(piece, load=Kind.AIR, load_yaw=0)
            pieces = (*self.pieces[:place], bare, *self.pieces[place + 1 :])
            if piece.load != Kind.AIR and self.fails(pieces, self.size, self.action):
                return True
        lower = lowered(self.pieces)
        return bool(lower) and self.fails(lower, self.size, self.action)


@dataclass(frozen=True)
class Counterexample:
    """A failure in its smallest world."""

    key: str
    """Name of the trial."""
    sentence: str
    """When it fails, or why it could not be shrunk."""
    rules: str
    """The rule set that allows the action."""
    minimal: bool
    """Whether nothing can be taken away any more without the failure going away, too."""
    trials: int
    cells: tuple[int, int, int] | None
    """Size of the smallest world; None where there is none."""
    folder: str | None
    """With its blueprint and its actions, relative to the campaign's."""


MinimizeProgress = Callable[[int], AbstractContextManager[Callable[[Counterexample], None]]]
"""Given the number of kinds, opens what is called with each one's result."""


def minimize_bundle(
    bundle: Bundle, out: Path, name: str, on_trial: OnTrial = lambda fails: None
) -> Counterexample:
    """Shrink the failure of a replay bundle, and write its smallest world into the folder ``name`` of ``out``.

    Raises InputError where no legal action fails, and for a folder that cannot be written.
    """
    rules, why = bundle.recipe.setup.rules, ""
    for failing in failing_actions(bundle.recipe, bundle.attempts, bundle.most_s):
        try:
            found = minimize(failing, on_trial)
        except NotReproducibleError as error:
            why = why or f"car {failing.car} {failing.action.name}: {error}"
            continue
        folder = directory_within(out, name)
        write_blueprint(found.grid, folder / BLUEPRINT)
        write_whole(folder / ACTIONS, f"0 {found.action.name}\n")
        return Counterexample(
            bundle.key, found.words, rules, found.minimal, found.trials, found.grid.size, name
        )
    return Counterexample(bundle.key, why, rules, minimal=False, trials=0, cells=None, folder=None)


def minimize_failures(
    session: Session, records: Iterable[TrialRecord], progress: MinimizeProgress
) -> tuple[Counterexample, ...]:
    """Shrink the first failure of each kind that has a replay bundle, and write its world into :data:`FOLDER`."""
    bundles = list(first_of_each_kind(records).values())
    if not bundles or session.out is None:
        return ()
    out = session.out.resolve()
    items = [
        Trial(bundle, FOLDER, 0, (out, bundle, f"{FOLDER}/{number:02d}"))
        for number, bundle in enumerate(bundles)
    ]
    with progress(len(items)) as on_each:
        answers = session.map(
            *(FOLDER, items, _minimize, "looking for the smallest worlds"),
            timeout_s=_TIMEOUT_S,
            on_answer=lambda number, answer: on_each(_shrunk(bundles[number], answer)),
        )
    return tuple(_shrunk(bundle, answer) for bundle, answer in zip(bundles, answers, strict=True))


def kind_of(reason: str) -> str:
    """Return a reason with its numbers masked: reasons that differ only in these are of one kind."""
    return _NUMBER.sub("#", reason)


def first_of_each_kind(records: Iterable[TrialRecord]) -> dict[str, str]:
    """Return the bundle of the first failure of each kind of a legal action, by the kind."""
    found: dict[str, str] = {}
    for record in records:
        wrong = next((a for a in record["attempts"] if a["legal"] and a["performed"] and a["reason"]), None)
        if wrong is not None and record["bundle"]:
            found.setdefault(f"{wrong['verb']}: {kind_of(wrong['reason'])}", record["bundle"])
    return found


def _minimize(job: tuple[Path, str, str]) -> Result:
    out, bundle, name = job
    return Result(
        agrees=True,
        extra=asdict(minimize_bundle(read_bundle(out / bundle, of_own_run=True).bundle, out, name)),
    )


def _shrunk(bundle: str, answer: Answer) -> Counterexample:
    if isinstance(answer, Failure):
        return Counterexample(bundle, answer.text, "", minimal=False, trials=0, cells=None, folder=None)
    cells = answer.extra["cells"]
    return Counterexample(**{**answer.extra, "cells": None if cells is None else tuple(cells)})
