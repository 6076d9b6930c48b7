"""Messages over TCP: the sockets of robots, and those of who drives them or looks on.

Before each message stands its length, 4 bytes with the highest first. What is kept of a connection is bounded: a
message that has come in part, and some that wait to leave; of what comes in between TCP makes the sender wait.
"""

from __future__ import annotations

import contextlib
import itertools
import selectors
import socket
import time
from collections.abc import Iterable
from typing import Final

from craftsim.errors import InputError
from craftsim.robots import ROBOT_HOST, ROBOT_PORT
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


class Line(OfOneProcess):
    """One connection: bytes become messages, and messages bytes."""

    _instead = "connect again"

    def __init__(self, connected: socket.socket) -> None:
        connected.setblocking(False)
        connected.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        for option in (socket.SO_SNDBUF, socket.SO_RCVBUF):
            connected.setsockopt(socket.SOL_SOCKET, option, _SYSTEM_BYTES)
        self.socket = connected
        self._came = bytearray()
        self._leaving = bytearray()
        self.ended = False
        """Whether nothing more comes than what :meth:`take` returns."""

    def fileno(self) -> int:
        """Return the socket's number, for a selector."""
        return self.socket.fileno()

    def read(self) -> None:
        """Read what has come, up to a message and its length. Raises CraftsimError in a forked process."""
        self.check_process()
        room = _HEAD_BYTES + MESSAGE_BYTES - len(self._came)
        if room <= 0 or self.ended:
            return
        try:
            data = self.socket.recv(room)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        self._came += data
        self.ended = not data

    def take(self) -> bytes | None:
        """Return the next message that has come whole, if there is one; one that is too long ends the connection."""
        size = int.from_bytes(self._came[:_HEAD_BYTES], "big")
        end = _HEAD_BYTES + size
        if len(self._came) >= _HEAD_BYTES and size > MESSAGE_BYTES:
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
        try:
            while self._leaving:
                del self._leaving[: self.socket.send(self._leaving)]
        except BlockingIOError:
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
        lines: Iterable[Line], timeout_s: float, listens: socket.socket | None = None
    ) -> bool:
        """Wait until something comes or can leave, and take part of it up; return whether somebody calls."""
        with selectors.DefaultSelector() as selector:
            if listens is not None:
                selector.register(listens, selectors.EVENT_READ)
            for line in lines:
                leaving = 0
                if line._leaving:
                    leaving = selectors.EVENT_WRITE
                selector.register(line, selectors.EVENT_READ | leaving)
            ready = [key.fileobj for key, _ in selector.select(timeout_s)]
        for attended in ready:
            if isinstance(attended, Line):
                attended.flush()
                attended.read()
        return listens in ready


class Caller(NotCopyable):
    """The socket of who drives robots, or looks on: a :class:`~craftsim.robots.link.Messenger`."""

    _instead = "make another one of the same address"

    def __init__(self, address: str) -> None:
        """Call ``HOST:PORT`` or ``tcp://HOST:PORT``. Raises InputError for what is no address."""
        scheme, _, place = address.rpartition("://")
        host, _, port = place.rpartition(":")
        host = host.removeprefix("[").removesuffix("]")
        try:
            if scheme not in ("", "tcp") or not host:
                raise ValueError("not HOST:PORT")
            if not (port.isascii() and port.isdecimal() and 1 <= int(port[:6]) <= 65_535):
                raise ValueError("the port should be 1 to 65535")
            self._place = host, int(port)
            socket.getaddrinfo(*self._place, type=socket.SOCK_STREAM)
        except (OSError, TypeError, ValueError) as error:
            problem = getattr(error, "strerror", None) or error
            raise InputError(
                f"'{address[:100]}' is no address of robots ({problem}); try {ROBOT_HOST}:{ROBOT_PORT}"
            ) from None
        self._line: Line | None = None
        self._first = list[bytes]()
        """Messages to be sent as soon as somebody listens."""

    def send(self, data: bytes) -> None:
        """Send a message, or drop it where too many wait."""
        if self._line is not None:
            self._line.send(data)
        elif len(self._first) < _ADMITTED:
            self._first.append(data)

    def receive(self, timeout_s: float) -> bytes | None:
        """Return the next message that comes in time, or None; raise ConnectionError once the other side has closed."""
        deadline = time.monotonic() + timeout_s
        line = self._line or self._call(deadline)
        while line is not None:
            line.read()
            data = line.take()
            if data is not None:
                return data
            if line.ended:
                raise ConnectionError("the connection was closed")
            left_s = deadline - time.monotonic()
            if left_s <= 0:
                break
            Line.attend([line], left_s)
        return None

    def _call(self, deadline: float) -> Line | None:
        while True:
            left_s = max(_AGAIN_S, min(_CONNECTED_S, deadline - time.monotonic()))
            with contextlib.suppress(OSError):
                self._line = Line(socket.create_connection(self._place, left_s))
                for data in self._first:
                    self._line.send(data)
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

    def __init__(self, host: str, port: int) -> None:
        """Listen on a port, any free one if it is 0. Raises InputError for a place that cannot be had."""
        if ":" in host:
            family = socket.AF_INET6
        else:
            family = socket.AF_INET
        try:
            if not host:
                raise ValueError("no address")
            self._listens = socket.create_server((host, port), family=family)
        except (OSError, TypeError, ValueError) as error:
            problem = getattr(error, "strerror", None) or error
            raise InputError(
                f"cannot listen on {host}, port {port}: {problem}; try --host {ROBOT_HOST}, and --port 0 for a free one"
            ) from None
        self._listens.setblocking(False)
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
        there are too many, the one who came first of those but the ``driver`` is let go.
        """
        deadline = time.monotonic() + timeout_s
        left_s = 0.0
        while True:
            # What waits elsewhere is looked for before each turn, so that one who sends much starves nobody.
            if Line.attend(self._lines.values(), left_s, self._listens):
                self._admit(driver)
            for name, line in list(self._lines.items()):
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

    def _admit(self, driver: bytes | None) -> None:
        for _ in range(_ADMITTED):
            try:
                connected, _ = self._listens.accept()
            except OSError:
                return
            if len(self._lines) >= ROBOT_CONNECTIONS:
                first = min((name for name in self._lines if name != driver), key=int)
                self._lines.pop(first).close()
            try:
                self._lines[str(next(self._names)).encode()] = Line(connected)
            except OSError:  # it is closed already
                connected.close()
