"""A whole audit: its trials as a campaign, the bundles of the disagreements, and the figures of its report."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from craftsim.audit.plan import PlanRow, rows_by_flag
from craftsim.checking.setup import Setup
from craftsim.experiments.compare import Comparison, compare_runs, read_earlier
from craftsim.experiments.durations import write_durations
from craftsim.experiments.experiment import Experiment, RunOptions, TrialRecord
from craftsim.experiments.session import open_session
from craftsim.experiments.statistics import Figures, campaign_figures, capped_steps, retried
from craftsim.validation.audit.results import Results, bundle_disagreements, judged_by_rules
from craftsim.validation.audit.trial import BATCH, TIMEOUT_S, items_of, try_it
from craftsim.validation.forms import TRIALS
from craftsim.validation.shrinking.campaign import ShrinkProgress, Shrunk, shrink_failures

COMMAND = "audit"


@dataclass(frozen=True)
class Audit:
    """The result of an audit."""

    records: Sequence[TrialRecord]
    results: Results
    figures: Figures
    config: dict[str, Any]
    seed: int
    corrections: Mapping[str, Sequence[str]]
    """The corrections that would each concern an unsound row, by its name."""
    comparison: Comparison | None
    smallest: tuple[Shrunk, ...] = ()
    """The first failure of each kind in its smallest world, where that was asked for."""

    @property
    def judged(self) -> Iterable[TrialRecord]:
        """The records without those of what is begun all at once."""
        return judged_by_rules(self.records)

    @property
    def rows_by_flag(self) -> dict[str, int]:
        """How many unsound rows each correction concerns."""
        return rows_by_flag(self.corrections)


def run_audit(
    plan: Sequence[PlanRow],
    setup: Setup,
    trials: int,
    seed: int,
    out: Path,
    *,
    asked: Mapping[str, Any],
    options: RunOptions,
    batch: int = BATCH,
    shrink: ShrinkProgress | None = None,
) -> Audit:
    """Try the rows of a plan in physics, and write report.json, durations.csv and replay bundles into a folder.

    Args:
        plan: the rows.
        setup: configuration of the physics; its rules are audited.
        trials: at least how many for each row; each of its contexts is tried at least once.
        seed: decides the places, the physics and the noise of all trials.
        out: the folder.
        asked: the options that chose the rows, for the report.
        options: how.
        batch: trials that a worker takes at once; the default suits rows of many trials.
        shrink: shows how the first failure of each kind is shrunk to its smallest world; unless given, none is.
    """
    config = {**asked, "trials": trials, "rules": setup.rules, "setup": setup, "digests": setup.digests}
    items = items_of(plan, trials, seed, setup)
    experiment = Experiment(COMMAND, seed, config, items, try_it, TRIALS, TIMEOUT_S, batch)
    earlier = read_earlier(experiment, out, options)
    with open_session(experiment, out, options) as session:
        records = session.run()
        records = records.with_bundles(bundle_disagreements(session, records))
        smallest = () if shrink is None else shrink_failures(session, records, shrink)
        results = Results.of(records)
        corrections = results.corrected(plan, setup.rules)
        figures = campaign_figures(judged_by_rules(records), seed)
        comparison = None if earlier is None else compare_runs(earlier, session, judged_by_rules)
        found = results.figures(plan, corrections)
        found |= {"capped_steps": capped_steps(records), "retried": retried(records)}
        session.write_report(
            {"audit": found, "validation": figures, "paired": comparison, "smallest": smallest}
        )
        write_durations(out, figures.durations)
    return Audit(records, results, figures, config, seed, corrections, comparison, smallest)
