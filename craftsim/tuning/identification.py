"""Identifying a car's parameters from a log: weighted nonlinear least squares over segments of it.

Residuals are in terms of the noise of their channel, which is worked out anew after each fit; outliers are left out.
Intervals are of the linearized problem with segments as independent samples (Liang and Zeger's sandwich estimate),
never narrower than of independent residuals, where what is held may be off as its prior says.

A direction of the unknowns, each in terms of its common error, with the singular value s of the residuals' Jacobian is
known to 1 / s. Motion says forces only in proportion to masses: contacts and dry friction of a simulation have a
stiffness that would tell a little more, so that this direction is taken out of the Jacobian, and the unknown in it that
is easiest to measure otherwise is held. All others are fitted together, also those that the log hardly tells: a wide
prior keeps these near what is assumed, and what they may be off is in the intervals of the rest.

A Jacobian is of one place. A torque limit that the assumed car never reaches has no effect there, while the true car
may reach its own in every start. So what has no effect where a fit has ended is tried over its whole range, the others
fitted anew with each value of it; the search goes on from what fits best, and where nothing fits better, the range that
fits as well is reported.

What is left after the fit is compared with the noise of the measurements, by their differences from row to row, in
which a smooth motion cancels. Intervals say how far noise may have moved the estimates: of a model that cannot follow
the log they say nothing, and the report says so.

``mujoco.sysid`` compares one rollout with all of a recording from a given state, and has intervals of independent
residuals only.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from craftsim.compiled.arrays import Floats
from craftsim.errors import InputError
from craftsim.mjcf.machines import Machines
from craftsim.robots.log import Log
from craftsim.tuning.least_squares import huber, minimize_huber
from craftsim.tuning.prediction import (
    N_COLUMNS,
    SIGNALS,
    Predictor,
    Unknown,
    machines_of,
    unknowns_of,
)

_ROUNDS: Final = ((8, 1e-2), (5, 1e-3), (5, 1e-4))
"""Fits, each with the noise that the one before has left: most Jacobians, and the share of its cost by which a last
step lowers it."""
_NOISE: Final = {
    "position": (0.003, 1e-4),
    "heading": (0.006, 1e-4),
    "wheel speeds": (0.2, 0.05),
    "board": (2e-4, 2e-6),
    "board force": (0.5, 0.02),
}
"""Noise with which the first fit begins, and what no model is better than, by channel."""
_OUTLIER: Final = 6.0
_CONFIDENCE: Final = 0.95

_UNKNOWN: Final = 1.0
"""A direction counts as unidentified where it is known to this share of its common error, or worse."""
_SURE: Final = 0.5
"""An unknown counts as identified where half its interval is this share of its common error, or less."""
_MEMBER: Final = 0.2
"""Share of a direction's largest part that another part must have to be named with it."""
_PRIOR: Final = 3.0
"""Standard deviation of an unknown around its start, in its common errors: a figure that is 2.5 times too large or too
small is within."""
_NO_EFFECT: Final = 0.7
"""What the log leaves of a prior's standard deviation where it does not tell an unknown at all."""
_HARDLY: Final = 1.0
"""To how many of its common errors the log tells a limit that hardly acts: its effect is of one side."""
MISFIT: Final = 1.3
"""What is left after a fit is more than noise where it is so many times the noise of the measurements."""
_STIFFEST: Final = 1.6
"""Share of its difference from the command by which a wheel's speed changes in a step of the physics, at most."""
_GRID: Final = 1.2
"""Factor between the values of a figure that are tried over its range."""
_EFFECT: Final = 2.0
"""Change of the cost, which is half a sum of squares in terms of the noise, that says something: two deviations."""
_WORSE: Final = 10.0
"""Rise of the cost above the best beyond which values further out are not tried..."""
_WORSE_SHARE: Final = 0.1
"""...or this share of the best."""


@dataclass(frozen=True)
class Unidentified:
    """A direction of the unknowns that a log does not tell."""

    held_key: str
    """The key of the unknown in it that is easiest to measure otherwise."""
    members: tuple[str, ...]
    """Keys of all that take part in it, the largest part first."""
    text: str
    of_scale: bool = False
    """Whether it is that of all forces and masses in proportion, which no motion tells."""


def unidentified_directions(jacobian: Floats, unknowns: Sequence[Unknown]) -> list[Unidentified]:
    """Return what a log does not tell, worst first.

    ``jacobian`` (m, n) is of the residuals in terms of their noise, by unknowns in terms of their common errors.
    """
    scale = np.array([1 / unknown.usual if unknown.scales else 0.0 for unknown in unknowns])
    free = list(range(len(unknowns)))
    untold: list[Unidentified] = []
    while free:
        columns = jacobian[:, free]
        of_scale = scale.any() and all(k in free for k in np.flatnonzero(scale))
        if of_scale:
            unit = scale[free] / np.linalg.norm(scale)
            columns = columns - np.outer(columns @ unit, unit)
        _, singular, directions = np.linalg.svd(columns, full_matrices=False)
        if singular[-1] * _UNKNOWN > 1:
            break
        direction = np.abs(directions[-1])
        members = [
            free[k] for k in np.argsort(-direction) if direction[k] > _MEMBER * direction.max()
        ]
        # The largest part first where none is easier to measure.
        easiest = max(members, key=lambda k: unknowns[k].weighed)
        *first_words, last = (unknowns[k].words for k in members)
        if first_words:
            ratio = all(unknowns[k].of_machine for k in members)
            if ratio:
                known_part = "only as ratios to each other"
            else:
                known_part = "only together"
            text = f"{', '.join(first_words)} and {last}: {known_part}"
        else:
            text = f"{last}: the log does not tell it"
        keys = tuple(unknowns[k].key for k in members)
        # Of several equal directions the decomposition may mix others into that of the scale.
        of_scale = bool(
            of_scale and unknowns[easiest].weighed == max(unknown.weighed for unknown in unknowns)
        )
        if of_scale:
            text += f"; {unknowns[easiest].words} is held"
        untold.append(Unidentified(unknowns[easiest].key, keys, text, of_scale))
        free.remove(easiest)
    return untold


@dataclass(frozen=True)
class Identified:
    """What a log says of one unknown."""

    unknown: Unknown
    start: float
    value: float
    half_width: float | None
    """Of its interval of 95 %; None where the log does not tell it."""
    at_bound: bool = False
    """Whether the search ended at the border of what fits together."""
    range: tuple[float, float] | None = None
    """Of a machine's parameter that the log does not tell: between which values it may be anywhere, the others fitted
    to each, as far as it was sought."""

    @property
    def identified(self) -> bool:
        """Whether the log identifies it: its interval is narrow, and not at the border of the search."""
        if self.half_width is None or self.at_bound:
            return False
        scale = 1.0
        if self.unknown.of_machine:
            scale = self.value
        return self.half_width <= _SURE * self.unknown.usual * scale

    @property
    def moved(self) -> bool:
        """Whether it was fitted, identified or not, or is not what was assumed."""
        return self.half_width is not None or self.value != self.start


Tell = Callable[[str, int], None]
"""Called with what is done now, and how often the log has been predicted."""


def _silent(stage: str, predictions: int) -> None:
    pass


def identify(
    log: Log, machines: Machines, loaded: bool = False, tell: Tell = _silent
) -> Identification:
    """Identify one car from its log. Raises InputError for a log that says nothing of a car.

    Args:
        log: of one car.
        machines: what is assumed: the start of the search, and what is held; its drive is that of the simulation.
        loaded: a block stood over the car at the start, and was lifted.
        tell: is called after each prediction of the log, with what is done now and how many there were.
    """
    predictor = Predictor(log, machines, loaded)
    if not predictor.segments:
        raise InputError("the car leans all the time; identification needs a level floor")
    if not (log.commands[:, :4] != 0).any():
        raise InputError(
            "no wheel is ever commanded in this log; 'craftsim robot excite' makes a drive that tells much"
        )
    return Identification(predictor, machines, unknowns_of(loaded), tell)


def _most_deviation(unknown: Unknown) -> float:
    """Return to how many of its common errors the log tells an unknown that has an effect, at least."""
    if unknown.limits_motion:
        return _HARDLY
    return _NO_EFFECT * _PRIOR


class Identification:
    """What a log says of a car, by fits of vectors: the unknowns less their starts, in terms of common errors."""

    def __init__(
        self,
        predictor: Predictor,
        machines: Machines,
        unknowns: Sequence[Unknown],
        tell: Tell = _silent,
    ) -> None:
        self._predictor = predictor
        self._assumed = machines
        self._unknowns = unknowns
        self._tell = tell
        self._stage = "first look"
        self._derivatives: dict[int, Floats] = {}
        """By column, of the errors at one vector."""
        self._derived_at = b""
        self._starts = [unknown.start(machines) for unknown in unknowns]
        self._low, self._high = np.array([*map(Unknown.bounds, unknowns, self._starts)]).T
        self._vector = np.zeros(len(unknowns))
        self.measured_noise = predictor.measured_noise(
            {name: floor for name, (_, floor) in _NOISE.items()}
        )
        """Standard deviation of what is measured, by its differences from row to row, by channel."""
        self._noise = np.empty(N_COLUMNS)
        for name, (_, columns) in SIGNALS.items():
            self._noise[columns] = _NOISE[name][0]
        self._known = np.isfinite(self._errors(self._vector))
        self._kept = self._known
        """Which values count."""
        self._fit()
        self.values = self._values(self._vector)
        """Of all unknowns, by key."""
        self.machines = machines_of(machines, self.values)
        """With what was found."""
        self.outliers = int(self._known.sum() - self._kept.sum())
        """Values that were left out."""
        measured = []
        for name, (_, columns) in SIGNALS.items():
            if self._kept[..., columns].any():
                measured.append((name, columns))
        self.noise = {name: float(self._noise[columns][0]) for name, columns in measured}
        """Standard deviation of what is left, by channel that was measured."""
        self.misfit = {
            name: residual / self.measured_noise[name] for name, residual in self.noise.items()
        }
        """The same, as a factor of the noise of the measurements."""
        self.n_values = int(self._kept.sum())
        numbers = np.arange(len(self._kept))[:, None, None]
        self._segment = np.broadcast_to(numbers, self._kept.shape)[self._kept]
        self.n_segments = len(np.unique(self._segment))
        self._stage = "intervals"
        self.estimates = self._estimates()

    def __getitem__(self, key: str) -> Identified:
        return next(estimate for estimate in self.estimates if estimate.unknown.key == key)

    @property
    def predictions(self) -> int:
        """How often a car was simulated through the log."""
        return self._predictor.predictions

    @property
    def fits(self) -> bool:
        """Whether what is left is no more than the noise of the measurements."""
        return max(self.misfit.values(), default=0.0) <= MISFIT

    def _fit(self) -> None:
        """Find the vector, what is free in it, and what the log does not tell."""
        self._ranges: dict[int, tuple[float, float]] = {}
        """By column, of values that fit as well, as vectors count."""
        self._as_good: dict[int, list[Floats]] = {}
        """Vectors that fit as well, by the column whose values were tried."""
        self._judge()
        if not self._free:
            return
        self._fit_in_rounds("fit", _ROUNDS)
        before = self._vector
        noise = self._noise.copy()
        weighed = self._kept
        if self._search():
            self._fit_in_rounds("fit from there", _ROUNDS[1:])
            after = self._vector
            self._noise = noise
            self._kept = weighed
            if self._cost(before) < self._cost(after):
                self._vector = before
            self._weigh()
        self._hold_untold()
        untold = self._without_effect()
        self._ranges = {column: ends for column, ends in self._ranges.items() if column in untold}
        self._as_good = {column: self._as_good[column] for column in self._ranges}
        self._stage = "intervals"
        self._judge()

    def _fit_in_rounds(self, stage: str, rounds: Sequence[tuple[int, float]]) -> None:
        """Fit what is free, each time with the noise that the fit before has left."""
        for number, (most_steps, tolerance) in enumerate(rounds):
            self._stage = f"{stage}, {number + 1} of {len(rounds)}"
            self._vector = self._fitted(self._vector, self._free, most_steps, tolerance)
            self._weigh()

    def _search(self) -> bool:
        """Try other values of what has no effect, and of limits where the fit leaves more than noise.

        Returns whether one is better: then the search has gone there.
        """
        columns = self._without_effect()
        if not self._explained():
            columns += [
                k for k in self._free if self._unknowns[k].limits_motion and k not in columns
            ]
        moved = False
        # Twice, since what was found before a move does not hold at the place to which it led.
        for _ in range(2):
            for column in columns:
                if column not in self._ranges and self._go_to_best(column):
                    moved = True
                    self._weigh()
                    self._ranges.clear()
                    self._as_good.clear()
        return moved

    def _hold_untold(self) -> None:
        """Put what the log does not tell where it is assumed to be, the others fitted anew, where that fits as well.

        Then others may turn out to have no effect, which have one at their fitted values.
        """
        tried: list[int] = []
        for _ in self._unknowns:
            untold = [column for column in self._without_effect() if column not in tried]
            if not untold:
                return
            tried += untold
            for column in untold:
                if column not in self._ranges:
                    self._go_to_best(column)
            to_hold = []
            for column in untold:
                low, high = self._ranges.get(column, (np.inf, np.inf))
                if low <= 0.0 <= high:
                    to_hold.append(column)
            if not to_hold:
                continue
            moved = self._vector.copy()
            moved[to_hold] = 0.0
            free_columns = [column for column in self._free if column not in tried]
            slopes = None
            if self._explained():
                slopes = self._jacobian(self._vector, free_columns)
            vector = self._fitted(moved, free_columns, 8, 1e-3, slopes)
            if self._cost(vector) <= self._cost(self._vector) + _EFFECT * len(to_hold):
                self._vector = vector

    def _judge(self) -> None:
        """Find what the log does not tell at the present vector; the scale of forces and masses is held."""
        everything = range(len(self._unknowns))
        self.unidentified = unidentified_directions(
            self._jacobian(self._vector, everything), self._unknowns
        )
        held_keys = {direction.held_key for direction in self.unidentified if direction.of_scale}
        self._free = [k for k in everything if self._unknowns[k].key not in held_keys]

    def _deviations(self) -> Floats:
        """Return the standard deviations of what is free, by unit noise and the prior alone."""
        jacobian = self._jacobian(self._vector, self._free)
        information = jacobian.T @ jacobian + np.eye(len(self._free)) / _PRIOR**2
        deviations: Floats = np.sqrt(np.diag(np.linalg.inv(information)))
        return deviations

    def _without_effect(self) -> list[int]:
        """Return the figures of machines that have no effect where the fit has ended."""
        pairs = zip(self._free, self._deviations(), strict=True)
        silent = [k for k, deviation in pairs if deviation > _most_deviation(self._unknowns[k])]
        return [k for k in silent if self._unknowns[k].of_machine]

    def _explained(self) -> bool:
        """Return whether the fit leaves no more than noise."""
        return max(self._left().values(), default=0.0) <= MISFIT

    def _go_to_best(self, column: int) -> bool:
        """Fit the others with values of an unknown over its whole range; move to the best, if it is better.

        Returns whether it is; if not the range of values that fit as well is kept.
        """
        self._stage = f"other values of the {self._unknowns[column].words}"
        free_columns = [k for k in self._free if k != column]
        start_cost = self._cost(self._vector)
        # Where the fit explains the log, little changes, and the Jacobian is that of the fit.
        slopes = None
        if self._explained():
            slopes = self._jacobian(self._vector, free_columns)
        best = self._vector
        best_cost = start_cost
        ends = [self._low[column], self._high[column]]
        as_good: list[Floats] = []
        for number, side in enumerate((-1, 1)):
            vector = self._vector
            ended = False
            for value in self._from_edge(column, side):
                moved = vector.copy()
                moved[column] = value
                if slopes is None:
                    vector = self._fitted(moved, free_columns, 3, 1e-2)
                else:
                    vector = self._fitted(moved, free_columns, 8, 1e-3, slopes)
                cost = self._cost(vector)
                if cost <= start_cost + _EFFECT:
                    as_good.append(vector)
                if cost > start_cost + _EFFECT and not ended:
                    ends[number] = value
                    ended = True
                if cost < best_cost:
                    best = vector
                    best_cost = cost
                if cost > best_cost + max(_WORSE, _WORSE_SHARE * best_cost):
                    break
        if best_cost < start_cost - _EFFECT:
            self._vector = best
            return True
        self._ranges[column] = (ends[0], ends[1])
        self._as_good[column] = as_good
        return False

    def _from_edge(self, column: int, side: int) -> Floats:
        """Return a grid of values of an unknown on one side, from the first with which the log is predicted otherwise.

        Empty where there is no such value within the bounds. An effect that has begun is taken to last.
        """
        unknown = self._unknowns[column]
        step = side * np.log(_GRID) / unknown.usual
        if side < 0:
            end = self._low[column]
        else:
            end = self._high[column]
        n_steps = int((end - self._vector[column]) / step + 1e-9)
        before = self._residuals(self._vector)

        def has_effect(n: int) -> bool:
            vector = self._vector.copy()
            vector[column] += n * step
            change = self._residuals(vector) - before
            return float(change @ change) / 2 > _EFFECT

        if n_steps < 1 or not has_effect(n_steps):
            return np.zeros(0)
        without = 0
        with_effect = n_steps
        while with_effect - without > 1:
            middle = (without + with_effect) // 2
            if has_effect(middle):
                with_effect = middle
            else:
                without = middle
        return self._vector[column] + step * np.arange(with_effect, n_steps + 1)

    def _fitted(
        self,
        start: Floats,
        free: Sequence[int],
        most_steps: int,
        tolerance: float,
        slopes: Floats | None = None,
    ) -> Floats:
        """Return a vector with what is free fitted; ``slopes`` stand for the Jacobian everywhere."""

        def whole(numbers: Floats) -> Floats:
            vector = start.copy()
            vector[list(free)] = numbers
            return vector

        minimum = minimize_huber(
            lambda numbers: self._residuals(whole(numbers)),
            lambda numbers: self._jacobian(whole(numbers), free) if slopes is None else slopes,
            start[list(free)],
            (self._low[list(free)], self._high[list(free)]),
            lambda numbers: (
                self._stiffness(whole(numbers)) <= max(_STIFFEST, self._stiffness(start))
            ),
            _PRIOR,
            most_steps,
            tolerance,
        )
        return whole(minimum.point)

    def _stiffness(self, vector: Floats) -> float:
        """Return by what share of its difference from the command a wheel's speed changes in a step of the physics.

        The servo acts on its motor's inertia and on a quarter of the car. From 2 on it rings: a search that goes there
        stays there.
        """
        car = machines_of(self._assumed, self._values(vector)).car(0)
        inertia = car.wheel_armature_kgm2 + car.mass_kg * car.wheel_radius_m**2 / 4
        return car.wheel_gain_nms_rad * self._predictor.timestep_s / inertia

    def _values(self, vector: Floats) -> dict[str, float]:
        values = map(Unknown.value, self._unknowns, self._starts, vector.tolist())
        return {unknown.key: value for unknown, value in zip(self._unknowns, values, strict=True)}

    def _errors(self, vector: Floats) -> Floats:
        values = self._values(vector)
        errors = self._predictor.errors(machines_of(self._assumed, values), values)
        self._tell(self._stage, self._predictor.predictions)
        return errors

    def _residuals(self, vector: Floats) -> Floats:
        residuals: Floats = (self._errors(vector) / self._noise)[self._kept]
        return residuals

    def _cost(self, vector: Floats) -> float:
        return huber(self._residuals(vector))

    def _jacobian(self, vector: Floats, columns: Sequence[int]) -> Floats:
        if vector.tobytes() != self._derived_at:
            self._derivatives = {}
            self._derived_at = vector.tobytes()
        missing = [column for column in columns if column not in self._derivatives]
        if missing:
            base = self._errors(vector)
            for column in missing:
                moved = vector.copy()
                step = self._unknowns[column].step
                if vector[column] + step > self._high[column]:
                    step = -step
                moved[column] += step
                self._derivatives[column] = (self._errors(moved) - base) / step
        jacobian = np.empty((int(self._kept.sum()), len(columns)))
        for place, column in enumerate(columns):
            jacobian[:, place] = (self._derivatives[column] / self._noise)[self._kept]
        return jacobian

    def _left(self) -> dict[str, float]:
        """Return what is left after a fit by channel, as a factor of the noise of the measurements."""
        return {
            name: float(self._noise[columns][0]) / self.measured_noise[name]
            for name, (_, columns) in SIGNALS.items()
            if self._kept[..., columns].any()
        }

    def _weigh(self) -> None:
        """Take each channel's noise from what is left, and leave out what is far beyond it."""
        errors = self._errors(self._vector)
        for name, (_, columns) in SIGNALS.items():
            residuals = errors[..., columns][self._known[..., columns]]
            if residuals.size:
                floor = _NOISE[name][1]
                spread = 1.4826 * float(np.median(np.abs(residuals)))
                inside = residuals[np.abs(residuals) < _OUTLIER * max(spread, floor)]
                self._noise[columns] = max(float(inside.std()), floor)
        self._kept = self._known & (np.abs(errors) < _OUTLIER * self._noise)

    def _estimates(self) -> list[Identified]:
        from scipy.stats import t

        starts = zip(self._unknowns, self._starts, strict=True)
        estimates = [
            Identified(unknown, start, self.values[unknown.key], None) for unknown, start in starts
        ]
        free = self._free
        if not free:
            return estimates
        jacobian = self._jacobian(self._vector, free)
        residuals = self._residuals(self._vector)
        inverse = np.linalg.inv(jacobian.T @ jacobian + np.eye(len(free)) / _PRIOR**2)
        independent = inverse * max(
            1.0, float(residuals @ residuals) / max(1, len(residuals) - len(free))
        )
        pulls = np.zeros((len(self._kept), len(free)))
        np.add.at(pulls, self._segment, jacobian * residuals[:, None])
        share = self.n_segments / max(1, self.n_segments - 1)
        sandwich = inverse @ (pulls.T @ pulls * share) @ inverse
        deviations = np.sqrt(np.maximum(np.diag(independent), np.diag(sandwich)))
        widths = deviations * float(t.ppf(0.5 + _CONFIDENCE / 2, max(1, self.n_segments - 1)))
        for vectors in self._as_good.values():
            # Other values of what the log does not tell fit as well, with other values of the rest.
            if vectors:
                away = np.abs(np.array(vectors) - self._vector).max(axis=0)
                widths = widths + away[free]
        for k, deviation, width in zip(free, self._deviations(), widths, strict=True):
            unknown = self._unknowns[k]
            if k in self._ranges or deviation > _most_deviation(unknown):
                continue
            scale = 1.0
            if unknown.of_machine:
                scale = estimates[k].value
            edge = not self._low[k] + 1e-3 < self._vector[k] < self._high[k] - 1e-3
            half = float(width) * unknown.usual * scale
            estimates[k] = replace(estimates[k], half_width=half, at_bound=edge)
        for k, (low, high) in self._ranges.items():
            unknown = self._unknowns[k]
            ends = unknown.value(self._starts[k], low), unknown.value(self._starts[k], high)
            estimates[k] = replace(estimates[k], range=ends)
        return estimates
