"""The folder of a small run: going on with it, and comparing with it."""

from __future__ import annotations

import zlib
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

from validation.synthetic import attempt

from craftsim.audit.audit import audit_rows
from craftsim.checking.attempt import Attempt, Verdict
from craftsim.experiments.compare import compare_trials
from craftsim.experiments.experiment import Experiment, Result, RunOptions, Trial
from craftsim.experiments.minimize import first_of_each_kind
from craftsim.experiments.records import DATABASE, TRIALS_FILE, read_finished
from craftsim.experiments.session import open_session, run_experiment
from craftsim.experiments.statistics import campaign_figures
from craftsim.validation.play import coverage_of
from craftsim.validation.record_schemas import RUN_FORM
from craftsim.validation.report import runs_table

EXTRA = {
    "ticks": 2,
    "forbidden": 0,
    "makespan_s": 3.5,
    "grid_success": True,
    "physics_success": False,
    "coverage": {"MOVE 1": {"all": 2, "wall": 1, "~on slopes": 1}},
}


def _attempt(tick: int, result: Verdict = Verdict.AS_PREDICTED) -> Attempt:
    return Attempt.of(attempt(result, tick=tick, placed_error_m=None if tick else 0.0003))


def _stored(number: int) -> Result:
    """Return the result of a trial."""
    return (
        Result(True, [_attempt(0), _attempt(1)], extra=EXTRA),
        Result(False, [_attempt(0), _attempt(1, Verdict.FAILED)], "bundles/strip-play-0001", EXTRA),
        Result(True, (), extra={**EXTRA, "does_not_stand": "two in one place"}),
    )[number]


EXPERIMENT = Experiment(
    *(
        "validate",
        7,
        {"worlds": {"strip": "shipped"}, "trials": 3, "setup": {"gains": [1.5, None]}},
    ),
    *(
        [Trial(f"strip/play/{i:04d}", "play", 7, i, "strip", i) for i in range(3)],
        _stored,
        RUN_FORM,
    ),
)


@cache
def valid() -> tuple[bytes, bytes]:
    """Return the run's database, and its lines."""
    with TemporaryDirectory() as folder:
        run_experiment(EXPERIMENT, place := Path(folder))
        return (place / DATABASE).read_bytes(), (place / TRIALS_FILE).read_bytes()


def files() -> dict[str, bytes]:
    """Return the folder that a run is in."""
    return {DATABASE: valid()[0]}


def resume(folder: Path) -> None:
    """Go on with a run."""
    with open_session(EXPERIMENT, folder, RunOptions(resume=True)) as session:
        left = [number for number, done in enumerate(session._done) if not done]
        assert not left or session.state.startswith(f"{3 - len(left)} of 3")


def against(folder: Path) -> None:
    """Compare with a run, and now and then do all else that commands do with its records, which takes long."""
    records = read_finished(folder, "validate", RUN_FORM).records
    if sum(zlib.crc32(path.read_bytes()) for path in folder.iterdir()) % 50 == 0:
        campaign_figures(records, 0)
        coverage_of(records)
        runs_table(records)
        audit_rows(records)
        first_of_each_kind(records)
        compare_trials(records, records)
