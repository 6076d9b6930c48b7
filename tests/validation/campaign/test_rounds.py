"""Trials that run in rounds until a rule has decided: the same ones at any number of workers, and after a cut."""

import itertools
import sqlite3
from contextlib import closing

import cheap_work
import pytest

from craftsim.errors import InputError
from craftsim.experiments.experiment import RunOptions
from craftsim.experiments.records import read_finished
from craftsim.experiments.session import open_session


class UpTo:
    """Decides on a group after as many trials as its limit says."""

    def __init__(self, **limits):
        self.limits = limits
        self.seen = dict.fromkeys(limits, 0)

    def subject_of(self, trial):
        return trial.group.replace(" ", "_")

    def order_of(self, trial):
        return -trial.job[0]

    def round_sizes(self):
        return itertools.chain([1], itertools.repeat(2))

    def is_decided(self, subject, records):
        self.seen[subject] += len(records)
        return self.seen[subject] >= self.limits[subject]


EXPERIMENT = cheap_work.experiment(20)
LIMITS = {"group_0": 1, "group_1": 4}
EXPECTED = [11, 13, 15, 17, 18, 19]
"""Numbers of the trials that run: the largest first, 1 of one group, 1 + 2 + 2 of the other."""


def _run(folder, rule, **options):
    with open_session(EXPERIMENT, folder, RunOptions(**options)) as session:
        return list(session.run(rule))


@pytest.mark.parametrize("workers", [1, 2])
def test_only_what_is_needed_runs_and_the_run_is_finished(tmp_path, workers):
    records = _run(tmp_path, UpTo(**LIMITS), workers=workers)
    assert [record["index"] for record in records] == EXPECTED
    finished = read_finished(tmp_path, "test")
    assert list(finished.records) == records
    assert finished.records[-1]["index"] == 19
    assert finished.records[1:3] == records[1:3]
    assert len((tmp_path / "trials.jsonl").read_text().splitlines()) == len(EXPECTED)
    # Begun anew in its folder, as any finished run.
    assert _run(tmp_path, UpTo(**LIMITS)) == records


def test_without_a_folder_it_is_the_same(tmp_path):
    assert _run(None, UpTo(**LIMITS)) == _run(tmp_path, UpTo(**LIMITS))


def test_a_group_that_stays_undecided_runs_all_its_trials():
    records = _run(None, UpTo(group_0=99, group_1=99))
    assert [record["index"] for record in records] == list(range(20))


def test_a_run_that_was_cut_off_is_unfinished_and_goes_on(tmp_path):
    whole = _run(tmp_path / "whole", UpTo(**LIMITS))
    cut = tmp_path / "cut"
    _run(cut, UpTo(**LIMITS))
    with closing(sqlite3.connect(cut / "session.db")) as database, database:
        database.execute("DELETE FROM further")
        database.execute("DELETE FROM trials WHERE number NOT IN (17, 19)")
    with pytest.raises(InputError, match=r"unfinished run \(2 of 20 trials\)"):
        read_finished(cut, "test")
    assert _run(cut, UpTo(**LIMITS), resume=True) == whole
    assert _run(cut, UpTo(**LIMITS), resume=True) == whole, "nothing is left to do"


def test_a_trial_with_an_error_is_repeated_and_may_be_decided_otherwise(tmp_path):
    experiment = cheap_work.experiment(cheap_work.items(20, i19="raise"))
    with open_session(experiment, tmp_path, RunOptions()) as session:
        records = session.run(UpTo(**LIMITS))
        assert records[-1]["error"] is not None
    with open_session(experiment, tmp_path, RunOptions(resume=True)) as session:
        assert [record["index"] for record in session.run(UpTo(group_0=3, group_1=4))] == [
            11,
            13,
            14,
            15,
            16,
            17,
            18,
            19,
        ]
