"""Measure what a campaign costs for each of its trials, beside the trial itself."""

from __future__ import annotations

import resource
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from craftsim.commands.options import Engine
from craftsim.validation.campaign import Done, Header, Item, run_campaign
from craftsim.validation.validation import validate

_FEW, _MANY = 200, 1200
MILLION: Final = 1_000_000


@dataclass(frozen=True)
class TrialCost:
    """CPU time of a trial in a campaign of one local worker, in seconds."""

    trial_s: float
    """A run of the task, start to end, with all that belongs to it."""
    handing_out_s: float
    """Of that, for handing it out, taking its result and writing it down."""

    @property
    def million_h(self) -> float:
        """CPU hours of a million such trials."""
        return MILLION * self.trial_s / 3600


def cost_of_a_trial(task: str, runs: int, seed: int) -> TrialCost:
    """Build a task in mildly random physics so many times more than once, and return what each further run costs."""
    seconds = []
    # The first of them loads compiled functions, which takes as long as a run.
    for trials in (1, 1, 1 + runs):
        with tempfile.TemporaryDirectory() as folder:
            begun = _cpu_s()
            validate(task, randomize="mild", trials=trials, seed=seed, out=Path(folder))
            seconds.append(_cpu_s() - begun)
    empty = [of_nothing(n, "local", _cpu_s) for n in (_FEW, _MANY)]
    return TrialCost((seconds[2] - seconds[1]) / runs, (empty[1] - empty[0]) / (_MANY - _FEW))


def of_nothing(n: int, engine: Engine, cpu_s: Callable[[], float]) -> float:
    """Return the CPU time of a campaign of so many trials in which nothing is done, by a clock of CPU seconds."""
    items = [Item(f"item {i}", "all", i, i) for i in range(n)]
    with tempfile.TemporaryDirectory() as folder:
        begun = cpu_s()
        run_campaign(items, _nothing, Path(folder), Header("bench", 0, {}), engine=engine)
        return cpu_s() - begun


def _nothing(job: int) -> Done:
    return Done(True)


def _cpu_s() -> float:
    """Return the CPU seconds of this process, and of those that it has started and that have ended."""
    ended = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + ended.ru_utime + ended.ru_stime
