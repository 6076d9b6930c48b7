"""Identifying a car's parameters from a log: weighted nonlinear least squares over segments of it.

Residuals are in terms of the noise of their channel, which is worked out anew after each fit; outliers are left out.
Intervals are of the linearized problem with segments as independent samples (Liang and Zeger's sandwich estimate),
never narrower than of independent residuals with forces as assumed, where what is held may be off by its common error.

A direction of the unknowns, each in terms of its common error, with the singular value s of the residuals' Jacobian is
known to 1 / s. Where this is not well below 1 the unknown in it that is easiest to measure otherwise is held at its
start. Motion says forces only in proportion to masses: contacts and dry friction of a simulation have a stiffness that
would tell a little more, so that this direction is taken out of the Jacobian.

``mujoco.sysid`` compares one rollout with all of a recording from a given state, and has intervals of independent
residuals only.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from craftsim.errors import InputError
from craftsim.logs.log import Floats, Log
from craftsim.mjcf.parameters import Machines
from craftsim.tuning.prediction import CHANNELS, N_COLUMNS, Predictor, Unknown, machines_of, unknowns_of

_ROUNDS: Final = (1e-2, 1e-3, 1e-5)
"""Fits, each with the noise that the one before has left: the share of its cost by which a last step lowers it."""
_EVALUATIONS: Final = 10
"""Of the residuals in a fit, at most."""
_NOISE: Final = {
    "position": (0.003, 1e-4),
    "heading": (0.006, 1e-4),
    "wheel speeds": (0.2, 0.05),
    "board": (2e-4, 2e-6),
    "board force": (0.5, 0.02),
}
"""Noise with which the first fit begins, and what no model is better than, by channel."""
_OUTLIER: Final = 6.0
CONFIDENCE: Final = 0.95


IDENTIFIED: Final = 0.1
"""A direction counts as identified where it is known to this share of its common error, or better."""
_MEMBER: Final = 0.2
"""Share of a direction's largest part that another part must have to be named with it."""


@dataclass(frozen=True)
class Unidentified:
    """A direction of the unknowns that a log does not tell."""

    held: str
    """The key of the unknown that is held because of it."""
    members: tuple[str, ...]
    """Keys of all that take part in it, the largest part first."""
    text: str


def unidentified_directions(jacobian: Floats, unknowns: Sequence[Unknown]) -> list[Unidentified]:
    """Return what a log does not tell, worst first.

    ``jacobian`` (m, n) is of the residuals in terms of their noise, by unknowns in terms of their common errors.
    """
    scale = np.array([1 / one.usual if one.scales else 0.0 for one in unknowns])
    free, found = list(range(len(unknowns))), list[Unidentified]()
    while free:
        seen = jacobian[:, free]
        if all(k in free for k in np.flatnonzero(scale)) and scale.any():
            unit = scale[free] / np.linalg.norm(scale)
            seen = seen - np.outer(seen @ unit, unit)
        _, singular, directions = np.linalg.svd(seen, full_matrices=False)
        if singular[-1] * IDENTIFIED >= 1:
            break
        direction = np.abs(directions[-1])
        members = [free[k] for k in np.argsort(-direction) if direction[k] > _MEMBER * direction.max()]
        # The largest part first where none is easier to measure.
        held = max(members, key=lambda k: unknowns[k].weighed)
        *first, last = (unknowns[k].words for k in members)
        ratio = all(unknowns[k].of_machine for k in members)
        what = "only as ratios to each other" if ratio else "only together"
        text = f"{', '.join(first)} and {last}: {what}; {unknowns[held].words} is held"
        if not first:
            text = f"{last}: the log does not tell it; it is held"
        keys = tuple(unknowns[k].key for k in members)
        found.append(Unidentified(unknowns[held].key, keys, text))
        free.remove(held)
    return found


@dataclass(frozen=True)
class Identified:
    """What a log says of one unknown."""

    unknown: Unknown
    start: float
    value: float
    half_width: float | None
    """Of its interval of 95 %; None where it is held at its start."""
    at_bound: bool = False
    """Whether the search ended at the border of what fits together."""

    @property
    def identified(self) -> bool:
        """Whether the log identifies it."""
        return self.half_width is not None and not self.at_bound


Tell = Callable[[int, int], None]


def identify(
    log: Log, machines: Machines, loaded: bool = False, tell: Tell = lambda number, total: None
) -> Identification:
    """Identify one car from its log. Raises InputError for a log that says nothing of a car.

    Args:
        log: of one car.
        machines: what is assumed: the start of the search, and what is held; its drive is that of the simulation.
        loaded: a block stood over the car at the start, and was lifted.
        tell: is called as each fit begins, with its number and how many there are.
    """
    predictor = Predictor(log, machines, loaded)
    if not predictor.segments:
        raise InputError("the car leans all the time; identification needs a level floor")
    if not (log.commands[:, :4] != 0).any():
        raise InputError(
            "no wheel is ever commanded in this log; 'craftsim robot excite' makes a drive that tells much"
        )
    return Identification(predictor, machines, unknowns_of(machines, loaded), tell)


class Identification:
    """What a log says of a car, by fits of vectors: the unknowns less their starts, in terms of common errors."""

    def __init__(
        self, predictor: Predictor, machines: Machines, unknowns: Sequence[Unknown], tell: Tell
    ) -> None:
        self._predictor, self._assumed, self._unknowns = predictor, machines, unknowns
        self._starts = [one.start(machines) for one in unknowns]
        self._low, self._high = np.array([*map(Unknown.bounds, unknowns, self._starts)]).T
        self._vector = np.zeros(len(unknowns))
        self._noise = np.empty(N_COLUMNS)
        for name, (_, columns) in CHANNELS.items():
            self._noise[columns] = _NOISE[name][0]
        self._kept = np.isfinite(self._errors(self._vector))
        """Which values count."""
        self.outliers = 0
        """Values that were left out."""
        for number, tolerance in enumerate(_ROUNDS):
            tell(number + 1, len(_ROUNDS))
            looked_at = self._jacobian(self._with_assumed_forces(), range(len(unknowns)))
            self.unidentified = unidentified_directions(looked_at, unknowns)
            held = {one.held for one in self.unidentified}
            # What is held is held where it is assumed to be, wherever an earlier fit has taken it.
            self._vector[[k for k, one in enumerate(unknowns) if one.key in held]] = 0.0
            free = [k for k, one in enumerate(unknowns) if one.key not in held]
            if not free:
                break
            self._vector[free] = self._fitted(free, tolerance)
            self.outliers += self._weigh()
        self.values = self._values(self._vector)
        """Of all unknowns, by key."""
        self.machines = machines_of(machines, self.values)
        """With what was found."""
        of_channels = ((name, columns) for name, (_, columns) in CHANNELS.items())
        seen = ((name, columns) for name, columns in of_channels if self._kept[..., columns].any())
        self.noise = {name: float(self._noise[columns][0]) for name, columns in seen}
        """Standard deviation of what is left, by channel that was measured."""
        self.n_values = int(self._kept.sum())
        self._segment = np.broadcast_to(np.arange(len(self._kept))[:, None, None], self._kept.shape)[
            self._kept
        ]
        self.n_segments = len(np.unique(self._segment))
        self.estimates = self._estimates(free)

    def __getitem__(self, key: str) -> Identified:
        return next(one for one in self.estimates if one.unknown.key == key)

    def _fitted(self, free: list[int], tolerance: float) -> Floats:
        from scipy.optimize import least_squares

        low, high, vector = self._low[free], self._high[free], self._vector.copy()

        def put(numbers: Floats) -> Floats:
            vector[free] = numbers
            return vector

        fitted: Floats = least_squares(
            lambda numbers: self._residuals(put(numbers)),
            np.clip(self._vector[free], low + 1e-6, high - 1e-6),
            jac=lambda numbers: self._jacobian(put(numbers), free),
            bounds=(low, high),
            loss="huber",
            f_scale=3.0,
            x_scale="jac",
            max_nfev=_EVALUATIONS,
            xtol=1e-6,
            ftol=tolerance,
        ).x
        return fitted

    def _with_assumed_forces(self) -> Floats:
        """Return where to look at what is identified: forces as assumed, all else as found.

        Where a search has gone astray, to servos so stiff that they ring, everything seems to be identified.
        """
        vector = self._vector.copy()
        vector[[one.scales for one in self._unknowns]] = 0.0
        return vector

    def _values(self, vector: Floats) -> dict[str, float]:
        values = map(Unknown.value, self._unknowns, self._starts, vector.tolist())
        return {one.key: value for one, value in zip(self._unknowns, values, strict=True)}

    def _errors(self, vector: Floats) -> Floats:
        values = self._values(vector)
        return self._predictor.errors(machines_of(self._assumed, values), values)

    def _residuals(self, vector: Floats) -> Floats:
        found: Floats = (self._errors(vector) / self._noise)[self._kept]
        return found

    def _jacobian(self, vector: Floats, columns: Sequence[int]) -> Floats:
        base = self._residuals(vector)
        found = np.empty((len(base), len(columns)))
        for place, column in enumerate(columns):
            moved, step = vector.copy(), self._unknowns[column].step
            if vector[column] + step > self._high[column]:
                step = -step
            moved[column] += step
            found[:, place] = (self._residuals(moved) - base) / step
        return found

    def _weigh(self) -> int:
        """Take each channel's noise from what is left, and leave out what is far beyond it; return how many."""
        errors = self._errors(self._vector)
        was = int(self._kept.sum())
        for name, (_, columns) in CHANNELS.items():
            left = errors[..., columns][self._kept[..., columns]]
            if left.size:
                spread, least = 1.4826 * float(np.median(np.abs(left))), _NOISE[name][1]
                inside = left[np.abs(left) < _OUTLIER * max(spread, least)]
                self._noise[columns] = max(float(inside.std()), least)
        self._kept &= np.abs(errors) < _OUTLIER * self._noise
        return was - int(self._kept.sum())

    def _estimates(self, free: list[int]) -> list[Identified]:
        from scipy.stats import t

        n_segments = self.n_segments
        jacobian, left = self._jacobian(self._vector, free), self._residuals(self._vector)
        inverse = np.linalg.inv(jacobian.T @ jacobian)
        independent = inverse * (left @ left) / max(1, len(left) - len(free))
        pulls = np.zeros((len(self._kept), len(free)))
        np.add.at(pulls, self._segment, jacobian * left[:, None])
        sandwich = inverse @ (pulls.T @ pulls) @ inverse * n_segments / max(1, n_segments - 1)
        # What is held may be off by its common error, except for forces: the rest is known in proportion to those.
        unsure = [k for k, one in enumerate(self._unknowns) if k not in free and not one.scales]
        elsewhere = self._jacobian(self._with_assumed_forces(), [*free, *unsure])
        known = np.linalg.inv(elsewhere.T @ elsewhere + np.eye(elsewhere.shape[1]))[: len(free), : len(free)]
        spread = np.sqrt(np.max([np.diag(independent), np.diag(sandwich), np.diag(known)], axis=0))
        wide = dict(zip(free, spread * t.ppf(0.5 + CONFIDENCE / 2, max(1, n_segments - 1)), strict=True))
        starts = zip(self._unknowns, self._starts, strict=True)
        estimates = [Identified(one, start, self.values[one.key], None) for one, start in starts]
        for k, width in wide.items():
            one, value = self._unknowns[k], estimates[k].value
            half = float(width * one.usual * (value if one.of_machine else 1.0))
            edge = not self._low[k] + 1e-3 < self._vector[k] < self._high[k] - 1e-3
            estimates[k] = replace(estimates[k], half_width=half, at_bound=edge)
        return estimates
