"""Messages over TCP, by ZeroMQ: the socket of robots, and those of who drives them or looks on."""

from __future__ import annotations

from types import TracebackType
from typing import Any, Final, Self

import zmq

from craftsim.errors import InputError
from craftsim.robots.extra import LOOPBACK
from craftsim.storage.limits import MESSAGE_BYTES

_QUEUED: Final = 200
"""Messages that wait in a socket; more are dropped."""


def _socket(kind: int) -> Any:
    socket: Any = zmq.Context.instance().socket(kind)
    socket.setsockopt(zmq.LINGER, 0)
    socket.setsockopt(zmq.SNDHWM, _QUEUED)
    socket.setsockopt(zmq.RCVHWM, _QUEUED)
    socket.setsockopt(zmq.MAXMSGSIZE, MESSAGE_BYTES)
    return socket


def _poll(socket: Any, timeout_s: float) -> bool:
    return bool(socket.poll(max(0, round(1e3 * timeout_s)), zmq.POLLIN))


class Caller:
    """The socket of who drives robots, or looks on: a :class:`~craftsim.robots.link.Messenger`."""

    def __init__(self, address: str) -> None:
        """Connect to ``tcp://HOST:PORT``. Raises InputError for what is no address."""
        self._socket = _socket(zmq.DEALER)
        try:
            self._socket.connect(address)
        except zmq.ZMQError as error:
            self._socket.close()
            raise InputError(
                f"'{address}' is no address of robots ({error}); try tcp://{LOOPBACK}:5555"
            ) from None

    def send(self, data: bytes) -> None:
        """Send a message, or drop it where too many wait."""
        try:
            self._socket.send(data, zmq.NOBLOCK)
        except zmq.Again:
            return

    def receive(self, timeout_s: float) -> bytes | None:
        """Return the next message that comes, or None where none does in time."""
        if not _poll(self._socket, timeout_s):
            return None
        data: bytes = self._socket.recv(zmq.NOBLOCK)
        return data

    def close(self) -> None:
        """Close the socket."""
        # What was sent last, such as a farewell, may leave.
        self._socket.close(linger=200)


class Host:
    """The socket of robots."""

    def __init__(self, host: str, port: int) -> None:
        """Listen on a port, any free one if it is 0.

        Raises InputError for an address or a port that cannot be had.
        """
        self._socket = _socket(zmq.ROUTER)
        try:
            self._socket.bind(f"tcp://{host}:{port or '*'}")
        except zmq.ZMQError as error:
            self.__exit__(None, None, None)
            raise InputError(
                f"cannot listen on {host}, port {port}: {error}; try --host {LOOPBACK}, and --port 0 for a free one"
            ) from None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the socket."""
        self._socket.close(linger=200)

    @property
    def address(self) -> str:
        """Where robots are reached."""
        return str(self._socket.getsockopt_string(zmq.LAST_ENDPOINT))

    def send(self, receiver: bytes, data: bytes) -> None:
        """Send a message, or drop it where too many wait."""
        try:
            self._socket.send_multipart([receiver, data], zmq.NOBLOCK)
        except zmq.Again:
            return

    def receive(self, timeout_s: float) -> tuple[bytes, bytes] | None:
        """Return (from whom, what) comes next, or None where nothing does in time."""
        if not _poll(self._socket, timeout_s):
            return None
        sender, *parts = self._socket.recv_multipart(zmq.NOBLOCK)
        return sender, parts[-1] if len(parts) == 1 else b""
