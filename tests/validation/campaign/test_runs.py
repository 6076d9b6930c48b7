"""Every trial gets one record, whatever becomes of it, at any number of workers, killed, interrupted or out of room."""

import json
import os
import resource
import signal
import subprocess
import sys
import time
from contextlib import nullcontext
from pathlib import Path

import cheap_work
import pytest

from craftsim.errors import InputError
from craftsim.experiments.experiment import Failure, Result, RunOptions
from craftsim.experiments.records import read_finished
from craftsim.experiments.session import Session, open_session, run_experiment
from craftsim.workers import interrupts

SCRIPT = Path(__file__).parent / "run_cheap.py"
LIMIT = 1 << 16
"""Bytes that a file may have on a small disk."""


def _run(out, items, batch=1, timeout_s=60.0, **options):
    return run_experiment(
        cheap_work.experiment(items, batch=batch, timeout_s=timeout_s), out, RunOptions(**options)
    )


def test_what_goes_wrong_with_an_item_is_its_record_and_harms_no_other(tmp_path):
    items = cheap_work.items(
        16,
        i3="raise",
        i5="die",
        i6=("die once", tmp_path / "died"),
        i9="exit",
        i11="hang",
        i13="nan",
    )
    options = {"timeout_s": 1.0}
    one = _run(tmp_path / "one", items, **options)
    assert [record["key"] for record in one] == [item.key for item in items]
    assert {record["index"]: record["error"] for record in one if record["error"]} == {
        3: "ValueError: no 3\nin two lines",
        5: "its worker process died, 2 times",
        9: "SystemExit: 3",
        11: "no answer within 1 s",
    }
    assert one[3]["extra"]["traceback"].startswith("Traceback")
    assert one[6]["agrees"]
    assert one[6]["extra"] == {"number": 6}
    assert one[13]["attempts"] == [{"error_m": None}]
    (tmp_path / "died").unlink()
    assert _run(tmp_path / "two", items, workers=2, batch=2, **options) == one
    lines = [(tmp_path / name / "trials.jsonl").read_text() for name in ("one", "two")]
    assert lines[0] == lines[1]
    assert [json.loads(line) for line in lines[0].splitlines()] == one


def test_a_full_disk_in_a_worker_stops_the_campaign_and_resume_tries_again_what_had_an_error(
    tmp_path,
):
    items = cheap_work.items(5, i1="raise", i3="disk")
    with pytest.raises(InputError, match=r"bundles/one: No space left on device; .*--resume"):
        _run(tmp_path, items)
    seen = []
    progress = lambda total: nullcontext(lambda record: seen.append(record["index"]))  # noqa: E731
    records = _run(tmp_path, cheap_work.items(5), resume=True, progress=progress)
    assert sorted(seen) == [0, 1, 2, 3, 4]
    assert all(record["agrees"] for record in records)


def test_too_little_memory_in_a_worker_stops_the_campaign_and_says_so(tmp_path):
    with pytest.raises(
        InputError,
        match=r"too little memory.*'ulimit -v'.*then --resume; what was finished is kept",
    ):
        _run(tmp_path, cheap_work.items(5, i3="memory"))
    assert all(record["agrees"] for record in _run(tmp_path, cheap_work.items(5), resume=True))


def _map(out, items, options=RunOptions(workers=2), **more):  # noqa: B008
    with open_session(cheap_work.experiment(1), out, options) as session:
        session.run()
        jobs = {item.key: item.job for item in items}
        return session.map("more", jobs, cheap_work.work, "testing", timeout_s=1.0, **more)


def test_a_stage_has_an_answer_for_each_item_and_what_was_done_is_not_done_again(tmp_path):
    seen = []
    items = cheap_work.items(4, i1="raise", i3="hang")
    answers = _map(tmp_path, items, on_answer=lambda key, answer: seen.append(key))
    assert sorted(seen) == [item.key for item in items] == list(answers)
    failures = {key: a.text for key, a in answers.items() if isinstance(a, Failure)}
    assert failures == {
        "item 1": "ValueError: no 1\nin two lines",
        "item 3": "no answer within 1 s",
    }
    again = _map(tmp_path, cheap_work.items(4, i0="die", i2="die"), RunOptions(resume=True))
    assert all(again[key] == answers[key] for key in ("item 0", "item 2"))
    assert again["item 1"] == Result(True, [{"sum": 1 / 3}], extra={"number": 1})
    with pytest.raises(InputError, match=r"bundles/one: No space left on device; .*--resume"):
        _map(tmp_path / "full", cheap_work.items(3, i1="disk"))


def test_nothing_to_do_starts_no_worker(tmp_path):
    with open_session(cheap_work.experiment(0), tmp_path) as session:
        assert session.map("more", {}, cheap_work.work, "testing", timeout_s=1.0) == {}
        assert session._pool is None


def test_it_is_read_back_whole_and_of_its_command_alone(tmp_path):
    items = cheap_work.items(3, i1="raise")
    expected = list(
        run_experiment(cheap_work.experiment(items, "validate", {"trials": 3}), tmp_path)
    )
    found = read_finished(tmp_path, "validate")
    assert found.records == expected
    assert (found.manifest["seed"], found.manifest["config"]) == (7, {"trials": 3})
    with pytest.raises(InputError, match="holds a run of 'craftsim validate'"):
        read_finished(tmp_path, "audit")
    with pytest.raises(InputError, match="holds no run"):
        read_finished(tmp_path / "nowhere", "validate")


def _start(out, *options, what="cheap", **popen):
    words = [sys.executable, str(SCRIPT), str(out), what, *options]
    return subprocess.Popen(words, stderr=subprocess.PIPE, text=True, **popen)


def _finished(out):
    path = out / "trials.jsonl"
    return path.read_bytes().count(b"\n") if path.exists() else 0


def _wait_for(condition, limit_s=60.0):
    end = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < end, "it did not happen in time"
        time.sleep(0.005)


def _children(pid):
    found = subprocess.run(["pgrep", "-P", str(pid)], capture_output=True, text=True, check=False)
    return [int(word) for word in found.stdout.split()]


def _alive(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except FileNotFoundError:
        return False


def test_a_campaign_whose_workers_or_itself_are_killed_or_interrupted_goes_on_to_the_same_result(
    tmp_path,
):
    out = tmp_path / "out"
    process = _start(out)
    _wait_for(lambda: _finished(out) >= 1)
    os.kill(_children(process.pid)[-1], signal.SIGKILL)  # is replaced
    _wait_for(lambda: _finished(out) >= 10)
    workers = _children(process.pid)
    assert workers
    process.kill()
    process.wait()
    _wait_for(lambda: not any(map(_alive, workers)))
    kept = [json.loads(line)["key"] for line in (out / "trials.jsonl").read_text().splitlines()]
    assert len(kept) == len(set(kept)) < 40

    held = tmp_path / "held"
    held.touch()  # it does not end by itself
    process = _start(out, "--resume", start_new_session=True)
    _wait_for(lambda: _finished(out) > len(kept))  # not before it has begun
    os.killpg(process.pid, signal.SIGINT)
    assert process.wait(60) == 130
    said = f"interrupted: {_finished(out)} of 40 trials are kept in {out}; the same command with --resume goes on"
    assert process.stderr.read() == f"craftsim: {said}\n"

    held.unlink()
    own = cheap_work.experiment(cheap_work.items(40), "cheap", batch=3)
    run_experiment(own, out, RunOptions(resume=True))
    run_experiment(own, tmp_path / "undisturbed")
    assert (out / "trials.jsonl").read_bytes() == (
        tmp_path / "undisturbed" / "trials.jsonl"
    ).read_bytes()


def _interrupt(*_, **__):
    signal.raise_signal(signal.SIGINT)


def _hidden(*_):
    try:
        raise KeyboardInterrupt
    except KeyboardInterrupt as interrupt:
        raise ImportError("initialization failed") from interrupt


@pytest.mark.parametrize(
    ("place", "fails", "kept"),
    [
        ("_export", _interrupt, "0 of 3 trials are"),
        ("_export", lambda *_: (_interrupt(), _interrupt()), "what was finished is"),
        ("_append", _interrupt, "1 of 3 trials are"),
        ("run", _hidden, "0 of 3 trials are"),
        ("close", _interrupt, "3 of 3 trials are"),
    ],
)
def test_an_interrupt_says_what_is_kept_wherever_it_comes(
    place, fails, kept, tmp_path, monkeypatch
):
    usual = getattr(Session, place)

    def interrupted(*arguments):
        fails()
        return usual(*arguments)

    monkeypatch.setattr(Session, place, interrupted)
    monkeypatch.setattr(interrupts, "_SAME_S", 0.0)  # of two, the second is one of its own
    said = f"^interrupted: {kept} kept in {tmp_path}; the same command with --resume goes on$"
    with pytest.raises(KeyboardInterrupt, match=said):
        _run(tmp_path, 3)
    monkeypatch.undo()
    assert [record["agrees"] for record in _run(tmp_path, 3, resume=True)] == [True] * 3


def test_an_interrupt_before_or_after_the_session_says_what_is_kept_too(
    tmp_path, capsys, monkeypatch
):
    from craftsim import cli
    from craftsim.validation import report, validation

    words = [
        "validate",
        "strip",
        "--trials",
        "1",
        "--drive",
        "wheels",
        "--randomize",
        "none",
        "--video",
        "none",
        "--out",
    ]
    said = (
        f"interrupted: 1 of 1 trials are kept in {tmp_path}; the same command with --resume goes on"
    )
    monkeypatch.setattr(report, "validation_report", _interrupt)
    assert cli.main([*words, str(tmp_path)]) == 130
    assert capsys.readouterr().err.endswith(f"craftsim: {said}\n")
    monkeypatch.setattr(validation, "validate", _interrupt)
    assert cli.main([*words, str(tmp_path), "--resume"]) == 130
    assert capsys.readouterr().err == f"craftsim: {said}\n"
    assert cli.main([*words, str(tmp_path / "new")]) == 130
    assert capsys.readouterr().err == "craftsim: interrupted\n"


def test_a_terminated_stage_leaves_no_workers_behind_and_killed_ones_are_replaced(tmp_path):
    process = _start(tmp_path, what="after", start_new_session=True)
    _wait_for(lambda: list(tmp_path.glob("left-*")))
    os.kill(_children(process.pid)[-1], signal.SIGKILL)
    done = len(list(tmp_path.glob("left-*")))
    _wait_for(lambda: len(list(tmp_path.glob("left-*"))) > done + 3)
    workers = _children(process.pid)
    assert workers
    process.terminate()
    assert process.wait(60) == 130
    _wait_for(lambda: not any(map(_alive, workers)))
    said = f"interrupted: while leaving files; all trials are kept in {tmp_path}; the same command with --resume"
    assert process.stderr.read() == f"craftsim: {said} goes on\n"


def test_a_disk_that_fills_up_stops_with_a_message_and_resume_goes_on(tmp_path):
    def small_disk():
        resource.setrlimit(resource.RLIMIT_FSIZE, (LIMIT, LIMIT))

    process = _start(tmp_path, preexec_fn=small_disk)
    assert process.wait(60) == 2
    assert "what was finished is kept: make room, then --resume" in process.stderr.read()
    text = (tmp_path / "trials.jsonl").read_bytes()
    assert 0 < len(text) < LIMIT
    assert text.endswith(b"\n"), "nothing half-written"
    records = run_experiment(
        cheap_work.experiment(cheap_work.items(40), "cheap", batch=3),
        tmp_path,
        RunOptions(resume=True),
    )
    assert all(record["agrees"] for record in records)


def test_a_full_file_system_stops_with_a_message(tmp_path):
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=256k", "tmpfs", tmp_path],
        capture_output=True,
        check=False,
    )
    if mounted.returncode:
        pytest.skip("this user may not mount a small file system")
    try:
        with pytest.raises(InputError, match=r"cannot write into .* make room, then --resume"):
            run_experiment(cheap_work.experiment(4000), tmp_path)
        assert 0 < _finished(tmp_path) < 4000
    finally:
        subprocess.run(["umount", tmp_path], check=True)
