"""How the physics step decides results: what ``craftsim bench steps`` prints."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from statistics import median
from typing import TYPE_CHECKING, Any, Final

from craftsim.mjcf.parameters import Drive

if TYPE_CHECKING:
    from rich.console import Console

    from craftsim.checking.attempt import Attempt
    from craftsim.validation.audit.trial import Trial

STEPS_S: Final = (0.001, 0.002, 0.004, 0.005)
"""Physics steps, the finest first: all others are compared with it."""


@dataclass(frozen=True)
class Outcomes:
    """What came of all trials with one physics step."""

    attempts: tuple[tuple[Attempt, ...], ...]
    """By trial."""
    cpu_s: float

    def against(self, finest: Outcomes) -> dict[str, float]:
        """Return how these trials differ from the same with the finest step."""
        pairs = list(zip(self.attempts, finest.attempts, strict=True))
        alike = sum([a.agrees for a in one] == [a.agrees for a in other] for one, other in pairs)
        both = [
            (a, b)
            for one, other in pairs
            for a, b in zip(one, other, strict=True)
            if a.agrees and b.agrees and a.performed and b.performed
        ]
        return {
            "verdicts_alike": alike / len(pairs),
            "error_difference_m": max(abs(a.car_error_m - b.car_error_m) for a, b in both),
            "duration_ratio": median(a.duration_s / b.duration_s for a, b in both if b.duration_s),
            "peak_force_ratio": median(a.peak_force_n / b.peak_force_n for a, b in both if b.peak_force_n),
            "capped_steps": sum(a.capped_steps for one in self.attempts for a in one),
            "cpu_s": self.cpu_s / len(pairs),
        }


def bench_steps(console: Console, drive: Drive, contexts: int, seed: int) -> dict[str, Any]:
    """Print how verdicts, errors, durations and forces depend on the physics step; return the figures by step.

    Args:
        console: where to print.
        drive: of the cars.
        contexts: how many contexts of the audit of the published rules are tried, evenly from all, once each.
        seed: of the audit.
    """
    from rich.box import SIMPLE
    from rich.table import Table

    trials = _sample(drive, contexts, seed)
    found = {step: _try_all(trials, step) for step in STEPS_S}
    finest = found[STEPS_S[0]]
    table = Table(
        *("step ms", "verdicts alike", "error mm", "duration", "peak force", "at the cap", "CPU ms a trial"),
        title=f"{drive}: {len(trials)} trials against those with steps of {1e3 * STEPS_S[0]:g} ms",
        box=SIMPLE,
    )
    figures: dict[str, Any] = {}
    for step, outcomes in found.items():
        one = figures[f"{1e3 * step:.2f}"] = outcomes.against(finest)
        table.add_row(
            *(f"{1e3 * step:.2f}", f"{one['verdicts_alike']:.1%}", f"{1e3 * one['error_difference_m']:.2f}"),
            *(f"{one['duration_ratio']:.3f}", f"{one['peak_force_ratio']:.2f}", f"{one['capped_steps']}"),
            f"{1e3 * one['cpu_s']:.0f}",
        )
    console.print(table)
    return {"trials": len(trials), "steps_ms": figures}


def _sample(drive: Drive, contexts: int, seed: int) -> list[Trial]:
    from craftsim.checking.setup import setup_of
    from craftsim.validation.audit.rows import audit_plan
    from craftsim.validation.audit.trial import Trial, items_of

    setup = setup_of("none", "published", drive=drive)
    trials = [item.job for item in items_of(audit_plan("published"), 1, seed, setup)]
    found = [trial for trial in trials if isinstance(trial, Trial)]
    n = min(contexts, len(found))
    return [found[number * len(found) // n] for number in range(n)]


def _try_all(trials: Sequence[Trial], step_s: float) -> Outcomes:
    from craftsim.checking.attempt import Attempt
    from craftsim.validation.audit.trial import try_it

    begun = time.process_time()
    done = []
    for trial in trials:
        simulation = replace(trial.setup.simulation, timestep_s=step_s)
        found = try_it(replace(trial, setup=replace(trial.setup, simulation=simulation)))
        done.append(tuple(attempt for attempt in found.attempts if isinstance(attempt, Attempt)))
    return Outcomes(tuple(done), time.process_time() - begun)
