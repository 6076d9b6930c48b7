"""The types of messages that are read from ROS 2 bags, and their decoders.

A bag brings a text of its own for each type. It is not used: a decoder that is built of it would do whatever work it
asks for, and what these four types hold is the same wherever they come from.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any, Final

from craftsim.errors import InputError
from craftsim.extras import need

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


def definition(kind: str) -> str:
    """Return the text that defines a type, with all that it is made of."""
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

    made = DecoderFactory().decoder_for(encoding, Schema(1, definition(kind).encode(), "ros2msg", kind))
    if made is None:
        raise InputError(f"messages are encoded as '{encoding}'; allowed: cdr, as ROS 2 does")
    return made
