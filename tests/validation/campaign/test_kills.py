"""A campaign that is killed, interrupted or out of room loses nothing, and goes on to the same result."""

import json
import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import cheap_work
import pytest

from craftsim.errors import InputError
from craftsim.experiments.session import run_experiment

SCRIPT = Path(__file__).parent / "run_cheap.py"
LIMIT = 1 << 16
"""Bytes that a file may have on a small disk."""


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


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    out = tmp_path_factory.mktemp("undisturbed")
    process = _start(out)
    assert process.wait(60) == 0, process.stderr.read()
    return (out / "trials.jsonl").read_bytes()


def test_a_campaign_killed_again_and_again_goes_on_to_the_same_result(tmp_path, undisturbed):
    workers = []
    for n in (1, 13, 25):
        process = _start(tmp_path, "--resume")
        _wait_for(lambda n=n: _finished(tmp_path) >= n)
        workers += _children(process.pid)
        process.kill()
        process.wait()
    assert workers
    _wait_for(lambda: not any(map(_alive, workers)))
    kept = [json.loads(line)["key"] for line in (tmp_path / "trials.jsonl").read_text().splitlines()]
    assert len(kept) == len(set(kept)) < 40
    process = _start(tmp_path, "--resume")
    assert process.wait(60) == 0, process.stderr.read()
    assert (tmp_path / "trials.jsonl").read_bytes() == undisturbed


def test_killed_workers_are_replaced(tmp_path, undisturbed):
    process = _start(tmp_path)
    for n in (1, 16):
        _wait_for(lambda n=n: _finished(tmp_path) >= n)
        for child in _children(process.pid)[-1:]:
            os.kill(child, signal.SIGKILL)
    assert process.wait(60) == 0, process.stderr.read()
    assert (tmp_path / "trials.jsonl").read_bytes() == undisturbed


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_campaign_says_how_to_go_on(tmp_path, undisturbed, number):
    process = _start(tmp_path, start_new_session=True)
    _wait_for(lambda: _finished(tmp_path) >= 1)
    os.killpg(process.pid, number)
    assert process.wait(60) == 130
    message = process.stderr.read()
    n = _finished(tmp_path)
    expected = f"interrupted: {n} of 40 trials are kept in {tmp_path}; the same command with --resume goes on"
    assert message == f"craftsim: {expected}\n"
    process = _start(tmp_path, "--resume")
    assert process.wait(60) == 0, process.stderr.read()
    assert (tmp_path / "trials.jsonl").read_bytes() == undisturbed


def test_a_disk_that_fills_up_stops_with_a_message_and_resume_goes_on(tmp_path, undisturbed):
    def small_disk():
        resource.setrlimit(resource.RLIMIT_FSIZE, (LIMIT, LIMIT))

    process = _start(tmp_path, preexec_fn=small_disk)
    assert process.wait(60) == 2
    assert "what was finished is kept: make room, then --resume" in process.stderr.read()
    text = (tmp_path / "trials.jsonl").read_bytes()
    assert 0 < len(text) < LIMIT
    assert text.endswith(b"\n"), "nothing half-written"
    process = _start(tmp_path, "--resume")
    assert process.wait(60) == 0, process.stderr.read()
    assert (tmp_path / "trials.jsonl").read_bytes() == undisturbed


def test_a_full_file_system_stops_with_a_message(tmp_path):
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=256k", "tmpfs", tmp_path], capture_output=True, check=False
    )
    if mounted.returncode:
        pytest.skip("this user may not mount a small file system")
    try:
        with pytest.raises(InputError, match=r"cannot write into .* make room, then --resume"):
            run_experiment(cheap_work.experiment(4000), tmp_path)
        assert 0 < _finished(tmp_path) < 4000
    finally:
        subprocess.run(["umount", tmp_path], check=True)
