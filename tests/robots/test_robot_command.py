"""Robots in a process of their own, reached over sockets: what is built, and what becomes of a lost connection."""

import json
import os
import re
import signal
import time
from contextlib import contextmanager

import numpy as np
import pytest
from robots.piped import piped

from craftsim.checking.setup import Seed, setup_of
from craftsim.cli import main
from craftsim.discrete.kinds import Action
from craftsim.robots import robots_at
from craftsim.skills.outcome import Reason
from craftsim.tasks import make_task

PLAN = "0 0 MOVE_RIGHT\n0 1 MOVE_LEFT\n1 0 LIFT\n1 1 ROTATE_LEFT\n"
BUSY = ("--delay-ms", "30", "--jitter-ms", "10", "--loss", "0.02")
DRIVE = """
import os, signal
import numpy as np
from craftsim.checking.setup import setup_of
from craftsim.checking.setup import Seed
from craftsim.robots import robots_at
from craftsim.discrete.kinds import Action
from craftsim.tasks import make_task
with robots_at("{address}", 30.0) as where:
    grid = make_task("simple_two_story").draw(np.random.default_rng(0))
    executor = where(grid, setup_of(drive="wheels"), Seed((0,)), ()).executor
    for fate in (signal.SIGSTOP, signal.SIGKILL):
        executor.begin(0, Action.MOVE_RIGHT)
        for _ in range(10):
            assert not executor.advance()
        print("acting", flush=True)
        os.kill(os.getpid(), fate)
        while not (ended := executor.advance()):
            pass
        print(ended[0], flush=True)
"""
"""A process that drives one car, stops in the midst of it, goes on when it is told to, and then is killed."""


@contextmanager
def served(out, *options):
    """Yield a process that serves robots, its address, and what it says of errors."""
    words = ["robot", "serve", "--drive", "wheels", "--port", "0", "--out", out, *options]
    with piped("craftsim", *words) as (process, said, errors):
        yield process, re.search(r"tcp://\S+", said.readline())[0], errors


def stop_of(errors) -> tuple[float, float]:
    """Return when robots stopped the next time, and when the last command before had come."""
    for line in errors:
        if found := re.search(r"([.\d]+) s: no command since ([.\d]+) s, the robots stop", line):
            return float(found[1]), float(found[2])
    raise AssertionError("the robots did not stop")


@pytest.mark.parametrize(
    ("options", "n_agree", "said"),
    [
        (BUSY, 4, "4 of 4"),
        (("--silent", "1:0.5"), None, "car 1 has not answered since 0.48 s of its clock"),
    ],
    ids=["busy", "silent"],
)
def test_a_plan_is_carried_out_by_robots_in_another_process(
    tmp_path, capsys, options, n_agree, said
):
    plan = tmp_path / "short.plan"
    plan.write_text(PLAN, encoding="utf-8")
    with served(tmp_path / "robot", "--lockstep", "--once", *options) as (process, address, _):
        words = ["demo", "--robot", address, "--plan", str(plan), "--drive", "wheels", "--no-video"]
        done = main(
            [*words, "--timeout", "60" if n_agree else "1", "--out", str(tmp_path / "demo")]
        )
        assert done == 1  # the goal is not reached
        process.join(60)
        assert process.exitcode == 0
    assert said in capsys.readouterr().out
    figures, report = (
        json.loads((tmp_path / name / "report.json").read_text()) for name in ("demo", "robot")
    )
    if n_agree:
        assert figures["figures"]["agree"] == n_agree
        assert figures["figures"]["simulated_s"] > 2
        assert (tmp_path / "demo/simple_two_story.npz").is_file()
        assert report["figures"]["stopped_at_s"] == []
    else:
        assert report["config"]["network"]["silent"] == [[1, 0.5]]


@pytest.mark.parametrize(
    ("silent", "said"),
    [
        ("1", "--silent 1: allowed: a car and seconds, such as 1:5"),
        ("2:1", "no car 2 to fall silent; there are cars 0 to 1"),
        ("1:-1", "car 1 falls silent after -1 s; allowed: 0 s or more"),
        ("1:nan", "car 1 falls silent after nan s"),
    ],
)
def test_what_cannot_fall_silent_is_refused(silent, said, tmp_path, capsys):
    assert main(["robot", "serve", "--silent", silent, "--port", "0", "--out", str(tmp_path)]) == 2
    assert said in capsys.readouterr().err


def test_robots_and_who_drives_them_outlive_each_other(tmp_path):
    with served(tmp_path / "out", "--lockstep", "--timeout", "3") as (process, address, errors):
        (tmp_path / "drive.py").write_text(DRIVE.format(address=address))
        with piped(tmp_path / "drive.py") as (driver, said, _):
            assert said.readline() == "acting\n"
            asleep = stop_of(errors)
            os.kill(driver.pid, signal.SIGCONT)
            lost = "disconnected: the robots had no command for 100 ms, and stopped\n"
            assert [said.readline() for _ in range(2)] == [lost, "acting\n"]
            killed = stop_of(errors)
            driver.join(60)
            assert driver.exitcode == -signal.SIGKILL
        for stopped_s, heard_s in (asleep, killed):
            assert 0.09 < stopped_s - heard_s < 0.13  # as far as two digits say
        with robots_at(address, 2.0) as where:
            grid = make_task("simple_two_story").draw(np.random.default_rng(0))
            executor = where(grid, setup_of(drive="wheels"), Seed((0,)), ()).executor
            executor.begin(1, Action.ROTATE_LEFT)
            process.kill()
            begun = time.monotonic()
            ended = {}
            while not ended:
                ended = executor.advance()
        assert ended[1].reason is Reason.DISCONNECTED
        assert time.monotonic() - begun < 60  # two seconds where nothing else runs


@pytest.mark.parametrize(
    ("host", "has_key", "status"),
    [("0.0.0.0", False, 2), ("0.0.0.0", True, 0), ("127.0.0.1", False, 0), ("127.0.0.1", True, 0)],
)
def test_robots_that_other_machines_reach_have_a_key(
    tmp_path, capsys, monkeypatch, key, host, has_key, status
):
    monkeypatch.setattr("craftsim.robots.server.Server.run", lambda self, ended: None)
    words = [
        "robot",
        "serve",
        "--task",
        "strip",
        "--host",
        host,
        "--port",
        "0",
        "--out",
        str(tmp_path),
    ]
    if has_key:
        words += ["--key", str(key)]
    assert main(words) == status
    said = "cannot listen on 0.0.0.0, port 0: other machines reach it, so it needs --key FILE"
    assert (said in capsys.readouterr().err) == (status == 2)


def test_who_has_the_key_drives_and_who_has_another_is_told(tmp_path, capsys, key, other_key):
    plan = tmp_path / "short.plan"
    plan.write_text("0 0 MOVE_RIGHT\n", encoding="utf-8")
    serving = ("--lockstep", "--once", "--key", str(key))
    with served(tmp_path / "robot", *serving) as (process, address, errors):
        words = ["demo", "--robot", address, "--plan", str(plan), "--drive", "wheels", "--no-video"]
        words += ["--timeout", "60", "--out", str(tmp_path / "demo")]
        assert main([*words, "--key", str(other_key)]) == 2
        assert "another key" in capsys.readouterr().err
        assert "refused a connection: TLS: tlsv1 alert unknown ca" in errors.readline()
        assert main(words) == 2
        assert "a key is asked for; --key FILE" in capsys.readouterr().err
        assert main([*words, "--key", str(key)]) == 1  # the goal is not reached
        process.join(60)
        assert process.exitcode == 0
    assert "1 of 1" in capsys.readouterr().out
    report = json.loads((tmp_path / "robot/report.json").read_text())
    assert report["figures"]["connections_refused"] == 2
    written = "".join(path.read_text() for path in tmp_path.glob("*/*.[jhy]*"))
    assert "PRIVATE KEY" not in written


def test_a_key_goes_with_robots_and_other_machines_need_one(capsys, key):
    assert main(["demo", "strip", "--robot", "192.0.2.1:5555"]) == 2
    assert "on another machine, and there is no key" in capsys.readouterr().err
    assert main(["demo", "strip", "--key", str(key)]) == 2
    assert "--robot HOST:PORT says where they are" in capsys.readouterr().err


def test_an_address_where_no_robots_are_is_refused_in_words(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("craftsim.robots.link._GREETED_S", 0.2)
    words = [
        "demo",
        "--robot",
        "127.0.0.1:9",
        "--timeout",
        "0.1",
        "--no-video",
        "--out",
        str(tmp_path),
    ]
    assert main(words) == 2
    assert (
        "no robots answer within 0.2 s; start some with: craftsim robot serve"
        in capsys.readouterr().err
    )
    assert main([*words, "--task", "all"]) == 2
    assert "--robot goes with a single task" in capsys.readouterr().err
    assert main(["demo", "--robot", "udp://nowhere", "--out", str(tmp_path), "--no-video"]) == 2
    assert "is no address of robots" in capsys.readouterr().err
