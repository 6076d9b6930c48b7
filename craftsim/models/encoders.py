"""Encoders of the wheels: they count by how far each wheel has turned, and a speed is a difference of counts.

A wheel on an axle turns by its joint. The wheels of the reduced drive have none and roll without slip: they turn by the
car's way over the period, in its own frame, times the gears of its motors.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from craftsim.discrete.kernel.jit import compiled, records
from craftsim.discrete.kernel.rotation import body_axes
from craftsim.models.measuring import Floats, Records, Wiring
from craftsim.models.world import Site

_WHEELS: Final = [(name, "f8", (4,)) for name in ("before", "angles", "counts")]
_ENCODERS: Final = np.dtype([("joints", "i8", (4,)), ("pose", "f8", (7,)), *_WHEELS], align=True)
"""A car's: where its wheels' angles lie in MjData.qpos, -1 for none; its pose a period ago; by wheel the angle before
the first count, the angle, and its counts."""


class Encoders:
    """Those of all cars of a Site; they count on from one control period to the next."""

    def __init__(self, site: Site, wiring: Wiring, step_rad: float, rng: np.random.Generator) -> None:
        """Begin where the cars stand; ``rng`` draws how far each wheel is from its next count of ``step_rad``."""
        model, data = site.model, site.data
        self._encoders = records(len(site.cars), _ENCODERS)
        self._encoders["joints"] = -1
        self._encoders["before"] = step_rad * rng.uniform(0, 1, (len(site.cars), 4))
        for row, car in zip(self._encoders, site.cars, strict=True):
            row["pose"] = np.concatenate(site.free_body_state(car.base))
            row["angles"] = row["before"]
            if wiring.on_axles:
                row["joints"] = model.jnt_qposadr[model.dof_jntid[car.wheel_dofs]]
                row["angles"] += data.qpos[row["joints"]]
        self._encoders["counts"] = np.floor(self._encoders["angles"] / step_rad)
        self._arrays = (data.qpos, model.actuator_gear, wiring.cars, self._encoders)
        self._step_rad, self._period_s = step_rad, site.config.control_period_s

    def read(self, readings: Records) -> None:
        """Replace the speeds in exact readings of all cars, (n,) of READING, by those of a control period's counts."""
        _read(*self._arrays, self._step_rad, self._period_s, readings)


@compiled
def _read(
    qpos: Floats,
    gear: Floats,
    cars: Records,
    encoders: Records,
    step_rad: float,
    period_s: float,
    out: Records,
) -> None:
    for i in range(len(cars)):
        own, was, at = encoders[i], encoders[i].pose, cars[i].pose
        # How a car has moved since, along the mean of its axes then and now: by that its wheels turn without joints.
        x, y, z = qpos[at] - was[0], qpos[at + 1] - was[1], qpos[at + 2] - was[2]
        ahead, aside, _ = body_axes(was[3], was[4], was[5], was[6])
        forward, left, _ = body_axes(qpos[at + 3], qpos[at + 4], qpos[at + 5], qpos[at + 6])
        along = (x * (ahead[0] + forward[0]) + y * (ahead[1] + forward[1]) + z * (ahead[2] + forward[2])) / 2
        across = (x * (aside[0] + left[0]) + y * (aside[1] + left[1]) + z * (aside[2] + left[2])) / 2
        turn = math.atan2(
            forward[0] * aside[0] + forward[1] * aside[1] + forward[2] * aside[2],
            forward[0] * ahead[0] + forward[1] * ahead[1] + forward[2] * ahead[2],
        )
        for k in range(7):
            was[k] = qpos[at + k]
        for wheel in range(4):
            if own.joints[wheel] >= 0:
                own.angles[wheel] = own.before[wheel] + qpos[own.joints[wheel]]
            else:
                gears = gear[cars[i].wheel_motors[wheel]]
                own.angles[wheel] += gears[0] * along + gears[1] * across + gears[5] * turn
            counts = math.floor(own.angles[wheel] / step_rad)
            out[i].wheel_speeds[wheel] = (counts - own.counts[wheel]) * step_rad / period_s
            own.counts[wheel] = counts
