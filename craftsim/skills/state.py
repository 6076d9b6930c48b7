"""The data of compiled controllers: one record a car, with its constants, its reading, its task and its command."""

from __future__ import annotations

from dataclasses import astuple, fields
from functools import lru_cache
from typing import Final

import numpy as np

from craftsim.compiled.arrays import Records
from craftsim.compiled.jit import layout, records
from craftsim.mjcf.machines import Machines
from craftsim.mjcf.parameters import GRAVITY, SmartcarParameters
from craftsim.models.measuring import READING
from craftsim.skills.gains import SECTIONS, Gains
from craftsim.skills.outcome import Outcome, Reason

IDLE, HOLD, OWN, DRIVE, BOARD, HINGE, STOP = range(7)
"""The law of a car: none, the hold of a parked car, a skill in Python, or a compiled law of a task."""

RUNNING, SUCCEEDED, NOT_FINITE, LEANS, LOAD_MISSED, BLOCKED, SLIPPED = range(7)
RESTS_OFF_TARGET, MOVES_OFF_TARGET, BOARD_SHORT, NO_LOAD, UNDOCKED, HINGE_SHORT, WHEELS_TURN = (
    range(7, 14)
)
"""The status of a task."""

_ENDINGS: Final[dict[int, tuple[Reason | None, str]]] = {
    SUCCEEDED: (None, ""),
    NOT_FINITE: (Reason.DIVERGED, "a measurement is not finite"),
    LEANS: (Reason.TIPPED, "pitch {:+.2f} rad, roll {:+.2f} rad"),
    LOAD_MISSED: (Reason.LOAD_LOST, "the board feels {:.1f} N"),
    BLOCKED: (Reason.BLOCKED, "{:.0f} mm behind the path"),
    SLIPPED: (Reason.SLIPPED, "{:.0f} mm behind the path"),
    RESTS_OFF_TARGET: (Reason.MISALIGNED, "{:.2f} mm and {:.1f} mrad from the target"),
    MOVES_OFF_TARGET: (Reason.TIMEOUT, "{:.2f} mm and {:.1f} mrad from the target"),
    BOARD_SHORT: (Reason.TIMEOUT, "the board is {:+.1f} mm from its end"),
    NO_LOAD: (Reason.LOAD_LOST, "the board is up and feels {:.1f} N"),
    UNDOCKED: (Reason.MISALIGNED, "the car is not docked to a slope"),
    HINGE_SHORT: (Reason.TIMEOUT, "the hinge is {:+.2f} rad from its end"),
    WHEELS_TURN: (Reason.TIMEOUT, "the wheels still turn"),
}
"""For each status that ends a task, the reason of a failure, and a text with the task's two details."""


_CAR: Final = layout(
    f8="lever_m radius_m mass_kg spin_mass_kg turn_inertia_kgm2 wheel_inertia_kgm2 wheel_x_m wheel_gain_nms_rad "
    "gear_friction_nm wheel_speed_rad_s wheel_torque_nm board_speed_m_s hinge_speed_rad_s felt_load_n"
)
KNOWN: Final = layout(
    f8="period_s",
    car=_CAR,
    **{name: layout(f8=" ".join(f.name for f in fields(kind))) for name, kind in SECTIONS.items()},
)
"""A car's parameters, those of the hinge that it may turn, and the gains by section."""

_POSE: Final = layout(f8="x y heading")
DRIVE_TASK: Final = layout(
    **dict.fromkeys(("origin", "delta", "direction", "integral", "before"), _POSE),
    profile=layout(f8="cruise_speed ramp_s duration_s"),
    behind=layout(f8="stuck_s rolled_m moved_m free_m_s free_m"),
    f8="load_kg unloaded_s step_x step_y start_rad end_rad waited_s pace lean_x lean_y aside_x aside_y begins_s ends_s",
    f8x3="path",
    f8x4="wheels_before commanded torques",
    i8="loaded under centres sloping waits there_periods near_periods rest_periods at_rest n_lean",
)
"""``path`` is the next set point: x and y in metres, and heading; nan without one. A path that ``waits`` for its car
goes on at a ``pace`` from 0 to 1, and is late by ``waited_s``. One that keeps off something first goes aside by
so many metres, follows its profile from ``begins_s``, and is back at ``ends_s``. At its end the car has leant to x
and y by the mean of ``n_lean`` readings, in radians. A car that ``centres`` itself then raises its board."""
TASK: Final = layout(
    i8="law status feels_load sure returning",
    f8="elapsed_s ended_s detail second_detail crept_s",
    f8x4="turned",
    held=_POSE,
    drive=DRIVE_TASK,
    board=layout(f8="target_m speed last_m deadline_s", i8="needs_load"),
    hinge=layout(f8="target_rad speed deadline_s undocked_s", i8="slope n_past"),
)
"""The task of a car: its law, its status, and the state of the law. For a parked car that is held, that is how far its
wheels have turned, its pose when it was parked, or when it first was ``sure`` of that, for how long it has been away
from there, and whether it returns."""

NO_TASK: Final = np.zeros((), TASK)
"""The initial task."""
NO_TASK["drive"]["path"] = np.nan

COMMAND: Final = layout(f8x4="wheels", f8="board hinge")
"""A :class:`~craftsim.skills.skill.Command` as a record."""


LAG: Final = layout(f8="steps", f8x13="mismatches shares", f8x13x4="servos", f8x4="sent")
"""The estimate of the motors' lag: the likeliest time constant, in steps between candidates; for each candidate its
mismatch, its servo speeds, and the share by which these approach a command in a control period; the last command."""
N_LAGS: Final[int] = LAG["mismatches"].shape[0]

FLOOR: Final = layout(
    f8="pitch roll variance way_m pitch_on_way roll_on_way", i8="n_read suspected uneven"
)
"""The floor estimate: mean pitch and roll in radians, the variance of both together, and the number of readings;
whether the mean is too large, but may be noise; whether it was ever significantly too large. The means over all of the
way that the wheels have rolled show by how much the sensors are off."""

CAR: Final = layout(known=KNOWN, now=READING, task=TASK, command=COMMAND, lag=LAG, floor=FLOOR)
"""All of one car; ``now`` is its reading with the estimated pose. The command of an idle car is zero."""


@lru_cache(maxsize=64)
def constants_of(
    car: SmartcarParameters, machines: Machines, gains: Gains, period_s: float
) -> Records:
    """Return the constants of a car, shape (1,) of KNOWN; not to be written to."""
    # About the vertical axis, the spin of the wheels included.
    turn_inertia_kgm2 = (
        car.chassis_mass_kg * (car.chassis_length_m**2 + car.chassis_width_m**2) / 12
        + 4 * car.wheel_mass_kg * (car.wheel_x_m**2 + car.wheel_y_m**2)
        + car.spin_mass_kg * car.turn_radius_m**2
    )
    felt_load_n = (
        car.board_mass_kg + machines.lightest_load_kg * gains.health.load_share
    ) * GRAVITY
    parameters = (
        *(car.turn_radius_m, car.wheel_radius_m, car.mass_kg, car.spin_mass_kg, turn_inertia_kgm2),
        *(car.wheel_inertia_kgm2, car.wheel_x_m, car.wheel_gain_nms_rad, car.gear_friction_nm),
        *(car.wheel_speed_rad_s, car.wheel_torque_nm, car.board_speed_m_s),
        *(machines.slope.hinge_speed_rad_s, felt_load_n),
    )
    constants = records(1, KNOWN)
    constants[0] = (period_s, parameters, *(astuple(getattr(gains, name)) for name in SECTIONS))
    return constants


def n_angles(gains: Gains, period_s: float) -> int:
    """Return the number of remembered hinge angles, one a control period: a hinge must be still over these."""
    return round(gains.hinge.still_time / period_s) + 1


def outcome_of(task: np.void) -> Outcome | None:
    """Return how a task has ended; None while it runs."""
    return ending(
        int(task["status"]), float(task["ended_s"]), task["detail"], task["second_detail"]
    )


def ending(status: int, ended_s: float, detail: float, second_detail: float) -> Outcome | None:
    """Return the outcome of a task with a status and the numbers that its text holds; None for RUNNING."""
    if status == RUNNING:
        return None
    reason, text = _ENDINGS[status]
    return Outcome(reason, ended_s, text.format(detail, second_detail))
