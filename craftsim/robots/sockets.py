"""Messages over TCP: the sockets of robots, and those of who drives them or looks on.

Before each message stands its length, 4 bytes with the highest first. What is kept of a connection is bounded: a
message that has come in part, and some that wait to leave; of what comes in between TCP makes the sender wait. With a
key (craftsim/robots/keys.py) no message is read or sent before the other side has shown it.
"""

from __future__ import annotations

import contextlib
import ipaddress
import itertools
import selectors
import socket
import ssl
import time
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Final

from craftsim.errors import InputError
from craftsim.robots import ROBOT_HOST, ROBOT_PORT
from craftsim.robots.keys import tls_of
from craftsim.storage.limits import MESSAGE_BYTES, ROBOT_CONNECTIONS
from craftsim.workers.copying import NotCopyable, OfOneProcess

_HEAD_BYTES: Final = 4
_LEAVING_BYTES: Final = 4 * MESSAGE_BYTES
"""Limit of what waits to be sent; messages beyond it are dropped."""
_SYSTEM_BYTES: Final = MESSAGE_BYTES
"""Buffer of the system in each direction: old messages are of no use."""
_AGAIN_S: Final = 0.05
"""Time between attempts to connect where nobody listens yet."""
_CONNECTED_S: Final = 1.0
"""Time limit of accepting a connection."""
_ADMITTED: Final = 4
"""Connections that are accepted before the existing ones are read again."""
_SHOWN_S: Final = 2.0
"""Time limit of showing the key."""
_SHOWING_S: Final = 0.004
"""Time after which no further connection is taken up, in the same turn, that has not shown the key."""
_HELLO: Final = b"\x16\x03"
"""Beginning of what TLS says at first; no message that is short enough begins so."""
_ALERT: Final = b"\x15\x03"
"""Beginning of what TLS says where it ends."""
_NO_TLS: Final = _ALERT + b"\x03\x00\x02\x02\x46"
"""What is said in TLS to who speaks it alone, or does not where it is asked for: protocol version (RFC 8446, 6)."""

_PLAIN: Final = ("WRONG_VERSION_NUMBER", "HTTP_REQUEST")
"""Reasons of TLS for what is none of it."""


def is_loopback(host: str) -> bool:
    """Return whether this machine alone reaches an address. Raises OSError or ValueError for what is none."""
    places = {str(place[4][0]).partition("%")[0] for place in socket.getaddrinfo(host, None)}
    return all(ipaddress.ip_address(place).is_loopback for place in places)


def _is_end(error: ssl.SSLError) -> bool:
    """Return whether TLS says no more than that the connection has ended."""
    return isinstance(error, ssl.SSLEOFError | ssl.SSLZeroReturnError)


class Line(OfOneProcess):
    """One connection: bytes become messages, and messages bytes."""

    _instead = "connect again"

    def __init__(self, connected: socket.socket, tls: ssl.SSLContext | None = None) -> None:
        connected.setblocking(False)
        connected.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        for option in (socket.SO_SNDBUF, socket.SO_RCVBUF):
            connected.setsockopt(socket.SOL_SOCKET, option, _SYSTEM_BYTES)
        self.trusted = tls is None
        """Whether the other side has shown the key, or needs none."""
        self.socket = connected
        if tls is not None:
            listens = tls.protocol == ssl.PROTOCOL_TLS_SERVER
            self.socket = tls.wrap_socket(
                connected, server_side=listens, do_handshake_on_connect=False
            )
        self.since_s = time.monotonic()
        """Time at which it began, by this machine's clock."""
        self._came = bytearray()
        self._leaving = bytearray()
        self.ended = False
        """Whether nothing more comes than what :meth:`take` returns."""
        self.problem = ""
        """Why it ended, where the other side has not shown the key, or asks for one."""
        self.is_final = False
        """Whether another call would end in the same way."""

    def fileno(self) -> int:
        """Return the socket's number, for a selector."""
        return self.socket.fileno()

    def read(self) -> None:
        """Read what has come, up to a message and its length. Raises CraftsimError in a forked process."""
        self.check_process()
        if not self.trusted and not self.ended:
            self._show_key()
        room = _HEAD_BYTES + MESSAGE_BYTES - len(self._came)
        if room <= 0 or self.ended or not self.trusted:
            return
        try:
            data = self.socket.recv(room)
        except (BlockingIOError, ssl.SSLWantReadError):
            return
        except OSError as error:
            self._note(error)
            data = b""
        self._came += data
        self.ended = not data

    def _show_key(self) -> None:
        """Go on with showing each other the key, as far as what has come allows."""
        assert isinstance(self.socket, ssl.SSLSocket)
        try:
            self.socket.do_handshake()
        except ssl.SSLWantReadError:
            return
        except OSError as error:
            # What is to be written here is less than the system's buffer.
            self._note(error)
            self.problem = self.problem or "the connection was closed before the key was shown"
            if getattr(error, "reason", "") in _PLAIN:
                self._say_no()
            self.ended = True
            return
        self.trusted = True

    def _note(self, error: OSError) -> None:
        """Note what TLS says, if it is TLS that says something."""
        self.is_final = isinstance(error, ssl.SSLError) and not _is_end(error)
        if isinstance(error, ssl.SSLCertVerificationError):
            self.problem = f"another key ({error.verify_message})"
        elif self.is_final:
            reason = getattr(error, "reason", "") or "it ended"
            self.problem = f"TLS: {reason.lower().replace('_', ' ')}"

    def _say_no(self) -> None:
        with contextlib.suppress(OSError):
            # Beside TLS, if there is any.
            socket.socket.send(self.socket, _NO_TLS)

    @property
    def _has_more(self) -> bool:
        """Whether something has been decrypted that no selector tells of."""
        return isinstance(self.socket, ssl.SSLSocket) and self.socket.pending() > 0

    def take(self) -> bytes | None:
        """Return the next message that has come whole, if there is one; one that is too long ends the connection."""
        size = int.from_bytes(self._came[:_HEAD_BYTES], "big")
        end = _HEAD_BYTES + size
        if len(self._came) >= _HEAD_BYTES and size > MESSAGE_BYTES:
            if self._came.startswith(_ALERT):
                self.problem = "a key is asked for"
            if self._came.startswith(_HELLO):
                self._say_no()
            self.ended = True
            self._came.clear()
        if len(self._came) < end:
            return None
        data = bytes(self._came[_HEAD_BYTES:end])
        del self._came[:end]
        return data

    def send(self, data: bytes) -> None:
        """Send a message, or drop it where too many wait. Raises CraftsimError in a forked process."""
        self.check_process()
        if not self.ended and len(self._leaving) <= _LEAVING_BYTES:
            self._leaving += len(data).to_bytes(_HEAD_BYTES, "big") + data
            self.flush()

    def flush(self) -> None:
        """Let leave what can."""
        if not self.trusted:
            return
        try:
            while self._leaving:
                del self._leaving[: self.socket.send(self._leaving)]
        except (BlockingIOError, ssl.SSLWantWriteError, ssl.SSLWantReadError):
            return
        except OSError:
            # What has come before may still be read.
            self._leaving.clear()

    def close(self) -> None:
        """Let leave what can, such as a farewell, and close; in a forked process the connection stays the other's."""
        if self.is_forked:
            self.socket.close()
            return
        self.flush()
        with contextlib.suppress(OSError):
            # A socket that is closed with something unread takes back what has not arrived yet.
            self.socket.shutdown(socket.SHUT_WR)
            self.socket.recv(2 * _SYSTEM_BYTES)
        self.socket.close()

    @staticmethod
    def attend(
        lines: Collection[Line], timeout_s: float, listens: socket.socket | None = None
    ) -> bool:
        """Wait until something comes or can leave, and take part of it up; return whether somebody calls."""
        has_more = [line for line in lines if line._has_more]
        if has_more:
            timeout_s = 0.0
        with selectors.DefaultSelector() as selector:
            if listens is not None:
                selector.register(listens, selectors.EVENT_READ)
            for line in lines:
                leaving = 0
                if line._leaving and line.trusted:
                    leaving = selectors.EVENT_WRITE
                selector.register(line, selectors.EVENT_READ | leaving)
            ready = [key.fileobj for key, _ in selector.select(timeout_s)]
        ready += has_more
        until_s = time.monotonic() + _SHOWING_S
        for line in lines:
            if line in ready and (line.trusted or time.monotonic() < until_s):
                line.flush()
                line.read()
        return listens in ready


class Caller(NotCopyable):
    """The socket of who drives robots, or looks on: a :class:`~craftsim.robots.link.Messenger`."""

    _instead = "make another one of the same address"

    def __init__(self, address: str, key: Path | None = None) -> None:
        """Call ``HOST:PORT`` or ``tcp://HOST:PORT``, with the key of the robots if they have one.

        Raises InputError for what is no address or no key, and without one for another machine's address.
        """
        scheme, _, place = address.rpartition("://")
        host, _, port = place.rpartition(":")
        host = host.removeprefix("[").removesuffix("]")
        try:
            if scheme not in ("", "tcp") or not host:
                raise ValueError("not HOST:PORT")
            if not (port.isascii() and port.isdecimal() and 1 <= int(port[:6]) <= 65_535):
                raise ValueError("the port should be 1 to 65535")
            self._place = host, int(port)
            is_near = is_loopback(host)
        except (OSError, TypeError, ValueError) as error:
            problem = getattr(error, "strerror", None) or error
            raise InputError(
                f"'{address[:100]}' is no address of robots ({problem}); try {ROBOT_HOST}:{ROBOT_PORT}"
            ) from None
        self._tls = None
        if key is not None:
            self._tls = tls_of(key, listens=False)
        elif not is_near:
            raise InputError(
                f"robots at {address[:100]} are on another machine, and there is no key; add their key by --key FILE, "
                "or tunnel with ssh -L (docs/how-to/robots.md)"
            )
        self._line: Line | None = None
        self._first = list[bytes]()
        """Messages to be sent as soon as somebody listens, and has shown the key."""

    @property
    def now_s(self) -> float:
        """This machine's time, in seconds."""
        return time.monotonic()

    def send(self, data: bytes) -> None:
        """Send a message, or drop it where too many wait."""
        if self._line is not None and self._line.trusted:
            self._line.send(data)
        elif len(self._first) < _ADMITTED:
            self._first.append(data)

    def receive(self, timeout_s: float) -> bytes | None:
        """Return the next message that comes in time, or None; raise ConnectionError once the other side has closed."""
        deadline = time.monotonic() + timeout_s
        while (line := self._line or self._call(deadline)) is not None:
            line.read()
            if line.trusted:
                self._send_first(line)
            data = line.take()
            if data is not None:
                return data
            left_s = deadline - time.monotonic()
            if line.ended and (line.trusted or line.is_final or left_s <= _AGAIN_S):
                raise ConnectionError(self._why(line))
            if left_s <= 0:
                break
            if line.ended:
                # Too many others have called at the same time.
                line.close()
                self._line = None
                time.sleep(_AGAIN_S)
            else:
                Line.attend([line], left_s)
        return None

    def _send_first(self, line: Line) -> None:
        for data in self._first:
            line.send(data)
        self._first.clear()

    def _why(self, line: Line) -> str:
        """Return why a connection has ended."""
        if not line.problem:
            return "the connection was closed"
        place = ":".join(map(str, self._place))
        if self._tls is None:
            return f"{place}: {line.problem}; --key FILE names the key of the robots"
        return f"{place}: {line.problem}; robots and driver need the same --key FILE"

    def _call(self, deadline: float) -> Line | None:
        while True:
            left_s = max(_AGAIN_S, min(_CONNECTED_S, deadline - time.monotonic()))
            with contextlib.suppress(OSError):
                self._line = Line(socket.create_connection(self._place, left_s), self._tls)
                return self._line
            if deadline - time.monotonic() < _AGAIN_S:
                return None
            time.sleep(_AGAIN_S)

    def close(self) -> None:
        """Close the connection."""
        if self._line is not None:
            self._line.close()


class Host(NotCopyable):
    """The socket of robots, and the connections to it."""

    _instead = "make another one, at another port"

    def __init__(self, host: str, port: int, key: Path | None = None) -> None:
        """Listen on a port, any free one if it is 0, to those who have the key, to all where there is none.

        Raises InputError for a place that cannot be had, for what is no key, and for an address that other machines
        reach without one.
        """
        self._tls = None
        if key is not None:
            self._tls = tls_of(key, listens=True)
        if ":" in host:
            family = socket.AF_INET6
        else:
            family = socket.AF_INET
        try:
            if not host:
                raise ValueError("no address")
            if self._tls is None and not is_loopback(host):
                raise ValueError("other machines reach it, so it needs --key FILE")
            self._listens = socket.create_server((host, port), family=family)
        except (OSError, TypeError, ValueError) as error:
            problem = getattr(error, "strerror", None) or error
            raise InputError(
                f"cannot listen on {host}, port {port}: {problem}; try --host {ROBOT_HOST}, and --port 0 for a free one"
            ) from None
        self._listens.setblocking(False)
        self.refused = 0
        """Connections on which the key was not shown."""
        self.tell: Callable[[str], None] = lambda line: None
        """Says who was refused."""
        self._lines: dict[bytes, Line] = {}
        """By who has connected, numbers that count up; who had a turn last comes last."""
        self._names = itertools.count(1)

    def close(self) -> None:
        """Close all connections."""
        for line in self._lines.values():
            line.close()
        self._listens.close()

    @property
    def address(self) -> str:
        """Address at which robots are reached."""
        host, port = self._listens.getsockname()[:2]
        if ":" in host:
            return f"tcp://[{host}]:{port}"
        return f"tcp://{host}:{port}"

    def send(self, receiver: bytes, data: bytes) -> None:
        """Send a message, or drop it where too many wait."""
        line = self._lines.get(receiver)
        if line is not None:
            line.send(data)

    def receive(
        self, timeout_s: float, driver: bytes | None = None
    ) -> tuple[bytes, bytes | None] | None:
        """Return (from whom, what) comes next, or None where nothing does in time.

        Who are connected have one turn after the other. No message is of one who has closed the connection. Where
        there are too many, the one who came first of those but the ``driver`` is let go, of those first who have not
        shown the key; nothing is said of these.
        """
        deadline = time.monotonic() + timeout_s
        left_s = 0.0
        while True:
            # What waits elsewhere is looked for before each turn, so that one who sends much starves nobody.
            if Line.attend(self._lines.values(), left_s, self._listens):
                self._admit(driver)
            late_s = time.monotonic() - _SHOWN_S
            for name, line in list(self._lines.items()):
                if not line.trusted:
                    if line.ended or line.since_s < late_s:
                        self._refuse(name)
                    continue
                data = line.take()
                if data is None and not line.ended:
                    continue
                del self._lines[name]
                if data is None:
                    line.close()
                else:
                    self._lines[name] = line
                return name, data
            left_s = deadline - time.monotonic()
            if left_s <= 0:
                return None

    def _refuse(self, name: bytes) -> None:
        line = self._lines.pop(name)
        self.refused += 1
        self.tell(f"refused a connection: {line.problem or 'no key was shown in time'}")
        line.close()

    def _admit(self, driver: bytes | None) -> None:
        for _ in range(_ADMITTED):
            try:
                connected, _ = self._listens.accept()
            except OSError:
                return
            if len(self._lines) >= ROBOT_CONNECTIONS:
                candidates = self._lines.keys() - {driver}
                first = min(candidates, key=lambda name: (self._lines[name].trusted, int(name)))
                if self._lines[first].trusted:
                    self._lines.pop(first).close()
                else:
                    self._refuse(first)
            try:
                self._lines[str(next(self._names)).encode()] = Line(connected, self._tls)
            except OSError:  # it is closed already
                connected.close()
