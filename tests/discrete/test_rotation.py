"""Angles are wrapped as the standard library's remainder does it, to the last bit."""

import math

import numpy as np

from craftsim.discrete.kernel.rotation import wrap

_RNG = np.random.default_rng(0)
ANGLES = [
    *_RNG.normal(scale=10.0, size=2000),
    *_RNG.normal(scale=1e5, size=2000),
    *(math.nextafter(k * math.pi, towards) for k in range(-40, 41) for towards in (-9e9, k * math.pi, 9e9)),
    *(0.0, -0.0, 5e-324, 1e300, -1e300),
]


def test_an_angle_is_wrapped_as_remainder_does():
    for angle in map(float, ANGLES):
        wrapped, expected = wrap(angle), math.remainder(angle, math.tau)
        assert wrapped == expected, angle
        assert math.copysign(1.0, wrapped) == math.copysign(1.0, expected), angle


def test_what_is_not_finite_wraps_to_nan():
    for angle in (math.inf, -math.inf, math.nan):
        assert math.isnan(wrap(angle))
