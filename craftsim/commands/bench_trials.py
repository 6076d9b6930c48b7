"""Measure what a trial of the audit costs, and where it goes: what ``craftsim bench trials`` prints."""

from __future__ import annotations

import resource
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from statistics import median
from typing import TYPE_CHECKING, Any, Final
from unittest.mock import patch

from craftsim.mjcf.parameters import Drive

if TYPE_CHECKING:
    from rich.console import Console

    from craftsim.validation.audit.trial import Trial

MOST: Final = 3
"""Trials of one context that are timed: more would make setting up look cheaper than most contexts have it."""

_FIRST_STEP: Final = """
from craftsim.envs import parallel_env
env = parallel_env("simple_two_story", "physics")
env.reset(seed=0)
env.step({agent: 0 for agent in env.agents})
"""

STAGES: Final = {
    "draw": "the world drawn and written down",
    "compile": "compiled, or taken from those kept",
    "stand": "at rest at nominal physics, and read",
    "set up": "physics drawn, at rest again, sensors and judge",
    "act": "the action, and the judgement",
}
"""What a trial goes through, by its name in the report."""


def bench_trials(console: Console, drive: Drive, contexts: int, seed: int) -> dict[str, Any]:
    """Print what a trial of the audit of the published rules costs under mild randomization; return the figures.

    Args:
        console: where to print.
        drive: of the cars.
        contexts: how many contexts to take, evenly from all of the audit.
        seed: of the audit.
    """
    import mujoco
    from rich.box import SIMPLE
    from rich.table import Table

    costs: list[dict[str, float]] = []
    steps = _Stopwatch(mujoco.mj_step)
    with patch.object(mujoco, "mj_step", steps):
        sample = _sample(drive, contexts, seed)
        _time(sample[0])  # compiles the rules, and reads files
        steps.n, steps.seconds = 0, 0.0
        for trials in sample:
            costs.append(_time(trials))
    total = {stage: sum(cost[stage] for cost in costs) for stage in STAGES}
    ms = median(1e3 * sum(cost.values()) for cost in costs)
    table = Table("stage", "what", "median ms", "share", title="CPU time of a trial", box=SIMPLE)
    shares = {stage: seconds / sum(total.values()) for stage, seconds in total.items()}
    medians = {stage: median(1e3 * cost[stage] for cost in costs) for stage in STAGES}
    for stage, what in STAGES.items():
        table.add_row(stage, what, f"{medians[stage]:.1f}", f"{shares[stage]:.0%}")
    console.print(table)
    weighted = sum(sum(cost.values()) * len(trials) for cost, trials in zip(costs, sample, strict=True))
    physics = steps.seconds / weighted
    console.print(
        f"median of {len(costs)} contexts: {ms:.0f} ms a trial; {physics:.0%} of all is MuJoCo's in "
        f"{steps.n:,} physics steps, {1e6 * steps.seconds / max(steps.n, 1):.0f} us each"
    )
    first_s = _first_step_s()
    console.print(
        f"first step of an environment in physics: {first_s:.1f} s of CPU time from the start of its process"
    )
    return {
        "median_ms": ms,
        "stage_ms": medians,
        "stage_shares": shares,
        "physics_share": physics,
        "first_step_s": first_s,
    }


def _first_step_s() -> float:
    """Return the CPU seconds of a process from its start to its first step, the rules having been compiled before."""
    for _ in range(2):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run([sys.executable, "-P", "-c", _FIRST_STEP], check=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


class _Stopwatch:
    """A function whose calls are counted and timed, in CPU seconds."""

    def __init__(self, function: Callable[..., None]) -> None:
        self.function = function
        self.n, self.seconds = 0, 0.0

    def __call__(self, *args: Any) -> None:
        begun = time.process_time()
        self.function(*args)
        self.seconds += time.process_time() - begun
        self.n += 1


def _sample(drive: Drive, contexts: int, seed: int) -> list[list[Trial]]:
    """Return the first trials of some contexts of the audit."""
    from craftsim.checking.setup import setup_of
    from craftsim.commands.audit import OPTIONS
    from craftsim.validation.audit.rows import audit_plan
    from craftsim.validation.audit.trial import Trial, items_of

    trials: dict[str | None, list[Trial]] = defaultdict(list)
    for item in items_of(
        audit_plan(OPTIONS.rules), OPTIONS.trials, seed, setup_of("mild", OPTIONS.rules, drive=drive)
    ):
        if isinstance(item.job, Trial):
            trials[item.context].append(item.job)
    found = list(trials.values())
    n = min(contexts, len(found))
    return [found[number * len(found) // n][:MOST] for number in range(n)]


def _time(trials: Sequence[Trial]) -> dict[str, float]:
    """Return the CPU seconds of each stage of a trial, the mean over trials of one context."""
    from craftsim.checking.episode import do, run_up
    from craftsim.validation.audit.trial import physics_of, recipe_of, why_not_standing

    spent = dict.fromkeys(STAGES, 0.0)

    @contextmanager
    def stage(name: str) -> Iterator[None]:
        begun = time.process_time()
        yield
        spent[name] += (time.process_time() - begun) / len(trials)

    for trial in trials:
        with stage("draw"):
            recipe = recipe_of(trial)
        with stage("compile"):
            physics = physics_of(trial)
        with stage("stand"):
            problems = why_not_standing(trial)
        if problems:
            continue
        with stage("set up"):
            judge = run_up(recipe, physics)
        with stage("act"):
            do(judge, recipe.steps[-1])
    return spent
