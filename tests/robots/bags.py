"""Writing test bags with the library's own writer."""

import io
import math
import struct

from mcap.data_stream import RecordBuilder
from mcap.records import Channel, ChunkIndex, DataEnd, Footer, Header, Message, Schema
from mcap.stream_reader import StreamReader
from mcap_ros2.writer import Writer

MAGIC = b"\x89MCAP0\r\n"
STAMP = "builtin_interfaces/Time stamp\nstring frame_id"
TIME = "int32 sec\nuint32 nanosec"
RULE = "=" * 80
HEADER = f"{RULE}\nMSG: std_msgs/Header\n{STAMP}\n{RULE}\nMSG: builtin_interfaces/Time\n{TIME}"
POSE = f"""std_msgs/Header header
geometry_msgs/Pose pose
{RULE}
MSG: geometry_msgs/Pose
geometry_msgs/Point position
geometry_msgs/Quaternion orientation
{RULE}
MSG: geometry_msgs/Point
float64 x
float64 y
float64 z
{RULE}
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
{HEADER}"""
JOINTS = f"""std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
{HEADER}"""
NAMES = ["wheel_fl", "wheel_fr", "wheel_rl", "wheel_rr", "board"]


def write_bag(
    path,
    log,
    commands="/wheel_commands",
    pose_topics=("/localisation",),
    compression=None,
    alter=None,
):
    """Write a log as a robot would record it: poses, joint states and commands by their own topics.

    ``alter`` takes topic, row, message and time in ns of each message, and returns a list of messages with their times
    to be written in its place.
    """
    from mcap.writer import CompressionType

    with open(path, "wb") as file:
        writer = Writer(file, compression=compression or CompressionType.ZSTD)
        poses = writer.register_msgdef("geometry_msgs/msg/PoseStamped", POSE)
        joints = writer.register_msgdef("sensor_msgs/msg/JointState", JOINTS)

        def write(topic, kind, row, message, at):
            written = alter(topic, row, message, at) if alter else [(message, at)]
            for message, at in written:
                writer.write_message(topic, kind, message, at, at)

        for row, time in enumerate(log.time_s):
            at = 1_700_000_000_000_000_000 + round(time * 1e9)
            header = {"stamp": {"sec": int(time), "nanosec": 0}, "frame_id": "map"}
            x, y, heading = map(float, log.pose[row])
            turn = {"x": 0.0, "y": 0.0, "z": math.sin(heading / 2), "w": math.cos(heading / 2)}
            pose = {"position": {"x": x, "y": y, "z": 0.0}, "orientation": turn}
            for topic in pose_topics:
                write(topic, poses, row, {"header": header, "pose": pose}, at)
            board, force = map(float, log.board[row])
            state = {"header": header, "name": NAMES, "position": [0.0] * 4 + [board]}
            state |= {
                "velocity": [*map(float, log.wheel_speeds[row]), 0.0],
                "effort": [0.0] * 4 + [force],
            }
            write("/joint_states", joints, row, state, at)
            told = {"header": header, "name": NAMES, "position": [], "effort": []}
            told |= {"velocity": [*map(float, log.commands[row, :5])]}
            write(commands, joints, row, told, at)
        writer.finish()
    return path


def records_of(bag, *kinds):
    """Return the records of some kinds before the summary, unpacked."""
    found = []
    for record in StreamReader(io.BytesIO(bag)).records:
        if isinstance(record, DataEnd):
            return found
        if isinstance(record, kinds):
            found.append(record)
    return found


def loose_bag(bag, messages=None, chunk=None, schema=None, channels=()):
    """Return a bag without chunks or checksums, of the same messages, or of others.

    ``chunk`` stands in their place, as packing and content; its head and its entry in the index claim 1000 bytes.
    ``schema`` is a text that is put after that of each type; ``channels`` are more of them.
    """
    described = [*records_of(bag, Schema, Channel), *channels]
    for record in described:
        if isinstance(record, Schema) and schema:
            record.data += schema
    data = RecordBuilder()
    data.write(MAGIC)
    Header("ros2", "").write(data)
    for record in described:
        record.write(data)
    place = data.count
    if chunk:
        packing, content = chunk
        head = (
            struct.pack("<QQQI", 0, 1, 1000, 0) + struct.pack("<I", len(packing)) + packing.encode()
        )
        content = head + struct.pack("<Q", len(content)) + content
        data.write(struct.pack("<BQ", 0x06, len(content)) + content)
    else:
        for message in messages or records_of(bag, Message):
            message.write(data)
    length = data.count - place
    DataEnd(0).write(data)
    start = data.count
    for record in described:
        record.write(data)
    if chunk:
        ChunkIndex(length, place, packing, length, 1, 0, {}, 0, 1000).write(data)
    Footer(start, 0, 0).write(data)
    data.write(MAGIC)
    return data.end()
