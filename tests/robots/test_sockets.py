"""Real sockets on the loopback address: strangers neither fill the memory nor keep robots from their driver.

So it is without a key, and with one that they have, too.
"""

import contextlib
import resource
import socket
import ssl
from contextlib import ExitStack, closing, contextmanager

import pytest
from robots.made_keys import greet

from craftsim.errors import InputError
from craftsim.robots.keys import tls_of
from craftsim.robots.messages import Ack, Hello, pack, unpack
from craftsim.robots.sockets import Caller, Host
from craftsim.storage.limits import MESSAGE_BYTES, MIB, ROBOT_CONNECTIONS

WAIT_S = 20.0


def framed(data: bytes) -> bytes:
    return len(data).to_bytes(4, "big") + data


@pytest.fixture(params=["no key", "key"])
def host(request):
    key = None
    if request.param == "key":
        key = request.getfixturevalue("key")
    with closing(Host("127.0.0.1", 0, key)) as host:
        host.key = key
        host.tls = key and tls_of(key, listens=False)
        yield host


@contextmanager
def connected(host: Host, driver: bytes | None = None):
    place, port = host.address.removeprefix("tcp://").rsplit(":", 1)
    with socket.create_connection((place, int(port)), timeout=WAIT_S) as connection:
        if host.tls is None:
            yield connection
            return
        connection.setblocking(False)
        with host.tls.wrap_socket(connection, do_handshake_on_connect=False) as secret:
            greet(host, secret, driver)
            secret.settimeout(WAIT_S)
            yield secret


@contextmanager
def calling(host: Host, driver: bytes | None = None):
    with closing(Caller(host.address, host.key)) as caller:
        while caller._line is None or not caller._line.trusted:
            assert caller.receive(0.0) is None
            host.receive(0.0, driver)
        yield caller


def test_messages_come_whole_and_in_order_and_the_end_is_seen(host):
    with calling(host) as caller:
        sent = [b"", b"1", b"2" * MESSAGE_BYTES, *(str(n).encode() for n in range(500))]
        came = []
        for data in sent:
            caller.send(data)
            assert caller.receive(0.0) is None
            name, data = host.receive(WAIT_S)
            came.append(data)
        assert came == sent
        host.send(name, b"answer")
        assert caller.receive(WAIT_S) == b"answer"
    assert host.receive(WAIT_S) == (name, None)


def test_who_comes_first_is_waited_for():
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    caller = Caller(f"127.0.0.1:{port}")
    caller.send(b"early")
    assert caller.receive(0.1) is None
    with closing(Host("127.0.0.1", port)) as host:
        assert caller.receive(0.1) is None
        assert host.receive(WAIT_S)[1] == b"early"
    with pytest.raises(ConnectionError):
        caller.receive(WAIT_S)
    caller.close()


def test_what_does_not_end_is_bounded(host):
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with connected(host) as stranger, calling(host) as caller:
        stranger.setblocking(False)
        stranger.send((MESSAGE_BYTES).to_bytes(4, "big"))
        sent = 0
        with contextlib.suppress(
            ConnectionError, ssl.SSLEOFError
        ):  # the second message would be too long
            for _ in range(2000):
                with contextlib.suppress(BlockingIOError, ssl.SSLWantWriteError):
                    sent += stranger.send(b"\xff" * 65536)
                host.receive(0.0)
        assert sent < 4 * MIB
        caller.send(b"mine")
        assert caller.receive(0.0) is None
        assert any((host.receive(WAIT_S) or (0, 0))[1] == b"mine" for _ in range(10))
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 64 * 1024


def test_a_message_that_is_too_long_ends_the_connection(host):
    for head in (b"\xff\xff\xff\xff", (MESSAGE_BYTES + 1).to_bytes(4, "big"), b"GET "):
        with connected(host) as stranger:
            stranger.sendall(head + b"x" * 100)
            assert host.receive(WAIT_S)[1] is None
            assert stranger.recv(100) == b""


def test_one_who_reads_nothing_costs_a_bounded_queue(host):
    with connected(host) as stranger:
        stranger.sendall(framed(b"hello"))
        name, _ = host.receive(WAIT_S)
        for _ in range(1000):
            host.send(name, b"x" * MESSAGE_BYTES)
        assert len(host._lines[name]._leaving) <= 6 * MESSAGE_BYTES


def test_idle_connections_shut_nobody_out(host):
    with ExitStack() as stack:
        driver = stack.enter_context(calling(host))
        driver.send(b"drive")
        driver.receive(0.0)
        kept, _ = host.receive(WAIT_S)
        for _ in range(300):
            stack.enter_context(connected(host, kept))
            host.receive(0.0, kept)
        late = stack.enter_context(calling(host, kept))
        late.send(b"late")
        late.receive(0.0)
        found = [host.receive(WAIT_S, kept)]
        assert found[0][1] == b"late"
        assert len(host._lines) <= ROBOT_CONNECTIONS
        driver.send(b"still here")
        assert host.receive(WAIT_S, kept) == (kept, b"still here")


def test_one_who_sends_much_starves_nobody(host):
    ack = framed(pack(Ack(1)))
    with connected(host) as flood, calling(host) as caller:
        flood.sendall(ack * 2000)
        assert host.receive(WAIT_S)[1] == pack(Ack(1))
        caller.send(pack(Hello(1)))
        caller.receive(0.0)
        before = [host.receive(WAIT_S)[1] for _ in range(4)]
        assert isinstance(unpack(before[-1]), Ack)
        assert pack(Hello(1)) in before


def test_what_is_no_address_is_refused_in_words():
    for address in (
        *(
            "",
            ":",
            "127.0.0.1",
            "127.0.0.1:",
            "127.0.0.1:0",
            "127.0.0.1:99999",
            "127.0.0.1:5x",
            ":5555",
        ),
        *("\udcff:5555", "a" * 300 + ":5555", "a\x00b:5555", "[::1:5555:", "udp://127.0.0.1:5555"),
        "127.0.0.1:" + "9" * 5000,
    ):
        with pytest.raises(InputError, match="is no address of robots"):
            Caller(address)


def test_where_nobody_can_listen_is_refused_in_words(key):
    for host in ("", "\udcff", "a" * 300, "a\x00b", "192.0.2.1", "::2"):
        with pytest.raises(InputError, match="cannot listen on"):
            Host(host, 0, key)
