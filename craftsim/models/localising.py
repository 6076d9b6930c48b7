"""The localisations that cars get: late, beside their places, now and then, and sometimes not at all."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from craftsim.discrete.kernel.jit import compiled, records
from craftsim.discrete.kernel.rotation import wrap
from craftsim.models.measuring import Floats, Records
from craftsim.models.noise import SensorNoise

_LEVELS: Final = (
    *("position_m", "heading_rad", "position_drift_m", "heading_drift_rad", "jitter_s"),
    *("localisation_period_s", "lost_share", "outlier_share", "outlier_m"),
)
_WANDERING: Final = ("position_drift_m", "heading_drift_rad", "jitter_s", "lost_share", "outlier_share")
"""Figures for which numbers are drawn each period, beside those of the white noise."""
_CUT: Final = 4.0
"""Jitter is cut off at so many deviations."""

_OWN: Final = np.dtype(
    [*((name, "f8") for name in ("delay", "phase", "off_x", "off_y", "off_heading")), ("last", "i8")],
    align=True,
)
"""A car's: delay and phase of its localisations in periods, their bias as it has drifted, and the last one's number."""


class Localisations:
    """Those of all cars; a localisation is the pose of some time ago, with noise and bias."""

    def __init__(
        self,
        noise: SensorNoise,
        n_cars: int,
        period_s: float,
        rng: np.random.Generator,
        more: np.random.Generator,
    ) -> None:
        """Draw what each car's localisations have of their own: delays from ``rng``, all else from ``more``."""
        late = noise.max_delay_s + _CUT * noise.jitter_s
        depth = math.ceil(late / period_s) + bool(noise.localisation_period_s) + 2
        self._past = np.zeros((n_cars, depth, 4))
        """x, y, z and heading in the last periods, the newest first."""
        self._n_periods = 0
        self._levels = records(1, np.dtype([(name, "f8") for name in _LEVELS]))
        self._levels[0] = tuple(getattr(noise, name) for name in _LEVELS)
        # In periods, and what walks in one.
        self._levels["jitter_s"] /= period_s
        self._levels["localisation_period_s"] /= period_s
        for name in ("position_drift_m", "heading_drift_rad"):
            self._levels[name] *= math.sqrt(period_s)
        self._own = records(n_cars, _OWN)
        self._own["delay"] = rng.uniform(noise.min_delay_s, noise.max_delay_s, n_cars) / period_s
        towards = more.uniform(0, math.tau, n_cars)
        self._own["off_x"] = noise.position_bias_m * np.cos(towards)
        self._own["off_y"] = noise.position_bias_m * np.sin(towards)
        self._own["off_heading"] = noise.heading_bias_rad * more.choice((-1.0, 1.0), n_cars)
        self._own["phase"] = more.uniform(0, 1, n_cars) * self._levels["localisation_period_s"]
        self._more = more if any(getattr(noise, name) for name in _WANDERING) else None
        self._normals, self._uniforms = np.zeros((n_cars, 4)), np.zeros((n_cars, 3))
        """Of a period, by car: of jitter and of the drifts of x, y and heading; of loss, of outliers, of their way."""

    def take(self, true: Records, normals: Floats, readings: Records) -> None:
        """Take in the exact poses of a control period; ``readings`` take what arrives.

        Args:
            true: (n,) READING.
            normals: (n, m) of the white noise: x, y, z and heading come first.
            readings: (n,) READING; where nothing arrives the pose stays, and is not fresh.
        """
        if self._more is not None:
            self._more.standard_normal(out=self._normals)
            self._more.random(out=self._uniforms)
        _take(
            true,
            self._own,
            self._past,
            self._n_periods,
            self._levels,
            *(normals, self._normals, self._uniforms, readings),
        )
        self._n_periods += 1


@compiled
def _take(
    true: Records,
    own: Records,
    past: Floats,
    n_periods: int,
    levels: Records,
    white: Floats,
    normals: Floats,
    uniforms: Floats,
    out: Records,
) -> None:
    noise = levels[0]
    oldest = min(n_periods, past.shape[1] - 1)
    for i in range(len(true)):
        car, now = own[i], out[i]
        real = true[i]
        for row in range(past.shape[1] - 1, 0, -1):
            for k in range(4):
                past[i, row, k] = past[i, row - 1, k]
        past[i, 0, 0], past[i, 0, 1], past[i, 0, 2], past[i, 0, 3] = real.x, real.y, real.z, real.heading
        if n_periods:
            car.off_x += noise.position_drift_m * normals[i, 1]
            car.off_y += noise.position_drift_m * normals[i, 2]
            car.off_heading += noise.heading_drift_rad * normals[i, 3]
        since, arrives = 0.0, True
        if noise.localisation_period_s > 0.0:
            number = math.floor((n_periods - car.phase) / noise.localisation_period_s)
            arrives = number != car.last
            car.last = number
            if n_periods:
                since = n_periods - car.phase - number * noise.localisation_period_s
        # There is always a first one.
        now.fresh = 1 if n_periods == 0 or (arrives and uniforms[i, 0] >= noise.lost_share) else 0
        if now.fresh:
            # The pose of so many periods ago.
            back = min(max(car.delay + since + noise.jitter_s * normals[i, 0], 0.0), float(oldest))
            newer, older = math.floor(back), math.ceil(back)
            share = back - newer
            a, b = past[i, newer], past[i, older]
            now.x = a[0] + share * (b[0] - a[0]) + noise.position_m * white[i, 0]
            now.y = a[1] + share * (b[1] - a[1]) + noise.position_m * white[i, 1]
            now.z = a[2] + share * (b[2] - a[2]) + noise.position_m * white[i, 2]
            heading = a[3] + share * wrap(b[3] - a[3]) + noise.heading_rad * white[i, 3]
            # That lies beside the car's place.
            now.x += car.off_x
            now.y += car.off_y
            now.heading = wrap(heading + car.off_heading)
            if uniforms[i, 1] < noise.outlier_share:
                now.x += noise.outlier_m * math.cos(2 * math.pi * uniforms[i, 2])
                now.y += noise.outlier_m * math.sin(2 * math.pi * uniforms[i, 2])
