"""The six ways in which a car drives on the flat."""

SPEED_RAD_S = 10.0
"""A normal driving speed: 0.5 m/s."""
DIRECTIONS = {
    "forward": ((1, 1, 1, 1), 0),
    "backward": ((-1, -1, -1, -1), 0),
    "left": ((-1, 1, 1, -1), 1),
    "right": ((1, -1, -1, 1), 1),
    "turning left": ((-1, 1, -1, 1), 2),
    "turning right": ((1, -1, 1, -1), 2),
}
"""By name: the signs of the wheels' speeds in the order of WHEELS, and the axis of the twist (x, y, about z)."""
