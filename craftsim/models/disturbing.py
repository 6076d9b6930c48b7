"""What noise, delay and lag make of exact readings, compiled for all cars."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from craftsim.discrete.kernel.jit import compiled, records
from craftsim.models.localising import Localisations
from craftsim.models.measuring import READING, Floats, Records
from craftsim.models.noise import SensorNoise

_N_NORMALS = 9
"""Normal numbers for each reading of a car: x, y, z, heading, pitch, roll, board, its force, hinge."""
_LEVELS = ("tilt_rad", "board_m", "board_force_n", "hinge_rad", "undocked_share")
_BIASES: Final = {
    "pitch": "tilt_bias_rad",
    "roll": "tilt_bias_rad",
    "board_m": "board_bias_m",
    "board_force_n": "board_force_bias_n",
    "hinge_rad": "hinge_bias_rad",
}
"""Readings whose bias has a sign that is drawn, and the figures of that bias."""


class Disturber:
    """The noisy, late readings of all cars: :attr:`readings`, shape (n,) of READING."""

    def __init__(self, noise: SensorNoise, n_cars: int, period_s: float, rng: np.random.Generator) -> None:
        """Disturb one set of readings each control period."""
        self.readings = records(n_cars, READING)
        self._rng, self._period_s = rng, period_s
        # What is not white noise comes from other generators: whatever of it there is, the noise is the same.
        more, self._of_lines = rng.spawn(2)
        self._localisations = Localisations(noise, n_cars, period_s, rng, more)
        self._encoder_share = (
            1.0 if not noise.encoder_lag_s else 1 - math.exp(-period_s / noise.encoder_lag_s)
        )
        self._levels = records(1, np.dtype([(name, "f8") for name in _LEVELS]))
        self._levels[0] = tuple(getattr(noise, name) for name in _LEVELS)
        self._biases = records(n_cars, np.dtype([(reading, "f8") for reading in _BIASES]))
        for reading, figure in _BIASES.items():
            self._biases[reading] = getattr(noise, figure) * more.choice((-1.0, 1.0), n_cars)
        self._normals = np.zeros((n_cars, _N_NORMALS))
        self._uniforms = np.zeros(n_cars)
        self._line_m, self._line_normals = noise.line_m, np.zeros((n_cars, 4))

    def disturb(self, true: Records) -> None:
        """Take in the exact readings of a control period."""
        for car, normals in enumerate(self._normals):
            self._rng.standard_normal(out=normals)
            self._uniforms[car] = self._rng.random()
        self._localisations.take(true, self._normals, self.readings)
        _disturb(
            true,
            self._encoder_share,
            self._levels,
            self._biases,
            self._normals,
            self._uniforms,
            self.readings,
        )
        self.readings["lines"] = true["lines"]
        if self._line_m:
            self._of_lines.standard_normal(out=self._line_normals)
            self.readings["lines"] += self._line_m * self._line_normals


@compiled
def _disturb(
    true: Records,
    encoder_share: float,
    levels: Records,
    biases: Records,
    normals: Floats,
    uniforms: Floats,
    out: Records,
) -> None:
    noise = levels[0]
    for i in range(len(true)):
        real, now, bias = true[i], out[i], biases[i]
        now.time_s = real.time_s
        for wheel in range(4):
            old = now.wheel_speeds[wheel]
            now.wheel_speeds[wheel] = real.wheel_speeds[wheel]
            if encoder_share < 1.0:
                now.wheel_speeds[wheel] = old + encoder_share * (real.wheel_speeds[wheel] - old)
        now.pitch = real.pitch + noise.tilt_rad * normals[i, 4] + bias.pitch
        now.roll = real.roll + noise.tilt_rad * normals[i, 5] + bias.roll
        now.board_m = real.board_m + noise.board_m * normals[i, 6] + bias.board_m
        now.board_force_n = real.board_force_n + noise.board_force_n * normals[i, 7] + bias.board_force_n
        docked = real.slope >= 0 and uniforms[i] >= noise.undocked_share
        now.slope = real.slope if docked else -1
        now.hinge_rad = real.hinge_rad + noise.hinge_rad * normals[i, 8] + bias.hinge_rad if docked else 0.0
        now.position_std_m = now.heading_std_rad = 0.0
