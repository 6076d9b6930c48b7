"""The records of a ROS 2 bag (MCAP, https://mcap.dev/spec): its channels, and the messages of some of them.

Every length in a bag is a claim of whoever wrote it. What a record claims is compared with what is allowed before it is
read, and a chunk is unpacked no further than the size that it claims. What is not needed is passed over: schemas,
whose text would have to be parsed, and the index, which may name one chunk a thousand times. A bag brings a text of
its own for each type, too. It is not used: a decoder that is built of it would do whatever work it asks for, and what
the four types that are read hold is the same wherever they come from.
"""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from functools import cache
from typing import IO, Any, Final

from craftsim.errors import InputError
from craftsim.extras import need
from craftsim.storage.limits import BAG, BAG_CHUNK_BYTES, BAG_MESSAGE_BYTES, BAG_RECORDS, MIB, size_text

_MAGIC: Final = b"\x89MCAP0\r\n"
_FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _DATA_END = 0x02, 0x03, 0x04, 0x05, 0x06, 0x0F
_RECORD: Final = struct.Struct("<BQ")
"""Header of a record: opcode and length."""
_FOOTER_HEAD: Final = _RECORD.pack(_FOOTER, 20)
_FOOTER_BYTES: Final = len(_FOOTER_HEAD) + 20 + len(_MAGIC)
"""Size of the end of a bag: footer and magic bytes."""
_CHUNK_HEAD: Final = struct.Struct("<QQQI")
"""Head of a chunk: first and last time, unpacked length, and its checksum."""
_MESSAGE_HEAD: Final = struct.Struct("<HIQQ")
"""Head of a message: channel, number, time of receipt, and time of sending."""
_DESCRIPTION_BYTES: Final = MIB
"""Size of a schema or a channel."""
_NAME_BYTES: Final = 256
"""Longest name of a topic, type or encoding."""


@dataclass(frozen=True)
class BagChannel:
    """A channel: topic, type and encoding of its messages."""

    topic: str
    type: str
    """Type of the messages, such as ``sensor_msgs/msg/JointState``."""
    encoding: str
    """Encoding of the messages; ROS 2 uses ``cdr``."""


class BagFile:
    """An open bag. Raises InputError, or Python's errors for damaged data."""

    def __init__(self, file: IO[bytes]) -> None:
        """Open a file. Raises InputError if it is not a bag or incomplete."""
        self._file, self._size = file, file.seek(0, io.SEEK_END)
        file.seek(0)
        if file.read(len(_MAGIC)) != _MAGIC:
            raise InputError("damaged or no ROS 2 bag: it does not begin as one")
        self._records = self._unpacked_bytes = 0

    def channels(self) -> dict[int, BagChannel]:
        """Return the channels in the summary of the bag by number."""
        self._file.seek(max(0, self._size - _FOOTER_BYTES))
        end = self._file.read(_FOOTER_BYTES)
        start = int.from_bytes(end[len(_FOOTER_HEAD) :][:8], "little")
        if not (end.startswith(_FOOTER_HEAD) and end.endswith(_MAGIC) and start):
            raise InputError("the bag has no summary at its end; was it cut off? 'mcap recover' repairs it")
        self._file.seek(start)
        types: dict[int, str] = {0: ""}
        channels: dict[int, BagChannel] = {}
        for kind, data in self._walk(self._file, self._size, (_SCHEMA, _CHANNEL, _FOOTER)):
            number = int.from_bytes(data[:2], "little")
            if kind == _SCHEMA:
                types[number] = _name(data, 2)[0]
            elif kind == _CHANNEL:
                topic, end_of_topic = _name(data, 4)
                of = types.get(int.from_bytes(data[2:4], "little"), "")
                channels[number] = BagChannel(topic, of, _name(data, end_of_topic)[0])
        return channels

    def messages(self, wanted: Collection[int]) -> Iterator[tuple[int, float, bytes]]:
        """Yield channel number, seconds and content of the messages of some channels, not sorted by time."""
        self._file.seek(len(_MAGIC))
        for kind, data in self._walk(self._file, self._size, (_MESSAGE, _CHUNK, _DATA_END)):
            if kind == _CHUNK:
                unpacked = self._unpack(data)
                inner = self._walk(io.BytesIO(unpacked), len(unpacked), (_MESSAGE,))
                yield from (message for _, one in inner for message in _message(one, wanted))
            else:
                yield from _message(data, wanted)

    def _walk(self, file: IO[bytes], size: int, kinds: tuple[int, ...]) -> Iterator[tuple[int, bytes]]:
        """Yield the contents of records of some kinds from the current position to the end of the section."""
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
            allowed = BAG_CHUNK_BYTES if kind in (_CHUNK, _MESSAGE) else _DESCRIPTION_BYTES
            if length > allowed:
                raise InputError(f"a record of {size_text(length)}; allowed: {size_text(allowed)}")
            data = file.read(length)
            if kind in (_FOOTER, _DATA_END):
                return
            yield kind, data

    def _unpack(self, chunk: bytes) -> bytes:
        """Return the content of a chunk. Raises InputError if it does not match its head."""
        _, _, claimed, checksum = _CHUNK_HEAD.unpack_from(chunk)
        packing, place = _name(chunk, _CHUNK_HEAD.size)
        packed = memoryview(chunk)[place + 8 :][: int.from_bytes(chunk[place : place + 8], "little")]
        self._unpacked_bytes += claimed
        if claimed > BAG_CHUNK_BYTES or self._unpacked_bytes > BAG.content_bytes:
            allowed = f"{size_text(BAG_CHUNK_BYTES)} a chunk, {size_text(BAG.content_bytes)} in all"
            raise InputError(f"unpacks to {size_text(self._unpacked_bytes)}; allowed: {allowed}")
        # One byte more shows that there is more.
        data = _first_bytes(packing, packed, claimed + 1)
        if len(data) != claimed or (checksum and zlib.crc32(data) != checksum):
            raise InputError("damaged: a chunk does not hold what it claims")
        return data


def _first_bytes(packing: str, packed: memoryview, most: int) -> bytes:
    """Unpack only the first bytes of packed data."""
    if packing == "zstd":
        import zstandard

        with zstandard.ZstdDecompressor().stream_reader(packed) as reader:
            return reader.read(most)
    if packing == "lz4":
        from lz4.frame import LZ4FrameDecompressor

        unpacked: bytes = LZ4FrameDecompressor().decompress(packed, max_length=most)
        return unpacked
    if packing:
        raise InputError(f"a chunk is packed by '{packing}'; allowed: zstd, lz4")
    return bytes(packed[:most])


def _message(data: bytes, wanted: Collection[int]) -> Iterator[tuple[int, float, bytes]]:
    """Yield a message's channel, seconds and content if it is of a wanted channel."""
    channel, _, received_ns, _ = _MESSAGE_HEAD.unpack_from(data)
    if channel in wanted:
        if len(data) > BAG_MESSAGE_BYTES:
            raise InputError(
                f"a message of {size_text(len(data))} on a topic that is read; "
                f"allowed: {size_text(BAG_MESSAGE_BYTES)}"
            )
        yield channel, received_ns * 1e-9, data[_MESSAGE_HEAD.size :]


def _name(data: bytes, place: int) -> tuple[str, int]:
    """Return the text at an offset of a record, and the offset after it."""
    length = int.from_bytes(data[place : place + 4], "little")
    end = place + 4 + length
    if length > _NAME_BYTES or end > len(data):
        raise InputError(f"damaged: a name of {length} bytes; allowed: {_NAME_BYTES}, within its record")
    return str(data[place + 4 : end], "utf-8"), end


ODOMETRY: Final = "nav_msgs/msg/Odometry"
POSE: Final = "geometry_msgs/msg/PoseStamped"
JOINTS: Final = "sensor_msgs/msg/JointState"
NUMBERS: Final = "std_msgs/msg/Float64MultiArray"

_FIELDS: Final = {
    ODOMETRY: """std_msgs/Header header
        string child_frame_id
        geometry_msgs/PoseWithCovariance pose
        geometry_msgs/TwistWithCovariance twist""",
    POSE: """std_msgs/Header header
        geometry_msgs/Pose pose""",
    JOINTS: """std_msgs/Header header
        string[] name
        float64[] position
        float64[] velocity
        float64[] effort""",
    NUMBERS: """std_msgs/MultiArrayLayout layout
        float64[] data""",
}
_PARTS: Final = {
    "std_msgs/Header": "builtin_interfaces/Time stamp\n string frame_id",
    "std_msgs/MultiArrayLayout": "std_msgs/MultiArrayDimension[] dim\n uint32 data_offset",
    "std_msgs/MultiArrayDimension": "string label\n uint32 size\n uint32 stride",
    "geometry_msgs/PoseWithCovariance": "geometry_msgs/Pose pose\n float64[36] covariance",
    "geometry_msgs/TwistWithCovariance": "geometry_msgs/Twist twist\n float64[36] covariance",
    "geometry_msgs/Pose": "geometry_msgs/Point position\n geometry_msgs/Quaternion orientation",
    "geometry_msgs/Twist": "geometry_msgs/Vector3 linear\n geometry_msgs/Vector3 angular",
    "geometry_msgs/Point": "float64 x\n float64 y\n float64 z",
    "geometry_msgs/Vector3": "float64 x\n float64 y\n float64 z",
    "geometry_msgs/Quaternion": "float64 x\n float64 y\n float64 z\n float64 w",
}
"""As in https://github.com/ros2/common_interfaces."""


def _definition(kind: str) -> str:
    """Return the definition of a type, with those of its parts."""
    parts = [_FIELDS[kind], *(f"MSG: {name}\n{text}" for name, text in _PARTS.items())]
    return f"\n{'=' * 80}\n".join("\n".join(line.strip() for line in part.splitlines()) for part in parts)


@cache
def decoder(kind: str, encoding: str) -> Callable[[bytes], Any]:
    """Return what makes objects of messages' contents; raise InputError without the extra ``ros2``.

    Each is built once, which takes 0.5 ms, however many channels a bag claims.
    """
    need("ros2", "reading ROS 2 bags needs", "mcap", "mcap_ros2")
    from mcap.records import Schema
    from mcap_ros2.decoder import DecoderFactory

    made = DecoderFactory().decoder_for(encoding, Schema(1, _definition(kind).encode(), "ros2msg", kind))
    if made is None:
        raise InputError(f"messages are encoded as '{encoding}'; allowed: cdr, as ROS 2 does")
    return made
