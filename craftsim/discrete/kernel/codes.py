"""Numbers of actions, and of what may forbid one: codes of reasons; :mod:`craftsim.discrete.rules` has their words.

Codes of the published rules come first, then those of corrections.
"""

from __future__ import annotations

from craftsim.discrete.kinds import Action

LIFT, DROP, FOLD, UNFOLD, ROTATE_LEFT, ROTATE_RIGHT = range(Action.MOVE_FORWARD)
FIRST_MOVE = int(Action.MOVE_FORWARD)
LAST_MOVE = int(Action.MOVE_RIGHT)
STOP = int(Action.STOP)
N_ACTIONS = len(Action)
MOVE_DIRECTIONS = (1, 3, 2, 0)
"""Directions of the four moves, from FIRST_MOVE on: +y, -y, -x, +x."""

LEGAL, NEVER, ON_SLOPE, CARRIES, CARRIES_NOTHING, NOTHING_TO_LIFT, THING_ON_TOP, ABOVE_TOP_LEVEL = (
    range(8)
)
NO_RAMP_HERE, CAR_ON_OWN_FOOT, NO_SLOPE_HERE, FOOT_BLOCKED, FOOT_UNSUPPORTED = range(8, 13)
LANDING_BELOW_FOOT, LANDING_BELOW_BODY, TURN_UNDER_SLOPE, LOAD_HITS_THING = range(13, 17)
SLOPE_HITS_CORNER, LOAD_HITS_LOAD, LOAD_HITS_GEAR, FORWARD_ONLY, NOT_SIDEWAYS = range(17, 22)
NO_FLOOR, IN_THE_WAY, CAR_THERE, GEAR_THERE, GEAR_NO_ROOM, LOAD_NOT_UNDER = range(22, 28)
ENTERED_SIDEWAYS, HIGH_SIDE_ONLY, LOAD_NOT_THROUGH_GEAR, NO_DESCENT_FROM = range(28, 32)
DOWN_FORWARD_ONLY, THING_ON_BODY_BELOW, CAR_ON_FOOT_BELOW, NO_FLOOR_AT_END, THING_AT_END = range(
    32, 37
)
NO_ASCENT_FROM, UP_FORWARD_ONLY, CAR_ON_FOOT, THING_ON_BODY, NO_LANDING = range(37, 42)
CAR_ON_LANDING, NO_ROOM_ON_LANDING = range(42, 44)
FLAP_HITS, TURNING_LOAD_HITS, LEANING_LOAD_HITS, OTHER_RAMP, RAMP_UNDER_GEAR = range(44, 49)
REACHING_LOAD_HITS, WALL_OVERHEAD, GEARS_CROSS, UNDER_THING_AT_END = range(49, 53)
PATTERN_MATCHES = 53
"""A learned pattern forbids it; its detail is the number of the pattern."""
N_CODES = 54
"""Number of the codes above: reasons that forbid an action, and LEGAL."""

DETAIL_BITS = 8
"""A reason's detail, a direction 0..3 or a car's number, lies above so many bits."""
