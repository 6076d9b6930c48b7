"""Wheel commands that lead, by as much as motors lag: the lag of each car is found out from how its wheels follow.

For candidate time constants the speed that the servos would have by now is kept; whose squared distance from the speed
that the encoders measure is least is the lag, as with the ages of localisations (:mod:`craftsim.skills.ages`). A
command then goes beyond what is wanted so far that the servo has the wanted speed after one control period.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from craftsim.discrete.kernel.jit import Record, compiled, records
from craftsim.models.measuring import Floats, Records
from craftsim.skills.ages import assume_age, likeliest_age

_STEP_S: Final = 0.01
"""Between two candidate time constants."""
_N: Final = 13
_ASSUMED: Final = (1.0, 3.0)
"""Mean and standard deviation of a motor's lag before it has moved, in such steps."""
_UNSURE_RAD_S: Final = 0.3
"""Standard deviation of a wheel's speed from its servo's: dry friction and inertia are fed forward, but not quite."""

LEAD: Final = np.dtype(
    [("mismatches", "f8", (_N,)), ("servos", "f8", (_N, 4)), ("shares", "f8", (_N,)), ("sent", "f8", (4,))],
    align=True,
)
"""Of one car: the mismatch of each candidate, the speeds that its servos would have, and by what shares these approach
a command in a control period; then the command sent last."""


def leads(n_cars: int, period_s: float) -> Records:
    """Return the LEAD of each car before it has moved, (n,)."""
    rows = records(n_cars, LEAD)
    for row in rows:
        assume_age(row["mismatches"], *_ASSUMED)
        row["shares"] = [1.0, *(1 - math.exp(-period_s / (k * _STEP_S)) for k in range(1, _N))]
    return rows


@compiled
def lead_wheels(
    lead: Record, wheels: Floats, turning: Floats, car: Record, period_s: float, level: bool
) -> None:
    """Take in how fast wheels turn, and change their commands so that servos have these speeds after a control period.

    Args:
        lead: of the car.
        wheels: (4,) rad/s, commands, changed in place; four zeros brake at once.
        turning: (4,) rad/s, measured a control period after the last commands.
        car: its figures.
        period_s: the control period.
        level: whether wheels follow their servos with all their torque: on a slope only as far as they have grip.
    """
    # A wheel that is further behind its servo lacks torque or grip, which says nothing of the lag.
    most_behind = car.wheel_torque_nm / car.wheel_gain_nms_rad
    limit = car.wheel_speed_rad_s
    if level:
        steps, _ = likeliest_age(lead.mismatches[:])
        below = min(int(steps), _N - 2)
        part = steps - below
        for wheel in range(4):
            servo = lead.servos[below, wheel] * (1 - part) + lead.servos[below + 1, wheel] * part
            if lead.sent[wheel] != 0.0 and abs(servo - turning[wheel]) < most_behind:
                for k in range(_N):
                    off = turning[wheel] - lead.servos[k, wheel]
                    lead.mismatches[k] += (off / _UNSURE_RAD_S) ** 2
    steps, _ = likeliest_age(lead.mismatches[:])
    below = min(int(steps), _N - 2)
    part = steps - below
    lag_s = steps * _STEP_S
    share = 1 - math.exp(-period_s / lag_s) if lag_s > 0 else 1.0
    stopped = wheels[0] == 0.0 and wheels[1] == 0.0 and wheels[2] == 0.0 and wheels[3] == 0.0
    for wheel in range(4):
        servo = lead.servos[below, wheel] * (1 - part) + lead.servos[below + 1, wheel] * part
        if not stopped:
            wheels[wheel] = max(-limit, min(limit, servo + (wheels[wheel] - servo) / share))
        lead.sent[wheel] = wheels[wheel]
        for k in range(_N):
            near = 1.0 if stopped else lead.shares[k]
            lead.servos[k, wheel] += near * (wheels[wheel] - lead.servos[k, wheel])
