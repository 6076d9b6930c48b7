"""Minimization: the smallest world in which an action still fails.

The search is delta debugging (Zeller and Hildebrandt, Simplifying and Isolating Failure-Inducing Input, IEEE TSE
2002). The result is 1-minimal: without any single piece (and those on it) the action is as predicted, or forbidden.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass, replace
from itertools import product
from pathlib import Path
from typing import Final

from craftsim.checking.attempt import Attempt
from craftsim.checking.recipe import OverrunError, Recipe, Step, limit_time, perform_step, start
from craftsim.checking.setup import SEED_0, Seed, Setup, set_up
from craftsim.discrete.files.blueprint import blueprint_text, write_blueprint
from craftsim.discrete.grid import Cell, Grid, Kind
from craftsim.discrete.kinds import MOVE_DIRECTION, Action
from craftsim.discrete.rules import Rules
from craftsim.discrete.schedule import make_schedule
from craftsim.errors import InputError
from craftsim.experiments import counterexample as parts
from craftsim.experiments.bundle import Bundle, read_bundle, write_bundle
from craftsim.experiments.experiment import Answer, Failure, Result, TrialRecord
from craftsim.experiments.records import DATABASE
from craftsim.experiments.session import Session
from craftsim.mjcf.machines import NOMINAL
from craftsim.models.randomization import NONE
from craftsim.storage.folders import directory_within
from craftsim.storage.limits import MINIMIZE_S
from craftsim.storage.records import from_json, record
from craftsim.storage.writing import write_whole

_FOLDER: Final = "smallest"
BLUEPRINT: Final = "smallest.yaml"
ACTIONS_FILE: Final = "smallest.actions"
_BUNDLE: Final = "bundle"
_TIMEOUT_S: Final = 3600.0

MOST_TRIALS: Final = 150
"""Trials after which the search ends with the smallest world so far; also after :data:`MINIMIZE_S`."""

OnTrial = Callable[[bool], None]
"""Called after each trial with whether the action still fails."""

_NUMBER: Final = re.compile(r"\d+(\.\d+)?")
_MARGINS: Final = ((0, 0), (1, 0), (0, 1), (1, 1), (2, 2))
"""(columns, levels) of empty margin around the smallest world."""
_MOVES: Final = {direction: action for action, direction in MOVE_DIRECTION.items()}


@dataclass(frozen=True)
class FailingAction:
    """A legal action of one car in a world, with the configuration of the physics."""

    grid: Grid
    car: int
    action: Action
    setup: Setup
    seed: Seed = SEED_0


class NotReproducibleError(Exception):
    """The action alone, from a fresh start, does not fail; the message says why."""


def failing_actions(
    recipe: Recipe, attempts: Sequence[Attempt], most_s: float = math.inf
) -> list[FailingAction]:
    """Return the legal actions of a recipe's last step that fail, each in the world right before it.

    That world is the one read before the step, with the predicted effects of the step's earlier actions. Several
    concurrent actions may fail because of one of them.

    Raises InputError if no legal action fails, or if the earlier steps take more than ``most_s`` simulated seconds.
    """
    wrong = [a for a in attempts if a.legal and a.performed and not a.agrees]
    if not wrong:
        raise InputError(
            "no action that the rules allow fails there; only such a failure can be minimized"
        )
    step = recipe.steps[-1]
    judge = start(recipe)
    limit_time(judge, most_s, "what comes before the last step")
    for earlier in recipe.steps[:-1]:
        perform_step(judge, earlier)
    ticks = []
    for tick in step.ticks:
        ticks.append([(act.car, Action[act.action]) for act in tick])
    schedule = make_schedule(judge.grid, ticks, judge.rules, step.order or "sequential")
    before = {}
    for scheduled in schedule.steps:
        before[step.number + scheduled.tick, scheduled.car] = scheduled.before
    failing = []
    for attempt in wrong:
        grid = before[attempt.tick, attempt.car]
        action = Action[attempt.action]
        failing.append(FailingAction(grid, attempt.car, action, recipe.setup, recipe.seed))
    return failing


def minimize(
    failing: FailingAction, on_trial: OnTrial = lambda fails: None, max_trials: int = MOST_TRIALS
) -> Smallest:
    """Return the smallest world in which an action still fails with the same result.

    The search ends after ``max_trials`` trials.
    Trials use nominal physics without noise; if the action works there, the setup and seed of the failure. Raises
    NotReproducibleError for an action that works from a fresh start.
    """
    nominal = replace(failing.setup, randomization=NONE)
    trials = 0
    for setup, seed in dict.fromkeys(((nominal, SEED_0), (failing.setup, failing.seed))):
        search = Smallest(replace(failing, setup=setup, seed=seed), on_trial, max_trials, trials)
        if search.fails:
            search.run()
            return search
        trials = search.trials
    if not trials:
        raise NotReproducibleError("the world before it cannot be set up from a fresh start")
    raise NotReproducibleError(
        "tried alone from a fresh start it is as predicted: the failure depends on earlier or concurrent actions"
    )


class Smallest:
    """The smallest world in which an action still fails, and the search for it; the acting car is car 0."""

    attempt: Attempt

    def __init__(
        self, failing: FailingAction, on_trial: OnTrial, max_trials: int, trials: int = 0
    ) -> None:
        """Try the action alone, as one of at most ``max_trials`` trials after ``trials``."""
        self.setup = failing.setup
        self.action = failing.action
        self.trials = trials
        self.fails = False
        self._remaining_s = MINIMIZE_S
        self._outcomes = dict[str, bool]()
        self.seed = failing.seed
        self._rules = Rules(failing.setup.rules)
        self._on_trial = on_trial
        self._max_trials = max_trials
        self._pieces = parts.pieces_of(failing.grid, failing.car)
        self._size = failing.grid.size
        # What play led to need not be what a drawing may show; then no smaller world need be.
        self._has_drawing = "snapshot:" not in blueprint_text(self.grid)
        self._fails(self._pieces, self._size, self.action)

    @property
    def grid(self) -> Grid:
        """The world."""
        return parts.world_of(self._pieces, self._size)

    @property
    def minimal(self) -> bool:
        """Whether every piece is needed; False if the trials did not suffice."""
        return self.trials < self._max_trials

    @property
    def words(self) -> str:
        """The failure in one sentence."""
        return parts.words_of(self.grid, self.action, self.attempt.result, self._rules)

    def run(self) -> None:
        """Remove pieces, lower the rest, and crop the map."""
        self._remove()
        while self._simplify():
            self._remove()
        quarters = -self._pieces[0].yaw
        action = self.action
        if action in MOVE_DIRECTION:
            action = _MOVES[(MOVE_DIRECTION[action] + quarters) % 4]
        heading_x = tuple(piece.turned(quarters) for piece in self._pieces)
        crops = product(((heading_x, action), (self._pieces, self.action)), _MARGINS)
        for (pieces, act), margins in crops:
            if self._fails(*parts.cropped(pieces, *margins), act):
                break

    def _fails(self, pieces: Sequence[parts.WorldPart], size: Cell, action: Action) -> bool:
        """Return whether the action of the first piece is legal in a world and fails; if so keep that world."""
        grid = parts.world_of(pieces, size)
        text = blueprint_text(grid)
        key = f"{action.name} {text}"
        if key not in self._outcomes:
            if self.trials >= self._max_trials:
                return False
            hopeless = self._has_drawing and "snapshot:" in text
            self._outcomes[key] = (
                not hopeless
                and self._rules.legal(grid, 0, action)
                and self._try_in_physics(grid, action)
            )
        if self._outcomes[key]:
            self._pieces = tuple(pieces)
            self._size = size
            self.action = action
        return self._outcomes[key]

    def _try_in_physics(self, grid: Grid, action: Action) -> bool:
        judge = set_up(grid, self.setup, self.seed)
        if judge.problems or not judge.grid.same_visible(grid):
            return False
        self.trials += 1
        passed_s = limit_time(judge, self._remaining_s, action.name)
        try:
            attempt = judge.perform(0, action)
        except OverrunError:
            self.trials = self._max_trials
            return False
        self._remaining_s -= passed_s()
        fails = not attempt.agrees and (not self.fails or self.attempt.result == attempt.result)
        if fails:
            self.attempt = attempt
            self.fails = True
        self._on_trial(fails)
        return fails

    def _remove(self) -> None:
        """Remove surrounding pieces, in smaller and smaller groups."""
        n = 2
        while removable := self._removable_pieces():
            n = min(n, len(removable))
            before = len(self._pieces)
            for i in range(n):
                group = removable[i * len(removable) // n : (i + 1) * len(removable) // n]
                keep = parts.without_parts(self._pieces, group)
                if len(keep) < len(self._pieces):
                    self._fails(keep, self._size, self.action)
            if len(self._pieces) == before and n == len(removable):
                return
            if len(self._pieces) == before:
                n = 2 * n
            else:
                n = max(n - 1, 2)

    def _removable_pieces(self) -> list[parts.WorldPart]:
        """Return all pieces but the acting car and those below it, furthest along the axes first."""
        me, *other_pieces = self._pieces
        free = (
            piece for piece in other_pieces if me in parts.without_parts(self._pieces, (piece,))
        )

        def distance(piece: parts.WorldPart) -> int:
            return sum(abs(a - b) for a, b in zip(piece.cell, me.cell, strict=True))

        return sorted(free, key=lambda piece: (-distance(piece), piece.cell, piece.kind))

    def _simplify(self) -> bool:
        """Remove a load, or lower everything by a level; return whether the failure remains."""
        for place, piece in enumerate(self._pieces):
            bare = piece._replace(load=Kind.AIR, load_yaw=0)
            pieces = (*self._pieces[:place], bare, *self._pieces[place + 1 :])
            if piece.load != Kind.AIR and self._fails(pieces, self._size, self.action):
                return True
        lower = parts.lowered(self._pieces)
        return bool(lower) and self._fails(lower, self._size, self.action)


@record()
class Counterexample:
    """A minimized failure."""

    key: str
    sentence: str
    """The failure in one sentence, or why it could not be minimized."""
    rules: str
    minimal: bool = False
    trials: int = 0
    cells: tuple[int, int, int] | None = None
    folder: str | None = None
    """Folder with its blueprint and actions, relative to the run's."""
    nominal: bool = False
    """Whether it fails in nominal physics without noise."""
    drive: str = "rollers"
    bundle: str | None = None
    """Replay bundle of it, relative to the run's folder, where options of 'craftsim validate' do not say all: for other
    gains or machines, learned rules, user-defined skills, and draws."""


MinimizeProgress = Callable[[int], AbstractContextManager[Callable[[Counterexample], None]]]
"""Given the number of kinds of failure, returns a context whose value is called with each result."""


def minimize_bundle(
    bundle: Bundle, out: Path, name: str, on_trial: OnTrial = lambda fails: None
) -> Counterexample:
    """Minimize the failure of a replay bundle, and write its smallest world into the folder ``name`` of ``out``.

    Raises InputError if no legal action fails, and for a folder that cannot be written.
    """
    rules = bundle.recipe.setup.rules
    reason = ""
    for failing in failing_actions(bundle.recipe, bundle.attempts, bundle.most_s):
        try:
            smallest = minimize(failing, on_trial)
        except NotReproducibleError as error:
            reason = reason or f"car {failing.car} {failing.action.name}: {error}"
            continue
        folder = directory_within(out, name)
        write_blueprint(smallest.grid, folder / BLUEPRINT)
        write_whole(folder / ACTIONS_FILE, f"0 {smallest.action.name}\n")
        replayed = None
        if not _is_plain(smallest.setup):
            replayed = f"{name}/{_BUNDLE}"
            steps = (Step.single(0, 0, smallest.action),)
            recipe = Recipe(blueprint_text(smallest.grid), steps, smallest.setup, smallest.seed)
            write_bundle(directory_within(folder, _BUNDLE), bundle.key, recipe)
        return Counterexample(
            bundle.key,
            smallest.words,
            str(rules),
            smallest.minimal,
            smallest.trials,
            smallest.grid.size,
            name,
            smallest.setup.randomization == NONE,
            smallest.setup.machines.drive,
            replayed,
        )
    return Counterexample(bundle.key, reason, str(rules))


def _is_plain(setup: Setup) -> bool:
    """Return whether the name of a rule set, drive and ``--randomize none`` say all of the physics."""
    plain = Setup(rules=setup.rules, machines=replace(NOMINAL, drive=setup.machines.drive))
    return isinstance(setup.rules, str) and setup == plain


def minimize_failures(
    session: Session, records: Iterable[TrialRecord], progress: MinimizeProgress
) -> tuple[Counterexample, ...]:
    """Minimize the first failure of each kind that has a replay bundle, and write its world into :data:`_FOLDER`."""
    bundles = first_of_each_kind(records).values()
    if not bundles or session.out is None:
        return ()
    out = session.out.resolve()
    jobs = {
        bundle: (out, bundle, f"{_FOLDER}/{number:02d}") for number, bundle in enumerate(bundles)
    }
    with progress(len(jobs)) as on_each:
        answers = session.map(
            _FOLDER,
            jobs,
            _minimize,
            "looking for the smallest worlds",
            timeout_s=_TIMEOUT_S,
            on_answer=lambda bundle, answer: on_each(_minimized(out, bundle, answer)),
        )
    return tuple(_minimized(out, bundle, answer) for bundle, answer in answers.items())


def kind_of(reason: str) -> str:
    """Return the kind of a reason: the text with its numbers masked."""
    return _NUMBER.sub("#", reason)


def first_of_each_kind(records: Iterable[TrialRecord]) -> dict[str, str]:
    """Return the bundle of the first failure of each kind among legal actions, by kind."""
    bundles: dict[str, str] = {}
    for trial in records:
        wrong = next(
            (a for a in trial["attempts"] if a["legal"] and a["performed"] and a["reason"]), None
        )
        if wrong is not None and trial["bundle"]:
            bundles.setdefault(f"{wrong['verb']}: {kind_of(wrong['reason'])}", trial["bundle"])
    return bundles


def _minimize(job: tuple[Path, str, str]) -> Result:
    out, bundle, name = job
    return Result(
        agrees=True,
        extra=asdict(minimize_bundle(read_bundle(out / bundle, of_own_run=True).bundle, out, name)),
    )


def _minimized(out: Path, bundle: str, answer: Answer) -> Counterexample:
    """Return what became of a bundle. Raises InputError for an answer of an earlier run that is none."""
    if isinstance(answer, Failure):
        return Counterexample(bundle, answer.text, "")
    try:
        return from_json(Counterexample, json.dumps(answer.extra).encode(), f"'{bundle}'")
    except InputError as error:
        raise InputError(f"{out / DATABASE}: {error}; choose another --out") from None
