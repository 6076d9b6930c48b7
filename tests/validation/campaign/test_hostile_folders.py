"""Folders of runs that are foreign, damaged or hostile are refused before anything is tried, and stay as they are."""

import json
import os
import pickle
import sqlite3
import sys
import time
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import cheap_work
import pytest
from validation.campaign.sessions import cut_off, manifest_of, put

from craftsim.errors import InputError
from craftsim.experiments.experiment import (
    Result,
    RunOptions,
    Trial,
    answer_of,
    record_text,
)
from craftsim.experiments.minimize import _minimized
from craftsim.experiments.records import read_finished
from craftsim.experiments.session import open_session, run_experiment
from craftsim.storage.limits import MAX_ERROR_CHARACTERS, RECORD_BYTES
from craftsim.validation.record_schemas import RUN_FORM

sys.path.append(str(Path(__file__).parents[2] / "fuzzing"))
import campaign_folders

EXPERIMENT = replace(campaign_folders.EXPERIMENT, work=None)
"""Nothing of it may be tried."""


def _content(folder):
    return {
        path.name: path.read_bytes() if path.is_file() else path.stat().st_mode
        for path in folder.iterdir()
    }


@pytest.fixture
def unfinished(tmp_path):
    """Return the folder of a run of which two of three trials are done."""
    database, lines = campaign_folders.valid()
    (tmp_path / "session.db").write_bytes(database)
    (tmp_path / "trials.jsonl").write_bytes(lines)
    cut_off(tmp_path, (0, 1))
    return tmp_path


def _refused(folder, match, resume=True):
    before, begun = _content(folder), time.process_time()
    with pytest.raises(InputError, match=match):
        run_experiment(EXPERIMENT, folder, RunOptions(resume=resume))
    assert time.process_time() - begun < 10
    assert _content(folder) == before


@pytest.mark.parametrize("name", ["trials.jsonl", "durations.csv", "worlds"])
def test_what_no_run_of_ours_wrote_is_never_overwritten(tmp_path, name):
    if "." in name:
        (tmp_path / name).write_text("mine\n")
    else:
        (tmp_path / name).mkdir()
        (tmp_path / name / "mine").touch()
    for resume in (False, True):
        _refused(tmp_path, rf"holds {name}, but no session\.db .*put session\.db back", resume)


@pytest.mark.parametrize(
    ("name", "make"),
    [
        ("trials.jsonl", os.mkfifo),
        ("session.db", os.mkdir),
        ("session.db", lambda path: os.symlink("/dev/zero", path)),
        ("report.json", os.mkfifo),
        ("durations.csv", os.mkdir),
        ("bundles", Path.touch),
    ],
)
def test_what_is_of_another_kind_in_the_place_of_files_and_folders_is_refused(
    unfinished, name, make
):
    (unfinished / name).unlink(missing_ok=True)
    make(unfinished / name)
    _refused(unfinished, rf"{name}: not a (regular file|folder); .*another --out")


def _changed(**changes):
    return lambda record: json.dumps({**record, **changes}).encode()


def _attempted(**changes):
    return lambda record: json.dumps(
        {**record, "attempts": [{**record["attempts"][0], **changes}]}, allow_nan=True
    ).encode()


DAMAGED = {
    "a key is missing": (lambda r: json.dumps(r).replace("extra", "more").encode(), "extra' is missing"),
    "a text for a number": (_attempted(duration_s="1"), r"attempts\[0\]\.duration_s': .* number, not '1'"),
    "an unknown result": (_attempted(result="fine"), r"attempts\[0\]\.result': .*not 'fine'"),
    "a huge number": (_attempted(car_error_m=10**400), "finite"),
    "a bundle elsewhere": (_changed(bundle="../mine"), "bundle': .*folder in bundles/"),
    "a wrong extra": (_changed(extra={"ticks": 1, "forbidden": 0}), "extra': needs 'makespan_s'"),
    "a failure that agrees": (_changed(error="x", attempts=[]), "does not agree"),
    "nested brackets": (lambda r: b"[" * 300_000, "recursion limit"),
    "a lone surrogate": (lambda r: b'{"key": "\\ud800"}', "not JSON"),
}  # fmt: skip


@pytest.mark.parametrize("name", DAMAGED)
def test_a_damaged_record_is_named_before_anything_is_tried(unfinished, name):
    damage, message = DAMAGED[name]
    lines = (unfinished / "trials.jsonl").read_bytes().splitlines()
    data = damage(json.loads(lines[0]))
    put(unfinished, 0, data)
    _refused(
        unfinished,
        rf"session\.db: trial 0: not a trial's record: .*{message}.*choose another --out",
    )


@pytest.mark.parametrize("change", [{"items": 10**15}, {"command": 3}, {"keys": None}])
def test_a_damaged_manifest_is_refused(unfinished, change):
    record = (unfinished / "trials.jsonl").read_text().splitlines()[0]
    put(unfinished, 0, record, json.dumps({**manifest_of(unfinished), **change}))
    message = f"not a run's manifest: key '{next(iter(change))}': "
    _refused(unfinished, message)
    with pytest.raises(InputError, match=message):
        read_finished(unfinished, "validate", RUN_FORM)


def test_what_utf_8_cannot_say_is_recorded_as_an_escape_and_read_back(tmp_path):
    odd = [Trial("caf\udce9/0", "group \udce9", 7, (0, "odd"), "caf\udce9")]
    own = cheap_work.experiment(odd, "validate", {"worlds": {"caf\udce9": "shipped"}})
    (record,) = run_experiment(own, tmp_path)
    assert record["key"] == "caf\\udce9/0"
    assert record["error"] == "ValueError: \\ud800"
    assert read_finished(tmp_path, "validate").records == [record]
    assert run_experiment(own, tmp_path, RunOptions(resume=True))[0]["error"] is not None


def _verbose(job):
    raise ValueError("y" * 10**6)


def test_a_record_that_is_too_long_gives_way_to_a_failure(tmp_path):
    (item,) = cheap_work.items(1, i0=("text", RECORD_BYTES))
    (long,) = run_experiment(cheap_work.experiment([item]), tmp_path)
    assert long["error"] == "its record has 16 MiB; allowed: at most 16 MiB"
    said = json.loads(record_text(item, 0, answer_of(_verbose, None)))
    assert len(said["error"]) < MAX_ERROR_CHARACTERS + 10
    assert len(said["extra"]["traceback"]) < MAX_ERROR_CHARACTERS + 10


def test_records_stay_as_they_were_when_another_run_begins(tmp_path):
    own = cheap_work.experiment(3)
    records = run_experiment(own, tmp_path, RunOptions(workers=2))
    before = list(records)
    with open_session(own, tmp_path):
        assert records == before == records[:] == pickle.loads(pickle.dumps(records))
    assert [records[-1], records[1]] == [before[2], before[1]]
    with pytest.raises(IndexError):
        records[3]


@pytest.mark.parametrize(
    "text", ["{", "[1]", '{"agrees": 1}', '{"agrees": true, "more": 1}', b"\xff", 5]
)
def test_a_stored_answer_of_a_further_stage_that_is_none_is_refused(unfinished, text):
    with closing(sqlite3.connect(unfinished / "session.db")) as database, database:
        values = ("smallest", "bundles/00000", text)
        database.execute("INSERT INTO further VALUES (?, ?, CAST(? AS TEXT))", values)
    with (
        open_session(EXPERIMENT, unfinished, RunOptions(resume=True)) as session,
        pytest.raises(InputError, match=r"session\.db: .*another"),
    ):
        session.map("smallest", {"bundles/00000": 1}, None, "searching", timeout_s=1)


@pytest.mark.parametrize(
    ("extra", "match"),
    [
        ({}, "key 'key' is missing"),
        ({"key": "a", "sentence": "b", "rules": "c", "cells": 5}, "cells'"),
    ],
)
def test_a_stored_smallest_world_that_is_none_is_refused(tmp_path, extra, match):
    with pytest.raises(
        InputError, match=rf"session\.db: 'bundles/00000': .*{match}.*another --out"
    ):
        _minimized(tmp_path, "bundles/00000", Result(True, extra=extra))
