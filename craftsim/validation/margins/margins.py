"""A whole search for margins: its campaign, what each action stands, and replay bundles of what fails first."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Final

from craftsim.checking.setup import Setup
from craftsim.errors import InputError
from craftsim.experiments.bundle import write_bundles
from craftsim.experiments.experiment import Done, Experiment, RunOptions, TrialRecord
from craftsim.experiments.records import read_finished
from craftsim.experiments.session import Session, open_session
from craftsim.storage.paths import resolved
from craftsim.validation.forms import MARGINS
from craftsim.validation.margins.axes import Axis
from craftsim.validation.margins.finding import End, Limit, MarginSearch, find, limit_of
from craftsim.validation.margins.maps import Map, MapRow, Pair, find_row, maps_of, rows_of, values_of
from craftsim.validation.margins.scenarios import Scenario
from craftsim.validation.margins.search import SHARE, confidence
from craftsim.validation.margins.trial import Rig

COMMAND: Final = "margins"
TIMEOUT_S: Final = 600.0
"""For a search, which takes seconds; or for a bundle."""


@dataclass(frozen=True)
class Margin:
    """The margin of a scenario along an axis."""

    action: str
    scenario: str
    axis: Axis
    limit: Limit
    before: Limit | None = None
    """That of an earlier campaign, where there is one to compare with."""
    bundle: str = ""
    """Folder of the replay bundle of the trial that fails next to it, relative to the campaign's; empty without one."""

    @property
    def key(self) -> str:
        """Of its record."""
        return f"{self.scenario}/{self.axis.name}"

    @property
    def number(self) -> str:
        """The margin as a table has it, in the axis' unit."""
        if self.limit.end in (End.BASE, End.NO_EFFECT):
            return {End.BASE: "base", End.NO_EFFECT: "-"}[self.limit.end]
        assert self.limit.margin is not None
        return f"{'>= ' * (self.limit.end is End.LARGEST)}{self.axis.scale * self.limit.margin:.3g}"

    @property
    def text(self) -> str:
        """The margin as a data sheet says it, such as ``1.6 mm``."""
        if self.limit.end in (End.BASE, End.NO_EFFECT):
            return {End.BASE: "not even the base", End.NO_EFFECT: "no effect"}[self.limit.end]
        return f"{self.number} {self.axis.unit}"

    @property
    def rank(self) -> tuple[int, float]:
        """By which the weakest scenario of an action comes first."""
        order = (End.BASE, End.EDGE, End.LARGEST, End.NO_EFFECT)
        return order.index(self.limit.end), self.limit.margin or 0.0


@dataclass(frozen=True)
class Margins:
    """The result of a search."""

    records: Sequence[TrialRecord]
    margins: tuple[Margin, ...]
    """Of each scenario along each axis that came to an end."""
    maps: tuple[Map, ...]
    """Of each scenario over the pair of axes that was asked for."""
    config: dict[str, Any]
    seed: int

    @property
    def weakest(self) -> dict[str, dict[str, Margin]]:
        """For each action and each axis by name the scenario that stands least."""
        found: dict[str, dict[str, Margin]] = {}
        for one in sorted(self.margins, key=lambda one: one.rank):
            found.setdefault(one.action, {}).setdefault(one.axis.name, one)
        order = dict.fromkeys(one.action for one in self.margins)
        return {action: found[action] for action in order}

    @property
    def telling(self) -> list[Axis]:
        """The axes that have an effect on any action."""
        every = {
            one.axis: one.limit.end is not End.NO_EFFECT
            for one in sorted(self.margins, key=lambda m: -m.rank[0])
        }
        return [axis for axis, tells in every.items() if tells]

    @property
    def stands(self) -> bool:
        """Whether every search came to an end, and every scenario stands the base."""
        ended = all(record["error"] is None for record in self.records)
        return ended and all(one.limit.end is not End.BASE for one in self.margins)


def run_margins(
    scenarios: Sequence[Scenario],
    axes: Sequence[Axis],
    setup: Setup,
    trials: int,
    seed: int,
    out: Path,
    *,
    asked: Mapping[str, Any],
    options: RunOptions,
    pair: Pair | None = None,
) -> Margins:
    """Search the margin of each scenario along each axis, and write report.json and replay bundles into a folder.

    Args:
        scenarios: what is done where.
        axes: the imperfections that grow, one at a time.
        setup: of the base.
        trials: of each scenario, all of which must stand a margin.
        seed: decides the places and all that is drawn.
        out: the folder.
        asked: the options that chose all this, for the report.
        options: how.
        pair: two axes of which a map is drawn for each scenario, too.
    """
    earlier = _earlier(options.against, out)
    config = {**asked, "trials": trials, "rules": setup.rules, "setup": setup, "digests": setup.digests}
    rigs = [Rig(scenario, setup, seed) for scenario in scenarios]
    searches = [MarginSearch(rig, axis, trials) for rig in rigs for axis in axes]
    rows = [row for rig in rigs for row in rows_of(rig, pair, trials)] if pair else []
    jobs: list[MarginSearch | MapRow] = [*searches, *rows]
    items = [job.item for job in jobs]
    experiment = Experiment(COMMAND, seed, config, items, work, MARGINS, TIMEOUT_S)
    with open_session(experiment, out, options) as session:
        records = session.run()
        ended = [
            (search, record)
            for search, record in zip(searches, records, strict=False)
            if record["error"] is None
        ]
        margins = [_margin(search, record, earlier.get(record["key"])) for search, record in ended]
        maps = maps_of((row, records[len(searches) + number]) for number, row in enumerate(rows))
        result = Margins(records, tuple(margins), maps, config, seed)
        folders = _bundles(session, result, ended)
        bundled = tuple(replace(one, bundle=folders.get(one.key, "")) for one in margins)
        result = replace(result, margins=bundled)
        session.write_report({"margins": _figures(result, trials)})
    return result


def work(job: MarginSearch | MapRow) -> Done:
    """Do one item of the campaign."""
    return find(job) if isinstance(job, MarginSearch) else find_row(job)


def _margin(search: MarginSearch, record: TrialRecord, before: Limit | None) -> Margin:
    scenario = search.rig.scenario
    return Margin(scenario.action, scenario.name, search.axis, limit_of(record), before)


def _earlier(folder: Path | None, out: Path) -> dict[str, Limit]:
    """Return the margins that an earlier search found, by the keys of their records."""
    if folder is None:
        return {}
    if resolved(folder) == resolved(out):
        raise InputError(f"--against {folder} is the folder of this run; choose another --out")
    records = read_finished(folder, COMMAND, MARGINS).records
    return {r["key"]: limit_of(r) for r in records if r["error"] is None and "margin" in r["extra"]}


def _bundles(
    session: Session, result: Margins, ended: Sequence[tuple[MarginSearch, TrialRecord]]
) -> dict[str, str]:
    """Write the replay bundle of what fails first of each action along each axis.

    Returns the folders of the bundles, relative to the run's, by the keys of their margins.
    """
    shown = {one.key for by_axis in result.weakest.values() for one in by_axis.values() if one.limit.reason}
    wanted = {}
    for search, record in ended:
        if record["key"] in shown and record["attempts"]:
            limit = limit_of(record)
            levels = () if limit.fails_at is None else ((search.axis, limit.fails_at),)
            assert limit.trial is not None
            wanted[record["index"]] = partial(search.rig.recipe, limit.trial, levels)
    folders = write_bundles(session, wanted)
    return {session.records[index]["key"]: folder for index, folder in folders.items()}


def _figures(result: Margins, trials: int) -> dict[str, Any]:
    """Return what ``report.json`` holds."""
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
