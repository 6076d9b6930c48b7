"""What cars estimate: their poses, the delay of localisations and motors, and whether their floor is uneven.

Cars are controlled by odometry. One Kalman filter a car estimates its errors, and the biases of localisations. A
localisation is compared with where the car believed to be when it was taken. Line sensors below a block or a slope see
a marker in the middle of its cell; a bias is corrected only while one is seen that no car has set down. Markers stand
a little beside their cells' middles, too: the pose is the mean of two hypotheses, that localisations have a bias and
that they are exact, weighted by how well each explains the markers and how localisations scatter. A delay is found from
the ways over a short window: the vertex of a parabola at the least mismatch, its width the variance.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from typing import Final

import numpy as np

from craftsim.compiled.arrays import Arrays, Flags, Floats, Records
from craftsim.compiled.jit import Record, compiled, layout, records
from craftsim.discrete.geometry import CELL_PITCH_M
from craftsim.discrete.kernel.rotation import wrap
from craftsim.mjcf.parameters import SmartcarParameters
from craftsim.models.measuring import READING
from craftsim.models.sensing import SensorNoise
from craftsim.skills.gains import LocalisationGains
from craftsim.skills.mecanum import body_twist
from craftsim.skills.state import DRIVE
from craftsim.workers.copying import Copyable

_WINDOW: Final = 5
"""Control periods over which ways are compared; a period's mismatch counts in so many windows."""
_SUREST: Final = 0.1
"""Least standard deviation of a delay, in periods: it is not quite constant."""
_OLDEST_S: Final = 0.3
"""The greatest delay that is looked for, unless more is assumed."""
_COUNTS: Final = 8.0
"""The assumed noise counts as so many localisations at rest..."""
_MEMORY: Final = 500.0
"""...and what was measured as so many at most."""
_ALIKE_M: Final = 0.05
"""Correlation length of wheel slip: as long as two wheels stand loose, or something is pushed..."""
_LOOSE: Final = 100.0
"""...up to this factor of the variance in one period."""
_STILL_M_S: Final = 0.002
"""A car that rolls slower than this rests."""
_LEAST: Final = 1e-12
"""Least variance of a measurement, in m^2 or rad^2."""
_ALIKE: Final = 100.0
"""An error of the delay is common to all localisations of a move: so many count as one."""
_DOUBT: Final = 0.1
"""Share of an outlier's distance by which it widens the estimate, so that a car believes several in a row."""
_OUTLIER: Final = 4.0
"""Standard deviations beyond which a measurement is an outlier; it is clipped there."""
_LOWERED_M: Final = 0.002
"""Below this height the board touches nothing, not even the pads of a slope: what is above stands where the map
says."""
_LEVEL_RAD: Final = 0.05
"""A car that leans further stands on a slope, where nothing is above it."""
_FEWEST: Final = 5
"""Least number of readings of the floor, or of localisations: fewer do not show how much they scatter."""
_SURE: Final = 3.0
"""Standard errors of the mean beyond which the floor is uneven."""
_LEANS_ALIKE_M: Final = 0.15
"""Way over which a car leans alike on an uneven floor: half a tile."""
_SIDEWAYS_S: Final = 0.15
"""Correlation time of the sideways speed of a car on two wheels of a diagonal..."""
_SIDEWAYS_M_S: Final = 0.05
"""...and the rolling speed beyond which it does not grow: a faster car rattles, which shares its weight out."""
_EXACT_M: Final = 0.00015
"""Standard deviation of localisations that may be exact: what scatters more may have a bias, too."""
_MOST_LOG: Final = 700.0
"""Beyond this an exponential is too large for a number."""
_X = 0
_Y = 1
_HEADING = 2
_BIAS = 3
_MARKER = 6
_SLIP = 9
_FIRST = 11
_N = 14
"""Indices in the state: the errors of odometry in x, y and heading; the biases of localisations in these; the offset of
the visible marker from the middle of its cell in these; the velocity of slip in x and y; the biases at the start. Last,
their number."""

_FILTER: Final = layout(f8x14="state slopes shares", f8x14x14="covariance")
"""A state and its covariance. ``slopes`` are the derivatives of the next measurement by the state; ``shares`` is
scratch."""

_SEEN: Final = layout(f8x4="reach_m", f8="variance placed turned", i8="seen x y raised")
"""How far a car's line sensors are before its middle, the first two, and to the left of it; the variances of a line's
position and of a marker's place and heading; whether a marker is seen, and its cell; whether the board was raised."""

_ESTIMATE: Final = layout(
    f8="period_s lever_m radius_m slip loose jitter counts compared delay delay_std",
    i8="n_still",
    f8x6="drifts",
    f8x3="noise scatter differences bias_variance weights",
    f8x3x3="factor",
    known=_FILTER,
    marker=_SEEN,
)
"""What one car estimates. ``drifts`` are the process variances of a period at rest; ``noise`` are the variances of
localisations, and ``scatter`` the sums from which they are computed, with what is assumed at first; ``differences`` are
these sums without that, of so many as were ``compared``. ``bias_variance`` is what is assumed of their bias at first;
``weights`` and ``factor`` are scratch."""


def assume_delay(mismatches: Floats, delay: float, std: float) -> None:
    """Set the prior of a delay, in periods; ``mismatches`` has one value for each candidate 0, 1, ..."""
    mismatches[:] = _WINDOW * ((np.arange(len(mismatches)) - delay) / std) ** 2


def likeliest_delay(mismatches: Floats) -> tuple[float, float]:
    """Return the delay in periods, and its standard deviation."""
    best = 0
    last = len(mismatches) - 1
    for k in range(1, last + 1):
        if mismatches[k] < mismatches[best]:
            best = k
    middle = min(max(best, 1), last - 1)
    before = mismatches[middle - 1]
    at = mismatches[middle]
    after = mismatches[middle + 1]
    bend = (before - 2 * at + after) / 2
    if bend <= 0.0:
        return float(best), 1.0
    delay = middle + (before - after) / (4 * bend)
    return max(0.0, min(float(last), delay)), max(_SUREST, math.sqrt(_WINDOW / bend))


delay_of = compiled(likeliest_delay)
"""The same in compiled code."""


class PoseEstimator(Copyable):
    """The pose estimates of all cars; call :meth:`update` once each control period."""

    _bound = ("_update",)

    def __init__(
        self,
        assumed: SensorNoise,
        period_s: float,
        cars: Sequence[SmartcarParameters],
        gains: LocalisationGains,
        size: Sequence[int],
    ) -> None:
        """Assume this noise at this period, for cars with these parameters in a world of this size in cells."""
        n = len(cars)
        self.readings = records(n, READING)
        """(n,) READING: the newest, with the estimated poses in place of the localised ones."""
        least_periods = assumed.min_delay_s / period_s
        most_periods = assumed.max_delay_s / period_s
        n_delays = math.ceil(max(assumed.max_delay_s, _OLDEST_S) / period_s) + 1
        self._delays = np.zeros((n, n_delays))
        """The mismatch of each delay in periods."""
        for mismatches in self._delays:
            assume_delay(
                mismatches,
                (least_periods + most_periods) / 2,
                max(0.1, (most_periods - least_periods) / math.sqrt(12)),
            )
        self._estimates = records(n, _ESTIMATE)
        for estimate, car in zip(self._estimates, cars, strict=True):
            estimate["period_s"] = period_s
            estimate["lever_m"] = car.turn_radius_m
            estimate["radius_m"] = car.wheel_radius_m
            marker = estimate["marker"]
            along_m = car.board_length_m / 2
            across_m = car.board_width_m / 2
            marker["reach_m"] = along_m, -along_m, across_m, -across_m
            marker["variance"] = assumed.line_m**2
            marker["placed"] = gains.placement**2
            marker["turned"] = (gains.placement / CELL_PITCH_M) ** 2
            estimate["slip"] = gains.slip
            estimate["jitter"] = assumed.jitter_s / period_s
            estimate["counts"] = _COUNTS
            place = gains.position_drift**2
            turn = gains.heading_drift**2
            walk = assumed.position_drift_m**2 * period_s
            sway = assumed.heading_drift_rad**2 * period_s
            estimate["drifts"] = place, place, turn, walk, walk, sway
            estimate["noise"] = assumed.position_m**2, assumed.position_m**2, assumed.heading_rad**2
            estimate["scatter"] = _COUNTS * estimate["noise"]
            stds = assumed.position_bias_m, assumed.position_bias_m, assumed.heading_bias_rad
            covariance = estimate["known"]["covariance"]
            for k, std in enumerate(stds):
                bias = std**2
                noise = estimate["noise"][k]
                covariance[k, k] = bias + noise
                for row_block, column_block in (
                    (_BIAS, _BIAS),
                    (_FIRST, _FIRST),
                    (_BIAS, _FIRST),
                    (_FIRST, _BIAS),
                ):
                    covariance[row_block + k, column_block + k] = bias
                for row_block in (_BIAS, _FIRST):
                    covariance[k, row_block + k] = covariance[row_block + k, k] = -bias
                estimate["bias_variance"][k] = bias
        self._odometry = np.zeros((n, 3, n_delays + _WINDOW))
        """x, y and heading by odometry alone at the end of each period; the newest first."""
        self._located = np.zeros((n, 3, _WINDOW + 1))
        """The localisations; the newest first."""
        self._moved = np.zeros(tuple(size[:2]), np.bool_)
        """(length, width): whether a car has set something down in a column of cells."""
        self._begun = np.zeros(1, np.bool_)
        """(1,): whether there was an update."""
        self._bind()

    def _bind(self) -> None:
        past = self._delays, self._odometry, self._located
        self._update = partial(
            _update, self._estimates, past, self._moved, self._begun, self.readings
        )

    def expect_loose(self, share: float) -> None:
        """From now on expect sideways slip, for a while in one direction, at this share of the speed."""
        self._estimates["loose"] = share

    def update(self, readings: Records) -> Records:
        """Take in the readings of all cars, shape (n,), and return :attr:`readings`."""
        if not self._begun[0]:
            self._begin(readings)
        self._update(readings)
        return self.readings

    def _begin(self, readings: Records) -> None:
        for past in (self._odometry, self._located):
            past[:] = np.stack([readings[name] for name in ("x", "y", "heading")], axis=1)[
                ..., None
            ]
        for estimate, mismatches in zip(self._estimates, self._delays, strict=True):
            estimate["delay"], estimate["delay_std"] = likeliest_delay(mismatches)


@compiled
def _update(
    estimates: Records,
    past: Arrays,
    moved: Flags,
    has_begun: Flags,
    out: Records,
    readings: Records,
) -> None:
    delays, odometry, located = past
    for i in range(len(readings)):
        out[i] = readings[i]
        reading = out[i]
        estimate = estimates[i]
        rolled = odometry[i]
        localised = located[i]
        kalman = estimate.known
        state = kalman.state
        covariance = kalman.covariance
        if has_begun[0]:
            _predict(reading, estimate, rolled)
            # Localisations grow older by a period; none has come yet.
            _shift(localised)
            localised[_X, 0] = localised[_Y, 0] = localised[_HEADING, 0] = math.nan
            if reading.fresh:
                _localise(reading, estimate, delays[i], rolled, localised)
        reading.x = rolled[_X, 0] + state[_X]
        reading.y = rolled[_Y, 0] + state[_Y]
        reading.heading = rolled[_HEADING, 0] + state[_HEADING]
        _update_marker(reading, kalman, estimate.marker, moved)
        share = _share_exact(estimate)
        reading.x = rolled[_X, 0] + state[_X] - share * _change_without_bias(estimate, _X)
        reading.y = rolled[_Y, 0] + state[_Y] - share * _change_without_bias(estimate, _Y)
        turn = share * _change_without_bias(estimate, _HEADING)
        reading.heading = wrap(rolled[_HEADING, 0] + state[_HEADING] - turn)
        # A coordinate is known from localisations up to their bias, and by a marker up to its place.
        reading.position_std_m = 0.0
        for k in range(3):
            variance = covariance[k, k]
            bias = _BIAS + k
            marker = _MARKER + k
            by_localisations = variance + 2 * covariance[k, bias] + covariance[bias, bias]
            by_marker = variance - 2 * covariance[k, marker] + covariance[marker, marker]
            std = math.sqrt(max(0.0, min(variance, min(by_localisations, by_marker))))
            if k == _HEADING:
                reading.heading_std_rad = std
            else:
                reading.position_std_m = max(reading.position_std_m, std)
    has_begun[0] = True


@compiled
def _shift(past: Floats) -> None:
    for row in range(3):
        for k in range(past.shape[1] - 1, 0, -1):
            past[row, k] = past[row, k - 1]


@compiled
def _predict(reading: Record, estimate: Record, rolled: Floats) -> None:
    """Predict the pose by odometry; slip grows with the way that the wheels rolled."""
    wheels = reading.wheel_speeds
    period_s = estimate.period_s
    lever_m = estimate.lever_m
    twist = body_twist(lever_m, estimate.radius_m, wheels[0], wheels[1], wheels[2], wheels[3])
    forward = period_s * twist[0]
    leftward = period_s * twist[1]
    turn = period_s * twist[2]
    forward = forward * math.cos(reading.pitch)
    leftward = leftward * math.cos(reading.roll)
    middle = rolled[_HEADING, 0] + estimate.known.state[_HEADING] + turn / 2
    c = math.cos(middle)
    s = math.sin(middle)
    x = c * forward - s * leftward
    y = s * forward + c * leftward
    _shift(rolled)
    rolled[_X, 0] += x
    rolled[_Y, 0] += y
    rolled[_HEADING, 0] += turn
    covariance = estimate.known.covariance
    # A car whose heading is off goes astray.
    for k in range(_N):
        covariance[_X, k] -= y * covariance[_HEADING, k]
        covariance[_Y, k] += x * covariance[_HEADING, k]
    for k in range(_N):
        covariance[k, _X] -= y * covariance[k, _HEADING]
        covariance[k, _Y] += x * covariance[k, _HEADING]
    for k in range(6):
        covariance[k, k] += estimate.drifts[k]
    # Whichever way the wheels roll, they slip in all directions, and over a while alike.
    rolled_m = math.hypot(forward, leftward) + lever_m * abs(turn)
    slipped = (estimate.slip * rolled_m) ** 2 * max(
        1.0, min(_LOOSE, _ALIKE_M / max(rolled_m, _LEAST))
    )
    covariance[_X, _X] += slipped
    covariance[_Y, _Y] += slipped
    covariance[_HEADING, _HEADING] += slipped / lever_m**2
    fade = math.exp(-period_s / _SIDEWAYS_S)
    # Slip along the way shows in localisations only as far as their age is known: at its end, where the car rests.
    # The way is taken over a while, for encoders jitter by a count.
    along_x = rolled[_X, 0] - rolled[_X, _WINDOW]
    along_y = rolled[_Y, 0] - rolled[_Y, _WINDOW]
    net_m = max(math.hypot(along_x, along_y), _LEAST)
    loose = (
        estimate.loose
        * math.sqrt(1 - fade**2)
        * min(_SIDEWAYS_M_S, net_m / (_WINDOW * period_s))
        / net_m
    )
    across = (-loose * along_y, loose * along_x)
    state = estimate.known.state
    for k in range(2):
        slip = _SLIP + k
        state[k] += period_s * state[slip]
        state[slip] *= fade
        for j in range(_N):
            covariance[k, j] += period_s * covariance[slip, j]
        for j in range(_N):
            covariance[j, k] += period_s * covariance[j, slip]
        for j in range(_N):
            covariance[slip, j] *= fade
        for j in range(_N):
            covariance[j, slip] *= fade
    for k in range(2):
        for j in range(2):
            covariance[_SLIP + k, _SLIP + j] += across[k] * across[j]
    estimate.n_still = estimate.n_still + 1 if rolled_m < _STILL_M_S * period_s else 0


@compiled
def _localise(
    reading: Record, estimate: Record, mismatches: Floats, rolled: Floats, localised: Floats
) -> None:
    delay = estimate.delay
    std = estimate.delay_std
    jitter = estimate.jitter
    kalman = estimate.known
    state = kalman.state
    turned = (
        reading.heading - _at(rolled, _HEADING, delay) - state[_HEADING] - state[_BIAS + _HEADING]
    )
    # Headings are counted on beyond half a turn.
    localised[_X, 0] = reading.x
    localised[_Y, 0] = reading.y
    localised[_HEADING, 0] = reading.heading - turned + wrap(turned)
    straight = True
    for k in range(3):
        kalman.slopes[k] = kalman.slopes[_BIAS + k] = 1.0
        off = localised[k, 0] - _at(rolled, k, delay) - state[k] - state[_BIAS + k]
        if k != _HEADING:
            # When it was taken, the car had not slipped as far.
            kalman.slopes[_SLIP + k] = -delay * estimate.period_s
            off -= kalman.slopes[_SLIP + k] * state[_SLIP + k]
        # A localisation of unknown delay says little of a car that moved.
        unsure = (_at(rolled, k, delay - std) - _at(rolled, k, delay + std)) / 2
        jittered = (_at(rolled, k, delay - jitter) - _at(rolled, k, delay + jitter)) / 2
        spread = _ALIKE * unsure**2 + jittered**2 + _LEAST
        # Without such a marker nothing tells a bias from slip, which is one-sided while a car turns one way.
        if not _correct(kalman, off, estimate.noise[k] + spread, 0 if estimate.marker.seen else 3):
            straight = False
            kalman.covariance[k, k] += (_DOUBT * off) ** 2
    if straight:
        _learn(estimate, mismatches, rolled, localised)
    else:
        localised[_X, 0] = localised[_Y, 0] = localised[_HEADING, 0] = math.nan


@compiled
def _learn(estimate: Record, mismatches: Floats, rolled: Floats, localised: Floats) -> None:
    """Estimate the delay of localisations by the last periods' ways, and their noise by how they differ at rest."""
    n_still = estimate.n_still
    noise = estimate.noise
    if n_still < rolled.shape[1] and math.isfinite(localised[_X, _WINDOW]):
        distance_m = math.hypot(
            localised[_X, 0] - localised[_X, _WINDOW], localised[_Y, 0] - localised[_Y, _WINDOW]
        )
        turn = localised[_HEADING, 0] - localised[_HEADING, _WINDOW]
        for k in range(3):
            unsure = estimate.slip * (turn if k == _HEADING else distance_m)
            late_way = localised[k, 0] - localised[k, _WINDOW]
            # Of the difference of the two ways at the true delay.
            variance = 2 * noise[k] + unsure**2 + _LEAST
            for delay in range(len(mismatches)):
                mismatches[delay] += (
                    late_way - rolled[k, delay] + rolled[k, delay + _WINDOW]
                ) ** 2 / variance
        estimate.delay, estimate.delay_std = delay_of(mismatches)
    last = 1
    while last < _WINDOW and not math.isfinite(localised[_X, last]):
        last += 1
    settled = estimate.delay + 3 * (estimate.delay_std + estimate.jitter) + 1 + last
    if n_still >= settled and math.isfinite(localised[_X, last]):
        fade = min(1.0, _MEMORY / (estimate.counts + 1))
        estimate.counts = fade * (estimate.counts + 1)
        estimate.compared = fade * (estimate.compared + 1)
        for k in range(3):
            square = (localised[k, 0] - localised[k, last]) ** 2 / 2
            estimate.scatter[k] = fade * (estimate.scatter[k] + square)
            estimate.differences[k] = fade * (estimate.differences[k] + square)
            noise[k] = estimate.scatter[k] / estimate.counts


@compiled
def _at(past: Floats, row: int, delay: float) -> float:
    """Return what a row of a past was so many periods ago, between two of them."""
    oldest = past.shape[1] - 1
    back = max(0.0, min(delay, float(oldest)))
    newer = math.floor(back)
    older = min(newer + 1, oldest)
    value: float = past[row, newer] + (back - newer) * (past[row, older] - past[row, newer])
    return value


@compiled
def _correct(kalman: Record, off: float, variance: float, n_held: int) -> bool:
    """Update a FILTER with a scalar measurement, ``off`` from what was expected; return False for an outlier.

    The ``slopes`` are zero afterwards. The first ``n_held`` biases are not changed, now and at the start
    (Schmidt-Kalman).
    """
    state = kalman.state
    covariance = kalman.covariance
    slopes = kalman.slopes
    shares = kalman.shares
    expected = variance
    for i in range(_N):
        shares[i] = 0.0
        for j in range(_N):
            shares[i] += covariance[i, j] * slopes[j]
        expected += slopes[i] * shares[i]
    largest = _OUTLIER * math.sqrt(expected)
    pull = max(-largest, min(largest, off)) / expected
    for i in range(_N):
        slopes[i] = 0.0
        is_held = _is_bias(i, n_held)
        if not is_held:
            state[i] += shares[i] * pull
        for j in range(_N):
            if not (is_held and _is_bias(j, n_held)):
                covariance[i, j] -= shares[i] * shares[j] / expected
    return abs(off) <= largest


@compiled
def _is_bias(i: int, n: int) -> bool:
    """Return whether this is the index of one of the first ``n`` biases, now or at the start."""
    return _BIAS <= i < _BIAS + n or _FIRST <= i < _FIRST + n


@compiled
def _share_exact(estimate: Record) -> float:
    """Return how probable it is that localisations are exact: that they had no bias at the start, and have no noise.

    The filter assumes that they had a bias. The Savage-Dickey ratio compares that with none: how much more probable a
    bias of zero is by now than it was at first. Before anything was seen both are equally probable. Unless it is 0,
    writes the ``weights`` by which a bias changes what :func:`_change_without_bias` returns.
    """
    kalman = estimate.known
    factor = estimate.factor
    weights = estimate.weights
    covariance = kalman.covariance
    state = kalman.state
    # Cars whose wheels never quite rest, as on uneven floors, do not find out.
    if estimate.compared < _FEWEST:
        return 0.0
    variance = (estimate.differences[_X] + estimate.differences[_Y]) / estimate.compared
    log_ratio = -variance / (2 * _EXACT_M**2)
    # The Cholesky factor of the covariance of these biases, and the biases divided by it: forwards, then backwards.
    for k in range(3):
        for j in range(k + 1):
            remainder = covariance[_FIRST + k, _FIRST + j]
            for i in range(j):
                remainder -= factor[k, i] * factor[j, i]
            if j < k:
                factor[k, j] = remainder / factor[j, j]
            else:
                factor[k, k] = math.sqrt(max(_LEAST, remainder))
        weights[k] = state[_FIRST + k]
        for j in range(k):
            weights[k] -= factor[k, j] * weights[j]
        weights[k] /= factor[k, k]
        at_first = max(_LEAST, estimate.bias_variance[k])
        log_ratio += math.log(at_first) / 2 - math.log(factor[k, k]) - weights[k] ** 2 / 2
    for k in range(2, -1, -1):
        for j in range(k + 1, 3):
            weights[k] -= factor[j, k] * weights[j]
        weights[k] /= factor[k, k]
    return 1 / (1 + math.exp(min(-log_ratio, _MOST_LOG)))


@compiled
def _change_without_bias(estimate: Record, row: int) -> float:
    """Return by how much less a coordinate of the state would be if localisations had had no bias at the start."""
    change = 0.0
    for k in range(3):
        change += estimate.known.covariance[row, _FIRST + k] * estimate.weights[k]
    return change


@compiled
def _update_marker(reading: Record, kalman: Record, marker: Record, moved: Flags) -> None:
    """Correct a pose by the lines that are seen of the marker above.

    The marker's offset from the middle of its cell is estimated while it is seen: a car knows its position no better
    than the marker was placed, however often it looks; over several markers this averages out. ``moved`` says of each
    column of cells whether a car has set something down there: such a marker would feed a car's own error back. A car
    that passes from below one marker to the next uses the first until it has lost it.
    """
    if reading.board_m > _LOWERED_M:
        marker.raised = 1
        marker.seen = 0
        return
    x = reading.x
    y = reading.y
    if marker.raised:
        marker.raised = 0
        column_x = math.floor(x / CELL_PITCH_M)
        column_y = math.floor(y / CELL_PITCH_M)
        # A car that believes to be outside has no column.
        if 0 <= column_x < moved.shape[0] and 0 <= column_y < moved.shape[1]:
            moved[column_x, column_y] = True
    if abs(reading.pitch) > _LEVEL_RAD or abs(reading.roll) > _LEVEL_RAD:
        marker.seen = 0
        return
    c = math.cos(reading.heading)
    s = math.sin(reading.heading)
    state = kalman.state
    slopes = kalman.slopes
    covariance = kalman.covariance
    before = (state[0], state[1], state[2])
    is_seen = False
    for k in range(4):
        toward_x, toward_y = (c, s) if k < 2 else (-s, c)
        in_column_x = math.floor((x + marker.reach_m[k] * toward_x) / CELL_PITCH_M) == marker.x
        in_column_y = math.floor((y + marker.reach_m[k] * toward_y) / CELL_PITCH_M) == marker.y
        is_seen = is_seen or (in_column_x and in_column_y and math.isfinite(reading.lines[k]))
    if not is_seen:
        marker.seen = 0
    for k in range(4):
        if not math.isfinite(reading.lines[k]):
            continue
        # Sensors before and behind measure to the left, the others forward.
        toward_x, toward_y, axis_x, axis_y = (c, s, -s, c) if k < 2 else (-s, c, c, s)
        from_x = marker.reach_m[k] * toward_x
        from_y = marker.reach_m[k] * toward_y
        cell_x = math.floor((x + from_x) / CELL_PITCH_M)
        cell_y = math.floor((y + from_y) / CELL_PITCH_M)
        has_column = 0 <= cell_x < moved.shape[0] and 0 <= cell_y < moved.shape[1]
        if has_column and moved[cell_x, cell_y]:
            continue
        if not marker.seen:
            marker.seen = 1
            marker.x = cell_x
            marker.y = cell_y
            # It is another marker, which may stand anywhere, whatever is known of all else.
            for j in range(_MARKER, _SLIP):
                state[j] = 0.0
                for i in range(_N):
                    covariance[i, j] = covariance[j, i] = 0.0
                covariance[j, j] = marker.turned if j == _MARKER + 2 else marker.placed
        elif cell_x != marker.x or cell_y != marker.y:
            continue
        # From the middle of the cell to the sensor.
        at_x = x + from_x - (cell_x + 0.5) * CELL_PITCH_M
        at_y = y + from_y - (cell_y + 0.5) * CELL_PITCH_M
        along_x = abs(axis_x) > abs(axis_y)
        # By how much the place of the sensor, or of the line there, moves when the car or the marker turns.
        if along_x:
            row = 0
            to_axis = axis_x
            slopes[2] = from_y / to_axis
            slopes[_MARKER + 2] = -at_y / to_axis
            off = reading.lines[k] + at_x / to_axis
        else:
            row = 1
            to_axis = axis_y
            slopes[2] = -from_x / to_axis
            slopes[_MARKER + 2] = at_x / to_axis
            off = reading.lines[k] + at_y / to_axis
        slopes[row] = -1 / to_axis
        slopes[_MARKER + row] = 1 / to_axis
        for j in range(3):
            off -= slopes[j] * (state[j] - before[j]) + slopes[_MARKER + j] * state[_MARKER + j]
        _correct(kalman, off, marker.variance, 0)


@compiled
def lean_of(car: Record, incline_rad: float) -> tuple[float, float]:
    """Return how far a car leans up at its nose and to its left, in radians, against an incline or level ground.

    Pitch and roll are off by a constant, and floors lean to all sides, each about as much: so a mean over a way that
    counts as n places shows n parts of n + 1 of that constant.
    """
    floor = car.floor
    n_places = floor.way_m / _LEANS_ALIKE_M
    shown = n_places / (n_places + 1)
    trusted = (n_places + 1) / (n_places + 2)
    pitch = trusted * (car.now.pitch - incline_rad - shown * floor.pitch_on_way)
    roll = trusted * (car.now.roll - shown * floor.roll_on_way)
    return pitch, roll


@compiled
def update_floor(car: Record) -> bool:
    """Update the floor estimate of a car from its pitch and roll, and return True; False for a car on a slope.

    Pitch and roll are averaged over a while. The floor is uneven when their mean is significantly too large; the
    sensors' noise is taken from the scatter of the readings.
    """
    reading = car.now
    floor = car.floor
    task = car.task
    constants = car.known
    leans = max(abs(reading.pitch), abs(reading.roll)) > constants.hold.level
    if leans or (task.law == DRIVE and task.drive.sloping):
        return False
    wheels = reading.wheel_speeds
    rolled_m = (
        (abs(wheels[0]) + abs(wheels[1]) + abs(wheels[2]) + abs(wheels[3]))
        / 4
        * constants.car.radius_m
        * constants.period_s
    )
    floor.way_m += rolled_m
    if floor.way_m > 0:
        floor.pitch_on_way += rolled_m / floor.way_m * (reading.pitch - floor.pitch_on_way)
        floor.roll_on_way += rolled_m / floor.way_m * (reading.roll - floor.roll_on_way)
    floor.n_read += 1
    share = 1 / min(float(floor.n_read), max(1.0, constants.uneven.tilt_time / constants.period_s))
    pitch = reading.pitch - floor.pitch
    roll = reading.roll - floor.roll
    floor.pitch += share * pitch
    floor.roll += share * roll
    floor.variance += share * ((1 - share) * (pitch * pitch + roll * roll) - floor.variance)
    excess = math.hypot(floor.pitch, floor.roll) - constants.uneven.tilt
    # The mean of n readings has 1 / n of their variance, a fading one of shares s has s / (2 - s).
    error = math.sqrt(floor.variance * max(share / (2 - share), 1.0 / floor.n_read))
    if floor.n_read >= _FEWEST and excess > _SURE * error:
        floor.uneven = 1
    floor.suspected = excess > 0 and not floor.uneven
    return True
