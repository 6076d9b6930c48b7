"""A pool answers every job once, whatever becomes of its workers, and leaves none behind."""

import os

import jobs
import pytest

from craftsim.errors import CraftsimError
from craftsim.workers.pool import Failure, Pool

pytestmark = pytest.mark.usefixtures("spawned")


def _gone(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    return False


def test_every_job_is_answered_once_whatever_goes_wrong_with_its_batch(tmp_path):
    todo = [0, 1, "die", 3, ("die once", tmp_path / "died"), 5, "hang", 7]
    expected = {
        **{str(job): job * job for job in (0, 1, 3, 5, 7)},
        "die": Failure("its worker process died, 2 times"),
        "hang": Failure("no answer within 1 s"),
        str(todo[4]): "squared",
    }
    with Pool(2) as pool:
        found = list(pool.map_unordered(jobs.square, todo, timeout_s=1.0, batch=3))
    assert len(found) == len(todo)
    assert {str(job): answer for job, answer in found} == expected


def test_without_retries_one_death_is_enough():
    with Pool(1) as pool:
        assert list(pool.map_unordered(jobs.square, ["die"], retries=0)) == [
            ("die", Failure("its worker process died, 1 times"))
        ]


def test_what_a_function_raises_is_raised_here_and_the_pool_goes_on():
    for job, words in (("raise", "^no square$"), ("unsendable", "UnsendableError: 1")):
        with Pool(1) as pool:
            with pytest.raises(CraftsimError, match=words):
                list(pool.map_unordered(jobs.square, [job]))
            assert list(pool.map_unordered(jobs.square, [3])) == [(3, 9)]


def test_workers_and_their_copies_of_a_function_last_and_end_with_the_pool():
    count, again = jobs.Counter(), jobs.Counter()
    with Pool(3) as pool:
        answers = [answer for _ in range(2) for _, answer in pool.map_unordered(count, [None])]
        answers += [answer for _, answer in pool.map_unordered(again, [None])]
        (pid,) = {pid for pid, _ in answers}
        assert [n for _, n in answers] == [1, 2, 1]
        assert not _gone(pid)
    assert _gone(pid)


def test_jobs_are_taken_when_a_worker_is_free_and_who_stops_early_leaves_no_worker_at_work():
    taken = []

    def some():
        for number in range(100):
            taken.append(number)
            yield number

    with Pool(2) as pool:
        answers = pool.map_unordered(jobs.Counter(), some())
        _, (pid, _) = next(answers)
        assert len(taken) <= 6
        answers.close()
        assert list(pool.map_unordered(jobs.square, [4])) == [(4, 16)]
    assert _gone(pid)


def test_a_worker_that_never_starts_holds_no_job_back():
    with Pool(2) as pool:
        actor, made = pool._kind, []

        class OneStarts(actor):
            def __init__(self, make):
                super().__init__(jobs.never if made else make)
                made.append(self)

        pool._kind = OneStarts
        found = dict(pool.map_unordered(jobs.square, range(6), batch=2))
    assert found == {job: job * job for job in range(6)}
    assert len(made) == 2
