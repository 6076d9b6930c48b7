"""Logs from ROS 2 bags (MCAP, https://mcap.dev/spec), read without ROS, with a row for each command.

Messages count from when the bag received them: a pose that was on its way for 30 ms is 30 ms late. Every length in a
bag is a claim, compared with what is allowed before anything is read. The texts of types that a bag brings are not
used: a decoder built of one would do whatever work it asks for.

A number that is nan was not measured, as with a joint without that sensor and a localisation that has lost its marker;
the latter also sends a quaternion of zeros. Such values are left out and counted in the notes of the log. All else that
cannot be a measurement is refused with its topic, message and time: infinite numbers, quaternions of another length,
commands that are not numbers, poses in several frames, and values that jump to and fro because several nodes publish.
"""

from __future__ import annotations

import io
import math
import struct
import zlib
from array import array
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import field, replace
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import IO, Annotated, Any, Final

import numpy as np
import zstandard
from lz4.frame import LZ4FrameDecompressor
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Schema
from mcap.stream_reader import MAGIC_SIZE
from mcap.writer import MCAP0_MAGIC
from mcap_ros2.decoder import DecoderFactory
from pydantic import AfterValidator, Field

from craftsim.compiled.arrays import Floats
from craftsim.errors import InputError
from craftsim.mjcf.car import WHEELS
from craftsim.robots.log import GROUPS, LONGEST_GAP, NEEDED, TIME, Log, interpolated
from craftsim.storage.limits import (
    BAG,
    BAG_CHUNK_BYTES,
    BAG_MESSAGE_BYTES,
    BAG_MESSAGES,
    BAG_RECORDS,
    MIB,
    shorten,
    size_text,
)
from craftsim.storage.reading import open_file
from craftsim.storage.records import record, unknown_words
from craftsim.storage.yaml import read_document

_RECORD: Final = struct.Struct("<BQ")
"""Header of a record: opcode and length."""
_FOOTER_HEAD: Final = _RECORD.pack(Opcode.FOOTER, 20)
_FOOTER_BYTES: Final = len(_FOOTER_HEAD) + 20 + MAGIC_SIZE
_MESSAGE_HEAD: Final = struct.Struct("<HIQQ")
"""Head of a message: channel, number, time of receipt, and time of sending."""
_DESCRIPTION_BYTES: Final = MIB
"""Size of a schema or a channel."""
_NAME_LENGTH: Final = 256
"""Longest name of a topic, type or encoding."""
_SHOWN_TOPICS: Final = 10
"""Topics listed in an error message."""
_LARGEST: Final = 1e9
"""Beyond what any robot measures, in any unit."""
_UNIT: Final = 0.01
"""Tolerance for the squared length of a quaternion, as in tf2 (``QUATERNION_NORMALIZATION_TOLERANCE``)."""

_JOINTS: Final = (*WHEELS, "board", "hinge")
_Name = Annotated[str, Field(min_length=1)]


def _known(names: dict[str, str]) -> dict[str, str]:
    for name in names:
        if name not in _JOINTS:
            raise ValueError(unknown_words(name, _JOINTS))
    return names


@record()
class Topics:
    """Topics by content; without a name the only topic of a matching type is used."""

    commands: _Name = "/wheel_commands"
    """JointState with velocities by joint, or Float64MultiArray with four wheels, then board and hinge if there."""
    joints: _Name = "/joint_states"
    """JointState: velocities of wheels, position and effort of the board, position of the hinge."""
    pose: _Name | None = None
    """Odometry or PoseStamped."""
    joint_names: Annotated[dict[str, _Name], AfterValidator(_known)] = field(
        default_factory=lambda: {name: name for name in _JOINTS}
    )
    """Names of the joints in the bag."""


def read_topics(path: Path) -> Topics:
    """Return the topics of a YAML file. Raises InputError with file and line for an invalid file."""
    return read_document(path).over({"joint_names": Topics().joint_names}).to(Topics)


def read_bag(path: Path, topics: Path | None = None) -> Log:
    """Return the log in a bag: a row for each command, with what was measured interpolated to its time.

    Raises InputError, naming the file, for what is no bag, has no commands on the expected topic, or says nothing else.
    """
    if topics is None:
        names = Topics()
    else:
        names = read_topics(topics)
    with open_file(path, BAG) as file:
        try:
            return _log(_collect(_Bag(file), names), names)
        except InputError as error:
            raise InputError(f"{path}: {error}") from error
        except (
            Exception
        ) as error:  # what decoders and decompressors raise for damaged data is their own
            raise InputError(
                f"{path}: damaged or no ROS 2 bag: {error or type(error).__name__}"
            ) from error


class _Bag:
    """An open bag. Raises InputError, or others' errors for damaged data."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self._size = file.seek(0, io.SEEK_END)
        file.seek(0)
        if file.read(MAGIC_SIZE) != MCAP0_MAGIC:
            raise InputError("damaged or no ROS 2 bag: it does not begin as one")
        self._records = self._unpacked_bytes = 0

    def channels(self) -> dict[int, tuple[Channel, str]]:
        """Return the channels in the summary of the bag by number, each with the type of its messages."""
        self._file.seek(max(0, self._size - _FOOTER_BYTES))
        end = self._file.read(_FOOTER_BYTES)
        start = int.from_bytes(end[len(_FOOTER_HEAD) :][:8], "little")
        if not (end.startswith(_FOOTER_HEAD) and end.endswith(MCAP0_MAGIC) and start):
            raise InputError(
                "the bag has no summary at its end; was it cut off? 'mcap recover' repairs it"
            )
        self._file.seek(start)
        types: dict[int, str] = {}
        channels: dict[int, tuple[Channel, str]] = {}
        kinds = Opcode.SCHEMA, Opcode.CHANNEL, Opcode.FOOTER
        for kind, data in self._walk(self._file, self._size, kinds):
            stream = ReadDataStream(io.BytesIO(data))
            if kind == Opcode.SCHEMA:
                schema = Schema.read(stream)
                types[schema.id], name = schema.name, schema.name
            else:
                channel = Channel.read(stream)
                channels[channel.id] = channel, types.get(channel.schema_id, "")
                name = max(channel.topic, channel.message_encoding, key=len)
            if len(name) > _NAME_LENGTH:
                raise InputError(
                    f"damaged: a name of {len(name)} characters; allowed: {_NAME_LENGTH}"
                )
        return channels

    def messages(self, channels: Collection[int]) -> Iterator[tuple[int, float, bytes]]:
        """Yield channel number, seconds and content of the messages of some channels, not sorted by time."""
        self._file.seek(MAGIC_SIZE)
        kinds = Opcode.MESSAGE, Opcode.CHUNK, Opcode.DATA_END
        for kind, data in self._walk(self._file, self._size, kinds):
            messages: Iterable[bytes] = [data]
            if kind == Opcode.CHUNK:
                messages = self._in_chunk(data)
            for message in messages:
                number, _, received_ns, _ = _MESSAGE_HEAD.unpack_from(message)
                if number not in channels:
                    continue
                if len(message) > BAG_MESSAGE_BYTES:
                    raise InputError(
                        f"a message of {size_text(len(message))} on a topic that is read; "
                        f"allowed: {size_text(BAG_MESSAGE_BYTES)}"
                    )
                yield number, received_ns * 1e-9, message[_MESSAGE_HEAD.size :]

    def _walk(
        self, file: IO[bytes], size: int, kinds: tuple[int, ...]
    ) -> Iterator[tuple[int, bytes]]:
        """Yield the records of some kinds from the present position to the end of the section."""
        place = file.tell()
        while place < size:
            kind, length = _RECORD.unpack(file.read(_RECORD.size))
            place += _RECORD.size + length
            self._records += 1
            if place > size:
                raise InputError("damaged: a record is longer than what is left of the bag")
            if self._records > BAG_RECORDS:
                raise InputError(f"more than the {BAG_RECORDS} records that are allowed")
            if kind not in kinds:
                file.seek(place)
                continue
            if kind in (Opcode.CHUNK, Opcode.MESSAGE):
                allowed = BAG_CHUNK_BYTES
            else:
                allowed = _DESCRIPTION_BYTES
            if length > allowed:
                raise InputError(f"a record of {size_text(length)}; allowed: {size_text(allowed)}")
            if kind in (Opcode.FOOTER, Opcode.DATA_END):
                return
            yield kind, file.read(length)

    def _in_chunk(self, data: bytes) -> Iterator[bytes]:
        """Yield the messages in a chunk. Raises InputError if it does not match its head."""
        chunk = Chunk.read(ReadDataStream(io.BytesIO(data)))
        claimed = chunk.uncompressed_size
        self._unpacked_bytes += claimed
        if claimed > BAG_CHUNK_BYTES or self._unpacked_bytes > BAG.content_bytes:
            allowed = f"{size_text(BAG_CHUNK_BYTES)} a chunk, {size_text(BAG.content_bytes)} in all"
            raise InputError(f"unpacks to {size_text(self._unpacked_bytes)}; allowed: {allowed}")
        read_bytes = claimed + 1  # one byte more shows that there is more
        match chunk.compression:
            case "zstd":
                with zstandard.ZstdDecompressor().stream_reader(chunk.data) as reader:
                    unpacked = reader.read(read_bytes)
            case "lz4":
                unpacked = LZ4FrameDecompressor().decompress(chunk.data, max_length=read_bytes)
            case "":
                unpacked = chunk.data[:read_bytes]
            case packing:
                raise InputError(
                    f"a chunk is packed by '{packing[:_NAME_LENGTH]}'; allowed: zstd, lz4"
                )
        checksum = chunk.uncompressed_crc
        if len(unpacked) != claimed or (checksum and zlib.crc32(unpacked) != checksum):
            raise InputError("damaged: a chunk does not hold what it claims")
        for _, message in self._walk(io.BytesIO(unpacked), claimed, (Opcode.MESSAGE,)):
            yield message


_Values = Iterable[tuple[str, float]]
"""Values by column of a log; nan for what was not measured."""
Take = Callable[[Any, Topics], _Values]
"""Takes the content of a message."""


class _Signals:
    """Contents of a bag, by column of a log, and what of them was not measured."""

    def __init__(self) -> None:
        series = {}
        for columns in GROUPS.values():
            for name in columns:
                series[name] = array("d")
        self.series = series
        """Times and values by column, alternating."""
        self.topics: dict[str, str] = {}
        """Topic by column."""
        self._missing = {name: array("d") for name in self.series}
        """Times of values that were not measured, by column."""

    def put(self, topic: str, time: float, column: str, value: float) -> None:
        """Note a value. Raises InputError for one that is none, and for a command that is nan."""
        if abs(value) > _LARGEST or (math.isnan(value) and column in GROUPS["commands"]):
            raise InputError(f"{column} is {value:g}; allowed: numbers up to {_LARGEST:g}")
        self.topics[column] = topic
        if math.isnan(value):
            self._missing[column].append(time)
        else:
            self.series[column].extend((time, value))

    def sorted(self, column: str) -> tuple[Floats, Floats]:
        """Return times and values of a column in the order of time; of several at the same time the last."""
        times, values = self.by_time(column)
        last = np.append(np.diff(times) > 0, np.ones(min(1, len(times)), bool))
        return times[last], values[last]

    def by_time(self, column: str) -> tuple[Floats, Floats]:
        """Return times and values of a column in the order of time, and else in that of the file."""
        signal = np.frombuffer(self.series[column]).reshape(-1, 2)
        # Chunks, and messages within one, are in no certain order.
        times, values = signal[np.argsort(signal[:, 0], kind="stable")].T
        return times, values

    def period_s(self, column: str) -> float:
        """Return the median time between messages, also those with nothing measured; 0 without two."""
        times = np.unique([*self.series[column][::2], *self._missing[column]])
        if len(times) > 1:
            return float(np.median(np.diff(times)))
        return 0.0

    def notes(self) -> tuple[str, ...]:
        """Return a sentence for each set of columns of a topic with values that were left out."""
        alike: dict[tuple[str, str], list[str]] = {}
        for column, topic in self.topics.items():
            n_values = len(self.series[column]) // 2
            n_missing = len(self._missing[column])
            n_messages = n_values + n_missing
            n_later = n_values - len(self.sorted(column)[0])
            if n_missing:
                fault = f"{n_missing} of {n_messages} messages have no {{}} (nan, or a quaternion of zeros); left out"
                alike.setdefault((topic, fault), []).append(column)
            if n_later:
                fault = f"{n_later} of {n_values} values of {{}} came at the time of another one; the last counts"
                alike.setdefault((topic, fault), []).append(column)
        return tuple(
            f"{topic}: {fault.format(', '.join(columns))}"
            for (topic, fault), columns in alike.items()
        )


def _numbers(content: Any, names: Topics) -> _Values:
    columns = GROUPS["commands"]
    if not 4 <= len(content.data) <= len(columns):
        raise InputError(f"{len(content.data)} numbers; allowed: four wheels, board and hinge")
    yield from zip(columns, content.data, strict=False)


def _named_commands(content: Any, names: Topics) -> _Values:
    place = _places(content)
    for column, joint in zip(GROUPS["commands"], _JOINTS, strict=True):
        number = place.get(names.joint_names[joint])
        if number is not None and number < len(content.velocity):
            yield column, content.velocity[number]


def _pose(content: Any, _: Topics) -> _Values:
    position = content.pose.position
    orientation = content.pose.orientation
    w = orientation.w
    x = orientation.x
    y = orientation.y
    z = orientation.z
    columns = (*GROUPS["pose"], *GROUPS["tilt"])
    squared_length = w * w + x * x + y * y + z * z
    if any(map(math.isnan, (position.x, position.y, squared_length))) or squared_length == 0.0:
        return [(column, math.nan) for column in columns]
    if not abs(squared_length - 1.0) < _UNIT:
        length = math.hypot(w, x, y, z)
        raise InputError(
            f"the quaternion has the length {length:.4g}; allowed: 1, within {_UNIT / 2:.1%}"
        )
    # Each component of an axis is in terms of the squared length, which cancels out.
    forward_x = squared_length - 2 * (y * y + z * z)
    forward_y = 2 * (x * y + w * z)
    forward_z = 2 * (x * z - w * y)
    left_z = 2 * (y * z + w * x)
    up_z = squared_length - 2 * (x * x + y * y)
    heading = math.atan2(forward_y, forward_x)
    pitch = math.atan2(forward_z, math.hypot(forward_x, forward_y))
    roll = math.atan2(left_z, up_z)
    return zip(columns, (position.x, position.y, heading, pitch, roll), strict=True)


def _joints(content: Any, names: Topics) -> _Values:
    place = _places(content)
    wheels = zip(GROUPS["wheel_speeds"], WHEELS, ["velocity"] * 4, strict=True)
    board_joints = ("board_m", "board", "position"), ("board_force_n", "board", "effort")
    for column, joint, quantity in (*wheels, *board_joints, ("hinge_rad", "hinge", "position")):
        k = place.get(names.joint_names[joint])
        values = getattr(content, quantity)
        if k is not None and k < len(values):
            yield column, values[k]


def _places(content: Any) -> dict[str, int]:
    """Return the places of joints by name. Raises InputError for a name that comes twice."""
    place = {name: k for k, name in enumerate(content.name)}
    if len(place) != len(content.name):
        name = next(name for k, name in enumerate(content.name) if place[name] != k)
        raise InputError(f"two joints '{shorten(name, 40)}'")
    return place


_ODOMETRY: Final = "nav_msgs/msg/Odometry"
_POSE: Final = "geometry_msgs/msg/PoseStamped"
_JOINT_STATE: Final = "sensor_msgs/msg/JointState"
_ARRAY: Final = "std_msgs/msg/Float64MultiArray"
_COMMANDS: Final[dict[str, Take]] = {_JOINT_STATE: _named_commands, _ARRAY: _numbers}
_MEASURED: Final[dict[str, Take]] = {_JOINT_STATE: _joints}
_POSES: Final[dict[str, Take]] = {
    _ODOMETRY: lambda content, names: _pose(content.pose, names),
    _POSE: _pose,
}


def _collect(bag: _Bag, names: Topics) -> _Signals:
    channels = bag.channels()
    poses = sorted({channel.topic for channel, kind in channels.values() if kind in _POSES})
    if names.pose is None and len(poses) > 1:
        examples = ", ".join(poses[:_SHOWN_TOPICS])
        if len(poses) > _SHOWN_TOPICS:
            examples += ", ..."
        raise InputError(
            f"several topics hold poses: {examples}; name one with --topics, key 'pose'"
        )
    pose = names.pose or next(iter(poses), None)
    takers_by_topic = {pose: _POSES, names.joints: _MEASURED, names.commands: _COMMANDS}
    takers: dict[int, tuple[Callable[[bytes], Any], Take]] = {}
    for number, (channel, kind) in channels.items():
        if channel.topic in takers_by_topic:
            takes = takers_by_topic[channel.topic]
            if kind not in takes:
                raise InputError(f"{channel.topic} holds {kind}; allowed: {', '.join(takes)}")
            takers[number] = _decoder(kind, channel.message_encoding), takes[kind]
    signals = _Signals()
    n_read = Counter[str]()
    frames: set[tuple[str, str]] = set()
    for number, time, data in bag.messages(takers) if takers else ():
        topic = channels[number][0].topic
        n_read[topic] += 1
        if n_read[topic] > BAG_MESSAGES:
            raise InputError(f"{topic} has more than the {BAG_MESSAGES} messages that are allowed")
        decode, take = takers[number]
        content = decode(data)
        try:
            if topic == pose:
                frames.add((content.header.frame_id, getattr(content, "child_frame_id", "")))
                _check_frames(frames)
            for column, value in take(content, names):
                signals.put(topic, time, column, value)
        except InputError as error:
            raise InputError(
                f"{topic}, message {n_read[topic]} at {time:.3f} s: {error}"
            ) from error
    return signals


def _check_frames(frames: set[tuple[str, str]]) -> None:
    """Raise InputError for poses of several frames, given those of poses and of what is where they say."""
    for names in zip(*frames, strict=True):
        different = sorted(set(names))
        if len(different) > 1:
            frame_names = ", ".join(f"'{shorten(name, 40)}'" for name in different)
            raise InputError(
                f"poses in the frames {frame_names} on one topic; allowed: one frame, one car"
            )


def _log(signals: _Signals, names: Topics) -> Log:
    commands = {name: signals.sorted(name) for name in GROUPS["commands"]}
    time = np.unique(np.concatenate([at for at, _ in commands.values()]))
    if not len(time):
        raise InputError(
            f"no commands on the topic {names.commands}; name theirs with --topics, key 'commands'"
        )
    for column, joint in zip(NEEDED[1:], WHEELS, strict=True):
        if not len(commands[column][0]):
            raise InputError(
                f"{names.commands} never commands the joint '{names.joint_names[joint]}'; name the wheels with "
                "--topics, key 'joint_names'"
            )
    columns: dict[str, Floats] = {TIME: time - time[0]}
    columns |= {name: _held(time, at, values) for name, (at, values) in commands.items()}
    for name in signals.series:
        at, values = signals.sorted(name)
        if name in commands or not len(at):
            continue
        _check_jumps(signals.topics[name], name, signals.by_time(name)[1])
        if name == "heading_rad":
            values = np.unwrap(values)
        columns[name] = interpolated(time, at, values, LONGEST_GAP * signals.period_s(name))
    notes = signals.notes()
    if len(columns) == 1 + len(commands):
        text = "".join(f"; {note}" for note in notes)
        raise InputError(f"nothing was measured: no values on {names.joints}, and no poses{text}")
    return replace(Log.of_columns(columns), notes=notes)


def _held(time: Floats, at: Floats, values: Floats) -> Floats:
    """Return the last command at each time; 0 before the first."""
    latest = np.searchsorted(at, time, side="right")
    return np.concatenate([[0.0], values])[latest]


_JUMPS: Final[dict[str, tuple[float, float]]] = {
    "x_m": (0.02, 0.3),
    "y_m": (0.02, 0.3),
    "heading_rad": (0.1, 0.3),
    "board_m": (0.002, 0.05),
    "hinge_rad": (0.05, 0.05),
    **dict.fromkeys(GROUPS["wheel_speeds"], (1.0, 0.6)),
}
"""Smallest jump to and fro that counts, above what coarse encoders show, and the share of a column's values that may do
so: localisations have outliers, and speeds by coarse encoders flicker, but the position of a joint does neither."""
_JUMP_RATIO: Final = 10.0
"""A jump to and fro is this many times as large as what is left after it, which no noise shows."""


def _check_jumps(topic: str, column: str, values: Floats) -> None:
    """Raise InputError where values in the order of time jump to and fro, as those of several publishers do."""
    if column not in _JUMPS or len(values) < 3:
        return
    threshold, allowed = _JUMPS[column]
    steps = np.abs(np.diff(values))
    smaller = np.minimum(steps[:-1], steps[1:])
    stays = np.quantile(np.abs(values[2:] - values[:-2]), 0.25)
    jumps = smaller > max(threshold, _JUMP_RATIO * stays)
    n_jumps = np.count_nonzero(jumps)
    if n_jumps > max(2, allowed * len(values)):
        raise InputError(
            f"{topic}: {column} jumps to and fro by {np.median(smaller[jumps]):.2g} in {n_jumps} of {len(values)} "
            "messages; do several nodes publish there? Record one alone"
        )


@cache
def _decoder(kind: str, encoding: str) -> Callable[[bytes], Any]:
    """Return what makes objects of messages' contents; each is built once, however many channels a bag claims.

    Definitions of types are as in https://github.com/ros2/common_interfaces.
    """
    texts = files("craftsim.data").joinpath("ros2")
    type_name = kind.rpartition("/")[2]
    definition_text = texts.joinpath(f"{type_name}.msg").read_text()
    parts = texts.joinpath("parts.msg").read_text()
    definition = f"{definition_text}{'=' * 80}\n{parts}".encode()
    decoder = DecoderFactory().decoder_for(encoding, Schema(1, definition, "ros2msg", kind))
    if decoder is None:
        raise InputError(f"messages are encoded as '{encoding}'; allowed: cdr, as ROS 2 does")
    return decoder
