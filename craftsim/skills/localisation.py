"""Where cars believe they are: wheel odometry, corrected by localisations that are noisy, and late by they know not what.

Odometry is prompt and smooth, so a car is controlled by it; localisations only say by how much odometry is off. A
scalar Kalman filter for each of x, y and heading estimates that: its variance grows with the way travelled, for wheels
slip, and each localisation is compared with where the car believed to be when it was taken. How long ago that was is
estimated from the motion itself (:mod:`craftsim.skills.ages`). As far as it is unknown, a localisation says little
while the car moves, and all that it can say once the car has rested for long enough: a delay that is not known yet
cannot make a car swing. How noisy localisations are is found from how they scatter at rest.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from craftsim.discrete.compiled import Record, compiled, records
from craftsim.discrete.rotation import wrap
from craftsim.models.measuring import READING, Floats, Records
from craftsim.models.noise import SensorNoise
from craftsim.skills.ages import WINDOW, assume_age, likeliest_age, weigh_ages
from craftsim.skills.gains import LocalisationGains
from craftsim.skills.mecanum import Mecanum, body_twist

_OLDEST_S: Final = 0.3
"""The greatest age that is looked for, unless more is assumed."""
_COUNTS: Final = 8.0
"""The assumed noise counts as much as so many localisations at rest..."""
_MEMORY: Final = 500.0
"""...and these as much as so many at most."""
_OUTLIER: Final = 4.0
"""A localisation that is further off than so many standard deviations pulls no more than one that is so far off."""
_STILL_M_S: Final = 0.002
"""A car that rolls slower than this rests."""

_COORDINATE: Final = np.dtype(
    [(name, "f8") for name in ("noise_variance", "drift_variance", "correction", "variance", "scatter")]
)
_ESTIMATE: Final = np.dtype(
    [
        ("x", _COORDINATE),
        ("y", _COORDINATE),
        ("heading", _COORDINATE),
        *((name, "f8") for name in ("period_s", "lever_m", "radius_m", "slip", "jitter", "counts", "age", "age_std")),
        *((name, "i8") for name in ("begun", "n_still")),
    ],
    align=True,
)


class Localiser:
    """The pose estimates of all cars; call :meth:`update` once each control period."""

    def __init__(
        self,
        assumed: SensorNoise,
        period_s: float,
        kinematics: Sequence[Mecanum],
        gains: LocalisationGains,
    ) -> None:
        """Expect readings with this noise at this period, of cars with these wheels; they may come otherwise."""
        n = len(kinematics)
        self.readings = records(n, READING)
        """(n,) READING: the newest, with the estimated poses in place of the localised ones."""
        least, most = assumed.min_delay_s / period_s, assumed.max_delay_s / period_s
        n_ages = math.ceil(max(assumed.max_delay_s, _OLDEST_S) / period_s) + 1
        self._ages = np.zeros((n, n_ages))
        """The mismatch of each age in periods."""
        for mismatches in self._ages:
            assume_age(mismatches, (least + most) / 2, max(0.1, (most - least) / math.sqrt(12)))
        self._estimates = records(n, _ESTIMATE)
        for row, wheels in zip(self._estimates, kinematics, strict=True):
            row["period_s"], row["lever_m"], row["radius_m"] = period_s, wheels.lever_m, wheels.radius_m
            row["slip"], row["jitter"], row["counts"] = gains.slip, assumed.jitter_s / period_s, _COUNTS
            row["age"], row["age_std"] = likeliest_age(self._ages[0])
            for name in ("x", "y", "heading"):
                std = assumed.heading_rad if name == "heading" else assumed.position_m
                drift = gains.heading_drift if name == "heading" else gains.position_drift
                row[name]["noise_variance"], row[name]["drift_variance"] = std**2, drift**2
                row[name]["scatter"] = _COUNTS * std**2
        self._odometry = np.zeros((n, 3, n_ages + WINDOW))
        """x, y and heading by odometry alone at the end of each period; the newest first."""
        self._located = np.zeros((n, 3, WINDOW + 1))
        """The localisations; the newest first."""

    def update(self, readings: Records) -> Records:
        """Take in the readings of all cars, shape (n,), and return :attr:`readings`."""
        _update(readings, self._estimates, self._ages, self._odometry, self._located, self.readings)
        return self.readings


@compiled
def _update(
    readings: Records, estimates: Records, ages: Floats, odometry: Floats, located: Floats, out: Records
) -> None:
    for i in range(len(readings)):
        out[i] = readings[i]
        now, estimate, rolled, seen = out[i], estimates[i], odometry[i], located[i]
        if estimate.begun:
            _predict(now, estimate, rolled)
            _note(seen, now)
            if now.fresh:
                _localise(now, estimate, ages[i], rolled, seen)
        else:
            _start(estimate, rolled, seen, now)
        x, y, heading = estimate.x, estimate.y, estimate.heading
        now.x, now.y = rolled[0, 0] + x.correction, rolled[1, 0] + y.correction
        now.heading = wrap(rolled[2, 0] + heading.correction)
        now.position_std_m = math.sqrt(max(x.variance, y.variance))
        now.heading_std_rad = math.sqrt(heading.variance)


@compiled
def _start(estimate: Record, rolled: Floats, seen: Floats, now: Record) -> None:
    """Begin with what is measured."""
    for k in range(rolled.shape[1]):
        rolled[0, k], rolled[1, k], rolled[2, k] = now.x, now.y, now.heading
    for k in range(seen.shape[1]):
        seen[0, k], seen[1, k], seen[2, k] = now.x, now.y, now.heading
    estimate.x.variance, estimate.y.variance = estimate.x.noise_variance, estimate.y.noise_variance
    estimate.heading.variance = estimate.heading.noise_variance
    estimate.begun = 1


@compiled
def _note(seen: Floats, now: Record) -> None:
    """Put a pose before those of the past, or nan where none has come; headings are counted on beyond half a turn."""
    for k in range(seen.shape[1] - 1, 0, -1):
        seen[0, k], seen[1, k], seen[2, k] = seen[0, k - 1], seen[1, k - 1], seen[2, k - 1]
    seen[0, 0] = seen[1, 0] = seen[2, 0] = math.nan


@compiled
def _localise(now: Record, estimate: Record, mismatches: Floats, rolled: Floats, seen: Floats) -> None:
    """Take in a localisation."""
    x, y, heading = estimate.x, estimate.y, estimate.heading
    off_x = now.x - _at(rolled[0], estimate.age) - x.correction
    off_y = now.y - _at(rolled[1], estimate.age) - y.correction
    believed = _at(rolled[2], estimate.age) + heading.correction
    turned = wrap(now.heading - believed)
    straight = _correct(x, rolled[0], off_x, estimate)
    straight &= _correct(y, rolled[1], off_y, estimate)
    straight &= _correct(heading, rolled[2], turned, estimate)
    if straight:
        seen[0, 0], seen[1, 0], seen[2, 0] = now.x, now.y, believed + turned
        _find_age(estimate, mismatches, rolled, seen)
        _find_noise(estimate, seen)


@compiled
def _predict(now: Record, estimate: Record, rolled: Floats) -> None:
    """Go on as the wheels do, no further than the car moved; they may slip on all that they rolled."""
    wheels, period_s, slip = now.wheel_speeds, estimate.period_s, estimate.slip
    twist = body_twist(estimate.lever_m, estimate.radius_m, wheels[0], wheels[1], wheels[2], wheels[3])
    forward, left, turn = period_s * twist[0], period_s * twist[1], period_s * twist[2]
    forward, left = forward * math.cos(now.pitch), left * math.cos(now.roll)
    middle = rolled[2, 0] + estimate.heading.correction + turn / 2
    c, s = math.cos(middle), math.sin(middle)
    for k in range(rolled.shape[1] - 1, 0, -1):
        rolled[0, k], rolled[1, k], rolled[2, k] = rolled[0, k - 1], rolled[1, k - 1], rolled[2, k - 1]
    rolled[0, 0] += c * forward - s * left
    rolled[1, 0] += s * forward + c * left
    rolled[2, 0] += turn
    length = math.hypot(forward, left)
    _grow(estimate.x, slip * length)
    _grow(estimate.y, slip * length)
    _grow(estimate.heading, slip * (abs(turn) + length / estimate.lever_m))
    still = length + estimate.lever_m * abs(turn) < _STILL_M_S * period_s
    estimate.n_still = estimate.n_still + 1 if still else 0


@compiled
def _grow(coordinate: Record, unsure: float) -> None:
    coordinate.variance += unsure**2 + coordinate.drift_variance


@compiled
def _find_age(estimate: Record, mismatches: Floats, rolled: Floats, seen: Floats) -> None:
    """Take in what the way of the last periods says of how late localisations are."""
    if estimate.n_still >= rolled.shape[1]:
        return
    way = math.hypot(seen[0, 0] - seen[0, WINDOW], seen[1, 0] - seen[1, WINDOW])
    turn = seen[2, 0] - seen[2, WINDOW]
    if not math.isfinite(turn):
        return
    unsure = (estimate.slip * way) ** 2
    weigh_ages(mismatches, seen[0, 0] - seen[0, WINDOW], rolled[0], 2 * estimate.x.noise_variance + unsure)
    weigh_ages(mismatches, seen[1, 0] - seen[1, WINDOW], rolled[1], 2 * estimate.y.noise_variance + unsure)
    weigh_ages(mismatches, turn, rolled[2], 2 * estimate.heading.noise_variance + (estimate.slip * turn) ** 2)
    age, std = likeliest_age(mismatches)
    estimate.age, estimate.age_std = age, math.hypot(std, estimate.jitter)


@compiled
def _find_noise(estimate: Record, seen: Floats) -> None:
    """Take in by how much localisations at rest differ from one to the next."""
    last = 1
    while last < WINDOW and not math.isfinite(seen[0, last]):
        last += 1
    if estimate.n_still < estimate.age + 3 * estimate.age_std + 1 + last or not math.isfinite(seen[0, last]):
        return
    fade = min(1.0, _MEMORY / (estimate.counts + 1))
    estimate.counts = fade * (estimate.counts + 1)
    for k in range(3):
        coordinate = estimate.x if k == 0 else estimate.y if k == 1 else estimate.heading
        coordinate.scatter = fade * (coordinate.scatter + (seen[k, 0] - seen[k, last]) ** 2 / 2)
        coordinate.noise_variance = coordinate.scatter / estimate.counts


@compiled
def _correct(coordinate: Record, rolled: Floats, innovation: float, estimate: Record) -> bool:
    """Take in by how much a localisation differs from what was believed when it was taken; False for an outlier."""
    # A localisation of unknown age says little of a car that moved.
    spread = (_at(rolled, estimate.age - estimate.age_std) - _at(rolled, estimate.age + estimate.age_std)) / 2
    expected = coordinate.variance + coordinate.noise_variance + spread**2
    most = _OUTLIER * math.sqrt(expected)
    gain = coordinate.variance / expected
    coordinate.correction += gain * max(-most, min(most, innovation))
    coordinate.variance *= 1 - gain
    return abs(innovation) <= most


@compiled
def _at(past: Floats, age: float) -> float:
    """Return what was so many periods ago, between two of them."""
    back = max(0.0, min(age, len(past) - 1.0))
    newer = math.floor(back)
    older = min(newer + 1, len(past) - 1)
    value: float = past[newer] + (back - newer) * (past[older] - past[newer])
    return value
