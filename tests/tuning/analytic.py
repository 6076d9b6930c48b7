"""Trials of a world without physics, for tests: an action takes longest with bad gains, and fails with wild ones."""

from contextlib import contextmanager

from craftsim.experiments.experiment import Result, make_record
from craftsim.tuning.tunable import tunable_gains
from craftsim.tuning.tune import Job, PlanJob

BEST = {"board.gain": 40.0, "board.acceleration": 1.0}


def values_of(job: Job | PlanJob) -> dict[str, float]:
    """Return the tuned gains of a candidate, by name."""
    if isinstance(job, PlanJob):
        group = job.group
        setup = job.setup
    else:
        group, setup, _, _ = job
    return {gain.name: gain.of(setup.gains) for gain in tunable_gains(group, setup.gains)}


def trials_of(job: Job) -> list[dict]:
    """Quickest where the gains are best; far from the limit where they are small."""
    found, values = [], values_of(job).items()
    for block in job[-1]:
        miss = sum((value / BEST[name] - 1) ** 2 for name, value in values)
        size = sum(value / BEST[name] for name, value in values)
        found.append(
            {
                "situation": "LIFT",
                "block": block,
                "agrees": size < 8,
                "duration_s": (1 + miss) * (1 + 0.01 * block),
                "error_share": 0.2,
                "used_share": min(1.0, 0.1 * size),
                "energy_j": size,
                "peak_force_n": 100.0,
            }
        )
    return found


class AnalyticSession:
    """A session that needs no workers; counts what was asked for."""

    def __init__(self, items, lose, other):
        self.items, self.lose, self.other, self.jobs = items, lose, other, {}

    def run_some(self, jobs, on_record):
        assert not set(jobs) & set(self.jobs), "done twice"
        self.jobs |= jobs
        records = []
        for number, job in jobs.items():
            loses = self.lose(job)
            trials = [] if isinstance(job, PlanJob) else trials_of(job)
            if loses:
                trials = [{**trial, "agrees": False} for trial in trials]
            done = Result(not loses, trials, extra={"gains": values_of(job) | self.other})
            records.append(make_record(self.items[number], number, done))
            on_record(records[-1])
        return records


def opener(made, lose=lambda job: False, other=None):
    """What stands for open_session; ``made`` gets the session, and ``other`` gains stand in their records."""

    @contextmanager
    def open_it(experiment, out, options):
        made.append(AnalyticSession(experiment.items, lose, other or {}))
        yield made[-1]
        assert set(made[-1].jobs) == set(range(len(experiment.items))), "not all was done"

    return open_it
