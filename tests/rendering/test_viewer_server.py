"""The web server of the viewer: who reaches it, how it begins and how it ends."""

import signal
import socket
import sys
import urllib.request
from functools import partial
from pathlib import Path
from subprocess import PIPE

import pytest

from craftsim import LiveView, Trajectory, cli
from craftsim.errors import InputError

pytest.importorskip("viser", reason="needs the extra 'view'")


def test_it_answers_on_its_own_address_alone(opened: LiveView):
    with urllib.request.urlopen(opened.address, timeout=10) as answer:
        assert answer.status == 200
        assert b"<html" in answer.read()[:2000].lower()
    port = int(opened.address.rsplit(":", 1)[1])
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.2", port), timeout=10)


def test_nobody_makes_it_public():
    from craftsim.rendering.viewer.server import LocalServer

    server = LocalServer(port=0)
    assert server.request_share_url() is None
    server.stop()


def test_a_port_in_use_is_an_error_and_not_another_port(run: Trajectory, tmp_path: Path, capsys):
    file = run.write(tmp_path / "run.npz")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert cli.main(["view", str(file), "--port", str(port)]) == 2
    assert f"port {port} of 127.0.0.1 is in use" in capsys.readouterr().err


def test_an_address_that_is_not_of_this_machine_is_an_error():
    with pytest.raises(InputError, match="cannot listen on 192"):
        LiveView("192.0.2.1", 0)


def test_without_viser_it_says_what_installs_it(monkeypatch: pytest.MonkeyPatch, capsys):
    monkeypatch.setattr("craftsim.extras.find_spec", lambda name: None)
    assert cli.main(["view", "strip"]) == 2
    assert "-m pip install 'viser>=" in capsys.readouterr().err


@pytest.mark.parametrize("what", ["no-such-task", "."])
def test_what_cannot_be_watched_is_named(what: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["view", what]) == 2
    assert what in capsys.readouterr().err


@pytest.mark.parametrize(
    ("ignored", "number", "status"),
    [
        (False, signal.SIGINT, 0),
        (False, signal.SIGTERM, -signal.SIGTERM),
        (True, signal.SIGTERM, -signal.SIGTERM),
    ],
)
def test_a_signal_ends_it_well(run: Trajectory, tmp_path: Path, start, ignored, number, status):
    file = run.write(tmp_path / "run.npz")
    command = [sys.executable, "-m", "craftsim", "view", str(file), "--port", "0"]
    # As what a shell runs in the background.
    before = partial(signal.signal, signal.SIGINT, signal.SIG_IGN) if ignored else None
    child = start(command, stdout=PIPE, stderr=PIPE, text=True, preexec_fn=before)
    assert "Watch at http://127.0.0.1:" in child.stdout.readline()
    child.send_signal(number)
    out, errors = child.communicate(timeout=60)
    assert (child.returncode, out, errors) == (status, "", "")
