"""Mutated campaign folders: going on with one, and comparing with one, gives records or our own error."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from craftsim.checking.attempt import Attempt
from craftsim.commands.validate_text import runs_table
from craftsim.validation.campaign import Done, Header, Item, Records, read_finished
from craftsim.validation.campaign.header import CAMPAIGN
from craftsim.validation.campaign.items import make_record
from craftsim.validation.campaign.store import TRIALS, Store
from craftsim.validation.forms import RUNS
from craftsim.validation.play.play import Coverage
from craftsim.validation.shrinking.campaign import first_of_each_kind
from craftsim.validation.statistics.audit_rows import audit_rows
from craftsim.validation.statistics.figures import campaign_figures
from craftsim.validation.statistics.paired import compare_paired
from fuzzing.mutations import mutated_json

HEADER = Header("validate", 7, {"worlds": {"strip": "shipped"}, "trials": 3, "setup": {"gains": [1.5, None]}})
ITEMS = [Item(f"strip/play/{i:04d}", "play", 7, None, "strip", i) for i in range(3)]
EXTRA = {
    "ticks": 2,
    "forbidden": 0,
    "makespan_s": 3.5,
    "grid_success": True,
    "physics_success": False,
    "coverage": {"MOVE 1": {"all": 2, "wall": 1, "~on slopes": 1}},
}
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
def valid() -> tuple[bytes, bytes]:
    """Return the two files of a campaign."""
    with TemporaryDirectory() as folder:
        return _written(Path(folder))


def _written(place: Path) -> tuple[bytes, bytes]:
    answers = (
        Done(True, [attempt(0), attempt(1)], extra=EXTRA),
        Done(False, [attempt(0), attempt(1, result="failed")], "bundles/strip-play-0001", EXTRA),
        Done(True, (), extra={**EXTRA, "does_not_stand": "two in one place"}),
    )
    store = Store(place, HEADER, ITEMS, resume=False, form=RUNS)
    for index, answer in enumerate(answers):
        record = make_record(ITEMS[index], index, answer)
        record["attempts"] = [
            vars(one) | {"differences": list(one.differences)} for one in record["attempts"]
        ]
        store.append(record)
    store.finish()
    store.close()
    return (place / CAMPAIGN).read_bytes(), (place / TRIALS).read_bytes()


def _shuffled(lines: bytes, rng: np.random.Generator) -> bytes:
    """Return the lines in another order now and then, some of them twice or not at all."""
    if rng.random() < 0.8:
        return lines
    several = lines.splitlines(keepends=True)
    return b"".join(several[place] for place in rng.integers(0, len(several), len(several)))


def _folder(rng: np.random.Generator, folder: Path, chance_of_header: float) -> Path:
    header, trials = valid()
    in_header = rng.random() < chance_of_header
    place = folder / "out"
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir()
    (place / CAMPAIGN).write_bytes(mutated_json(header, rng) if in_header else header)
    (place / TRIALS).write_bytes(trials if in_header else mutated_json(_shuffled(trials, rng), rng))
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
    """Go on with a mutated campaign."""
    place = _folder(rng, folder, 0.2)
    store = Store(place, HEADER, ITEMS, resume=True, form=RUNS)
    try:
        list(store.kept())
        for index, item in list(store.missing()):
            store.append(make_record(item, index, Done(True, extra=EXTRA)))
        _use(rng, store.finish())
    finally:
        store.close()


def against(rng: np.random.Generator, folder: Path) -> None:
    """Compare with a mutated campaign."""
    _use(rng, read_finished(_folder(rng, folder, 0.3), "validate", RUNS).records)


TARGETS: dict[str, Callable[[np.random.Generator, Path], None]] = {"resume": resume, "against": against}
