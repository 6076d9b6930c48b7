"""What a run needs besides its trials is done by workers that may hang, die and be stopped as those of its trials."""

import os
import signal

import cheap_work
import pytest
from test_kills import _alive, _children, _start, _wait_for

from craftsim.errors import InputError
from craftsim.experiments.experiment import Done, Failure, RunOptions
from craftsim.experiments.session import open_session


def _map(out, items, options=RunOptions(workers=2), **more):  # noqa: B008
    with open_session(cheap_work.experiment(1), out, options) as session:
        session.run()
        return session.map("more", items, cheap_work.work, "testing", timeout_s=1.0, **more)


def test_what_goes_wrong_is_the_answer_and_harms_no_other(tmp_path):
    items = cheap_work.items(
        8, i1="raise", i3="die", i4="hang", i6=("die once", tmp_path / "died"), i7="exit"
    )
    seen = []
    answers = _map(tmp_path, items, on_answer=lambda number, answer: seen.append(number))
    assert sorted(seen) == list(range(8))
    assert {i: a.text for i, a in enumerate(answers) if isinstance(a, Failure)} == {
        1: "ValueError: no 1\nin two lines",
        3: "its worker process died, 2 times",
        4: "no answer within 1 s",
        7: "SystemExit: 3",
    }
    assert answers[6] == Done(True, [{"sum": 2.0}], extra={"number": 6})


def test_a_full_disk_stops_it_with_a_message(tmp_path):
    with pytest.raises(InputError, match=r"bundles/one: No space left on device; .*--resume"):
        _map(tmp_path, cheap_work.items(3, i1="disk"))


def test_nothing_to_do_starts_no_worker(tmp_path):
    with open_session(cheap_work.experiment(0), tmp_path) as session:
        assert session.map("more", [], cheap_work.work, "testing", timeout_s=1.0) == []
        assert session._pool is None


def test_what_was_done_is_not_done_again_when_a_run_goes_on(tmp_path):
    first = _map(tmp_path, cheap_work.items(3, i1="raise"))
    assert isinstance(first[1], Failure)
    again = _map(tmp_path, cheap_work.items(3, i0="die", i2="die"), RunOptions(resume=True))
    assert [again[0], again[2]] == [first[0], first[2]]
    assert again[1] == Done(True, [{"sum": 1 / 3}], extra={"number": 1})


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_no_signal_leaves_workers_behind(tmp_path, number):
    process = _start(tmp_path, what="after", start_new_session=True)
    _wait_for(lambda: list(tmp_path.glob("left-*")))
    workers = _children(process.pid)
    assert workers
    os.kill(process.pid, number)
    status = process.wait(60)
    _wait_for(lambda: not any(map(_alive, workers)))
    if number != signal.SIGKILL:
        assert status == 130
        said = f"interrupted: while leaving files; all trials are kept in {tmp_path}; the same command with --resume"
        assert process.stderr.read() == f"craftsim: {said} goes on\n"


def test_killed_workers_are_replaced_there_too(tmp_path):
    process = _start(tmp_path, what="after")
    _wait_for(lambda: list(tmp_path.glob("left-*")))
    for child in _children(process.pid)[-1:]:
        os.kill(child, signal.SIGKILL)
    assert process.wait(60) == 0, process.stderr.read()
    assert len(list(tmp_path.glob("left-*"))) == 40
