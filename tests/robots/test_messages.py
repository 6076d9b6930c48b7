"""Messages: what is sent is read, and what is none is refused in words."""

import math
import re

import msgpack
import pytest
from pydantic import ValidationError

from craftsim.discrete.kinds import Action
from craftsim.models.measuring import CarMeasurement
from craftsim.robots.messages import (
    VERSION,
    Ack,
    Bye,
    Commands,
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

POSE = (0.0, 1.0, 2.0, 0.5, -0.5, 0.5, 0.5)
CAR = CarMeasurement(0.5, 1.0, 2.0, 0.0, 3.0, 0.1, -0.1, (1.0, 2.0, 3.0, 4.0), 0.045, 30.0, 1, 3.1)
MESSAGES = [
    Hello(2, "digest"),
    Welcome(2, 1, 0.02, 0.1, True, False),
    Refused("no", True),
    Measurements(7, 0.5, 3, -0.01, 0, (CAR, CAR._replace(slope=None, hinge_rad=None))),
    Commands(3, 0.6, (Command((1.0, 2.0, 3.0, 4.0), 0.05, -0.3),)),
    Ack(7),
    Bye(),
    TruePoses(0.5, (POSE,), (POSE, POSE), (3.1,), 2),
]


def test_what_is_sent_is_read():
    for message in MESSAGES:
        assert unpack(pack(message)) == message


def test_the_largest_worlds_fit_into_a_message():
    pose = (*(-1234.5678901234567,) * 3, *(-0.50000000001,) * 4)
    poses = TruePoses(1e9, (pose,) * PHYSICS_CARS, (pose,) * PHYSICS_PARTS, (1.23,) * PHYSICS_PARTS)
    assert len(pack(poses)) <= MESSAGE_BYTES
    assert (
        len(pack(Measurements(2**53, 1e9, 2**53, 0.1, 0, (CAR,) * PHYSICS_CARS))) <= MESSAGE_BYTES
    )


def changed(number: int = 4, /, **values) -> bytes:
    content = msgpack.unpackb(pack(MESSAGES[number]))
    return msgpack.packb({**content, **values})


def nested(depth: int) -> list:
    """Return a list in so many lists."""
    value: list = []
    for _ in range(depth):
        value = [value]
    return value


def test_what_is_no_message_is_refused_in_words():
    for data, why in (
        (b"", "no MessagePack"),
        (b"\xc1", "no MessagePack"),
        (b"\x91" * 5000, "no MessagePack"),
        (b"\x00" * (MESSAGE_BYTES + 1), "at most 131072"),
        (msgpack.packb([1, 2]), "no map"),
        (changed(v=VERSION + 1), "version 4 of the protocol; this craftsim speaks version 3"),
        (changed(kind="order"), "kind 'order'; there are hello"),
        (changed(kind=["x"] * 100), "kind \\['x'"),
        (changed(extra=1), "commands: unknown key 'extra'"),
        (
            changed(3, cars=[{}]),
            r"measurements: key 'cars\[0\]': needs 'time_s'; required: time_s, x",
        ),
        (
            changed(cars=[{"wheels": [1, 2, 3], "board": 0.0, "hinge": 0.0}]),
            "must be a list of 4 entries",
        ),
        (changed(cars=[{"wheels": [0] * 4}] * (PHYSICS_CARS + 1)), "commands: key 'cars'"),
        (changed(number=2**53 + 1), "number'"),
        (changed(3, cars=[{**CAR._asdict(), "slope": -1}]), "slope'"),
        (changed(1, period_s=1e-9), "period_s'"),
        (changed(7, cars=[(0.0,) * 7]), r"cars\[0\]'"),
        (changed(cars=nested(200)), "commands: "),
        (changed(cars=nested(900)), "commands: its lists or maps are nested too deep"),
    ):
        with pytest.raises(MessageError, match=why):
            unpack(data)


def test_a_message_full_of_mistakes_is_not_looked_through():
    many = {str(number): None for number in range(7_000)}
    for data in (
        changed(**many),
        changed(cars=[{}] * 60_000),
        changed(cars=[dict(list(many.items())[:30])] * 192),
        changed(3, cars=[{}] * 192),
        changed(7, things=[[None] * 7] * 7_000),
        changed(7, hinges=[None] * 60_000),
    ):
        assert len(data) <= MESSAGE_BYTES
        with pytest.raises(MessageError) as refused:
            unpack(data)
        why = refused.value.__context__
        assert not isinstance(why, ValidationError) or why.error_count() < 64


def places(node, place=""):
    """Yield where a number or a truth value stands in a message, and the key by which mistakes name it."""
    for key, value in node.items() if isinstance(node, dict) else enumerate(node):
        name = f"{place}[{key}]" if isinstance(key, int) else f"{place}.{key}".lstrip(".")
        if isinstance(value, dict | list):
            yield from places(value, name)
        elif isinstance(value, bool | int | float) and name != "v":
            yield node, key, name


def test_whatever_is_of_another_type_or_beyond_all_reason_is_refused_by_its_key():
    for message in MESSAGES:
        content = msgpack.unpackb(pack(message))
        for holder, key, name in places(content):
            before = holder[key]
            odd = (
                (None, 1, "x")
                if isinstance(before, bool)
                else (math.nan, 1e308, -1e308, True, "0", [1.0])
            )
            for value in odd:
                holder[key] = value
                with pytest.raises(MessageError, match=re.escape(f"{message.kind}: key '{name}'")):
                    unpack(msgpack.packb(content))
            holder[key] = before


def test_noise_is_refused_and_nothing_else_happens(make_robots):
    robots = make_robots((3, 1, 1), [(0, 0, 1, 0)])
    told = []
    robots.service._tell = told.append
    for data in (
        b"",
        b"\x80",
        pack(Welcome(1, 0, 0.02, 0.1)),
        pack(Commands(1, 0.0, (Command(),) * 2)),
    ):
        robots.service.arrive(b"driver", data, robots.service.now_s)
    robots.service.arrive(
        b"stranger", pack(Commands(99, 0.0, (Command((9.0,) * 4),))), robots.service.now_s
    )
    assert robots.service.malformed == 5
    assert [line[:18] for line in told] == ["dropped a message:"] * 5
    assert robots.judge.perform(0, Action.MOVE_RIGHT).agrees
