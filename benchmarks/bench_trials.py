"""What a trial of the audit costs, and how its result depends on the physics step: over trials from all of it."""

from dataclasses import replace
from statistics import median

import pytest

from craftsim.audit.audit import AuditTrial, run_trial, trials_of
from craftsim.audit.plan import audit_plan
from craftsim.checking.attempt import Attempt
from craftsim.checking.setup import setup_of
from craftsim.mjcf.drives import DRIVES

TRIALS = 60
STEPS_S = (0.001, 0.002, 0.004, 0.005)
"""Physics steps, the finest first: all others are compared with it."""


def sample(drive, preset):
    """Return some trials of the audit of the published rules, evenly from all of it."""
    found = [
        item.job
        for item in trials_of(
            audit_plan("published"), 1, 0, setup_of(preset, "published", drive=drive)
        )
    ]
    trials = [job for job in found if isinstance(job, AuditTrial)]
    return [trials[number * len(trials) // TRIALS] for number in range(TRIALS)]


@pytest.mark.parametrize("drive", DRIVES)
def test_a_trial(benchmark, drive):
    """Under mild randomization, another trial each round."""
    trials = iter(sample(drive, "mild"))
    benchmark.pedantic(
        run_trial, setup=lambda: ((next(trials),), {}), rounds=TRIALS - 1, warmup_rounds=1
    )


@pytest.mark.parametrize("step_s", STEPS_S)
@pytest.mark.parametrize("drive", DRIVES)
def test_the_physics_step(benchmark, drive, step_s):
    """What verdicts, errors, durations and forces become with other physics steps, beside the finest."""
    trials = sample(drive, "none")

    def try_all(seconds):
        timed = [
            replace(
                one,
                setup=replace(
                    one.setup, simulation=replace(one.setup.simulation, timestep_s=seconds)
                ),
            )
            for one in trials
        ]
        return [[a for a in run_trial(one).attempts if isinstance(a, Attempt)] for one in timed]

    found = benchmark.pedantic(try_all, args=(step_s,), rounds=1)
    finest = try_all(STEPS_S[0])
    pairs = [
        (a, b)
        for one, other in zip(found, finest, strict=True)
        for a, b in zip(one, other, strict=True)
    ]
    both = [(a, b) for a, b in pairs if a.agrees and b.agrees and a.performed and b.performed]
    benchmark.extra_info.update(
        verdicts_alike=sum(a.agrees == b.agrees for a, b in pairs) / len(pairs),
        error_difference_m=max(abs(a.car_error_m - b.car_error_m) for a, b in both),
        duration_ratio=median(a.duration_s / b.duration_s for a, b in both if b.duration_s),
        peak_force_ratio=median(a.peak_force_n / b.peak_force_n for a, b in both if b.peak_force_n),
        capped_steps=sum(a.capped_steps for a, _ in pairs),
    )
