"""Robustness margins: the largest value of each imperfection at which an action still works.

Trial i uses the same random draws at every level: it passes low levels and fails from its own *critical level* on.
Order statistics of independent critical levels give distribution-free tolerance bounds (S. S. Wilks, "Determination of
sample sizes for setting tolerance limits", 1941): with n = 59 trials at least 95 % of all worlds pass the smallest one,
with confidence 1 - 0.95**n = 95 %; above the third smallest of 16 more than 5 % fail. The search assumes that a trial
which fails at a level fails at all higher ones; the result does not: at the margin itself every trial is run.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from fnmatch import fnmatchcase
from functools import lru_cache, partial
from pathlib import Path
from typing import Annotated, Any, Final, Literal, NamedTuple

import numpy as np
from pydantic import Field

from craftsim.audit.audit import compiled_world
from craftsim.audit.imperfections import Imperfection
from craftsim.audit.situation import Row, Situation, scenes, shipped
from craftsim.audit.survey import row_of, situation_of
from craftsim.checking.attempt import Attempt
from craftsim.checking.recipe import Recipe, perform_step, start
from craftsim.checking.setup import Seed, Setup
from craftsim.discrete.files.blueprint import blueprint_text
from craftsim.discrete.rules import RuleSet
from craftsim.errors import InputError, StartError
from craftsim.experiments.bundle import write_bundles
from craftsim.experiments.compare import read_other
from craftsim.experiments.experiment import (
    STRICT,
    Experiment,
    Form,
    Result,
    RunOptions,
    Trial,
    TrialRecord,
)
from craftsim.experiments.session import open_session
from craftsim.experiments.statistics import carried_out
from craftsim.validation.record_schemas import Judged

_COMMAND: Final = "margins"
_TIMEOUT_S: Final = 600.0
"""Limit of a search, which takes seconds, and of writing a bundle."""
PASSING_SHARE: Final = 0.95
TRIALS_PER_LEVEL: Final = 59
"""Trials that must all pass a level for 95 % confidence that 95 % of all worlds pass it."""
RANKS: Final = ((16, 3), (7, 2), (1, 1))
"""(trials, rank): the upper bound is the critical level of this rank among the first trials; first pair that fits."""
BASE: Final = 0
"""Index of the level at which the imperfection has its nominal value, that of ``--randomize``."""
PROBES: Final = 3
"""Trials that must be bit-equal at the largest and the nominal level for the verdict "no effect"."""
MAP_TRIALS: Final = 20
STRIDE: Final = 4
"""A map has every fourth level: the preferred numbers R5, a factor of 1.6 apart."""

_Count = Annotated[int, Field(ge=0, lt=2**53)]
Levels = Sequence[tuple[Imperfection, float]]
End = Literal["base", "edge", "largest", "no effect"]
"""How a search ended: a trial fails at the nominal level, or at the level above the margin; all trials pass the largest
level; or the largest level gives the results of the nominal level, bit for bit."""
_ENDS: Final[tuple[End, ...]] = ("base", "edge", "largest", "no effect")


class Scenario(NamedTuple):
    """A situation with a readable name; its last action is judged."""

    action: str
    """Row of the data sheet, such as ``lift``."""
    place: str
    """Such as ``a block between blocks``."""
    row: Row

    @property
    def name(self) -> str:
        """Action and place."""
        return f"{self.action} {self.place}"


def _shipped_scenarios() -> tuple[Scenario, ...]:
    chosen = []
    for action, places in shipped("margins.yaml").items():
        for place, properties in places.items():
            chosen.append(Scenario(action, place, row_of(properties)))
    return tuple(chosen)


CHOSEN: Final = _shipped_scenarios()


def scenarios(pattern: str = "*", quick: bool = False) -> tuple[Scenario, ...]:
    """Return the scenarios whose names match a glob pattern; quick: the first one of each action.

    Raises InputError if none matches.
    """
    matching = []
    actions = set()
    for scenario in CHOSEN:
        is_first = scenario.action not in actions
        actions.add(scenario.action)
        if fnmatchcase(scenario.name, pattern) and (is_first or not quick):
            matching.append(scenario)
    if not matching:
        names = ", ".join(scenario.name for scenario in CHOSEN)
        raise InputError(f"no scenario matches '{pattern}'; there are {names}")
    return tuple(matching)


def confidence(trials: int) -> float:
    """Return the confidence that 95 % of all worlds pass a level that all of so many trials pass."""
    return 1.0 - PASSING_SHARE**trials


def search(
    passes: Callable[[int, int], bool], levels: int, trials: int
) -> tuple[int | None, int | None, tuple[int, int] | None]:
    """Search the margin among the levels 0 (nominal) to ``levels``; ``passes`` says whether a trial passes a level.

    Returns the largest level that all trials pass, None if one fails at the nominal level; the level above which more
    than 5 % of all worlds fail, None if too few trials fail at the largest level; and a trial that fails at the level
    above the margin, with that level, None if all pass the largest level.
    """
    failed = set[tuple[int, int]]()

    def passed(trial: int, level: int) -> bool:
        does_pass = passes(trial, level)
        if not does_pass:
            failed.add((trial, level))
        return does_pass

    def critical(trial: int, highest: int) -> int:
        """Return the largest level up to ``highest`` that a trial passes; -1 if it fails at the nominal level."""
        if passed(trial, highest):
            return highest
        fails = highest
        step = 1
        level = max(fails - step, BASE)
        while not passed(trial, level):
            if level == BASE:
                return -1
            fails = level
            step = 2 * step
            level = max(fails - step, BASE)
        while fails - level > 1:
            middle = (level + fails) // 2
            if passed(trial, middle):
                level = middle
            else:
                fails = middle
        return level

    first, rank = next(pair for pair in RANKS if pair[0] <= trials)
    ends = list[int]()
    for trial in range(first):
        highest = levels
        if len(ends) >= rank:
            highest = sorted(ends)[rank - 1]
        end = critical(trial, highest)
        if end < BASE:
            return None, None, (trial, BASE)
        ends.append(end)
    lowest = min(ends)
    upper = None
    if sorted(ends)[rank - 1] < levels:
        upper = sorted(ends)[rank - 1] + 1

    def further_trials() -> Iterator[int]:
        """Yield the trials after the first ones, and then those that fail at the lowest level so far."""
        yield from range(first, trials)
        failing = first_failing()
        while failing is not None:
            yield failing
            failing = first_failing()

    def first_failing() -> int | None:
        return next((trial for trial in range(trials) if not passed(trial, lowest)), None)

    for trial in further_trials():
        lowest = critical(trial, lowest)
        if lowest < BASE:
            return None, None, (trial, BASE)
    edge = min((pair for pair in failed if pair[1] == lowest + 1), default=None)
    return lowest, upper, edge


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
    tried: _Count
    identical: bool = False
    """Whether all trials are one, as nothing is drawn at random: the margin is exact for this world, and says
    nothing of others."""

    @property
    def rank(self) -> tuple[int, float]:
        """Sort key: the weakest scenario first."""
        return _ENDS.index(self.end), self.margin or 0.0

    @property
    def figures(self) -> dict[str, Any]:
        """The margin as report.json holds it, the end in capitals."""
        return asdict(self) | {"end": self.end.replace(" ", "_").upper()}


MARGINS: Final = Form(Judged, MarginResult | dict[Literal["stood"], tuple[_Count, ...]])
"""Schema of the records of a search for margins, and of a map's rows: how many trials pass, by horizontal level."""


@dataclass(frozen=True, slots=True)
class MarginSearch:
    """The search of the margin of one imperfection, or a row of the map of two; sent to a worker."""

    scenario: Scenario
    setup: Setup
    seed: int
    axes: tuple[Imperfection, ...]
    trials: int
    up: int = 0

    def recipe(self, number: int, levels: Levels = ()) -> Recipe:
        """Return the recipe of a trial; a trial has the same random draws at all levels."""
        randomization = self.setup.randomization
        for axis, value in levels:
            randomization = axis.on(randomization, value)
        situation = _situation(self.scenario.row, self.setup.rules)
        placed = situation.placed(np.random.default_rng(self.seed))
        seed = Seed((self.seed, situation.digest, number))
        return Recipe(
            blueprint_text(placed.grid),
            placed.steps(),
            replace(self.setup, randomization=randomization),
            seed,
        )

    def attempt(self, number: int, levels: Levels = ()) -> tuple[tuple[Attempt, ...], str]:
        """Run a trial; return its attempts at the last step, and the reason if it failed.

        There are no attempts in a world in which solids overlap at the start.
        """
        recipe = self.recipe(number, levels)
        try:
            # All trials on the same kind of floor share a compiled world.
            randomization = recipe.setup.randomization
            nominal = replace(
                self.setup.randomization, floor=randomization.floor, making=randomization.making
            )
            judge = start(
                recipe, compiled_world(recipe.world, replace(self.setup, randomization=nominal))
            )
        except StartError as error:
            return (), str(error)
        for step in recipe.steps:
            attempts = perform_step(judge, step)
        failed = next((attempt for attempt in attempts if not attempt.agrees), None)
        if failed is None:
            return attempts, ""
        return attempts, f"{failed.result}: {failed.reason}"

    @property
    def trial(self) -> Trial:
        """This search as a trial of the experiment."""
        names = " x ".join(axis.name for axis in self.axes)
        row = ""
        if len(self.axes) > 1:
            row = f"/{self.up}"
        name = self.scenario.name
        return Trial(f"{name}/{names}{row}", self.scenario.action, self.seed, self, context=name)


@lru_cache(maxsize=2)
def _situation(row: Row, rules: RuleSet) -> Situation:
    """Return a scenario's situation. Raises CraftsimError if there is none, or if its first actions are illegal."""
    if row.scene:
        return next(scene for scene in scenes() if scene.row == row)
    return situation_of(row, rules)


def find_margin(job: MarginSearch) -> Result:
    """Search a margin, or try all pairs of levels of one row of a map."""
    if len(job.axes) > 1:
        return Result(agrees=True, extra={"stood": _map_row(job)})
    (axis,) = job.axes
    base = axis.value(job.setup.randomization)
    values = [base, *(value for value in axis.levels if value > base)]
    largest = len(values) - 1
    tried = dict[tuple[int, int], tuple[tuple[Attempt, ...], str]]()

    def result(trial: int, level: int) -> tuple[tuple[Attempt, ...], str]:
        if (trial, level) not in tried:
            levels = []
            if level != BASE:
                levels.append((axis, values[level]))
            tried[trial, level] = job.attempt(trial, levels)
        return tried[trial, level]

    def passes(trial: int, level: int) -> bool:
        return not result(trial, level)[1]

    probes = range(min(PROBES, job.trials))

    def is_fixed(level: int) -> bool:
        """Return whether the probes are equal in every figure, so that no draw has an effect."""
        return bool(result(0, level)[0]) and all(
            result(n, level) == result(0, level) for n in probes
        )

    identical = len(probes) > 1 and is_fixed(largest) and is_fixed(BASE)
    trials = 1
    if not identical:
        trials = job.trials
    end: End = "no effect"
    margin: int | None = largest
    upper = None
    edge = None
    if not all(result(n, BASE) == result(n, largest) and passes(n, BASE) for n in probes):
        margin, upper, edge = search(passes, largest, trials)
        if edge is None:
            end = "largest"
        elif margin is None:
            end = "base"
        else:
            end = "edge"
    attempts: tuple[Attempt, ...] = ()
    reason = ""
    failing_trial = None
    fails_at = None
    if edge is not None:
        attempts, reason = result(*edge)
        failing_trial, fails_at = edge
        if fails_at == BASE:
            fails_at = None
    limit = MarginResult(
        end,
        _value_at(values, margin),
        _value_at(values, upper),
        _value_at(values, fails_at),
        failing_trial,
        reason,
        len(tried),
        identical,
    )
    return Result(end != "base", attempts, extra=asdict(limit))


def _value_at(values: Sequence[float], level: int | None) -> float | None:
    if level is None:
        return None
    return values[level]


def _map_row(job: MarginSearch) -> list[int]:
    """Return how many trials pass each horizontal level of a row of a map."""
    right, up = job.axes
    base = job.setup.randomization
    passed = []
    for value in values_of(right):
        pair = ((right, value), (up, values_of(up)[job.up]))
        levels = [(axis, level) for axis, level in pair if level > axis.value(base)]
        passed.append(sum(not job.attempt(trial, levels)[1] for trial in range(job.trials)))
    return passed


def values_of(axis: Imperfection) -> tuple[float, ...]:
    """Return the values of an imperfection on a map; 0 means the nominal value."""
    return (0.0, *axis.levels[::-1][::STRIDE][::-1])


@dataclass(frozen=True)
class Margin:
    """The margin of a scenario for one imperfection."""

    action: str
    scenario: str
    axis: Imperfection
    limit: MarginResult
    before: MarginResult | None = None
    bundle: str = ""
    """Replay bundle of the trial that fails above it, relative to the run's folder; empty without one."""

    @property
    def number(self) -> str:
        """The margin for a table, in the imperfection's unit."""
        if self.limit.margin is None or self.limit.end == "no effect":
            if self.limit.margin is None:
                return "fails"
            return "-"
        return f"{'>= ' * (self.limit.end == 'largest')}{self.axis.scale * self.limit.margin:.3g}"

    @property
    def text(self) -> str:
        """The margin with its unit, such as ``1.6 mm``."""
        words = {"fails": "fails at nominal", "-": "no effect"}
        return words.get(self.number, f"{self.number} {self.axis.unit}")


@dataclass(frozen=True)
class Margins:
    """The result of a search."""

    records: Sequence[TrialRecord]
    margins: tuple[Margin, ...]
    maps: Mapping[str, Sequence[Sequence[int]]]
    """By scenario, how many trials pass, by vertical, then by horizontal level; empty unless a pair was given."""
    pair: tuple[Imperfection, ...]
    """The imperfections on a map's horizontal and vertical axis."""
    config: dict[str, Any]
    seed: int

    @property
    def weakest(self) -> dict[str, dict[str, Margin]]:
        """The weakest scenario by action and by name of the imperfection."""
        weakest: dict[str, dict[str, Margin]] = {margin.action: {} for margin in self.margins}
        for margin in sorted(self.margins, key=lambda margin: margin.limit.rank):
            weakest[margin.action].setdefault(margin.axis.name, margin)
        return weakest

    @property
    def with_effect(self) -> list[Imperfection]:
        """The imperfections that have an effect on any action."""
        with_effect = {margin.axis for margin in self.margins if margin.limit.end != "no effect"}
        ranked = sorted(self.margins, key=lambda margin: -margin.limit.rank[0])
        return [
            axis for axis in dict.fromkeys(margin.axis for margin in ranked) if axis in with_effect
        ]

    @property
    def passed(self) -> bool:
        """Whether every search finished, and every scenario passes the nominal level."""
        ended = all(record["error"] is None for record in self.records)
        return ended and all(margin.limit.end != "base" for margin in self.margins)

    @property
    def map_trials(self) -> int:
        """Number of trials of each pair of levels of a map."""
        return min(self.config["trials"], MAP_TRIALS)


def run_margins(
    scenarios: Sequence[Scenario],
    axes: Sequence[Imperfection],
    setup: Setup,
    trials: int,
    seed: int,
    out: Path,
    *,
    selection: Mapping[str, Any],
    options: RunOptions,
    pair: tuple[Imperfection, ...] = (),
) -> Margins:
    """Search the margin of each scenario for each imperfection; write report.json and replay bundles into a folder.

    The imperfections ``axes`` are varied one at a time, beyond the nominal setup; of a ``pair`` a map is drawn for each
    scenario, too. ``selection`` has the given options, for the report.
    """
    earlier: dict[str, MarginResult] = {}
    if options.against is not None:
        for record in carried_out(read_other(options.against, out, _COMMAND, MARGINS).records):
            if "margin" in record["extra"]:
                earlier[record["key"]] = MarginResult(**record["extra"])
    config = {
        **selection,
        "trials": trials,
        "rules": setup.rules,
        **setup.provenance,
    }
    searches = []
    for scenario in scenarios:
        for axis in axes:
            searches.append(MarginSearch(scenario, setup, seed, (axis,), trials))
    map_rows = []
    if pair:
        map_trials = min(trials, MAP_TRIALS)
        for scenario in scenarios:
            for up in range(len(values_of(pair[1]))):
                map_rows.append(MarginSearch(scenario, setup, seed, pair, map_trials, up))
    items = [job.trial for job in (*searches, *map_rows)]
    experiment = Experiment(_COMMAND, seed, config, items, find_margin, MARGINS, _TIMEOUT_S)
    with open_session(experiment, out, options) as session:
        records = session.run()
        ended = []
        for search, record in zip(searches, records, strict=False):
            if record["error"] is None:
                ended.append((search, record, MarginResult(**record["extra"])))
        bundles = write_bundles(session, _recipes(ended))
        margins = []
        for search, record, limit in ended:
            margins.append(
                Margin(
                    search.scenario.action,
                    search.scenario.name,
                    search.axes[0],
                    limit,
                    earlier.get(record["key"]),
                    bundles.get(record["index"], ""),
                )
            )
        maps: dict[str, list[Sequence[int]]] = {}
        for record in records[len(searches) :]:
            maps.setdefault(record["context"] or "", []).append(record["extra"].get("stood", ()))
        complete_maps = {name: stood for name, stood in maps.items() if all(stood)}
        result = Margins(records, tuple(margins), complete_maps, pair, config, seed)
        session.write_report({"margins": _figures(result)})
    return result


def _recipes(
    ended: Iterable[tuple[MarginSearch, TrialRecord, MarginResult]],
) -> dict[int, Callable[[], Recipe]]:
    """Return how the weakest scenario of each action fails for each imperfection, by the index of its record."""
    weakest_indices = dict[tuple[str, Imperfection], int]()
    recipes: dict[int, Callable[[], Recipe]] = {}
    for search, record, limit in sorted(ended, key=lambda ended_search: ended_search[2].rank):
        (axis,) = search.axes
        index = record["index"]
        weakest = weakest_indices.setdefault((search.scenario.action, axis), index) == index
        if weakest and limit.trial is not None and record["attempts"]:
            levels: Levels = ()
            if limit.fails_at is not None:
                levels = ((axis, limit.fails_at),)
            recipes[index] = partial(search.recipe, limit.trial, levels)
    return recipes


def _figures(result: Margins) -> dict[str, Any]:
    """Return the metrics of ``report.json``."""
    scenario_figures = []
    for margin in result.margins:
        scenario_figures.append(
            {
                "action": margin.action,
                "scenario": margin.scenario,
                "axis": margin.axis.name,
                "figure": margin.axis.figure,
                "bundle": margin.bundle,
                "before": margin.before and margin.before.figures,
                **margin.limit.figures,
            }
        )
    weakest: dict[str, dict[str, Any]] = {}
    for action, by_axis in result.weakest.items():
        weakest[action] = {}
        for name, margin in by_axis.items():
            weakest[action][name] = {"scenario": margin.scenario, "text": margin.text}
    maps = []
    for scenario, stood in result.maps.items():
        maps.append(
            {
                "scenario": scenario,
                "stood": stood,
                "axes": [axis.name for axis in result.pair],
                "values": [values_of(axis) for axis in result.pair],
                "of": result.map_trials,
            }
        )
    return {
        "share": PASSING_SHARE,
        "confidence": confidence(result.config["trials"]),
        "scenarios": scenario_figures,
        "weakest": weakest,
        "maps": maps,
    }
