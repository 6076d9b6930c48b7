"""The web server of the viewer: who reaches it, how it begins and how it ends."""

import contextlib
import gc
import http.client
import math
import signal
import socket
import sys
import time
import urllib.request
from pathlib import Path
from subprocess import PIPE
from unittest.mock import Mock

import msgpack
import pytest
from websockets.datastructures import Headers
from websockets.exceptions import InvalidStatus
from websockets.sync import client as websocket

from craftsim import Grid, LiveView, PhysicsWorld, Trajectory, cli
from craftsim.errors import InputError
from craftsim.storage.limits import PAGE_CONNECTIONS

viser = pytest.importorskip("viser", reason="needs the extra 'view'")
PROTOCOL = f"viser-v{viser.__version__}"


def test_it_answers_on_its_own_address_alone(opened: LiveView):
    with urllib.request.urlopen(opened.address, timeout=10) as answer:
        assert answer.status == 200
        assert b"<html" in answer.read()[:2000].lower()
    port = int(opened.address.rsplit(":", 1)[1])
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.2", port), timeout=10)


def got(port: int, host: str, origin: str | None) -> int:
    """Return the status of an answer to a browser that asks for the page by a name, from a page of some origin."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
    connection.putrequest("GET", "/", skip_host=True)
    connection.putheader("Host", host)
    if origin is not None:
        connection.putheader("Origin", origin)
    connection.endheaders()
    with contextlib.closing(connection), connection.getresponse() as answer:
        if answer.status == 200:
            assert answer.headers["Content-Security-Policy"] == "frame-ancestors 'none'"
        return answer.status


def talked(port: int, host: str, origin: str | None) -> int:
    """Return the status of an answer to a page that opens a websocket; where it is opened the viewer says something."""
    try:
        with (
            socket.create_connection(("127.0.0.1", port), timeout=10) as sock,
            websocket.connect(
                f"ws://{host}", sock=sock, origin=origin, subprotocols=[PROTOCOL]
            ) as page,
        ):
            assert page.recv(timeout=10)
            return 200
    except InvalidStatus as refused:
        return refused.response.status_code


def test_pages_of_others_are_refused(opened: LiveView):
    for host, origin, status in (
        ("127.0.0.1:{}", None, 200),
        ("127.0.0.1:{}", "http://127.0.0.1:{}", 200),
        ("localhost:{}", "http://localhost:{}", 200),
        ("LOCALHOST:9000", "http://localhost:9000", 200),  # through ssh -L 9000:127.0.0.1:8080
        ("[::1]:{}", "http://[::1]:{}", 200),
        ("192.0.2.7", "https://192.0.2.7", 200),
        ("127.0.0.1:{}", "http://evil.example", 403),
        ("127.0.0.1:{}", "http://127.0.0.1:1", 403),
        ("127.0.0.1:{}", "http://localhost:{}", 403),
        ("127.0.0.1:{}", "null", 403),
        ("127.0.0.1:{}", "file://127.0.0.1:{}", 403),
        ("127.0.0.1:{}", "http://[", 403),
        ("evil.example:{}", None, 403),
        ("evil.example:{}", "http://evil.example:{}", 403),  # a name that leads here
        ("127.0.0.1.evil.example", "http://127.0.0.1.evil.example", 403),
    ):
        port = int(opened.address.rsplit(":", 1)[1])
        host, origin = host.format(port), origin and origin.format(port)
        assert (got(port, host, origin), talked(port, host, origin)) == (status, status)


def test_the_name_that_it_is_asked_for_is_its_own():
    from craftsim.rendering.viewer.server import refusal_of

    own = ("Host", "10.0.0.1")
    assert not refusal_of("robots.example", Headers([("Host", "Robots.example:8080")]))
    assert not refusal_of("0.0.0.0", Headers([("Host", socket.gethostname())]))
    strange = [[("Host", name)] for name in ("", "[", "robots.example")]
    for headers in ([], *strange, [own, own], [own, *[("Origin", "http://10.0.0.1")] * 2]):
        assert refusal_of("0.0.0.0", Headers(headers))


def test_strangers_write_nothing_on_the_terminal(capfd):
    with LiveView(port=0) as view:
        port = int(view.address.rsplit(":", 1)[1])
        for data in (
            b"\x00" * 100,
            b"GET / HTTP/1.1\r\nHost: x\r\n\r\n",
            b"GET " + b"/" * 20_000,
            b"",
        ):
            with socket.create_connection(("127.0.0.1", port), timeout=10) as connection:
                connection.sendall(data)
                connection.shutdown(socket.SHUT_WR)
                while connection.recv(65536):
                    pass
        with pytest.raises(InvalidStatus, match="400"), websocket.connect(f"ws://127.0.0.1:{port}"):
            pass
        for message in ("text", b"", b"\xc1", msgpack.packb({"type": "no such message"})):
            with websocket.connect(f"ws://127.0.0.1:{port}", subprotocols=[PROTOCOL]) as page:
                page.send(message)
                assert page.recv(timeout=10)
    assert capfd.readouterr() == ("", "")


def test_idle_connections_use_nothing_up(opened: LiveView, capfd):
    port = int(opened.address.rsplit(":", 1)[1])
    with contextlib.ExitStack() as stack:
        idle = [
            stack.enter_context(socket.create_connection(("127.0.0.1", port), timeout=5))
            for _ in range(PAGE_CONNECTIONS + 20)
        ]
        for connection in idle[:20]:
            with contextlib.suppress(ConnectionResetError):
                assert connection.recv(1) == b""
        assert got(port, f"127.0.0.1:{port}", None) == 200
        assert talked(port, f"127.0.0.1:{port}", None) == 200
    assert capfd.readouterr() == ("", "")


CHOICES = [
    "no such",
    "",
    5,
    True,
    None,
    ["1 x"],
    {"1 x": 1},
    math.nan,
    math.inf,
    -1e308,
    "2 x",
    0.5,
]


def test_a_page_sets_what_can_be_set_and_nothing_else(capfd):
    with LiveView(port=0) as view:
        physics = PhysicsWorld(Grid.empty((3, 1, 1), n_cars=1))
        view(physics)
        view.page.offer(("one", "two"), (0.0, 1.0))
        view.page.play.on_click(pressed := Mock())
        parts = {
            name: getattr(view.page, name) for name in ("speed", "run", "slider", "_cars", "play")
        }
        port = int(view.address.rsplit(":", 1)[1])
        before = {
            name: part.options for name, part in parts.items() if name in ("speed", "run", "_cars")
        }
        with websocket.connect(f"ws://127.0.0.1:{port}", subprotocols=[PROTOCOL]) as page:

            def send(kind: str, **values: object) -> None:
                page.send(msgpack.packb({"type": kind, **values}))

            for part in parts.values():
                for value in CHOICES:
                    for updates in (
                        {"value": value},
                        {"options": value},
                        {"min": value},
                        {"value": 0.5, "max": value},
                        value,
                    ):
                        send("GuiUpdateMessage", uuid=part._impl.uuid, updates=updates)
            for name in ([], {}, None, 5, "/nowhere"):
                send("SceneNodeClickMessage", name=name, owner="", ray_origin=name, modifier=name)
                send("ViewerCameraMessage", wxyz=name, position=[[1], 2], fov=name)
                send("ShareUrlRequest", name=name)
            send("GuiUpdateMessage", uuid=parts["speed"]._impl.uuid, updates={"value": "1/4 x"})
            assert (
                not pressed.called
            )  # a page is one of the viewer's when it has said where its camera is
            three, size = [0.0, 1.0, 2], {"image_height": 480, "image_width": 640, "fov": 1.0}
            pose = {
                "wxyz": [1, 0.0, 0.0, 0.0],
                "position": three,
                "look_at": three,
                "up_direction": three,
            }
            send("ViewerCameraMessage", **pose, **size, near=0.01, far=1000.0)
            send("GuiUpdateMessage", uuid=parts["play"]._impl.uuid, updates={"value": True})
            deadline = time.monotonic() + 20
            while not pressed.called and time.monotonic() < deadline:
                time.sleep(0.01)
        assert pressed.call_count == 1
        values = {name: parts[name].value for name in ("speed", "run", "slider", "_cars")}
        assert values == {"speed": "1/4 x", "run": "one", "slider": 0.5, "_cars": "0"}
        assert before == {name: parts[name].options for name in before}
        assert parts["slider"].max == 1.0
    gc.collect()
    assert capfd.readouterr() == ("", "")


def test_an_address_that_cannot_be_had_is_an_error(run: Trajectory, tmp_path: Path, capsys):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert cli.main(["view", str(run.write(tmp_path / "run.npz")), "--port", str(port)]) == 2
    assert f"port {port} of 127.0.0.1 is in use" in capsys.readouterr().err
    with pytest.raises(InputError, match="cannot listen on 192"):
        LiveView("192.0.2.1", 0)


def test_what_cannot_be_watched_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys):
    monkeypatch.chdir(tmp_path)
    for what in ("no-such-task", "."):
        assert cli.main(["view", what]) == 2
        assert what in capsys.readouterr().err
    monkeypatch.setattr("craftsim.storage.extras.find_spec", lambda name: None)
    assert cli.main(["view", "strip"]) == 2
    assert "-m pip install 'viser>=" in capsys.readouterr().err


def test_an_interrupt_ends_it_well(run: Trajectory, tmp_path: Path, start):
    file = run.write(tmp_path / "run.npz")
    command = [sys.executable, "-m", "craftsim", "view", str(file), "--port", "0"]
    child = start(command, stdout=PIPE, stderr=PIPE, text=True)
    assert "Watch at http://127.0.0.1:" in child.stdout.readline()
    child.send_signal(signal.SIGINT)
    out, errors = child.communicate(timeout=60)
    assert (child.returncode, out, errors) == (0, "", "")
