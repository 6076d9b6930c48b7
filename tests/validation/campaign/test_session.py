"""The folder of a run is what it says, or the user is told what is wrong with it."""

import json
import sqlite3
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import replace

import cheap_work
import pytest
from owner import owner
from validation.campaign.sessions import cut_off, manifest_of, put

from craftsim.errors import InputError
from craftsim.experiments.experiment import RunOptions
from craftsim.experiments.records import read_finished
from craftsim.experiments.session import open_session, run_experiment

EXPERIMENT = cheap_work.experiment(
    4, config={"trials": 1, "by": {"yard": "f9"}, "nested": {"a": [1.5]}}
)
RESUME = RunOptions(resume=True)


@pytest.fixture
def begun(tmp_path):
    """Return the folder of a run of which trials 0 and 2 are finished."""
    run_experiment(EXPERIMENT, tmp_path)
    cut_off(tmp_path, (0, 2))
    return tmp_path


def _resume(out, experiment=EXPERIMENT):
    """Return the numbers of the trials that are tried, the others being kept."""
    with open_session(experiment, out, RESUME) as session:
        return [n for n in range(len(experiment.items)) if not session._done[n]]


def test_what_is_missing_is_done_and_the_lines_are_those_of_a_run_that_was_never_cut_off(
    begun, tmp_path_factory
):
    whole = tmp_path_factory.mktemp("whole")
    records = run_experiment(EXPERIMENT, whole)
    with pytest.raises(InputError, match=r"unfinished run \(2 of 4 trials\): go on with --resume"):
        run_experiment(EXPERIMENT, begun)
    assert _resume(begun) == [1, 3]
    lines = (begun / "trials.jsonl").read_text().splitlines()
    assert [json.loads(line)["index"] for line in lines] == [0, 2], "the torn line is gone"
    assert run_experiment(EXPERIMENT, begun, RESUME) == records
    assert (begun / "trials.jsonl").read_bytes() == (whole / "trials.jsonl").read_bytes()
    assert sorted(path.name for path in begun.iterdir()) == ["session.db", "trials.jsonl"]


@pytest.mark.parametrize("workers", [1, 2])
def test_some_trials_are_tried_with_jobs_of_their_own_and_once(tmp_path, workers):
    for _ in range(2):
        seen = []
        with open_session(EXPERIMENT, tmp_path, RunOptions(workers, resume=True)) as session:
            first = session.run_some({1: (5, "add"), 0: (3, "add")}, seen.append)
        assert [record["extra"]["number"] for record in first] == [5, 3]
        assert sorted(record["index"] for record in seen) == [0, 1]
    records = run_experiment(EXPERIMENT, tmp_path, RESUME)
    assert [record["extra"]["number"] for record in records] == [3, 5, 2, 3]
    lines = (tmp_path / "trials.jsonl").read_text().splitlines()
    assert list(map(json.loads, lines)) == records
    failing = pytest.raises(InputError, match="item 0: ValueError: no 0")
    with failing, open_session(EXPERIMENT, tmp_path / "failing") as session:
        session.run_some({0: (0, "raise")}, lambda record: None)


def test_a_record_of_no_trial_is_named(begun):
    record = json.loads((begun / "trials.jsonl").read_text().splitlines()[0])
    put(begun, 0, json.dumps({**record, "key": "stranger"}))
    with pytest.raises(InputError, match=r"session\.db: trial 0, 'stranger', is none of this run"):
        _resume(begun)
    put(begun, 0, json.dumps({**record, "index": 1}))
    with pytest.raises(InputError, match=r"trial 0 says that it is 1"):
        _resume(begun)
    put(begun, 9, json.dumps({**record, "index": 9}))
    with pytest.raises(InputError, match=r"holds trial 9 of 4"):
        _resume(begun)


def test_another_experiment_or_version_is_not_resumed(begun):
    first, *others = EXPERIMENT.items
    for changes, key in (
        ({"seed": 8}, "seed is 7, not 8"),
        ({"config": {**EXPERIMENT.config, "trials": 2}}, "trials is 1, not 2"),
        (
            {"config": {**EXPERIMENT.config, "by": {"yard": "e8"}}},
            "plan or policy yard is 'f9', not 'e8'",
        ),
        ({"command": "other"}, "command is 'test', not 'other'"),
        ({"items": EXPERIMENT.items[:3]}, "items is 4, not 3"),
        ({"items": [replace(first, key="x"), *others]}, "keys is "),
    ):
        with pytest.raises(InputError, match=f"its {key}"):
            _resume(begun, replace(EXPERIMENT, **changes))
    manifest = manifest_of(begun)
    manifest["versions"]["mujoco"] = "0.1"
    put(begun, 0, (begun / "trials.jsonl").read_text().splitlines()[0], json.dumps(manifest))
    with pytest.raises(InputError, match=r"versions\.mujoco"):
        _resume(begun)


def test_a_finished_run_gives_way_to_another_with_all_that_it_left(begun):
    records = run_experiment(EXPERIMENT, begun, RESUME)
    before = list(records)
    (begun / "report.json").write_text("{}")
    for name in ("report.html", "durations.csv"):
        (begun / name).touch()
    for name in ("bundles", "films", "worlds", "smallest"):
        (begun / name).mkdir()
        (begun / name / "old").touch()
    (begun / "mine.txt").touch()
    with open_session(EXPERIMENT, begun):
        pass
    assert sorted(path.name for path in begun.iterdir()) == [
        "mine.txt",
        "session.db",
        "trials.jsonl",
    ]
    assert (begun / "trials.jsonl").read_bytes() == b""
    assert list(records) == before, "they stay as they are"


def test_one_process_at_a_time_has_a_folder(begun):
    with (
        owner(begun),
        pytest.raises(InputError, match="is in use: another craftsim writes into it"),
    ):
        _resume(begun)
    with (
        open_session(EXPERIMENT, begun, RESUME),
        ThreadPoolExecutor(1) as other,
        pytest.raises(InputError, match="is in use"),
    ):
        other.submit(_resume, begun).result()
    _resume(begun)


def test_who_has_the_database_open_is_named_too(begun):
    with closing(sqlite3.connect(begun / "session.db")) as other:
        other.execute("BEGIN EXCLUSIVE")
        with pytest.raises(InputError, match="is in use: another craftsim writes into it"):
            _resume(begun)
    assert _resume(begun) == [1, 3]


@pytest.mark.parametrize(
    "content",
    [
        b"nonsense" * 200,
        b"SQLite format 3\0" + b"\xff" * 4080,
        "CREATE TRIGGER t AFTER INSERT ON trials BEGIN DELETE FROM trials; END",
        "CREATE VIEW v AS WITH RECURSIVE r(n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM r) SELECT n FROM r",
    ],
)
def test_what_is_no_database_or_would_do_work_of_its_own_is_refused(begun, content):
    if isinstance(content, bytes):
        (begun / "session.db").write_bytes(content)
    else:
        with closing(sqlite3.connect(begun / "session.db")) as database, database:
            database.execute(content)
    for read in (_resume, lambda folder: read_finished(folder, "test")):
        with pytest.raises(InputError, match=r"session\.db: not a run's database"):
            read(begun)


def test_a_database_whose_tables_are_damaged_is_refused(begun):
    path = begun / "session.db"
    path.write_bytes(path.read_bytes().replace(b"CREATE TABLE trials", b"CREATE \x9eABLE trials"))
    for read in (_resume, lambda folder: read_finished(folder, "test")):
        with pytest.raises(InputError, match=r"session\.db: not a run's database"):
            read(begun)


def test_nothing_that_a_link_in_the_folder_points_to_is_changed(begun, tmp_path_factory):
    elsewhere = tmp_path_factory.mktemp("elsewhere")
    (elsewhere / "precious").write_text("a line without an end")
    for name in ("trials.jsonl", "session.db-wal", "session.db-journal"):
        (begun / name).unlink(missing_ok=True)
        (begun / name).symlink_to(elsewhere / "precious")
        with pytest.raises(InputError, match=rf"{name}: not a regular file"):
            _resume(begun)
        (begun / name).unlink()
    for name in ("bundles", "trajectories", "worlds"):
        (begun / name).symlink_to(elsewhere)
        for options in (RunOptions(), RESUME):
            with pytest.raises(InputError, match=f"{name}: not a folder; move it away"):
                run_experiment(EXPERIMENT, begun, options)
        (begun / name).unlink()
    assert (elsewhere / "precious").read_text() == "a line without an end"
    _resume(begun)


def test_without_a_folder_all_is_tried_in_this_process(tmp_path):
    own = cheap_work.experiment(3, work=lambda job: cheap_work.work(job))
    with open_session(own, None) as session:
        records = session.run()
    assert records == run_experiment(cheap_work.experiment(3), tmp_path)
