"""Logs from ROS 2 bags (.mcap), read without ROS, with a row for each command.

Messages count from when the bag received them, as a controller on the robot would have: a pose that was on its way for
30 ms is 30 ms late.
"""

from __future__ import annotations

import math
from array import array
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import field
from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np
from pydantic import AfterValidator, Field

from craftsim.errors import InputError
from craftsim.logs.bag_records import JOINTS, NUMBERS, ODOMETRY, POSE, BagChannel, BagFile, decoder
from craftsim.logs.log import GROUPS, LONGEST_GAP, TIME, Floats, Log, interpolated
from craftsim.mjcf.car import WHEELS
from craftsim.storage.limits import BAG, BAG_MESSAGES
from craftsim.storage.reading import open_file
from craftsim.storage.records import record, unknown_words
from craftsim.storage.yaml import read_document

Series = dict[str, "array[float]"]
"""Times and values by column of a log, alternating."""
Values = Iterable[tuple[str, float]]
"""Values by column of a log."""
_SHOWN_TOPICS: Final = 10
"""Topics listed in an error message."""

_Name = Annotated[str, Field(min_length=1)]
_JOINTS: Final = (*WHEELS, "board", "hinge")


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


Take = Callable[[Any, Topics], Values]
"""Takes the content of a message."""
Takers = dict[str, Take]
"""By the message's type."""


def read_topics(path: Path) -> Topics:
    """Return the topics of a YAML file. Raises InputError with file and line for an invalid file."""
    return read_document(path).over({"joint_names": Topics().joint_names}).to(Topics)


def read_bag(path: Path, topics: Path | None = None) -> Log:
    """Return the log in a bag: a row for each command, with what was measured interpolated to its time.

    Raises InputError, naming the file, for what is no bag, has no commands on the expected topic, or says nothing else;
    and where the extra ``ros2`` is not installed.
    """
    names = Topics() if topics is None else read_topics(topics)
    with open_file(path, BAG) as file:
        try:
            return _log(_collect(BagFile(file), names), names)
        except InputError as error:
            raise InputError(f"{path}: {error}") from error
        except Exception as error:  # what decoders and decompressors raise for damaged data is their own
            raise InputError(f"{path}: damaged or no ROS 2 bag: {error or type(error).__name__}") from error


def _collect(bag: BagFile, names: Topics) -> Series:
    """Return the contents of the wanted topics."""
    series: Series = {name: array("d") for columns in GROUPS.values() for name in columns}
    channels = bag.channels()
    wanted = {names.pose or _pose_topic(channels): _POSES, names.joints: _MEASURED, names.commands: _COMMANDS}
    takers: dict[int, tuple[Callable[[bytes], Any], Take]] = {}
    for number, channel in channels.items():
        if channel.topic in wanted:
            takes = wanted[channel.topic]
            if channel.type not in takes:
                raise InputError(f"{channel.topic} holds {channel.type}; allowed: {', '.join(takes)}")
            takers[number] = decoder(channel.type, channel.encoding), takes[channel.type]
    n_read = Counter[str]()
    for number, time, content in bag.messages(takers) if takers else ():
        topic = channels[number].topic
        n_read[topic] += 1
        if n_read[topic] > BAG_MESSAGES:
            raise InputError(f"{topic} has more than the {BAG_MESSAGES} messages that are allowed")
        decode, take = takers[number]
        for column, value in take(decode(content), names):
            series[column].extend((time, value))
    return series


def _pose_topic(channels: dict[int, BagChannel]) -> str | None:
    """Return the only topic with poses, if any."""
    found = sorted({channel.topic for channel in channels.values() if channel.type in (ODOMETRY, POSE)})
    if len(found) > 1:
        some = ", ".join(found[:_SHOWN_TOPICS]) + ", ..." * (len(found) > _SHOWN_TOPICS)
        raise InputError(f"several topics hold poses: {some}; name one with --topics, key 'pose'")
    return found[0] if found else None


def _numbers(content: Any, names: Topics) -> Values:
    columns = GROUPS["commands"]
    if not 4 <= len(content.data) <= len(columns):
        raise InputError(
            f"{names.commands} has {len(content.data)} numbers; allowed: four wheels, board and hinge"
        )
    given = dict(zip(columns, content.data, strict=False))
    return [(column, given.get(column, 0.0)) for column in columns]


def _named_commands(content: Any, names: Topics) -> Values:
    given = dict(zip(content.name, content.velocity, strict=False))
    return [
        (column, given.get(names.joint_names[joint], 0.0))
        for column, joint in zip(GROUPS["commands"], _JOINTS, strict=True)
    ]


def _pose(content: Any, _: Topics) -> Values:
    q, p = content.pose.orientation, content.pose.position
    heading = math.atan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y**2 + q.z**2))
    pitch = -math.asin(max(-1.0, min(1.0, 2 * (q.w * q.y - q.z * q.x))))
    roll = math.atan2(2 * (q.w * q.x + q.y * q.z), 1 - 2 * (q.x**2 + q.y**2))
    return zip((*GROUPS["pose"], *GROUPS["tilt"]), (p.x, p.y, heading, pitch, roll), strict=True)


def _odometry(content: Any, names: Topics) -> Values:
    return _pose(content.pose, names)


def _joints(content: Any, names: Topics) -> Values:
    place = {name: k for k, name in enumerate(content.name)}
    wheels = zip(GROUPS["wheel_speeds"], WHEELS, ["velocity"] * 4, strict=True)
    for column, joint, what in (*wheels, *_OTHER_JOINTS):
        k, values = place.get(names.joint_names[joint]), getattr(content, what)
        if k is not None and k < len(values):
            yield column, values[k]


_OTHER_JOINTS: Final = (
    ("board_m", "board", "position"),
    ("board_force_n", "board", "effort"),
    ("hinge_rad", "hinge", "position"),
)
_COMMANDS: Final[Takers] = {JOINTS: _named_commands, NUMBERS: _numbers}
_MEASURED: Final[Takers] = {JOINTS: _joints}
_POSES: Final[Takers] = {ODOMETRY: _odometry, POSE: _pose}


def _log(series: Series, names: Topics) -> Log:
    commands = {name: np.frombuffer(series[name]).reshape(-1, 2) for name in GROUPS["commands"]}
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
            signal = np.frombuffer(pairs).reshape(-1, 2)
            # Chunks, and messages within one, are in no certain order.
            in_order = signal[np.argsort(signal[:, 0], kind="stable")]
            columns[name] = _at(time, in_order, turns=name == "heading_rad")
    if len(columns) == 1 + len(commands):
        raise InputError(f"nothing was measured: no messages on {names.joints}, and no poses")
    return Log.of_columns(columns)


def _at(time: Floats, pairs: Floats, turns: bool) -> Floats:
    """Return a signal, given as rows of time and value, interpolated at other times."""
    at, values = pairs[:, 0], np.unwrap(pairs[:, 1]) if turns else pairs[:, 1]
    gap = float(np.median(np.diff(at))) if len(at) > 1 else 0.0
    return interpolated(time, at, values, LONGEST_GAP * gap)
