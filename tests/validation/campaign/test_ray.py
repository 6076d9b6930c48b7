"""On a real Ray cluster of two nodes a campaign gives the same as on this machine."""

import os
import socket
import subprocess
import sys
import time
from collections import deque
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace

import cheap_work
import pytest

from craftsim.cli import main
from craftsim.errors import InputError
from craftsim.experiments.experiment import RunOptions
from craftsim.experiments.session import run_experiment
from craftsim.workers.ray_actor import LOOK_S, RayActor

pytestmark = [
    pytest.mark.skipif(not find_spec("ray"), reason="the extra 'ray' is not installed"),
    pytest.mark.usefixtures("alone"),
]


@pytest.mark.slow
@pytest.mark.parametrize("ray_cluster", [2], indirect=True)
def test_records_are_those_of_local_workers_whatever_goes_wrong(tmp_path, ray_cluster, monkeypatch):
    monkeypatch.chdir(tmp_path)  # of which nothing is imported
    for name in ("wave", "pettingzoo", "gymnasium", "numpy"):
        (tmp_path / f"{name}.py").write_text("raise SystemExit('planted')\n")
    faults = {"i3": "raise", "i5": "die", "i9": "hang"}
    faults = {**faults, "i7": ("die once", tmp_path / "died")}
    items = cheap_work.items(12, **faults)
    own = cheap_work.experiment(items, timeout_s=3, batch=2)
    records = run_experiment(own, tmp_path / "ray", RunOptions(2, "ray"))
    assert [record["error"] is None for record in records] == [
        i not in (3, 5, 9) for i in range(12)
    ]
    (tmp_path / "died").unlink()
    local = run_experiment(own, tmp_path / "local", RunOptions(2))
    assert records == local


@pytest.mark.slow
def test_a_lost_head_is_told_within_seconds_and_resume_goes_on_without_it(tmp_path):
    script = Path(__file__).parent / "lose_head.py"
    environment = {**os.environ, "RAY_USAGE_STATS_ENABLED": "0"}
    words = [sys.executable, str(script), str(tmp_path)]
    ended = subprocess.run(
        words, capture_output=True, text=True, timeout=120, check=False, env=environment
    )
    assert ended.returncode == 0, ended.stderr
    assert "no Ray cluster answers at" in ended.stdout
    assert "--resume goes on" in ended.stdout
    # Otherwise Ray looks in vain for over a minute, and then ends the process.
    assert "Failed to connect to GCS" not in ended.stderr
    import lose_head

    n = len((tmp_path / "trials.jsonl").read_bytes().splitlines())
    assert 10 <= n < lose_head.N_ITEMS
    (tmp_path / "slow").unlink()
    own = cheap_work.experiment(lose_head.items(tmp_path))
    records = run_experiment(own, tmp_path, RunOptions(2, resume=True))
    assert all(record["agrees"] for record in records)


def test_without_a_cluster_the_message_says_how_to_start_one(tmp_path, monkeypatch):
    monkeypatch.delenv("RAY_ADDRESS", raising=False)
    with pytest.raises(InputError, match="ray start --head"):
        run_experiment(cheap_work.experiment(1), tmp_path, RunOptions(engine="ray"))


@pytest.fixture
def nobodys_port():
    """Yield a port of this machine that nobody listens at."""
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        yield taken.getsockname()[1]


def test_who_waits_for_a_cluster_looks_at_its_head_and_ends_when_that_is_gone(
    nobodys_port, monkeypatch
):
    """Without a cluster: one whose actors never answer; a slow test has a real one whose head is killed."""
    looks = []

    def silent(answers, timeout):
        looks.append(timeout)
        assert len(looks) < 3, "nobody looks at the head"
        return [], answers

    actor = RayActor.__new__(RayActor)
    actor._ray, actor._answers = SimpleNamespace(wait=silent), deque([object()])
    actor._head = f"127.0.0.1:{nobodys_port}"
    with pytest.raises(InputError, match=r"no Ray cluster answers at .*--resume goes on"):
        RayActor.wait([actor], None)
    assert looks == [LOOK_S]
    assert LOOK_S <= 2, "seconds; Ray itself looks in vain for over a minute"
    with socket.create_server(("127.0.0.1", 0)) as head:
        actor._head = f"127.0.0.1:{head.getsockname()[1]}"
        assert RayActor.wait([actor], 0.0) == []


@pytest.mark.parametrize("form", ["127.0.0.1:{}", "ray://127.0.0.1:{}"])
def test_an_address_where_nobody_listens_is_refused_within_seconds(
    tmp_path, monkeypatch, capsys, nobodys_port, form
):
    monkeypatch.setenv("RAY_ADDRESS", form.format(nobodys_port))
    begun = time.perf_counter()
    assert (
        main(["validate", "strip", "--engine", "ray", "--video", "none", "--out", str(tmp_path)])
        == 2
    )
    assert time.perf_counter() - begun < 60  # without a look at the port, Ray tries for minutes
    assert f"no Ray cluster answers at {form.format(nobodys_port)}" in capsys.readouterr().err


def test_a_cluster_of_this_machine_that_is_gone_is_refused(tmp_path, monkeypatch, nobodys_port):
    monkeypatch.delenv("RAY_ADDRESS", raising=False)
    monkeypatch.setenv("RAY_TMPDIR", str(tmp_path))
    (tmp_path / "ray").mkdir()
    (tmp_path / "ray" / "ray_current_cluster").write_text(f"127.0.0.1:{nobodys_port}")
    with pytest.raises(InputError, match=f"no Ray cluster answers at .*:{nobodys_port}"):
        run_experiment(cheap_work.experiment(1), tmp_path / "out", RunOptions(engine="ray"))


def test_an_address_that_never_answers_or_is_none_is_given_up(tmp_path, monkeypatch):
    def silent(address, timeout):
        assert timeout <= 10
        raise TimeoutError("timed out")

    monkeypatch.setattr(socket, "create_connection", silent)
    for address, message in {
        "198.51.100.1:6379": r"6379 \(timed out\)",
        "here:there": "HOST:PORT",
    }.items():
        monkeypatch.setenv("RAY_ADDRESS", address)
        with pytest.raises(InputError, match=message):
            run_experiment(cheap_work.experiment(1), tmp_path, RunOptions(engine="ray"))
