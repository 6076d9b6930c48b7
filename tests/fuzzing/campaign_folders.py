"""Mutated folders of runs: going on with one, and comparing with one, gives records or our own error."""

from __future__ import annotations

import shutil
import sqlite3
from collections.abc import Callable
from contextlib import closing
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from craftsim.checking.attempt import Attempt
from craftsim.experiments.compare import compare_paired
from craftsim.experiments.experiment import Done, Experiment, Item, RunOptions
from craftsim.experiments.records import DATABASE, OLD, TRIALS, Records, read_finished
from craftsim.experiments.session import open_session, run_experiment
from craftsim.experiments.statistics import campaign_figures
from craftsim.validation.audit import audit_rows
from craftsim.validation.forms import RUNS
from craftsim.validation.minimize import first_of_each_kind
from craftsim.validation.play import Coverage
from craftsim.validation.report import runs_table
from fuzzing.mutations import mutated_bytes, mutated_json


def _stored(number: int) -> Done:
    """Return the result of a trial."""
    return (
        Done(True, [attempt(0), attempt(1)], extra=EXTRA),
        Done(False, [attempt(0), attempt(1, result="failed")], "bundles/strip-play-0001", EXTRA),
        Done(True, (), extra={**EXTRA, "does_not_stand": "two in one place"}),
    )[number]


CONFIG = {"worlds": {"strip": "shipped"}, "trials": 3, "setup": {"gains": [1.5, None]}}
ITEMS = [Item(f"strip/play/{i:04d}", "play", 7, i, "strip", i) for i in range(3)]
EXPERIMENT = Experiment("validate", 7, CONFIG, ITEMS, _stored, RUNS)
EXTRA = {
    "ticks": 2,
    "forbidden": 0,
    "makespan_s": 3.5,
    "grid_success": True,
    "physics_success": False,
    "coverage": {"MOVE 1": {"all": 2, "wall": 1, "~on slopes": 1}},
}
BYTES = 0.2
"""Share of the cases in which bytes of the database are mutated."""
USED = 0.01
"""Share of the accepted cases of which all figures are made, which takes long."""


def attempt(tick: int, legal: bool = True, result: str = "as predicted") -> Attempt:
    """Return an attempt."""
    good = result == "as predicted"
    return Attempt(
        tick=tick,
        car=0,
        action="MOVE_LEFT",
        verb="MOVE",
        level=1,
        load="none",
        slope=False,
        legal=legal,
        performed=legal,
        result=result,
        finding="agrees" if good else "wrong place",
        skill="succeeded",
        reason="" if good else "blocked: 41 mm behind the path",
        differences=() if good else ("car 0: predicted 1,1,1 +x, read 0,1,1 +x",),
        predicted="1,1,1 +x",
        read="1,1,1 +x",
        car_error_m=0.0002,
        heading_error_rad=-0.001,
        height_error_m=0.0001,
        placed_error_m=None if tick else 0.0003,
        bystander_displacement_m=0.0,
        start_s=0.3,
        duration_s=1.0,
        peak_force_n=20.0,
    )


@cache
def valid() -> tuple[bytes, bytes, bytes]:
    """Return a run's database, its manifest, and its lines."""
    with TemporaryDirectory() as folder:
        run_experiment(EXPERIMENT, place := Path(folder))
        with closing(sqlite3.connect(place / DATABASE)) as database:
            ((manifest,),) = database.execute("SELECT text FROM manifest")
        return (place / DATABASE).read_bytes(), manifest.encode(), (place / TRIALS).read_bytes()


def _shuffled(lines: bytes, rng: np.random.Generator) -> bytes:
    """Return the lines in another order now and then, some of them twice or not at all."""
    if rng.random() < 0.8:
        return lines
    several = lines.splitlines(keepends=True)
    return b"".join(several[place] for place in rng.integers(0, len(several), len(several)))


def _folder(rng: np.random.Generator, folder: Path, chance_of_manifest: float) -> Path:
    """Return a run's folder, of which the database's bytes, or the JSON in it, is mutated."""
    data, manifest, lines = valid()
    place = folder / "out"
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir()
    if rng.random() < BYTES:
        (place / DATABASE).write_bytes(mutated_bytes(data, rng))
        return place
    (place / DATABASE).write_bytes(data)
    with closing(sqlite3.connect(place / DATABASE)) as database, database:
        if rng.random() < chance_of_manifest:
            database.execute("UPDATE manifest SET text = ?", (_text(mutated_json(manifest, rng)),))
            return place
        database.execute("DELETE FROM trials")
        for number, line in enumerate(mutated_json(_shuffled(lines, rng), rng).splitlines()[:5]):
            database.execute("INSERT INTO trials VALUES (?, ?)", (number, _text(line)))
    return place


def _text(data: bytes) -> str | bytes:
    """Return a text where there is one."""
    try:
        return data.decode()
    except UnicodeDecodeError:
        return data


def _old_folder(rng: np.random.Generator, folder: Path) -> Path:
    """Return a mutated folder of craftsim 0.2."""
    _, manifest, lines = valid()
    in_manifest = rng.random() < 0.3
    place = folder / "out"
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir()
    (place / OLD).write_bytes(mutated_json(manifest, rng) if in_manifest else manifest)
    (place / TRIALS).write_bytes(lines if in_manifest else mutated_json(_shuffled(lines, rng), rng))
    return place


def _use(rng: np.random.Generator, records: Records) -> None:
    """Do with records all that a command does."""
    if rng.random() < USED:
        campaign_figures(records, 0)
        Coverage.of(records)
        runs_table(records)
        audit_rows(records)
        first_of_each_kind(records)
        compare_paired(records, records)


def resume(rng: np.random.Generator, folder: Path) -> None:
    """Go on with a mutated run."""
    place = _folder(rng, folder, 0.2)
    with open_session(EXPERIMENT, place, RunOptions(resume=True)) as session:
        left = [number for number, done in enumerate(session._done) if not done]
        assert not left or session.state.startswith(f"{3 - len(left)} of 3")


def against(rng: np.random.Generator, folder: Path) -> None:
    """Compare with a mutated run, of craftsim 0.2 half of the time."""
    place = _folder(rng, folder, 0.3) if rng.random() < 0.5 else _old_folder(rng, folder)
    _use(rng, read_finished(place, "validate", RUNS).records)


TARGETS: dict[str, Callable[[np.random.Generator, Path], None]] = {"resume": resume, "against": against}
