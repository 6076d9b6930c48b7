"""Buildings that are planned, built in physics, and planned again where it went wrong: the whole job in one call."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
from typing import Any, Final

import numpy as np

from craftsim.checking.setup import Setup
from craftsim.discrete.files.design import read_design
from craftsim.discrete.rules import Rules
from craftsim.discrete.tasks import Task, as_task
from craftsim.errors import InputError
from craftsim.experiments.compare import Comparison, compare_runs, read_earlier
from craftsim.experiments.durations import write_durations
from craftsim.experiments.experiment import Experiment, Item, RunOptions, TrialRecord
from craftsim.experiments.intervals import Proportion
from craftsim.experiments.session import open_session
from craftsim.experiments.statistics import Figures, campaign_figures
from craftsim.planning import Planned, plan_building
from craftsim.validation.forms import BUILDS
from craftsim.validation.runs.choice import check_starts, subjects_of
from craftsim.validation.runs.rebuilding import Rebuilding
from craftsim.validation.runs.run import Run, Terms, do_run

COMMAND: Final = "build"


@dataclass(frozen=True)
class BuildFigures:
    """What all buildings of a campaign came to; times are medians, in simulated seconds."""

    built: Proportion
    """Of all that came to an end, however many plans they took."""
    endings: dict[str, int]
    """How many were built, given up, or could not be read any more."""
    replans: int
    """Plans after the first ones, all together."""
    disturbed: int
    """Buildings in which the disturbance that was asked for came about."""
    planned_s: float | None
    """Makespan of the first plan by the table of durations."""
    real_s: float | None
    """From the start of the first action to the end of the last, of what was built."""


@dataclass(frozen=True)
class Builds:
    """The result of :func:`build_all`."""

    records: Sequence[TrialRecord]
    """One for each building, as in ``trials.jsonl``."""
    builds: BuildFigures
    figures: Figures
    comparison: Comparison | None
    config: dict[str, Any]
    """What decided it, besides the seed."""
    seed: int
    items: Sequence[Item]
    """What was run, parallel to the records."""

    @property
    def all_built(self) -> bool:
        """Whether every one was built."""
        return self.builds.endings.get("built", 0) == len(self.records)


def read_goal(start: str, goal: Path | None) -> Task:
    """Return a task, whose goal is another design if a file of one is given.

    Raises InputError for files that are wrong or do not fit, and for what has no goal.
    """
    task = as_task(start)
    if goal is not None:
        design = read_design(goal)
        return replace(task, design=design, success="built")
    if not task.has_goal:
        raise InputError(f"{start} has no goal; give a design with --goal")
    return task


def build_all(
    task: Task,
    setup: Setup,
    asked: Rebuilding,
    *,
    trials: int,
    seed: int,
    out: Path,
    options: RunOptions,
    timeout_s: float = 600.0,
    record: bool = False,
) -> Builds:
    """Build what a task asks for many times, and write ``report.json``, ``trials.jsonl`` and bundles into a folder.

    Args:
        task: has a goal.
        setup: configuration of the physics.
        asked: how often is planned, and what goes wrong on purpose.
        trials: how many times.
        seed: decides all that is drawn.
        out: folder for results.
        options: how.
        timeout_s: after which a building counts as hanging.
        record: write a trajectory of each.

    Raises InputError where something does not fit together, and NoPlanError where there is no plan from the start.
    """
    subjects = subjects_of([task])
    check_starts(subjects, setup, seed)
    config: dict[str, Any] = {
        "world": subjects[0].digest,
        "trials": trials,
        "asked": asked,
        "record": record,
        "setup": setup,
        "digests": setup.digests,
    }
    terms = Terms(seed, setup, out.resolve(), record=record)
    items = [_item(task, episode, terms, asked) for episode in range(trials)]
    experiment = Experiment(COMMAND, seed, config, items, do_run, BUILDS, timeout_s)
    earlier = read_earlier(experiment, out, options)
    # Whether anything can be built is said before anything is begun; it may take long to find out.
    rng, rules = np.random.default_rng(seed), Rules(setup.rules)
    first = task.for_episode(rng)
    plan_building(first.draw(rng), first, rules, rounds=asked.rounds, time_s=math.inf, report=_enough)
    with open_session(experiment, out, options) as session:
        records = session.run()
        figures, builds = campaign_figures(records, seed), build_figures(records)
        comparison = None if earlier is None else compare_runs(earlier, session)
        session.write_report({"builds": builds, "validation": figures, "paired": comparison})
        write_durations(out, figures.durations)
    return Builds(records, builds, figures, comparison, config, seed, items)


def _enough(number: int, best: Planned | None) -> None:
    """Stop planning as soon as there is a plan."""
    if best is not None:
        raise KeyboardInterrupt


def _item(task: Task, episode: int, terms: Terms, asked: Rebuilding) -> Item:
    key = f"{task.name}/{episode:04d}"
    run = Run(key, task, None, "", episode, terms, rebuilding=asked)
    return Item(key, "built", terms.seed, run, task.name, episode)


def build_figures(records: Sequence[TrialRecord]) -> BuildFigures:
    """Return the figures of the buildings in some records."""
    extras = [record["extra"] for record in records if record["error"] is None]
    endings = Counter(extra["ended"] for extra in extras)
    times = [extra["makespan_s"] for extra in extras if extra["ended"] == "built"]
    return BuildFigures(
        built=Proportion.of(endings["built"], len(extras)),
        endings=dict(sorted(endings.items())),
        replans=sum(extra["replans"] for extra in extras),
        disturbed=sum(bool(extra["disturbed"]) for extra in extras),
        planned_s=median(extra["planned_s"] for extra in extras) if extras else None,
        real_s=median(times) if times else None,
    )
