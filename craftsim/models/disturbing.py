"""What noise, delay and lag make of exact readings, compiled for all cars."""

from __future__ import annotations

import math

import numpy as np

from craftsim.discrete.compiled import Record, compiled, records
from craftsim.discrete.rotation import wrap
from craftsim.models.measuring import READING, Floats, Records
from craftsim.models.noise import SensorNoise

_N_NORMALS = 9
"""Normal numbers for each reading of a car: x, y, z, heading, pitch, roll, board, its force, hinge."""
_LEVELS = (
    *("position_m", "heading_rad", "tilt_rad", "board_m", "board_force_n", "hinge_rad", "undocked_share"),
)


class Disturber:
    """The noisy, late readings of all cars: :attr:`readings`, shape (n,) of READING."""

    def __init__(self, noise: SensorNoise, n_cars: int, period_s: float, rng: np.random.Generator) -> None:
        """Disturb one set of readings each control period."""
        self.readings = records(n_cars, READING)
        self._rng = rng
        self._delays = rng.uniform(noise.min_delay_s, noise.max_delay_s, n_cars) / period_s
        depth = math.ceil(noise.max_delay_s / period_s) + 2
        self._past = np.zeros((n_cars, depth, 4))
        """x, y, z and heading in the last periods, the newest first."""
        self._n_past = 0
        self._encoder_share = (
            1.0 if not noise.encoder_lag_s else 1 - math.exp(-period_s / noise.encoder_lag_s)
        )
        self._levels = records(1, np.dtype([(name, "f8") for name in _LEVELS]))
        self._levels[0] = tuple(getattr(noise, name) for name in _LEVELS)
        self._normals = np.zeros((n_cars, _N_NORMALS))
        self._uniforms = np.zeros(n_cars)

    def disturb(self, true: Records) -> None:
        """Take in the exact readings of a control period."""
        for car, normals in enumerate(self._normals):
            self._rng.standard_normal(out=normals)
            self._uniforms[car] = self._rng.random()
        self._n_past = min(self._n_past + 1, self._past.shape[1])
        _disturb(
            true,
            self._delays,
            self._past,
            self._n_past,
            self._encoder_share,
            self._levels,
            self._normals,
            self._uniforms,
            self.readings,
        )


@compiled
def _disturb(
    true: Records,
    delays: Floats,
    past: Floats,
    n_past: int,
    encoder_share: float,
    levels: Records,
    normals: Floats,
    uniforms: Floats,
    out: Records,
) -> None:
    noise = levels[0]
    for i in range(len(true)):
        real, now = true[i], out[i]
        _remember(real, past[i])
        now.time_s = real.time_s
        _localise(now, past[i], min(delays[i], n_past - 1.0), noise, normals[i])
        for wheel in range(4):
            old = now.wheel_speeds[wheel]
            now.wheel_speeds[wheel] = old + encoder_share * (real.wheel_speeds[wheel] - old)
        now.pitch = real.pitch + noise.tilt_rad * normals[i, 4]
        now.roll = real.roll + noise.tilt_rad * normals[i, 5]
        now.board_m = real.board_m + noise.board_m * normals[i, 6]
        now.board_force_n = real.board_force_n + noise.board_force_n * normals[i, 7]
        docked = real.slope >= 0 and uniforms[i] >= noise.undocked_share
        now.slope = real.slope if docked else -1
        now.hinge_rad = real.hinge_rad + noise.hinge_rad * normals[i, 8] if docked else 0.0
        now.position_std_m = now.heading_std_rad = 0.0


@compiled
def _remember(real: Record, past: Floats) -> None:
    for row in range(len(past) - 1, 0, -1):
        for k in range(4):
            past[row, k] = past[row - 1, k]
    past[0, 0], past[0, 1], past[0, 2], past[0, 3] = real.x, real.y, real.z, real.heading


@compiled
def _localise(now: Record, past: Floats, back: float, noise: Record, normals: Floats) -> None:
    """Read the pose of ``back`` periods ago."""
    newer = math.floor(back)
    share = back - newer
    a, b = past[newer], past[math.ceil(back)]
    now.x = a[0] + share * (b[0] - a[0]) + noise.position_m * normals[0]
    now.y = a[1] + share * (b[1] - a[1]) + noise.position_m * normals[1]
    now.z = a[2] + share * (b[2] - a[2]) + noise.position_m * normals[2]
    turn = wrap(b[3] - a[3])
    now.heading = wrap(a[3] + share * turn + noise.heading_rad * normals[3])
