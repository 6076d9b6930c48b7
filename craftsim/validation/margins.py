"""Robustness margins: the largest value of each imperfection at which an action still works.

Trial i uses the same random draws at every level (common random numbers): it passes low levels and fails from its own
*critical level* on. Critical levels of independent trials are independent, so their order statistics give
distribution-free tolerance bounds (S. S. Wilks, "Determination of sample sizes for setting tolerance limits", 1941):

- at least 95 % of all worlds pass the smallest of n critical levels, with confidence 1 - 0.95**n: 95 % for n = 59;
- above the third smallest of 16 more than 5 % of all worlds fail, with 95 % confidence.

The search assumes that a trial which fails at a level fails at all higher ones; the result does not: at the margin
itself every trial is run.

In a scenario the car first drives to its place, so that its pose error there is that of its own localisation. Mirror
images are left out, since the machines are symmetric; diagonal moves are never legal.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from enum import StrEnum
from fnmatch import fnmatchcase
from functools import lru_cache, partial
from pathlib import Path
from typing import Annotated, Any, Final, NamedTuple

import numpy as np
from pydantic import Field

from craftsim.audit.situation import SCENES, Row, Situation, shipped
from craftsim.audit.survey import row_of, situation_of
from craftsim.checking.attempt import Attempt
from craftsim.checking.episode import Recipe, do, start
from craftsim.checking.setup import Seed, Setup, compile_world, imperfect
from craftsim.discrete.files.blueprint import blueprint_text
from craftsim.discrete.rules import RuleSet
from craftsim.errors import InputError, StartError
from craftsim.experiments.bundle import write_bundles
from craftsim.experiments.experiment import (
    STRICT,
    Experiment,
    Form,
    Result,
    RunOptions,
    Trial,
    TrialRecord,
)
from craftsim.experiments.records import read_finished
from craftsim.experiments.session import Session, open_session
from craftsim.models.floor import Floor
from craftsim.models.randomization import Making
from craftsim.models.world import PhysicsWorld
from craftsim.storage.paths import resolved
from craftsim.validation.forms import Judged
from craftsim.validation.imperfections import Imperfection

COMMAND: Final = "margins"
TIMEOUT_S: Final = 600.0
"""Limit of a search, which takes seconds, and of writing a bundle."""
SHARE: Final = 0.95
"""Share of all worlds that pass a margin."""
TRIALS: Final = 59
"""Trials that must all pass a level for 95 % confidence that 95 % of all worlds pass it."""
RANKS: Final = ((16, 3), (7, 2), (1, 1))
"""(trials, rank): the upper bound is the critical level of this rank among the first trials; first pair that fits."""
BASE: Final = 0
"""Index of the level at which the imperfection has its nominal value, that of ``--randomize``."""
PROBES: Final = 3
"""Trials that must be bit-equal at the largest and the nominal level for the verdict "no effect"."""
MAP_TRIALS: Final = 20
"""Largest number of trials of each pair of levels of a map."""
STRIDE: Final = 4
"""A map has every fourth level: the preferred numbers R5, a factor of 1.6 apart."""

_Count = Annotated[int, Field(ge=0, lt=2**53)]
Levels = Sequence[tuple[Imperfection, float]]
"""Imperfections and their values."""
Pair = tuple[Imperfection, Imperfection]
"""The imperfections on a map's horizontal and vertical axis."""


class Scenario(NamedTuple):
    """A situation with a readable name; its last action is judged."""

    action: str
    """Row of the data sheet, such as ``lift``."""
    where: str
    """Such as ``a block between blocks``."""
    row: Row

    @property
    def name(self) -> str:
        """Action and place."""
        return f"{self.action} {self.where}"

    def situation(self, rules: RuleSet) -> Situation:
        """Return the situation. Raises CraftsimError if there is none, or if the rules forbid its first actions."""
        if self.row.scene:
            return next(scene for scene in SCENES if scene.row == self.row)
        return situation_of(self.row, rules)


CHOSEN: Final = tuple(
    Scenario(action, where, row_of(said))
    for action, places in shipped("margins.yaml").items()
    for where, said in places.items()
)
"""The scenarios of ``craftsim/data/margins.yaml``."""


def scenarios(pattern: str = "*", quick: bool = False) -> tuple[Scenario, ...]:
    """Return the scenarios whose names match a glob pattern; quick: the first one of each action.

    Raises InputError if none matches.
    """
    first = {one.action: one for one in reversed(CHOSEN)}
    found = tuple(
        one for one in CHOSEN if fnmatchcase(one.name, pattern) and (not quick or one is first[one.action])
    )
    if not found:
        names = ", ".join(one.name for one in CHOSEN)
        raise InputError(f"no scenario matches '{pattern}'; there are {names}")
    return found


class Found(NamedTuple):
    """The result of a search, in indices of levels."""

    margin: int | None
    """The largest level that all trials pass; None if a trial fails at the nominal level."""
    upper: int | None
    """The level above which more than 5 % of all worlds fail; None if too few trials fail at the largest level."""
    edge: tuple[int, int] | None
    """A trial that fails at the level above the margin, and that level; None if all pass the largest level."""


def confidence(trials: int) -> float:
    """Return the confidence that 95 % of all worlds pass a level that all of so many trials pass."""
    return 1.0 - SHARE**trials


class _BaseFailsError(Exception):
    """A trial fails at the nominal level: its number."""


def search(passes: Callable[[int, int], bool], levels: int, trials: int) -> Found:
    """Return the margin among the levels 0 (nominal) to ``levels``.

    ``passes(trial, level)`` is called at most once for each pair.
    """
    known: dict[tuple[int, int], bool] = {}

    def passed(trial: int, level: int) -> bool:
        if (trial, level) not in known:
            known[trial, level] = passes(trial, level)
        return known[trial, level]

    def critical(trial: int, most: int) -> int:
        """Return the largest level up to ``most`` that a trial passes."""
        if passed(trial, most):
            return most
        fails, step = most, 1
        while not passed(trial, level := max(fails - step, BASE)):
            if level == BASE:
                raise _BaseFailsError(trial)
            fails, step = level, 2 * step
        while fails - level > 1:
            middle = (level + fails) // 2
            level, fails = (middle, fails) if passed(trial, middle) else (level, middle)
        return level

    first, rank = next(pair for pair in RANKS if pair[0] <= trials)
    ends: list[int] = []
    try:
        for trial in range(first):
            ends.append(critical(trial, sorted(ends)[rank - 1] if len(ends) >= rank else levels))
        lowest = min(ends)
        for trial in range(first, trials):
            lowest = critical(trial, lowest)
        while (failed := next((n for n in range(trials) if not passed(n, lowest)), None)) is not None:
            lowest = critical(failed, lowest)
    except _BaseFailsError as error:
        return Found(None, None, (error.args[0], BASE))
    upper = sorted(ends)[rank - 1] + 1
    failing = [trial for (trial, level), held in known.items() if level == lowest + 1 and not held]
    return Found(lowest, upper if upper <= levels else None, (min(failing), lowest + 1) if failing else None)


class End(StrEnum):
    """How a search ended."""

    EDGE = "edge"
    """A trial fails at the level above the margin."""
    LARGEST = "largest"
    """All trials pass the largest level."""
    NO_EFFECT = "no effect"
    """The largest level gives the results of the nominal level, bit for bit."""
    BASE = "base"
    """A trial fails at the nominal level."""


@dataclass(frozen=True)
class MarginResult:
    """A margin with its interval; values in the parameter's own unit."""

    __pydantic_config__ = STRICT
    end: End
    margin: float | None
    """The largest value that all trials passed; None if one failed at the nominal level."""
    upper: float | None
    """The value above which more than 5 % fail; None if too few trials failed to tell."""
    fails_at: float | None
    """The next value above the margin, at which a trial failed; None if none failed."""
    trial: int | None
    """The trial that failed there, or at the nominal level."""
    reason: str
    """Its reason."""
    tried: _Count
    """Number of trials run."""


@dataclass(frozen=True)
class RowFound:
    """One row of a map."""

    __pydantic_config__ = STRICT
    stood: tuple[_Count, ...]
    """Number of trials that pass, by horizontal level."""
    of: _Count
    """Number of trials of each."""


MARGINS: Final = Form(Judged, MarginResult | RowFound)
"""Schema of the records of a search for margins."""


def margin_of_record(record: TrialRecord) -> MarginResult:
    """Return the result in the record of a search."""
    return MarginResult(**{**record["extra"], "end": End(record["extra"]["end"])})


@dataclass(frozen=True, slots=True)
class ScenarioSetup:
    """A scenario with its nominal setup; hashable."""

    scenario: Scenario
    setup: Setup
    """The nominal setup."""
    seed: int

    def recipe(self, number: int, levels: Levels = ()) -> Recipe:
        """Return the recipe of a trial; a trial has the same random draws at all levels."""
        drawn = self.setup.randomization
        for axis, value in levels:
            drawn = axis.on(drawn, value)
        situation = _situation(self.scenario, self.setup.rules)
        placed = situation.placed(np.random.default_rng(self.seed))
        seed = Seed((self.seed, situation.digest, number))
        return Recipe(blueprint_text(placed.grid), placed.steps(), imperfect(self.setup, drawn), seed)

    def attempt(self, number: int, levels: Levels = ()) -> tuple[tuple[Attempt, ...], str]:
        """Run a trial; return its attempts at the last step, and the reason if it failed.

        There are no attempts in a world in which solids overlap at the start.
        """
        recipe = self.recipe(number, levels)
        drawn = recipe.setup.randomization
        try:
            judge = start(recipe, _physics(self, drawn.floor, drawn.making))
        except StartError as error:
            return (), str(error)
        for step in recipe.steps:
            attempts = do(judge, step)
        failed = next((attempt for attempt in attempts if not attempt.agrees), None)
        return attempts, "" if failed is None else f"{failed.result}: {failed.reason}"


@lru_cache(maxsize=2)
def _physics(rig: ScenarioSetup, floor: Floor, making: Making) -> PhysicsWorld:
    """Return the compiled world, shared by all trials on the same kind of floor."""
    recipe = rig.recipe(0)
    drawn = replace(recipe.setup.randomization, floor=floor, making=making)
    return compile_world(recipe.grid, imperfect(recipe.setup, drawn))


@lru_cache(maxsize=2)
def _situation(scenario: Scenario, rules: RuleSet) -> Situation:
    return scenario.situation(rules)


@dataclass(frozen=True, slots=True)
class MarginSearch:
    """The search of the margin of one imperfection, or a row of the map of two; sent to a worker."""

    rig: ScenarioSetup
    axes: tuple[Imperfection, ...]
    trials: int
    up: int = 0
    """Index of the row's level."""

    @property
    def item(self) -> Trial:
        """This search as a trial of the experiment."""
        scenario, names = self.rig.scenario, " x ".join(axis.name for axis in self.axes)
        row = f"/{self.up}" if len(self.axes) > 1 else ""
        key = f"{scenario.name}/{names}{row}"
        return Trial(key, scenario.action, self.rig.seed, self, context=scenario.name)


def work(job: MarginSearch) -> Result:
    """Run one trial of the experiment."""
    return find_row(job) if len(job.axes) > 1 else find(job)


def find(one: MarginSearch) -> Result:
    """Search a margin."""
    rig, (axis,) = one.rig, one.axes
    base = axis.value(rig.setup.randomization)
    values = [base, *(value for value in axis.levels if value > base)]
    results: dict[tuple[int, int], tuple[tuple[Attempt, ...], str]] = {}

    def result(trial: int, level: int) -> tuple[tuple[Attempt, ...], str]:
        if (trial, level) not in results:
            results[trial, level] = rig.attempt(trial, [(axis, values[level])] if level != BASE else [])
        return results[trial, level]

    def done(
        end: End, margin: int | None, upper: int | None = None, edge: tuple[int, int] | None = None
    ) -> Result:
        attempts, reason = result(*edge) if edge else ((), "")
        fails_at = values[edge[1]] if edge and edge[1] != BASE else None
        limit = MarginResult(
            end,
            None if margin is None else values[margin],
            None if upper is None else values[upper],
            *(fails_at, edge[0] if edge else None, reason, len(results)),
        )
        return Result(end is not End.BASE, attempts, extra=asdict(limit) | {"end": end.value})

    largest, probes = len(values) - 1, range(min(PROBES, one.trials))
    if all(result(n, BASE) == result(n, largest) and not result(n, BASE)[1] for n in probes):
        return done(End.NO_EFFECT, largest)
    found = search(lambda trial, level: not result(trial, level)[1], largest, one.trials)
    end = End.LARGEST if found.edge is None else End.BASE if found.margin is None else End.EDGE
    return done(end, *found)


def values_of(axis: Imperfection) -> tuple[float, ...]:
    """Return the values of an imperfection on a map; 0 means the nominal value."""
    return (0.0, *axis.levels[::-1][::STRIDE][::-1])


def find_row(row: MarginSearch) -> Result:
    """Try all pairs of levels of one row of a map."""
    rig, (right, up) = row.rig, row.axes
    base, value, stood = rig.setup.randomization, values_of(up)[row.up], []
    for other in values_of(right):
        levels = [(axis, v) for axis, v in ((right, other), (up, value)) if v > axis.value(base)]
        stood.append(sum(not rig.attempt(n, levels)[1] for n in range(row.trials)))
    return Result(agrees=True, extra=asdict(RowFound(tuple(stood), row.trials)))


class Map(NamedTuple):
    """The number of trials of a scenario that pass each pair of levels."""

    scenario: str
    pair: Pair
    stood: tuple[tuple[int, ...], ...]
    """By vertical, then by horizontal level."""
    of: int
    """Number of trials of each."""


@dataclass(frozen=True)
class Margin:
    """The margin of a scenario for one imperfection."""

    action: str
    scenario: str
    axis: Imperfection
    limit: MarginResult
    before: MarginResult | None = None
    """That of the run given as baseline."""
    bundle: str = ""
    """Replay bundle of the trial that fails above it, relative to the run's folder; empty without one."""

    @property
    def key(self) -> str:
        """Key of its record."""
        return f"{self.scenario}/{self.axis.name}"

    @property
    def number(self) -> str:
        """The margin for a table, in the imperfection's unit."""
        if self.limit.margin is None or self.limit.end is End.NO_EFFECT:
            return "fails" if self.limit.margin is None else "-"
        return f"{'>= ' * (self.limit.end is End.LARGEST)}{self.axis.scale * self.limit.margin:.3g}"

    @property
    def text(self) -> str:
        """The margin with its unit, such as ``1.6 mm``."""
        words = {"fails": "fails at nominal", "-": "no effect"}
        return words.get(self.number, f"{self.number} {self.axis.unit}")

    @property
    def rank(self) -> tuple[int, float]:
        """Sort key: the weakest scenario first."""
        order = (End.BASE, End.EDGE, End.LARGEST, End.NO_EFFECT)
        return order.index(self.limit.end), self.limit.margin or 0.0


@dataclass(frozen=True)
class Margins:
    """The result of a search."""

    records: Sequence[TrialRecord]
    margins: tuple[Margin, ...]
    """One for each finished search."""
    maps: tuple[Map, ...]
    """One for each scenario, if a pair of imperfections was given."""
    config: dict[str, Any]
    seed: int

    @property
    def weakest(self) -> dict[str, dict[str, Margin]]:
        """The weakest scenario by action and by name of the imperfection."""
        found: dict[str, dict[str, Margin]] = {one.action: {} for one in self.margins}
        for one in sorted(self.margins, key=lambda one: one.rank):
            found[one.action].setdefault(one.axis.name, one)
        return found

    @property
    def with_effect(self) -> list[Imperfection]:
        """The imperfections that have an effect on any action."""
        tells = {one.axis for one in self.margins if one.limit.end is not End.NO_EFFECT}
        ranked = sorted(self.margins, key=lambda one: -one.rank[0])
        return [axis for axis in dict.fromkeys(one.axis for one in ranked) if axis in tells]

    @property
    def passed(self) -> bool:
        """Whether every search finished, and every scenario passes the nominal level."""
        ended = all(record["error"] is None for record in self.records)
        return ended and all(one.limit.end is not End.BASE for one in self.margins)


def run_margins(
    scenarios: Sequence[Scenario],
    axes: Sequence[Imperfection],
    setup: Setup,
    trials: int,
    seed: int,
    out: Path,
    *,
    asked: Mapping[str, Any],
    options: RunOptions,
    pair: Pair | None = None,
) -> Margins:
    """Search the margin of each scenario for each imperfection; write report.json and replay bundles into a folder.

    Args:
        scenarios: the scenarios.
        axes: the imperfections, varied one at a time.
        setup: the nominal setup.
        trials: number of trials of each scenario, all of which must pass a margin.
        seed: random seed.
        out: the folder.
        asked: the given options, for the report.
        options: how the experiment is run.
        pair: two imperfections of which a map is drawn for each scenario, too.
    """
    earlier = _earlier(options.against, out)
    config = {**asked, "trials": trials, "rules": setup.rules, "setup": setup, "digests": setup.digests}
    rigs = [ScenarioSetup(scenario, setup, seed) for scenario in scenarios]
    searches = [MarginSearch(rig, (axis,), trials) for rig in rigs for axis in axes]
    ups = range(len(values_of(pair[1]))) if pair else range(0)
    rows = [MarginSearch(rig, pair or (), min(trials, MAP_TRIALS), up) for rig in rigs for up in ups]
    items = [job.item for job in (*searches, *rows)]
    experiment = Experiment(COMMAND, seed, config, items, work, MARGINS, TIMEOUT_S)
    with open_session(experiment, out, options) as session:
        records = session.run()
        ended = [(one, r) for one, r in zip(searches, records, strict=False) if r["error"] is None]
        margins = [
            Margin(r["group"], r["context"] or "", one.axes[0], margin_of_record(r), earlier.get(r["key"]))
            for one, r in ended
        ]
        found = [records[len(searches) + number] for number in range(len(rows))]
        maps = [_map(pair, found[at : at + len(ups)]) for at in range(0, len(rows), len(ups) or 1) if pair]
        whole = tuple(one for one in maps if one is not None)
        result = Margins(records, tuple(margins), whole, config, seed)
        folders = _bundles(session, result, ended)
        bundled = tuple(replace(one, bundle=folders.get(one.key, "")) for one in margins)
        result = replace(result, margins=bundled)
        session.write_report({"margins": _figures(result, trials)})
    return result


def _map(pair: Pair, rows: Sequence[TrialRecord]) -> Map | None:
    """Return the map with these rows; None if one of them has an error."""
    if any(row["error"] is not None for row in rows):
        return None
    stood = tuple(tuple(row["extra"]["stood"]) for row in rows)
    return Map(rows[0]["context"] or "", pair, stood, rows[0]["extra"]["of"])


def _earlier(folder: Path | None, out: Path) -> dict[str, MarginResult]:
    """Return the margins of an earlier run, by the keys of their records."""
    if folder is None:
        return {}
    if resolved(folder) == resolved(out):
        raise InputError(f"--against {folder} is the folder of this run; choose another --out")
    records = read_finished(folder, COMMAND, MARGINS).records
    return {r["key"]: margin_of_record(r) for r in records if r["error"] is None and "margin" in r["extra"]}


def _bundles(
    session: Session, result: Margins, ended: Iterable[tuple[MarginSearch, TrialRecord]]
) -> dict[str, str]:
    """Write the replay bundle of the weakest scenario of each action for each imperfection.

    Returns the folders of the bundles, relative to the run's, by the keys of their margins.
    """
    shown = {one.key for by_axis in result.weakest.values() for one in by_axis.values() if one.limit.reason}
    wanted = {}
    for one, record in ended:
        if record["key"] in shown and record["attempts"]:
            limit = margin_of_record(record)
            levels = () if limit.fails_at is None else ((one.axes[0], limit.fails_at),)
            assert limit.trial is not None
            wanted[record["index"]] = partial(one.rig.recipe, limit.trial, levels)
    folders = write_bundles(session, wanted)
    return {session.records[index]["key"]: folder for index, folder in folders.items()}


def _figures(result: Margins, trials: int) -> dict[str, Any]:
    """Return the metrics of ``report.json``."""
    return {
        "share": SHARE,
        "confidence": confidence(trials),
        "scenarios": [
            {
                "action": one.action,
                "scenario": one.scenario,
                "axis": one.axis.name,
                "figure": one.axis.figure,
            }
            | {"bundle": one.bundle, "before": one.before, **asdict(one.limit)}
            for one in result.margins
        ],
        "weakest": {
            action: {name: {"scenario": one.scenario, "text": one.text} for name, one in by_axis.items()}
            for action, by_axis in result.weakest.items()
        },
        "maps": [
            {
                "scenario": one.scenario,
                "axes": [axis.name for axis in one.pair],
                "values": [values_of(axis) for axis in one.pair],
                "stood": one.stood,
                "of": one.of,
            }
            for one in result.maps
        ],
    }
