"""Messages: what is sent is read, and what is none is refused in words."""

import math

import msgpack
import pytest

from craftsim.discrete.actions import Action
from craftsim.models.sensing import CarMeasurement
from craftsim.robots.messages import (
    VERSION,
    Ack,
    Bye,
    Commands,
    Follow,
    Hello,
    Measurements,
    MessageError,
    Refused,
    TruePoses,
    Welcome,
    pack,
    unpack,
)
from craftsim.skills.skill import Command
from craftsim.storage.limits import MESSAGE_BYTES, PHYSICS_CARS, PHYSICS_PARTS

POSE = (0.0, 1.0, 2.0, 1.0, 0.0, 0.0, 0.0)
CAR = CarMeasurement(0.5, 1.0, 2.0, 0.0, 3.0, 0.1, -0.1, (1.0, 2.0, 3.0, 4.0), 0.045, 30.0, 1, 3.1)
MESSAGES = [
    Hello(2, "digest"),
    Welcome(2, 1, 0.02, 0.1, True, False),
    Refused("no", True),
    Measurements(
        7, 0.5, 3, -0.01, 0, (CAR, CAR._replace(slope=None, hinge_rad=None, board_force_n=math.inf))
    ),
    Commands(3, 0.6, (Command((1.0, 2.0, 3.0, 4.0), 0.05, -0.3),)),
    Ack(7),
    Bye(),
    Follow(),
    TruePoses(7, 0.5, (POSE,), (POSE, POSE), (3.1,), 2),
]


@pytest.mark.parametrize("message", MESSAGES, ids=lambda message: message.kind)
def test_what_is_sent_is_read(message):
    assert unpack(pack(message)) == message


def test_the_largest_worlds_fit_into_a_message():
    pose = (-1.2345678901234567,) * 7
    poses = TruePoses(2**53, 1e9, (pose,) * PHYSICS_CARS, (pose,) * PHYSICS_PARTS, (1.23,) * PHYSICS_PARTS)
    assert len(pack(poses)) <= MESSAGE_BYTES
    assert len(pack(Measurements(2**53, 1e9, 2**53, 0.1, 0, (CAR,) * PHYSICS_CARS))) <= MESSAGE_BYTES


def changed(number: int = 4, /, **values) -> bytes:
    content = msgpack.unpackb(pack(MESSAGES[number]))
    return msgpack.packb({**content, **values})


@pytest.mark.parametrize(
    ("data", "why"),
    [
        (b"", "no MessagePack"),
        (b"\xc1", "no MessagePack"),
        (b"\x91" * 5000, "no MessagePack"),
        (b"\x00" * (MESSAGE_BYTES + 1), "at most 65536"),
        (msgpack.packb([1, 2]), "no map"),
        (changed(v=VERSION + 1), "version 2 of the protocol; this craftsim speaks version 1"),
        (changed(kind="order"), "kind 'order'; there are hello"),
        (changed(kind=["x"] * 1000), "kind \\['x'"),
        (changed(number=-1), "commands.number"),
        (changed(at_s=float("nan")), "commands.at_s"),
        (changed(extra=1), "commands.extra"),
        (changed(3, late_s=float("nan")), "measurements.late_s"),
        (changed(3, time_s=float("inf")), "measurements.time_s"),
        (changed(3, cars=[{}]), "measurements.cars.0.time_s"),
        (changed(8, hinges=[float("nan")]), "poses.hinges.0"),
        (changed(cars=[{"wheels": [1, 2, 3], "board": 0.0, "hinge": 0.0}]), "commands.cars.0.wheels.3"),
        (changed(cars=[{"wheels": [1, 2, 3, float("inf")], "board": 0.0, "hinge": 0.0}]), "finite"),
        (changed(cars=[{"wheels": [0] * 4}] * (PHYSICS_CARS + 1)), "commands.cars"),
    ],
)
def test_what_is_no_message_is_refused_in_words(data, why):
    with pytest.raises(MessageError, match=why):
        unpack(data)


def test_noise_is_refused_and_nothing_else_happens(make_robots):
    robots = make_robots((3, 1, 1), [(0, 0, 1, 0)])
    told = []
    robots.service._tell = told.append
    for data in (b"", b"\x80", pack(Welcome(1, 0, 0.02, 0.1)), pack(Commands(1, 0.0, (Command(),) * 2))):
        robots.service.arrive(b"driver", data, robots.service.now_s)
    robots.service.arrive(b"stranger", pack(Commands(99, 0.0, (Command((9.0,) * 4),))), robots.service.now_s)
    assert robots.service.malformed == 5
    assert [line[:18] for line in told] == ["dropped a message:"] * 5
    assert robots.checked.perform(0, Action.MOVE_RIGHT).agrees
