"""What all commands share that run a campaign: counting, keeping and resuming, and what a report says of the run."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from operator import itemgetter
from pathlib import Path
from typing import Any

from rich.console import Console

from craftsim.commands.progress import counting
from craftsim.discrete.errors import InputError
from craftsim.report import output_directory, write_report
from craftsim.validation.campaign import Engine, Header, Item, TrialRecord, run_campaign


@dataclass(frozen=True)
class CampaignCommand:
    """A command that runs a campaign, from when its options are known to be good to its report."""

    name: str
    seed: int
    out: Path
    """Folder of the campaign; made when this is."""
    workers: int
    engine: Engine
    resume: bool
    console: Console = field(default_factory=Console)
    started: float = field(default_factory=time.perf_counter)

    def __post_init__(self) -> None:
        """Make the folder; raise InputError for too few workers, and where it cannot be made."""
        if self.workers < 1:
            raise InputError(f"--workers must be at least 1, not {self.workers}")
        output_directory(self.out)

    def run(
        self,
        what: str,
        items: Sequence[Item],
        work: Callable[[Any], Any],
        config: Mapping[str, Any],
        *,
        timeout_s: float,
        batch: int = 1,
        good: Callable[[TrialRecord], bool] = itemgetter("agrees"),
    ) -> list[TrialRecord]:
        """Run the campaign behind a bar, and return its records as ``run_campaign`` does.

        Args:
            what: what the bar calls the items.
            items: what to try.
            work: gives an item's job its result.
            config: what else decides the results.
            timeout_s: after which an item counts as hanging.
            batch: items that a worker takes at once.
            good: whether the bar counts a record as good.
        """
        with counting(self.console, what, len(items)) as tell:
            return run_campaign(
                items,
                work,
                self.out,
                Header(self.name, self.seed, config),
                workers=self.workers,
                engine=self.engine,
                timeout_s=timeout_s,
                batch=batch,
                resume=self.resume,
                tell=lambda record: tell(good(record)),
            )

    def report(self, figures: Mapping[str, Any], config: Mapping[str, Any]) -> Path:
        """Write ``report.json`` and return its path."""
        total_s = time.perf_counter() - self.started
        wall = {"total_s": total_s, "workers": self.workers, "engine": self.engine}
        return write_report(self.out, figures, command=self.name, seed=self.seed, config=config, wall=wall)
