"""Robots and referees that say what cannot be, and clients of robots that mean harm: each ends in words."""

import math
import re
from collections import deque
from dataclasses import replace

import msgpack
import numpy as np
import pytest
from discrete.drawn import draw

from craftsim.checking.setup import set_up, setup_of
from craftsim.discrete.grid import Kind
from craftsim.discrete.kinds import Action
from craftsim.errors import InputError
from craftsim.models.measuring import CarMeasurement
from craftsim.robots.link import Link, connect
from craftsim.robots.messages import Ack, Bye, Commands, Hello, Measurements, Welcome, pack, unpack
from craftsim.robots.server import Network, Server, Service
from craftsim.robots.simulated import simulated_robots
from craftsim.skills.outcome import Reason
from craftsim.skills.skill import Command

SIZE, CARS = (3, 1, 1), [(0, 0, 1, 0)]


class Lying:
    """A connection on which some messages are others, and each receipt takes a thousandth of a second."""

    def __init__(self, true, lie, clock):
        self.true, self.lie, self.clock, self.receipts = true, lie, clock, 0

    @property
    def now_s(self) -> float:
        return self.clock[0]

    def send(self, data: bytes) -> None:
        self.true.send(data)

    def receive(self, timeout_s: float) -> bytes | None:
        self.receipts += 1
        assert self.receipts < 50_000, "it never ends"
        self.clock[0] += 0.001
        data = self.true.receive(timeout_s)
        return None if data is None else self.lie(data)


@pytest.fixture
def clock(monkeypatch):
    """Let the time in which links and mirrors wait be one that the test counts."""
    now = [0.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    return now


def changed(data: bytes, **values) -> bytes:
    return msgpack.packb({**msgpack.unpackb(data), **values})


def measured(time_s=lambda time_s: time_s, **values):
    """Return what changes the time of measurements, a function of the true one, and what the first car measures."""

    def lie(data: bytes) -> bytes:
        content = msgpack.unpackb(data)
        if content["kind"] == "measurements":
            content["cars"][0].update(values)
            content["time_s"] = time_s(content["time_s"])
        return msgpack.packb(content)

    return lie


def outcome_of(robots, periods):
    """Return how the action of the first car ends within so many control periods."""
    for _ in range(periods):
        if ended := robots.judge.executor.advance():
            return ended[0]
    raise AssertionError("it does not end")


@pytest.mark.parametrize(
    ("lie", "why"),
    [
        (measured(x=math.nan), r"dropped: measurements: key 'cars\[0\].x'"),
        (measured(lines=[1e308] * 4), r"dropped: measurements: key 'cars\[0\].lines"),
        (measured(x=500.0), "dropped: car 0 at \\(500, .*outside the world"),
        (measured(slope=0, hinge_rad=0.0), "dropped: car 0 docked to slope 0; there are 0"),
        (
            lambda data: changed(data, cars=[]) if b"measurements" in data else data,
            "of 0 cars; there are 1",
        ),
        (measured(lambda time_s: 0.0), "dropped: a clock that went from .* s to 0 s"),
        (measured(lambda time_s: 1e9 - time_s), "clock of the robots was 1e\\+09 s ahead"),
        (measured(lambda time_s: 1e8 * time_s), "clock of the robots was .* s ahead"),
        (lambda data: b"\xff\xfe", "dropped: no map|dropped: no MessagePack"),
        (lambda data: b"\x81\xa1\xff\xa1\xff", "dropped: no MessagePack"),
        (lambda data: pack(Ack(1)), "nothing has come from the robots for 1 s"),
    ],
)
def test_robots_that_say_what_cannot_be_are_lost_in_words(make_robots, clock, lie, why):
    robots = make_robots(SIZE, CARS)
    robots.judge.executor.begin(0, Action.MOVE_RIGHT)
    robots.judge.executor.advance()
    robots.link._transport = Lying(robots.driver, lie, clock)
    ended = outcome_of(robots, 3000)
    assert ended.reason is Reason.DISCONNECTED
    assert re.search(why, str(ended)), str(ended)


@pytest.mark.parametrize("lie", [measured(x=math.nan), measured(lambda time_s: 1e9 - time_s)])
def test_robots_that_say_what_cannot_be_at_first_are_refused(make_robots, clock, lie):
    robots = make_robots(SIZE, CARS)
    robots.service.leave()
    robots.driver.inbox.clear()
    with pytest.raises(InputError, match="dropped: "):
        Link(Lying(robots.driver, lie, clock), 1, setup_of(drive="wheels").machines)


def test_a_clock_that_leaps_makes_no_wheel_infinitely_fast(make_robots, clock):
    robots = make_robots(SIZE, CARS)
    leaps = measured(lambda time_s: time_s + 1e6, wheel_speeds=[0.0, 0.0, -1e3, 0.0])
    robots.link._transport = Lying(robots.driver, leaps, clock)
    robots.link.attend()
    assert not robots.link.lost
    assert abs(robots.link.read()["wheel_speeds"]).max() <= 1e5


def referee(lie):
    """Return what changes what the referee says, and nothing else."""
    return lambda data: lie(data) if msgpack.unpackb(data)["kind"] == "poses" else data


def poses(**values):
    return referee(lambda data: changed(data, **values))


POSE = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]


@pytest.mark.parametrize(
    ("lie", "why"),
    [
        (poses(things=[POSE]), "1 cars, 1 things and 0 hinges; there are 1, 0 and 0"),
        (poses(cars=[[math.nan, *POSE[1:]]]), r"poses: key 'cars\[0\]\[0\]"),
        (poses(cars=[[300.0, *POSE[1:]]]), "outside the world"),
        (poses(cars=[[0.0] * 7]), "length 1"),
        (poses(time_s=0.0), "nothing of use for 1 s"),
        (poses(time_s=1e9), "the referee's clock shows 1e"),
        (referee(lambda data: pack(Hello(1))), "nothing of use for 1 s"),
        (referee(lambda data: b"\xff\xfe"), "dropped: no "),
    ],
)
def test_a_referee_that_says_what_cannot_be_is_lost_in_words(make_robots, clock, lie, why):
    robots = make_robots(SIZE, CARS)
    robots.judge.executor.begin(0, Action.MOVE_RIGHT)
    robots.link._transport = Lying(robots.driver, lie, clock)
    ended = outcome_of(robots, 100)
    assert ended.reason is Reason.DISCONNECTED
    assert re.search(why, str(ended)), str(ended)
    assert np.isfinite(robots.judge.physics.data.qpos).all()


class Wire:
    """Sockets in memory, and a clock that goes on with each look at them."""

    def __init__(self):
        self.now_s, self.waiting, self.sent = 0.0, deque(), {}
        self.flood = None
        self.looks, self.flood_s = 0, 1e-5

    def now(self) -> float:
        return self.now_s

    def send(self, receiver: bytes, data: bytes) -> None:
        self.sent.setdefault(receiver, []).append(unpack(data))

    def receive(self, timeout_s: float, kept) -> tuple[bytes, bytes | None] | None:
        self.looks += 1
        assert self.looks < 100_000, "it never ends"
        if self.waiting:
            return self.waiting.popleft()
        if self.flood is not None:
            self.now_s += self.flood_s
            return self.flood
        self.now_s += max(timeout_s, 1e-4)
        return None


def serve(waits: bool, patience_s: float = 60.0):
    """Return a server of a robot, its service, its sockets and what is told."""
    fleet = set_up(
        draw(SIZE, (), CARS), setup_of(drive="wheels"), watch_contacts=False
    ).executor.fleet
    wire, told = Wire(), []
    rngs = [np.random.default_rng(0)] * 2
    service = Service(
        *(simulated_robots(fleet), fleet, wire.send, Network(), rngs), waits=waits, tell=told.append
    )
    return Server(service, wire, 1.0, patience_s, wire.now), service, wire, told


def driven(waits: bool, patience_s: float = 60.0, looks: int = 3):
    """Return the same, with somebody who has said hello."""
    server, service, wire, told = serve(waits, patience_s)
    wire.waiting.append((b"driver", pack(Hello(1))))
    run(server, wire, looks)
    return server, service, wire, told


def run(server: Server, wire: Wire, looks: int) -> None:
    """Let a server go round so often."""
    left = iter(range(looks))
    server.run(lambda: next(left, None) is None)


@pytest.mark.parametrize("sender", [b"driver", b"stranger"])
def test_acknowledgements_without_end_do_not_stop_the_robots_time(sender):
    server, service, wire, _ = driven(waits=False)
    wire.flood = sender, pack(Ack(1))
    before, looks = service.periods, wire.looks
    while wire.looks < looks + 20_000:  # 0.2 s of them
        run(server, wire, 100)
    assert service.periods - before >= 8
    assert server.behind_s < 0.1


@pytest.mark.parametrize("flood", [(b"stranger", pack(Ack(1))), (b"stranger", pack(Hello(1)))])
def test_robots_in_lock_step_leave_a_driver_that_is_silent(flood):
    server, service, wire, told = driven(waits=True, patience_s=0.1)
    wire.flood, wire.flood_s = flood, 5e-4
    looks = wire.looks
    while wire.looks < looks + 90_000 and service.now_s < 2.5:
        run(server, wire, 100)
        if service.driver == b"stranger":
            break
    wire.flood = None
    wire.waiting.append((b"other", pack(Hello(1))))
    run(server, wire, 3)
    assert service.driver in (b"other", b"stranger")
    assert sum("refused" in line or "dropped" in line for line in told) <= 10


@pytest.mark.parametrize("waits", [False, True])
def test_who_comes_and_goes_without_end_fills_no_log(waits):
    server, service, wire, told = serve(waits)
    for number in range(300):
        sender = str(number).encode()
        wire.waiting.extend(
            [
                (sender, pack(Hello(1))),
                (sender, pack(Bye())),
                (sender, pack(Hello(1))),
                (sender, None),
            ]
        )
    run(server, wire, 3000)
    assert not wire.waiting
    assert service.now_s < 60
    assert 1 <= sum("welcome" in line for line in told) <= 10


def test_robots_in_lock_step_obey_the_next_one_once_their_driver_is_gone():
    server, service, wire, _ = driven(waits=True)
    service.arrive(b"driver", pack(Commands(1, 0.0, (Command((5.0,) * 4),))), service.now_s)
    wire.waiting.append((b"driver", None))
    run(server, wire, 100)
    assert len(service.stopped_at_s) == 1  # the watchdog is what stops them
    assert (service.driver, service.farewells) == (None, 1)
    wire.waiting.append((b"other", pack(Hello(1))))
    run(server, wire, 2)
    assert service.driver == b"other"
    assert service.unseen  # and their time waits for it


def test_what_a_driver_has_sent_before_is_none_of_the_next_ones(monkeypatch):
    server, service, wire, _ = driven(waits=False, looks=1)
    wire.waiting.append((b"driver", pack(Commands(2**53, 0.0, (Command((5.0,) * 4),)))))
    wire.waiting.append((b"driver", pack(Bye())))
    wire.waiting.append((b"other", pack(Hello(1))))
    run(server, wire, 10)
    assert service.driver == b"other"
    assert service.inbox.heard == 0


class Scripted:
    """A connection on which robots answer a greeting, and then measure the same all the time."""

    def __init__(self, cars, clock, /, **values):
        self.left, self.clock = [pack(replace(Welcome(2, 1, 0.02, 0.1, True), **values))], clock
        self.left += [pack(Measurements(n, 0.02 * n, 0, 0.0, 0, cars)) for n in range(1, 60)]

    @property
    def now_s(self) -> float:
        return self.clock[0]

    def send(self, data: bytes) -> None:
        pass

    def receive(self, timeout_s: float) -> bytes | None:
        self.clock[0] += 0.0 if self.left else timeout_s
        return self.left.pop(0) if self.left else None

    def close(self) -> None:
        pass


CAR = CarMeasurement(0.5, 0.2, 0.2, 0.0, 0.0, 0.0, 0.0, (0.0,) * 4, 0.0, 0.0, None, None)


@pytest.mark.parametrize(
    ("cars", "values", "why"),
    [
        ((CAR,), {}, "measurements of 1 cars; there are 2"),
        ((CAR, CAR), {"slopes": 3}, "know of 3 slopes"),
        ((CAR, CAR), {"period_s": 0.01}, "control period is 0.01 s"),
        ((CAR, CAR), {"referee": False}, "there is no referee"),
        ((CAR, CAR), {"cars": 3}, "3 robots answer, and there should be 2"),
        ((CAR, CAR), {}, "the referee has shown nothing of use"),
    ],
)
def test_robots_that_do_not_fit_are_refused_in_words(clock, cars, values, why):
    grid = draw((3, 3, 2), [(Kind.FSLOPE, (1, 1, 1), 2)], [(0, 0, 1, 0), (2, 2, 1, 0)])
    with pytest.raises(InputError, match=why):
        connect(Scripted(cars, clock, **values), grid, setup_of(drive="wheels"))
