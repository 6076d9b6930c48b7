"""A whole audit: its trials as a campaign, the bundles of the disagreements, and the figures of its report."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from craftsim.audit.plan import PlanRow, rows_by_flag
from craftsim.checking.setup import Setup
from craftsim.report import write_report
from craftsim.storage.folders import owning
from craftsim.validation.audit.results import Results, bundle_disagreements, judged_by_rules
from craftsim.validation.audit.trial import BATCH, TIMEOUT_S, items_of, try_it
from craftsim.validation.campaign import Engine, Header, TrialRecord, run_campaign
from craftsim.validation.forms import TRIALS
from craftsim.validation.shrinking.campaign import ShrinkProgress, Shrunk, shrink_failures
from craftsim.validation.statistics.durations import write_durations
from craftsim.validation.statistics.figures import Figures, campaign_figures
from craftsim.validation.statistics.paired import Comparison, compare_runs, read_earlier
from craftsim.validation.statistics.records import capped_steps, retried
from craftsim.validation.validation import Progress

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


@owning
def run_audit(
    plan: Sequence[PlanRow],
    setup: Setup,
    trials: int,
    seed: int,
    out: Path,
    *,
    asked: Mapping[str, Any],
    progress: Progress,
    workers: int = 1,
    engine: Engine = "local",
    resume: bool = False,
    against: Path | None = None,
    batch: int | None = None,
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
        progress: shows what is done.
        workers: processes to share the work.
        engine: processes of this machine, or an existing Ray cluster.
        resume: go on with what an interrupted audit has left in the folder.
        against: folder of an earlier audit to compare with.
        batch: trials that a worker takes at once; the default suits rows of many trials.
        shrink: shows how the first failure of each kind is shrunk to its smallest world; unless given, none is.
    """
    started = time.perf_counter()
    config = {**asked, "trials": trials, "rules": setup.rules, "setup": setup, "digests": setup.digests}
    items = items_of(plan, trials, seed, setup)
    earlier = None if against is None else read_earlier(against, COMMAND, out, seed, items, TRIALS)
    with progress(len(items)) as on_record:
        records = run_campaign(
            items,
            try_it,
            out,
            Header(COMMAND, seed, config),
            workers=workers,
            engine=engine,
            timeout_s=TIMEOUT_S,
            batch=batch or BATCH,
            resume=resume,
            on_record=on_record,
            form=TRIALS,
        )
    records = records.with_bundles(bundle_disagreements(out, items, records, workers, engine))
    smallest = () if shrink is None else shrink_failures(out, records, workers, shrink, engine)
    results = Results.of(records)
    corrections = results.corrected(plan, setup.rules)
    judged = judged_by_rules(records)
    figures = campaign_figures(judged, seed)
    comparison = None if earlier is None else compare_runs(earlier, out, records, judged_by_rules)
    write_report(
        out,
        {
            "audit": results.figures(plan, corrections)
            | {"capped_steps": capped_steps(records), "retried": retried(records)},
            "validation": figures,
            "paired": comparison,
            "smallest": smallest,
        },
        command=COMMAND,
        seed=seed,
        config=config | {"against": against},
        wall={"total_s": time.perf_counter() - started, "workers": workers, "engine": engine},
    )
    write_durations(out, figures.durations)
    return Audit(records, results, figures, config, seed, corrections, comparison, smallest)
