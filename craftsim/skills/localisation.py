"""Where cars believe they are: wheel odometry, corrected by localisations that are noisy, late and biased.

Odometry is prompt and smooth, so a car is controlled by it; all else only says by how much odometry is off. One Kalman
filter for each car estimates that, for x, y and heading, and with it by how much its localisations are beside its
place. Uncertainty grows with the way travelled, for wheels slip.

- A localisation is compared with where the car believed to be when it was taken. How long ago that was is estimated
  from the motion itself (:mod:`craftsim.skills.ages`). As far as it is unknown, a localisation says little while the
  car moves, and all that it can say once the car has rested for long enough: a delay that is not known yet cannot make
  a car swing. How noisy localisations are is found from how they scatter at rest.
- Below a block or a slope, which stands in the middle of its cell, line sensors say where the car is, at once and
  without bias (:mod:`craftsim.skills.sighting`), unless a car has set it down there. Nothing else can tell a bias: it
  is changed only while such a cross is seen, and what is learnt of it there stays known.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from craftsim.discrete.geometry import CELL_PITCH_M
from craftsim.discrete.kernel.jit import Record, compiled, records
from craftsim.discrete.kernel.rotation import wrap
from craftsim.models.measuring import READING, Floats, Records
from craftsim.models.parameters import SmartcarParameters
from craftsim.models.sensing import SensorNoise
from craftsim.skills.ages import WINDOW, assume_age, likeliest_age
from craftsim.skills.filtering import FILTER, correct
from craftsim.skills.gains import LocalisationGains
from craftsim.skills.mecanum import body_twist
from craftsim.skills.sighting import CROSS, CROSS_X, Flags, sight

_OLDEST_S: Final = 0.3
"""The greatest age that is looked for, unless more is assumed."""
_COUNTS: Final = 8.0
"""The assumed noise counts as much as so many localisations at rest..."""
_MEMORY: Final = 500.0
"""...and these as much as so many at most."""
_ALIKE_M: Final = 0.05
"""So far wheels slip alike: as long as two of them stand loose, or something is pushed..."""
_LOOSE: Final = 100.0
"""...but over a period by no more than ten times their share."""
_STILL_M_S: Final = 0.002
"""A car that rolls slower than this rests."""
_LEAST: Final = 1e-12
"""m^2 or rad^2: what is exact is not taken to be quite so."""
_ALIKE: Final = 100.0
"""An age that is believed wrongly is so for all localisations of a move: about so many count as one."""
_DOUBT: Final = 0.1
"""By this share of its way an outlier makes a car doubt where it is, so that it believes one after the other."""
_X, _Y, _HEADING, _BIAS = range(4)
"""Places in the state: what odometry lacks of x, y and heading, then the biases of their localisations, and then by how
much the cross that the car looks at is beside the middle of its cell, and turned."""

_ESTIMATE: Final = np.dtype(
    [
        *((name, "f8") for name in ("period_s", "lever_m", "radius_m")),
        *((name, "f8") for name in ("slip", "jitter", "counts", "age", "age_std")),
        *((name, "i8") for name in ("begun", "n_still")),
        ("known", FILTER),
        ("cross", CROSS),
        ("drifts", "f8", (6,)),
        *((name, "f8", (3,)) for name in ("noise", "scatter")),
    ],
    align=True,
)
"""What one car estimates. ``drifts`` are variances that each state gains in a period at rest; ``noise`` has those of
localisations, and ``scatter`` the sums that they come from."""


class Localiser:
    """The pose estimates of all cars; call :meth:`update` once each control period."""

    def __init__(
        self,
        assumed: SensorNoise,
        period_s: float,
        cars: Sequence[SmartcarParameters],
        gains: LocalisationGains,
        size: Sequence[int],
    ) -> None:
        """Expect readings with this noise at this period, of cars with these figures; they may come otherwise.

        ``size`` is that of the world in cells, of which length and width count.
        """
        n = len(cars)
        self.readings = records(n, READING)
        """(n,) READING: the newest, with the estimated poses in place of the localised ones."""
        least, most = assumed.min_delay_s / period_s, assumed.max_delay_s / period_s
        n_ages = math.ceil(max(assumed.max_delay_s, _OLDEST_S) / period_s) + 1
        self._ages = np.zeros((n, n_ages))
        """The mismatch of each age in periods."""
        for mismatches in self._ages:
            assume_age(mismatches, (least + most) / 2, max(0.1, (most - least) / math.sqrt(12)))
        self._estimates = records(n, _ESTIMATE)
        for row, car in zip(self._estimates, cars, strict=True):
            row["period_s"], row["lever_m"], row["radius_m"] = period_s, car.turn_radius_m, car.wheel_radius_m
            cross, along_m, across_m = row["cross"], car.board_length_m / 2, car.board_width_m / 2
            cross["reach_m"], cross["variance"] = (along_m, -along_m, across_m, -across_m), assumed.line_m**2
            cross["placed"], cross["turned"] = gains.placement**2, (gains.placement / CELL_PITCH_M) ** 2
            row["slip"], row["jitter"], row["counts"] = gains.slip, assumed.jitter_s / period_s, _COUNTS
            place, turn = gains.position_drift**2, gains.heading_drift**2
            walk, sway = assumed.position_drift_m**2 * period_s, assumed.heading_drift_rad**2 * period_s
            row["drifts"] = place, place, turn, walk, walk, sway
            row["noise"] = assumed.position_m**2, assumed.position_m**2, assumed.heading_rad**2
            row["scatter"] = _COUNTS * row["noise"]
            for k, std in enumerate(
                (assumed.position_bias_m, assumed.position_bias_m, assumed.heading_bias_rad)
            ):
                bias, noise = std**2, row["noise"][k]
                covariance = row["known"]["covariance"]
                covariance[k, k], covariance[_BIAS + k, _BIAS + k] = bias + noise, bias
                covariance[k, _BIAS + k] = covariance[_BIAS + k, k] = -bias
        self._odometry = np.zeros((n, 3, n_ages + WINDOW))
        """x, y and heading by odometry alone at the end of each period; the newest first."""
        self._located = np.zeros((n, 3, WINDOW + 1))
        """The localisations; the newest first."""
        self._moved = np.zeros(tuple(size[:2]), np.bool_)
        """(length, width): whether a car has set something down in a column of cells."""

    def update(self, readings: Records) -> Records:
        """Take in the readings of all cars, shape (n,), and return :attr:`readings`."""
        _update(
            readings,
            *(self._estimates, self._ages, self._odometry, self._located, self._moved),
            self.readings,
        )
        return self.readings


@compiled
def _update(
    readings: Records,
    estimates: Records,
    ages: Floats,
    odometry: Floats,
    located: Floats,
    moved: Flags,
    out: Records,
) -> None:
    for i in range(len(readings)):
        out[i] = readings[i]
        now, estimate, rolled, seen = out[i], estimates[i], odometry[i], located[i]
        state, covariance = estimate.known.state, estimate.known.covariance
        if estimate.begun:
            _predict(now, estimate, rolled)
            # Localisations grow older by a period; none has come yet.
            for row in range(3):
                for k in range(seen.shape[1] - 1, 0, -1):
                    seen[row, k] = seen[row, k - 1]
                seen[row, 0] = math.nan
            if now.fresh:
                _localise(now, estimate, ages[i], rolled, seen)
        else:
            # Begin with what is measured.
            for k in range(rolled.shape[1]):
                rolled[_X, k], rolled[_Y, k], rolled[_HEADING, k] = now.x, now.y, now.heading
            for k in range(seen.shape[1]):
                seen[_X, k], seen[_Y, k], seen[_HEADING, k] = now.x, now.y, now.heading
            estimate.age, estimate.age_std = likeliest_age(ages[i])
            estimate.begun = 1
        now.x, now.y = rolled[_X, 0] + state[_X], rolled[_Y, 0] + state[_Y]
        now.heading = rolled[_HEADING, 0] + state[_HEADING]
        sight(now, estimate.known, estimate.cross, moved)
        now.x, now.y = rolled[_X, 0] + state[_X], rolled[_Y, 0] + state[_Y]
        now.heading = wrap(rolled[_HEADING, 0] + state[_HEADING])
        # A coordinate is known from localisations up to their bias, and by a cross up to its place.
        now.position_std_m = 0.0
        for k in range(3):
            own, bias, cross = covariance[k, k], _BIAS + k, CROSS_X + k
            by_localisations = own + 2 * covariance[k, bias] + covariance[bias, bias]
            by_cross = own - 2 * covariance[k, cross] + covariance[cross, cross]
            std = math.sqrt(max(0.0, min(own, by_localisations, by_cross)))
            if k == _HEADING:
                now.heading_std_rad = std
            else:
                now.position_std_m = max(now.position_std_m, std)


@compiled
def _localise(now: Record, estimate: Record, mismatches: Floats, rolled: Floats, seen: Floats) -> None:
    """Take in a localisation."""
    age, std, jitter, known = estimate.age, estimate.age_std, estimate.jitter, estimate.known
    state = known.state
    turned = now.heading - _at(rolled, _HEADING, age) - state[_HEADING] - state[_BIAS + _HEADING]
    # Headings are counted on beyond half a turn.
    seen[_X, 0], seen[_Y, 0], seen[_HEADING, 0] = now.x, now.y, now.heading - turned + wrap(turned)
    straight = True
    for k in range(3):
        known.slopes[k] = known.slopes[_BIAS + k] = 1.0
        off = seen[k, 0] - _at(rolled, k, age) - state[k] - state[_BIAS + k]
        # A localisation of unknown age says little of a car that moved.
        unsure = (_at(rolled, k, age - std) - _at(rolled, k, age + std)) / 2
        jittered = (_at(rolled, k, age - jitter) - _at(rolled, k, age + jitter)) / 2
        spread = _ALIKE * unsure**2 + jittered**2 + _LEAST
        # Without such a cross nothing tells a bias from slip, which is one-sided while a car turns one way.
        if not correct(known, off, estimate.noise[k] + spread, _BIAS, 0 if estimate.cross.seen else 3):
            straight = False
            known.covariance[k, k] += (_DOUBT * off) ** 2
    if straight:
        _learn(estimate, mismatches, rolled, seen)
    else:
        seen[_X, 0] = seen[_Y, 0] = seen[_HEADING, 0] = math.nan


@compiled
def _predict(now: Record, estimate: Record, rolled: Floats) -> None:
    """Go on as the wheels do, no further than the car moved; they may slip on all that they rolled."""
    wheels, period_s, slip = now.wheel_speeds, estimate.period_s, estimate.slip
    twist = body_twist(estimate.lever_m, estimate.radius_m, wheels[0], wheels[1], wheels[2], wheels[3])
    forward, left, turn = period_s * twist[0], period_s * twist[1], period_s * twist[2]
    forward, left = forward * math.cos(now.pitch), left * math.cos(now.roll)
    middle = rolled[_HEADING, 0] + estimate.known.state[_HEADING] + turn / 2
    c, s = math.cos(middle), math.sin(middle)
    x, y = c * forward - s * left, s * forward + c * left
    for row in range(3):
        for k in range(rolled.shape[1] - 1, 0, -1):
            rolled[row, k] = rolled[row, k - 1]
    rolled[_X, 0] += x
    rolled[_Y, 0] += y
    rolled[_HEADING, 0] += turn
    length = math.hypot(forward, left)
    covariance = estimate.known.covariance
    # A car whose heading is off goes astray.
    for k in range(len(covariance)):
        covariance[_X, k] -= y * covariance[_HEADING, k]
        covariance[_Y, k] += x * covariance[_HEADING, k]
    for k in range(len(covariance)):
        covariance[k, _X] -= y * covariance[k, _HEADING]
        covariance[k, _Y] += x * covariance[k, _HEADING]
    for k in range(6):
        covariance[k, k] += estimate.drifts[k]
    # Whichever way the wheels roll, they slip in all directions, and over a while alike.
    rolled_m = length + estimate.lever_m * abs(turn)
    slipped = (slip * rolled_m) ** 2 * max(1.0, min(_LOOSE, _ALIKE_M / max(rolled_m, _LEAST)))
    covariance[_X, _X] += slipped
    covariance[_Y, _Y] += slipped
    covariance[_HEADING, _HEADING] += slipped / estimate.lever_m**2
    still = rolled_m < _STILL_M_S * period_s
    estimate.n_still = estimate.n_still + 1 if still else 0


@compiled
def _learn(estimate: Record, mismatches: Floats, rolled: Floats, seen: Floats) -> None:
    """Take in what localisations say of themselves: how late they are, by the way of the last periods, and how noisy,
    by how much they differ at rest from one to the next."""
    if estimate.n_still < rolled.shape[1] and math.isfinite(seen[_X, WINDOW]):
        way = math.hypot(seen[_X, 0] - seen[_X, WINDOW], seen[_Y, 0] - seen[_Y, WINDOW])
        turn = seen[_HEADING, 0] - seen[_HEADING, WINDOW]
        for k in range(3):
            unsure = estimate.slip * (turn if k == _HEADING else way)
            late_way = seen[k, 0] - seen[k, WINDOW]
            # Of the difference of the two ways at the true age.
            variance = 2 * estimate.noise[k] + unsure**2 + _LEAST
            for age in range(len(mismatches)):
                mismatches[age] += (late_way - rolled[k, age] + rolled[k, age + WINDOW]) ** 2 / variance
        estimate.age, estimate.age_std = likeliest_age(mismatches)
    last = 1
    while last < WINDOW and not math.isfinite(seen[_X, last]):
        last += 1
    settled = estimate.age + 3 * (estimate.age_std + estimate.jitter) + 1 + last
    if estimate.n_still >= settled and math.isfinite(seen[_X, last]):
        fade = min(1.0, _MEMORY / (estimate.counts + 1))
        estimate.counts = fade * (estimate.counts + 1)
        for k in range(3):
            estimate.scatter[k] = fade * (estimate.scatter[k] + (seen[k, 0] - seen[k, last]) ** 2 / 2)
            estimate.noise[k] = estimate.scatter[k] / estimate.counts


@compiled
def _at(past: Floats, row: int, age: float) -> float:
    """Return what a row of a past was so many periods ago, between two of them."""
    oldest = past.shape[1] - 1
    back = max(0.0, min(age, float(oldest)))
    newer = math.floor(back)
    older = min(newer + 1, oldest)
    value: float = past[row, newer] + (back - newer) * (past[row, older] - past[row, newer])
    return value
