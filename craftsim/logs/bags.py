"""Logs in ROS 2 bags (.mcap), read without ROS: which topics hold what, and one row for each command.

Messages count from when the bag received them, as a controller on the robot would have: a pose that was on its way for
30 ms is 30 ms late.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, Final

import numpy as np

from craftsim.discrete.files.documents import Mapping, Scalar, Source, describe, parse_keys, read_text
from craftsim.errors import InputError
from craftsim.extras import need
from craftsim.logs.log import GROUPS, LONGEST_GAP, TIME, Floats, Log, interpolated
from craftsim.models.parts import WHEELS
from craftsim.storage.limits import BAG, BAG_MESSAGES, MIB, size_text
from craftsim.storage.reading import open_file

POSES: Final = ("nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseStamped")
JOINTS: Final = "sensor_msgs/msg/JointState"
NUMBERS: Final = "std_msgs/msg/Float64MultiArray"

_RECORD_BYTES: Final = 64 * MIB
"""Of one record, a chunk of messages."""

Series = dict[str, list[tuple[float, float]]]
"""(time, value) by column of a log."""


@dataclass(frozen=True)
class Topics:
    """Which topics hold what; without a name the one topic of a type that fits."""

    commands: str = "/wheel_commands"
    """JointState with velocities by joint, or Float64MultiArray with four wheels, then board and hinge if there."""
    joints: str = "/joint_states"
    """JointState: velocities of wheels, position and effort of the board, position of the hinge."""
    pose: str = ""
    """Odometry or PoseStamped."""
    joint_names: dict[str, str] = field(
        default_factory=lambda: {name: name for name in (*WHEELS, "board", "hinge")}
    )
    """What the bag calls the joints."""


def read_topics(path: Path) -> Topics:
    """Return the topics that a YAML file names; raise InputError, with file and line, for one that it should not."""
    names = [f.name for f in fields(Topics)]
    text, given = parse_keys(path, read_text(path), names)
    found: dict[str, Any] = {}
    for key, node in given.items.items():
        if key == "joint_names":
            known = list(Topics().joint_names)
            joints = text.mapping(node, key, known)
            found[key] = Topics().joint_names | {name: _name(text, joints, name) for name in joints.items}
        else:
            found[key] = _name(text, given, key)
    return Topics(**found)


def _name(source: Source, section: Mapping, key: str) -> str:
    node = section.items[key]
    if not isinstance(node, Scalar) or not node.text:
        source.fail(section.key_lines[key], f"'{key}' must be a name, not {describe(node)}")
    return node.text


def read_bag(path: Path, topics: Path | None = None) -> Log:
    """Return the log in a bag: a row for each command, with what was measured interpolated to its time.

    Raises InputError, naming the file, for what is no bag, has no commands on the expected topic, or says nothing else;
    and where the extra ``ros2`` is not installed.
    """
    names = Topics() if topics is None else read_topics(topics)
    need("ros2", "reading ROS 2 bags needs", "mcap", "mcap_ros2")
    from mcap.reader import SeekingReader
    from mcap_ros2.decoder import DecoderFactory

    with open_file(path, BAG) as file:
        try:
            reader = SeekingReader(file, True, [DecoderFactory()], record_size_limit=_RECORD_BYTES)
            summary = _summary(path, reader.get_summary())
            pose = names.pose or _pose_topic(path, summary)
            wanted = [name for name in (names.commands, names.joints, pose) if name]
            series = _collect(reader.iter_decoded_messages(wanted), names, pose)
        except InputError as error:
            raise InputError(f"{path}: {str(error).removeprefix(f'{path}: ')}") from error
        except Exception as error:  # what decoders and decompressors raise for damaged data is their own
            raise InputError(f"{path}: damaged or no ROS 2 bag: {error or type(error).__name__}") from error
    try:
        return _log(series, names)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _summary(path: Path, summary: Any) -> Any:
    """Return the summary of a bag that may be read."""
    if summary is None:
        raise InputError(
            f"{path}: the bag has no summary at its end; was it cut off? 'mcap recover' repairs it"
        )
    sizes = [chunk.uncompressed_size for chunk in summary.chunk_indexes]
    if max(sizes, default=0) > _RECORD_BYTES or sum(sizes) > BAG.content_bytes:
        raise InputError(
            f"{path}: unpacks to {size_text(sum(sizes))}; allowed: {size_text(BAG.content_bytes)}"
        )
    return summary


def _pose_topic(path: Path, summary: Any) -> str:
    """Return the one topic with poses; an empty text where there is none."""
    types = {channel.topic: summary.schemas[channel.schema_id].name for channel in summary.channels.values()}
    found = sorted(topic for topic, kind in types.items() if kind in POSES)
    if len(found) > 1:
        raise InputError(
            f"{path}: several topics hold poses: {', '.join(found)}; name one with --topics, key 'pose'"
        )
    return found[0] if found else ""


def _collect(messages: Iterator[Any], names: Topics, pose: str) -> Series:
    series: Series = {name: [] for columns in GROUPS.values() for name in columns}
    for number, (schema, channel, message, content) in enumerate(messages):
        if number == BAG_MESSAGES:
            raise InputError(f"more than the {BAG_MESSAGES} messages that are allowed")
        time = message.log_time * 1e-9
        if channel.topic == names.commands:
            _take_commands(series, time, schema.name, content, names)
        elif channel.topic == pose:
            _take_pose(series, time, schema.name, content)
        else:
            _take_joints(series, time, schema.name, content, names)
    return series


def _take_commands(series: Series, time: float, kind: str, content: Any, names: Topics) -> None:
    columns = GROUPS["commands"]
    if kind == NUMBERS:
        values = [float(value) for value in content.data]
        if not 4 <= len(values) <= len(columns):
            raise InputError(
                f"{names.commands} has {len(values)} numbers; allowed: four wheels, board and hinge"
            )
        given = dict(zip(columns, values, strict=False))
    elif kind == JOINTS:
        by_joint = dict(zip(content.name, content.velocity, strict=False))
        joints = (names.joint_names[name] for name in (*WHEELS, "board", "hinge"))
        given = {c: float(by_joint[j]) for c, j in zip(columns, joints, strict=True) if j in by_joint}
    else:
        raise InputError(f"{names.commands} holds {kind}; allowed: {JOINTS}, {NUMBERS}")
    for column in columns:
        series[column].append((time, given.get(column, 0.0)))


def _take_pose(series: Series, time: float, kind: str, content: Any) -> None:
    if kind not in POSES:
        raise InputError(f"the poses are {kind}; allowed: {', '.join(POSES)}")
    pose = content.pose.pose if kind == POSES[0] else content.pose
    q, p = pose.orientation, pose.position
    heading = math.atan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y**2 + q.z**2))
    pitch = -math.asin(max(-1.0, min(1.0, 2 * (q.w * q.y - q.z * q.x))))
    roll = math.atan2(2 * (q.w * q.x + q.y * q.z), 1 - 2 * (q.x**2 + q.y**2))
    columns = (*GROUPS["pose"], *GROUPS["tilt"])
    for column, value in zip(columns, (p.x, p.y, heading, pitch, roll), strict=True):
        series[column].append((time, float(value)))


def _take_joints(series: Series, time: float, kind: str, content: Any, names: Topics) -> None:
    if kind != JOINTS:
        raise InputError(f"{names.joints} holds {kind}; allowed: {JOINTS}")
    place = {name: k for k, name in enumerate(content.name)}

    def take(column: str, joint: str, values: Any) -> None:
        k = place.get(names.joint_names[joint])
        if k is not None and k < len(values):
            series[column].append((time, float(values[k])))

    for column, wheel in zip(GROUPS["wheel_speeds"], WHEELS, strict=True):
        take(column, wheel, content.velocity)
    take("board_m", "board", content.position)
    take("board_force_n", "board", content.effort)
    take("hinge_rad", "hinge", content.position)


def _log(series: Series, names: Topics) -> Log:
    commands = {name: np.array(series[name]).reshape(-1, 2) for name in GROUPS["commands"]}
    time = next(iter(commands.values()))[:, 0]
    if not len(time):
        raise InputError(
            f"no commands on the topic {names.commands}; name theirs with --topics, key 'commands'"
        )
    time, first = np.unique(time, return_index=True)
    columns: dict[str, Floats] = {TIME: time - time[0]}
    columns |= {name: values[first, 1] for name, values in commands.items()}
    for name, pairs in series.items():
        if name not in columns and pairs:
            columns[name] = _at(time, np.array(pairs), turns=name == "heading_rad")
    if len(columns) == 1 + len(commands):
        raise InputError(f"nothing was measured: no messages on {names.joints}, and no poses")
    return Log.of_columns(columns)


def _at(time: Floats, pairs: Floats, turns: bool) -> Floats:
    """Return a signal, rows of time and value, at other times."""
    at, values = pairs[:, 0], np.unwrap(pairs[:, 1]) if turns else pairs[:, 1]
    gap = float(np.median(np.diff(at))) if len(at) > 1 else 0.0
    return interpolated(time, at, values, LONGEST_GAP * gap)
