"""The key of robots: nothing is read of who does not show it, in bounded time and memory, and both sides say why."""

import contextlib
import socket
import ssl
import subprocess
import threading
import time
from contextlib import closing, contextmanager

import pytest
import robot_latency
from robots.made_keys import greet
from robots.test_sockets import WAIT_S, calling, framed

from craftsim.errors import InputError
from craftsim.robots.keys import tls_of
from craftsim.robots.messages import Hello, pack
from craftsim.robots.sockets import Caller, Host
from craftsim.storage.limits import KIB, ROBOT_CONNECTIONS

HELLO = framed(pack(Hello(1)))


@pytest.fixture
def host(key):
    with closing(Host("127.0.0.1", 0, key)) as host:
        host.key = key
        host.told = []
        host.tell = host.told.append
        yield host


@contextmanager
def plain(host):
    place, port = host.address.removeprefix("tcp://").rsplit(":", 1)
    with socket.create_connection((place, int(port)), timeout=WAIT_S) as connection:
        yield connection


@contextmanager
def served(host):
    """Serve, in another thread, and yield the messages that come."""
    came = []
    ended = threading.Event()

    def serve():
        while not ended.is_set():
            received = host.receive(0.01)
            if received is not None and received[1] is not None:
                came.append(received[1])
                host.send(received[0], b"answer")

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield came
    finally:
        ended.set()
        thread.join()


def refused(host, n=1):
    """Let a host go on until it has refused so many connections; no message comes."""
    deadline = time.monotonic() + WAIT_S
    while host.refused < n:
        assert host.receive(0.01) is None
        assert time.monotonic() < deadline
    return host.told[-1]


def test_who_has_the_key_drives(host):
    with served(host) as came, closing(Caller(host.address, host.key)) as caller:
        caller.send(b"drive")
        assert caller.receive(WAIT_S) == b"answer"
    assert came == [b"drive"]
    assert host.refused == 0


def test_a_wrong_key_is_said_on_both_sides_at_once(host, other_key):
    with served(host) as came, closing(Caller(host.address, other_key)) as caller:
        caller.send(b"drive")
        begun_s = time.monotonic()
        with pytest.raises(ConnectionError, match=r"another key .*the same --key FILE"):
            caller.receive(WAIT_S)
        assert time.monotonic() - begun_s < WAIT_S / 2
    assert "refused a connection: TLS: tlsv1 alert unknown ca" in refused(host)
    assert came == []


def attacking(key=None):
    """Return TLS of somebody who trusts everybody, and may show a key."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname = False
    context.verify_mode = ssl.CERT_NONE
    if key is not None:
        context.load_cert_chain(key)
    return context


@pytest.mark.parametrize(
    ("shows", "said"),
    [(False, "peer did not return a certificate"), (True, "another key (self-signed certificate)")],
)
def test_who_trusts_everybody_is_trusted_by_nobody(host, other_key, shows, said):
    tls = attacking(other_key if shows else None)
    with plain(host) as connection:
        connection.setblocking(False)
        with tls.wrap_socket(connection, do_handshake_on_connect=False) as attacker:
            greet(host, attacker)
            # In TLS 1.3 one side may send before the other has seen its certificate.
            with contextlib.suppress(OSError):
                attacker.send(HELLO)
            assert said in refused(host)
            attacker.settimeout(WAIT_S)
            with pytest.raises(ssl.SSLError, match=r"(?i)alert"):
                attacker.recv(100)


def test_older_tls_is_refused(host):
    tls = attacking(host.key)
    tls.maximum_version = ssl.TLSVersion.TLSv1_2
    with plain(host) as connection:
        connection.setblocking(False)
        with (
            tls.wrap_socket(connection, do_handshake_on_connect=False) as attacker,
            contextlib.suppress(ssl.SSLError),
        ):
            greet(host, attacker)
        refused(host)


@pytest.mark.parametrize(
    "data",
    [
        HELLO,
        b"GET / HTTP/1.1\r\n\r\n",
        b"\x00" * 1000,
        b"\x16\x03\x01\xff\xff" + b"\xff" * 70_000,
        b"\x16\x03\x01\x40\x00\x01\xff\xff\xff" + b"\x00" * 70_000,
        b"",
    ],
)
def test_what_is_no_tls_of_this_key_is_read_no_further(host, data):
    with plain(host) as connection:
        connection.setblocking(False)
        with contextlib.suppress(BlockingIOError):
            connection.send(data)
        if not data:
            connection.shutdown(socket.SHUT_WR)
        assert refused(host)
    assert host._lines == {}


def test_who_has_no_key_is_told_to_name_it(host):
    with served(host) as came, closing(Caller(host.address)) as caller:
        caller.send(b"drive")
        with pytest.raises(ConnectionError, match="a key is asked for; --key FILE"):
            caller.receive(WAIT_S)
    assert came == []


def test_robots_without_a_key_are_not_driven_with_one(key):
    with (
        closing(Host("127.0.0.1", 0)) as host,
        served(host) as came,
        closing(Caller(host.address, key)) as caller,
    ):
        caller.send(b"drive")
        with pytest.raises(ConnectionError, match=r"TLS: .*the same --key FILE"):
            caller.receive(WAIT_S)
    assert came == []


def test_what_was_recorded_cannot_be_shown_again(host):
    """All that a driver with the key has sent, byte for byte, is no use to somebody who has heard it."""
    tls = tls_of(host.key, listens=False)
    to_robots = ssl.MemoryBIO()
    from_robots = ssl.MemoryBIO()
    driver = tls.wrap_bio(from_robots, to_robots)
    recorded = []
    with plain(host) as connection:
        connection.settimeout(0.01)

        def pass_on():
            sent = to_robots.read()
            recorded.append(sent)
            connection.sendall(sent)
            came = host.receive(0.05)
            with contextlib.suppress(TimeoutError):
                from_robots.write(connection.recv(65536))
            return came

        for _ in range(2):
            with contextlib.suppress(ssl.SSLWantReadError):
                driver.do_handshake()
            pass_on()
        driver.write(HELLO)
        name, data = pass_on()
        assert data == pack(Hello(1))
    assert host.receive(WAIT_S) == (name, None)
    assert len(recorded) == 3
    for parts in (recorded, [b"".join(recorded)], recorded[1:]):
        n_refused = host.refused
        with plain(host) as connection:
            for part in parts:
                with contextlib.suppress(ConnectionError):
                    connection.sendall(part)
                assert host.receive(0.05) is None
            assert "TLS" in refused(host, n_refused + 1)


@pytest.mark.parametrize("dribbles", [False, True])
def test_a_slow_handshake_has_its_time_limit_and_keeps_nobody(host, monkeypatch, dribbles):
    monkeypatch.setattr("craftsim.robots.sockets._SHOWN_S", 0.3)
    hello = ssl.MemoryBIO()
    with contextlib.suppress(ssl.SSLWantReadError):
        tls_of(host.key, listens=False).wrap_bio(ssl.MemoryBIO(), hello).do_handshake()
    sent = hello.read()
    with plain(host) as slow, calling(host) as caller:
        begun_s = time.monotonic()
        for number in range(len(sent)):
            if dribbles:
                with contextlib.suppress(ConnectionError):
                    slow.sendall(sent[number : number + 1])
            caller.send(b"mine")
            assert caller.receive(0.0) is None
            assert host.receive(WAIT_S)[1] == b"mine"
            if host.refused:
                break
            time.sleep(0.02)
        assert host.refused == 1
        assert time.monotonic() - begun_s < 5
        assert host.told == ["refused a connection: no key was shown in time"]


def test_many_who_show_no_key_move_nobody_who_has(host):
    with contextlib.ExitStack() as stack:
        driver = stack.enter_context(calling(host))
        driver.send(b"drive")
        driver.receive(0.0)
        kept, _ = host.receive(WAIT_S)
        second = stack.enter_context(calling(host, kept))
        for _ in range(1000):
            stack.enter_context(plain(host)).sendall(b"\x16\x03\x01")
            assert host.receive(0.0, kept) is None
            assert len(host._lines) <= ROBOT_CONNECTIONS
        third = stack.enter_context(calling(host, kept))
        for caller in (driver, second, third):
            caller.send(b"still here")
            assert caller.receive(0.0) is None
            assert host.receive(WAIT_S, kept)[1] == b"still here"
    assert host.refused >= 1000 - ROBOT_CONNECTIONS


def test_fifty_thousand_messages_of_one_who_has_the_key_keep_nobody(host):
    with calling(host) as flood, calling(host) as caller:
        n_came = n_mine = 0
        for number in range(50_000):
            flood.send(b"x" * 50)
            if number % 5000 == 0:
                caller.send(b"mine")
                caller.receive(0.0)
                came = [host.receive(0.01) for _ in range(6)]
                n_mine += sum(received is not None and received[1] == b"mine" for received in came)
            if number % 10 == 0:
                n_came += host.receive(0.0) is not None
        assert n_mine == 10
        assert n_came > 1000


def test_latency_is_measured_with_and_without_a_key_in_turns(capsys):
    assert robot_latency.main(["--rounds", "1"]) == 0
    rows = [line.split("|")[1:5] for line in capsys.readouterr().out.splitlines()[2:]]
    assert [row[0].strip() for row in rows] == [
        "no key, quiet",
        "key, quiet",
        "no key, attacked",
        "key, attacked",
    ]
    assert all(0 < float(figure) < 1e4 for row in rows for figure in row[1:])


def test_another_machine_is_reached_with_a_key_alone(key):
    for host in ("0.0.0.0", "::", ""):
        with pytest.raises(InputError, match=r"cannot listen on .*(--key FILE|no address|port 0)"):
            Host(host, 0)
    with closing(Host("0.0.0.0", 0, key)) as host:
        assert host.address.startswith("tcp://0.0.0.0:")
    with pytest.raises(InputError, match=r"on another machine, and there is no key; .*--key FILE"):
        Caller("192.0.2.1:5555")
    Caller("192.0.2.1:5555", key).close()
    for address in ("127.0.0.1:5555", "localhost:5555", "[::1]:5555"):
        Caller(address).close()


def test_what_is_no_key_is_refused_in_words(key, other_key, tmp_path):
    text = key.read_bytes()
    begin = text.index(b"-----BEGIN CERTIFICATE")
    other = other_key.read_bytes()

    def openssl(words):
        return subprocess.run(["openssl", *words], check=True, capture_output=True).stdout

    locked = openssl(["pkey", "-in", key, "-aes128", "-passout", "pass:secret"])
    expired = openssl(["x509", "-in", key, "-signkey", key, "-days", "-1"])
    request = tmp_path / "request.pem"
    request.write_bytes(openssl(["req", "-new", "-key", key, "-subj", "/CN=own"]))
    authority = ["-CA", other_key, "-CAkey", other_key, "-set_serial", "1"]
    of_others = openssl(["x509", "-req", "-in", request, *authority])
    file = tmp_path / "own.pem"
    for content, mode, said in (
        (text, 0o640, "others may read or change this key .*chmod 600"),
        (text, 0o602, "others may read or change this key"),
        (b"", 0o600, "should hold one certificate"),
        (b"\xff" * 1000, 0o600, "should hold one certificate"),
        (text[:begin], 0o600, "should hold one certificate"),
        (text[begin:], 0o600, "no private key without a password"),
        (text + other[other.index(b"-----BEGIN CERTIFICATE") :], 0o600, "one certificate"),
        (text[:begin] + other[other.index(b"-----BEGIN CERTIFICATE") :], 0o600, "MISMATCH"),
        (b"x" * (64 * KIB + 1), 0o600, "no larger than"),
        (text[:begin] + expired, 0o600, "certificate has expired"),
        (text[:begin] + of_others, 0o600, "unable to get (local )?issuer"),
        (locked + text[begin:], 0o600, "without a password.*; make one with: openssl req"),
    ):
        file.write_bytes(content)
        file.chmod(mode)
        for listens in (True, False):
            with pytest.raises(InputError, match=said):
                tls_of(file, listens)
    for path, said in ((tmp_path, "not a regular file"), (tmp_path / "gone.pem", "no such file")):
        with pytest.raises(InputError, match=said):
            Caller("127.0.0.1:5555", path)
