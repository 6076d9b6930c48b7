"""The messages between robots and their driver: MessagePack maps, checked when read (docs/how-to/robots.md)."""

from __future__ import annotations

import math
from collections.abc import Hashable
from dataclasses import asdict, dataclass, fields
from typing import Annotated, Any, Final, cast, get_args

import msgpack
from pydantic import AfterValidator, FailFast, Field, ValidationError
from pydantic_core import PydanticSerializationError, to_json

from craftsim.errors import CraftsimError
from craftsim.models.measuring import CarMeasurement, Hinge, Metres
from craftsim.skills.skill import Command
from craftsim.storage.limits import MESSAGE_BYTES, PHYSICS_CARS, PHYSICS_PARTS, UNIT_LENGTH, Range
from craftsim.storage.records import adapter, first_mistake

VERSION: Final = 3
"""Version of the protocol; raised whenever something changes its meaning or goes away."""
COPIES: Final = 2
"""Copies of all commands and measurements that are sent; the first that arrives counts."""
_MOST_TEXT: Final = 1000

_MOST_THINGS: Final = max(PHYSICS_CARS, PHYSICS_PARTS)
"""Entries of a list. Longer ones, and all after the first mistake, are not read: else 128 KiB take seconds."""
_MOST_FIELDS: Final = 32
"""Entries of a map; no message has as many."""

# What can be, whatever the machines.
Number = Annotated[int, Range(0, 2**53)]
Seconds = Annotated[float, Range(0.0, 1e9)]
Text = Annotated[str, Field(max_length=_MOST_TEXT)]
_Cars = Annotated[int, Range(1, PHYSICS_CARS)]
Share = Annotated[float, Range(-1.001, 1.001)]


def _unit(pose: tuple[float, ...]) -> tuple[float, ...]:
    if abs(math.hypot(*pose[3:]) - 1) > UNIT_LENGTH:
        raise ValueError("the quaternion should have the length 1")
    return pose


_Pose = Annotated[tuple[Metres, Metres, Metres, Share, Share, Share, Share], AfterValidator(_unit)]
"""x, y, z in metres and a unit quaternion, w first; world frame."""


class MessageError(CraftsimError):
    """Raised for data that is no message of this protocol."""


@dataclass(frozen=True)
class Hello:
    """To the robots: somebody wants to drive them."""

    kind = "hello"
    cars: _Cars
    """How many there should be."""
    world: Text = ""
    """Digest of the world in which they should stand, empty for any."""


@dataclass(frozen=True)
class Welcome:
    """From the robots: they obey whoever said hello."""

    kind = "welcome"
    cars: _Cars
    slopes: Annotated[int, Range(0, PHYSICS_PARTS)]
    period_s: Annotated[float, Range(0.001, 1.0)]
    """Control period: they measure that often."""
    watchdog_s: Annotated[float, Range(0.001, 10.0)]
    """Without a command for so long they stop by themselves."""
    referee: bool = False
    """Whether a referee's poses come with the measurements."""
    waits: bool = False
    """Whether their time stands still until each measurement has been answered by Ack."""


@dataclass(frozen=True)
class Refused:
    """From the robots: they do not obey."""

    kind = "refused"
    why: Text
    busy: bool = False
    """Whether they will obey when somebody else has ended."""


@dataclass(frozen=True)
class Measurements:
    """From the robots, each control period: what they measure."""

    kind = "measurements"
    number: Number
    """Counts up."""
    time_s: Seconds
    """Time of the measurement by the robots' clock; theirs are all other times, too."""
    heard: Number
    """Number of the newest command that had come; 0 for none."""
    late_s: Annotated[float, Range(-1e9, 1e9)]
    """By how much that came after the time for which it was meant; negative where it was early."""
    stops: Number
    """Number of times that they have stopped because no command came."""
    cars: Annotated[tuple[CarMeasurement, ...], FailFast(), Field(max_length=PHYSICS_CARS)]


@dataclass(frozen=True)
class Commands:
    """To the robots, each control period: what their motors are to do."""

    kind = "commands"
    number: Number
    """Counts up from 1 after each hello."""
    at_s: Seconds
    """Time at which they are to begin with it; what comes too late is begun with at once."""
    cars: Annotated[tuple[Command, ...], FailFast(), Field(max_length=PHYSICS_CARS)]


@dataclass(frozen=True)
class Ack:
    """To robots that wait: a measurement has been dealt with."""

    kind = "ack"
    number: Number


@dataclass(frozen=True)
class Bye:
    """To the robots: they may obey somebody else. From the robots: they end."""

    kind = "bye"
    why: Text = ""


@dataclass(frozen=True)
class TruePoses:
    """From the referee, before the measurements of the same time: where everything is. The skills never see it."""

    kind = "poses"
    time_s: Seconds
    cars: Annotated[tuple[_Pose, ...], FailFast(), Field(max_length=PHYSICS_CARS)]
    things: Annotated[tuple[_Pose, ...], FailFast(), Field(max_length=PHYSICS_PARTS)]
    """Blocks, flags, then slopes, each in the order of their cells."""
    hinges: Annotated[tuple[Hinge, ...], FailFast(), Field(max_length=PHYSICS_PARTS)]
    """Angles of the slopes' hinges in radians: 0 unfolded, pi folded."""
    capped_steps: Number = 0
    """Number of physics steps in which the solver of a simulation gave up."""


Message = Hello | Welcome | Refused | Measurements | Commands | Ack | Bye | TruePoses
_KINDS: Final[dict[str, type[Message]]] = {kind.kind: kind for kind in get_args(Message)}


def pack(message: Message) -> bytes:
    """Return a message as it is sent."""
    content = {field.name: getattr(message, field.name) for field in fields(message)}
    packed: bytes = msgpack.packb(
        {"v": VERSION, "kind": message.kind, **content}, default=_plain, strict_types=True
    )
    return packed


def unpack(data: bytes) -> Message:
    """Return the message in what came. Raises MessageError, saying why, for what is none."""
    if len(data) > MESSAGE_BYTES:
        raise MessageError(f"{len(data)} bytes; allowed: at most {MESSAGE_BYTES}")
    try:
        content = msgpack.unpackb(
            data,
            max_str_len=_MOST_TEXT * 4,
            max_bin_len=0,
            max_ext_len=0,
            max_array_len=_MOST_THINGS,
            max_map_len=_MOST_FIELDS,
        )
    except (ValueError, msgpack.UnpackException) as error:
        raise MessageError(f"no MessagePack: {error or type(error).__name__}") from None
    if not isinstance(content, dict) or "v" not in content or "kind" not in content:
        raise MessageError("no map with 'v' and 'kind'")
    version = content.pop("v")
    kind = content.pop("kind")
    if type(version) is not int or version != VERSION:
        raise MessageError(
            f"version {_short(version)} of the protocol; this craftsim speaks version {VERSION}"
        )
    if not isinstance(kind, str) or kind not in _KINDS:
        raise MessageError(f"kind {_short(kind)}; there are {', '.join(_KINDS)}")
    try:
        # As JSON, where a mapping stands for a record and a list for a tuple, and nothing else for anything else.
        data = to_json(content, inf_nan_mode="constants")
        message: Message = adapter(cast(Hashable, _KINDS[kind])).validate_json(data)
    except PydanticSerializationError:
        raise MessageError(f"{kind}: its lists or maps are nested too deep") from None
    except ValidationError as error:
        raise MessageError(f"{kind}: {first_mistake(error, _KINDS[kind])}") from None
    return message


def _plain(value: Any) -> Any:
    if isinstance(value, CarMeasurement):
        return value._asdict()
    if isinstance(value, tuple):
        return list(value)
    return asdict(value)


def _short(value: object) -> str:
    text = repr(value)
    if len(text) <= 40:
        return text
    return f"{text[:37]}..."
