"""The folder of a small run: going on with it, and comparing with it."""

from __future__ import annotations

import sqlite3
import zlib
from contextlib import closing
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

from craftsim.checking.attempt import Attempt
from craftsim.experiments.compare import compare_paired
from craftsim.experiments.experiment import Experiment, Result, RunOptions, Trial
from craftsim.experiments.records import DATABASE, OLD, TRIALS, read_finished
from craftsim.experiments.session import open_session, run_experiment
from craftsim.experiments.statistics import campaign_figures
from craftsim.validation.audit import audit_rows
from craftsim.validation.forms import RUNS
from craftsim.validation.minimize import first_of_each_kind
from craftsim.validation.play import coverage_of
from craftsim.validation.report import runs_table

EXTRA = {
    "ticks": 2,
    "forbidden": 0,
    "makespan_s": 3.5,
    "grid_success": True,
    "physics_success": False,
    "coverage": {"MOVE 1": {"all": 2, "wall": 1, "~on slopes": 1}},
}


def _attempt(tick: int, result: str = "as predicted") -> Attempt:
    good = result == "as predicted"
    return Attempt(
        tick=tick,
        car=0,
        action="MOVE_LEFT",
        verb="MOVE",
        level=1,
        load="none",
        slope=False,
        legal=True,
        performed=True,
        result=result,
        skill="succeeded",
        finding="agrees" if good else "wrong place",
        reason="" if good else "blocked: 41 mm behind the path",
        differences=() if good else ("car 0: predicted 1,1,1 +x, read 0,1,1 +x",),
        predicted="1,1,1 +x",
        read="1,1,1 +x",
        placed_error_m=None if tick else 0.0003,
        car_error_m=0.0002,
        heading_error_rad=-0.001,
        height_error_m=0.0001,
        bystander_displacement_m=0.0,
        start_s=0.3,
        duration_s=1.0,
        peak_force_n=20.0,
    )


def _stored(number: int) -> Result:
    """Return the result of a trial."""
    return (
        Result(True, [_attempt(0), _attempt(1)], extra=EXTRA),
        Result(False, [_attempt(0), _attempt(1, "failed")], "bundles/strip-play-0001", EXTRA),
        Result(True, (), extra={**EXTRA, "does_not_stand": "two in one place"}),
    )[number]


EXPERIMENT = Experiment(
    *("validate", 7, {"worlds": {"strip": "shipped"}, "trials": 3, "setup": {"gains": [1.5, None]}}),
    *([Trial(f"strip/play/{i:04d}", "play", 7, i, "strip", i) for i in range(3)], _stored, RUNS),
)


@cache
def valid() -> tuple[bytes, bytes, bytes]:
    """Return the run's database, its manifest, and its lines."""
    with TemporaryDirectory() as folder:
        run_experiment(EXPERIMENT, place := Path(folder))
        with closing(sqlite3.connect(place / DATABASE)) as database:
            ((manifest,),) = database.execute("SELECT text FROM manifest")
        return (place / DATABASE).read_bytes(), manifest.encode(), (place / TRIALS).read_bytes()


def files() -> dict[str, bytes]:
    """Return the folder that a run is in."""
    return {DATABASE: valid()[0]}


def old_files() -> dict[str, bytes]:
    """Return that of a run of craftsim 0.2."""
    return {TRIALS: valid()[2], OLD: valid()[1]}


def resume(folder: Path) -> None:
    """Go on with a run."""
    with open_session(EXPERIMENT, folder, RunOptions(resume=True)) as session:
        left = [number for number, done in enumerate(session._done) if not done]
        assert not left or session.state.startswith(f"{3 - len(left)} of 3")


def against(folder: Path) -> None:
    """Compare with a run, and now and then do all else that commands do with its records, which takes long."""
    records = read_finished(folder, "validate", RUNS).records
    if sum(zlib.crc32(path.read_bytes()) for path in folder.iterdir()) % 50 == 0:
        campaign_figures(records, 0)
        coverage_of(records)
        runs_table(records)
        audit_rows(records)
        first_of_each_kind(records)
        compare_paired(records, records)
