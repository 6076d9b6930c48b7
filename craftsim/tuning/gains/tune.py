"""Tuning gains: search on some seeds, choose on others, and judge on seeds that had no part in either."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

from craftsim.checking.setup import Setup
from craftsim.experiments.experiment import Experiment, RunOptions
from craftsim.experiments.session import open_session
from craftsim.skills.gains import Gains
from craftsim.tuning.goal import Goal
from craftsim.tuning.gains.knobs import Knob, Subject, turned
from craftsim.tuning.gains.phases import Candidate, Effect, Phases, TuningPlan
from craftsim.tuning.gains.search import need_cma
from craftsim.tuning.gains.trials import FORM, try_gains
from craftsim.tuning.gains.verdict import HeldOut

COMMAND: Final = "tune"
GAINS_FILE: Final = "gains.yaml"


@dataclass(frozen=True)
class Tuned:
    """The result of a tuning."""

    goal: Goal
    knobs: tuple[Knob, ...]
    gains: Gains
    """The best; those of the start where nothing better was found."""
    verdict: HeldOut
    failures: Sequence[tuple[str, Mapping[str, Any]]]
    """The trials on held-out seeds that failed, with the gains that they were tried with: before, after or shipped."""
    finalists: Sequence[Candidate]
    """On fresh seeds, first the chosen one; of a front those that are on it."""
    searched: Sequence[Candidate]
    """All that were tried, in order; first the start."""
    sensitivity: Mapping[str, Effect]
    """Of each gain, around the result."""
    config: Mapping[str, Any]
    seed: int
    wall_s: float


def tune(
    subject: Subject,
    setup: Setup,
    out: Path,
    *,
    goal: Goal,
    evaluations: int,
    trials: int,
    seed: int,
    options: RunOptions,
) -> Tuned:
    """Tune gains, and return the best with the verdict on them.

    Every evaluation is in ``out/trials.jsonl`` as soon as it is known. Equal arguments give equal results at any number
    of workers, and whether the tuning was cut off and resumed or not.

    Args:
        subject: which gains.
        setup: configuration of the physics, with the gains to start from.
        out: the folder.
        goal: what is wanted.
        evaluations: candidates to try, about: whole generations of each search, at least one.
        trials: of each situation, for every candidate.
        seed: decides the candidates, and the physics and noise of all trials.
        options: how.

    Raises InputError where cma is missing, and for a folder that holds something else.
    """
    need_cma()
    started = time.perf_counter()
    plan = TuningPlan(subject, setup, goal, evaluations, trials, seed)
    items = plan.items()
    config = {
        "subject": subject,
        "goal": goal,
        "evaluations": plan.n_search,
        "trials": trials,
        "setup": setup,
        "digests": setup.digests,
    }
    experiment = Experiment(COMMAND, seed, config, items, try_gains, FORM)
    with (
        open_session(experiment, out, options) as session,
        options.progress(len(items)) as on_record,
    ):
        # Of an earlier tuning in this folder.
        (out / GAINS_FILE).unlink(missing_ok=True)
        phases = Phases(plan, partial(session.run_some, on_record=on_record))
        searched, favourites = phases.search()
        finalists = phases.finals(searched, favourites)
        verdict, failures = phases.judge(finalists[0])
        values = finalists[0].values if verdict.improved else plan.start
        sensitivity = phases.sensitivity(values)
    gains = turned(setup.gains, plan.knobs, values) if verdict.improved else setup.gains
    wall_s = time.perf_counter() - started
    return Tuned(
        *(goal, plan.knobs, gains, verdict, failures, finalists, searched, sensitivity, config, seed, wall_s)
    )
