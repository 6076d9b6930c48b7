"""Measure how long a message to robots and the answer take, with and without a key, in turns in one run.

    python scripts/robot_latency.py [--rounds 20]

Robots answer the commands of four cars with measurements over the loopback address, in another process. In half of the
cases somebody calls them without end and shows another key, or, where there is none, sends what is no message. It needs
the command openssl.
"""

from __future__ import annotations

import argparse
import multiprocessing
import shlex
import socket
import ssl
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

from craftsim.models.measuring import CarMeasurement
from craftsim.robots.keys import MAKE, tls_of
from craftsim.robots.messages import Commands, Measurements, pack
from craftsim.robots.sockets import Caller, Host
from craftsim.skills.skill import Command

CARS = 4
EACH = 100
"""Messages of a case in one round."""
ATTACK_S = 0.5
"""Time that an attacker has before its effect is measured."""
CAR = CarMeasurement(0.5, 0.2, 0.2, 0.0, 0.0, 0.0, 0.0, (0.0,) * 4, 0.0, 0.0, None, None)
COMMANDS = pack(Commands(1, 0.0, (Command((1.0,) * 4),) * CARS))
MEASURED = pack(Measurements(1, 0.0, 1, 0.0, 0, (CAR,) * CARS))
WAIT_S = 10.0


def main(words: list[str] | None = None) -> int:
    """Measure, and print a table. Exit status: 0, or 1 where a message had no answer."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--rounds", type=int, default=20, help="of 100 messages in each case")
    rounds = parser.parse_args(words).rounds
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        key = _make_key(Path(folder) / "robots.pem")
        other_key = _make_key(Path(folder) / "other.pem")
        times: dict[tuple[str, str], list[float]] = {}
        drivers = {}
        addresses = {}
        for name, file in (("no key", None), ("key", key)):
            addresses[name] = stack.enter_context(_process(_answer, file))
            drivers[name] = stack.enter_context(closing(Caller(addresses[name], file)))
        for _ in range(rounds):
            for name, driver in drivers.items():
                times.setdefault((name, "quiet"), []).extend(_ask(driver))
        for name, driver in drivers.items():
            shown = None
            if name == "key":
                shown = other_key
            with _process(_attack, addresses[name], shown):
                time.sleep(ATTACK_S)
                for _ in range(rounds):
                    times.setdefault((name, "attacked"), []).extend(_ask(driver))
    print("| | median, ms | 99 % below, ms | to no key |")
    print("| --- | --- | --- | --- |")
    for (name, condition), measured in times.items():
        median = float(np.median(measured))
        ratio = median / float(np.median(times["no key", condition]))
        high = float(np.quantile(measured, 0.99))
        print(f"| {name}, {condition} | {1e3 * median:.2f} | {1e3 * high:.2f} | {ratio:.2f} |")
    return int(any(np.isnan(measured).any() for measured in times.values()))


def _make_key(path: Path) -> Path:
    words = shlex.split(MAKE.replace("robots.pem", str(path)))
    subprocess.run(words, check=True, capture_output=True)
    return path


@contextmanager
def _process(function, *arguments) -> Iterator[str]:
    """Run a function in a process of its own, and yield the address that it sends, if any."""
    here, there = multiprocessing.Pipe()
    process = multiprocessing.get_context("spawn").Process(
        target=function, args=(there, *arguments), daemon=True
    )
    process.start()
    try:
        yield here.recv()
    finally:
        process.kill()
        process.join()


def _answer(told: Connection, key: Path | None) -> None:
    """Answer commands until the process is ended."""
    with closing(Host("127.0.0.1", 0, key)) as host:
        told.send(host.address.removeprefix("tcp://"))
        driver = None
        while True:
            received = host.receive(1.0, driver)
            if received is None or received[1] != COMMANDS:
                continue
            driver = received[0]
            host.send(driver, MEASURED)


def _attack(told: Connection, address: str, key: Path | None) -> None:
    """Call without end, and show a key, or send what is no message."""
    place, port = address.rsplit(":", 1)
    tls = None
    if key is not None:
        tls = tls_of(key, listens=False)
        tls.verify_mode = ssl.CERT_NONE
    told.send("")
    while True:
        with suppress(OSError), socket.create_connection((place, int(port)), 1.0) as connection:
            if tls is None:
                connection.sendall((COMMANDS[:2] + b"\xff") * 1000)
            else:
                tls.wrap_socket(connection).recv(1)


def _ask(driver: Caller) -> list[float]:
    """Return how long the answers to some messages took in seconds, not a number where none came."""
    times = []
    for _ in range(EACH):
        begun_s = time.perf_counter()
        driver.send(COMMANDS)
        if driver.receive(WAIT_S) == MEASURED:
            times.append(time.perf_counter() - begun_s)
        else:
            times.append(float("nan"))
    return times


if __name__ == "__main__":
    raise SystemExit(main())
