"""The goal of a tuning: a weighted product of objectives, or a Pareto front of several and the choice on it.

All objectives are costs above 0, and ratios of them are what counts: their logarithms are added, each with its weight,
so that no scale has to be chosen. A failed action raises all of them.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal, cast

import numpy as np
from numpy.typing import NDArray

from craftsim.errors import InputError, suggestion

TuningObjective = Literal["time", "error", "margin", "energy", "force"]
OBJECTIVES: Final[Mapping[TuningObjective, str]] = {
    "time": "duration in s, geometric mean",
    "error": "largest own error at the end, share of its limit, mean",
    "margin": "share of a limit that the worst trial took",
    "energy": "work of the motors in J, geometric mean",
    "force": "peak force between two machines in N, geometric mean",
}
"""What each is, over all trials; what the worst trial left of the limit is the margin."""

DEFAULT_WEIGHTS: Final[Mapping[TuningObjective, float]] = {"time": 1.0, "error": 0.2, "margin": 0.2}
_FAILURE_COST: Final = 25.0
"""A share of failed actions costs all objectives its exponential: one in 100 a factor of 1.28."""
LEAST_SHARE: Final = 0.05
"""Of a limit: an error below it counts as this, for nothing is won by making it smaller."""
_LEAST: Final = 1e-3
"""Seconds, joules and newtons."""


@dataclass(frozen=True)
class TuningScore:
    """How gains did over some trials."""

    trials: int
    failed: int
    values: Mapping[TuningObjective, float]

    @classmethod
    def of(cls, trials: Iterable[Mapping[str, Any]]) -> TuningScore:
        """Return the score of trials, as records hold them."""
        records = list(trials)
        values: dict[TuningObjective, float] = {
            "time": _mean_ratio(trial["duration_s"] for trial in records),
            "error": max(
                LEAST_SHARE, sum(trial["error_share"] for trial in records) / len(records)
            ),
            "margin": max(LEAST_SHARE, *(trial["used_share"] for trial in records)),
            "energy": _mean_ratio(trial["energy_j"] for trial in records),
            "force": _mean_ratio(trial["peak_force_n"] for trial in records),
        }
        return cls(len(records), sum(not trial["agrees"] for trial in records), values)

    @property
    def margin_left(self) -> float:
        """Share of the limit that is left at the worst trial; negative beyond it."""
        return 1 - self.values["margin"]

    def log_costs(self, objectives: Sequence[TuningObjective]) -> NDArray[np.float64]:
        """Return the logarithms of the objectives, failures included, (n,)."""
        logs = np.array([math.log(self.values[name]) for name in objectives])
        return logs + _FAILURE_COST * self.failed / self.trials

    def log_cost(self, weights: Mapping[TuningObjective, float]) -> float:
        """Return the logarithm of the weighted product, the weights scaled to a sum of 1."""
        total = sum(weights.values())
        shares = np.array([weight / total for weight in weights.values()])
        return float(shares @ self.log_costs(tuple(weights)))


def _mean_ratio(values: Iterable[float]) -> float:
    return math.exp(float(np.mean([math.log(max(value, _LEAST)) for value in values])))


def undominated(costs: NDArray[np.float64]) -> list[int]:
    """Return which rows of costs (n, k) no other row is as good as in all and better than in one, in their order."""
    _, first = np.unique(costs, axis=0, return_index=True)
    better = costs[:, None]
    beaten = np.any((better <= costs).all(axis=2) & (better < costs).any(axis=2), axis=0).tolist()
    return [row for row in sorted(first.tolist()) if not beaten[row]]


def _scaled(costs: NDArray[np.float64]) -> NDArray[np.float64]:
    low = costs.min(axis=0)
    high = costs.max(axis=0)
    return (costs - low) / np.where(high > low, high - low, 1.0)


def knee(costs: NDArray[np.float64]) -> int:
    """Return the row of costs (n, k), logarithms scaled to a range of 1, that is nearest to the best of each column."""
    scaled = _scaled(costs)
    return int(np.argmin((scaled * scaled).sum(axis=1)))


def spread_out(costs: NDArray[np.float64], count: int) -> list[int]:
    """Return at most so many rows of costs (n, k) that lie far from each other: the best of each column, then always
    the one that is furthest from those that were taken."""
    scaled = _scaled(costs)
    chosen = list(dict.fromkeys(costs.argmin(axis=0).tolist()))[:count]
    while len(chosen) < min(count, len(costs)):
        away = np.linalg.norm(scaled[:, None] - scaled[chosen], axis=2).min(axis=1)
        away[chosen] = -1.0
        chosen.append(int(away.argmax()))
    return chosen


def weightings(objectives: Sequence[TuningObjective]) -> list[dict[TuningObjective, float]]:
    """Return the weights by which a front of several objectives is searched, the most balanced first.

    A lattice on the simplex (Das and Dennis, SIAM J. Optim. 8, 1998), its points moved a little inwards, so that no
    objective is left out.
    """
    n = len(objectives)
    steps = {2: 4, 3: 3}.get(n, 2)
    lattice = [point for point in np.ndindex(*(steps + 1,) * n) if sum(point) == steps]
    lattice.sort(key=lambda point: (max(point), point))
    return [
        {
            name: (share + 0.2) / (steps + 0.2 * n)
            for name, share in zip(objectives, point, strict=True)
        }
        for point in lattice
    ]


_Choice = Literal["knee", "time", "error", "margin", "energy", "force"]


@dataclass(frozen=True)
class TuningGoal:
    """A weighted product of objectives, or the front of several and the choice on it."""

    weights: Mapping[TuningObjective, float]
    """Of a front all the same."""
    front: bool = False
    choice: _Choice = "knee"
    """The point of a front that is taken: its knee, or the best by an objective."""

    @classmethod
    def of(
        cls,
        words: Sequence[str] = (),
        objectives: Sequence[TuningObjective] = (),
        choice: _Choice = "knee",
    ) -> TuningGoal:
        """Return the goal of options: ``NAME=WEIGHT`` words of a product, or objectives and choice of a front.

        Raises InputError for both at once, and for what is no objective, no weight or no choice.
        """
        names: tuple[TuningObjective, ...] = tuple(dict.fromkeys(objectives))
        if names and words:
            raise InputError("--weights and --objectives exclude each other: a product, or a front")
        if not names:
            if choice != "knee":
                raise InputError("--choose is for a front; give its --objectives")
            return cls(dict(map(_weight, words)) or DEFAULT_WEIGHTS)
        if len(names) < 2:
            raise InputError(
                f"a front has at least two objectives; for one give --weights {names[0]}=1"
            )
        if choice != "knee" and choice not in names:
            raise InputError(
                f"--choose is {choice}; allowed on this front: knee, {', '.join(names)}"
            )
        return cls(dict.fromkeys(names, 1.0), True, choice)

    @property
    def objectives(self) -> tuple[TuningObjective, ...]:
        """Those that count."""
        return tuple(self.weights)

    @property
    def searches(self) -> Sequence[Mapping[TuningObjective, float]]:
        """The weights of each search."""
        if self.front:
            return weightings(self.objectives)
        return [self.weights]

    def pick(self, costs: NDArray[np.float64]) -> int:
        """Return which row of a front's costs (n, k) is chosen."""
        if self.choice == "knee":
            return knee(costs)
        return int(costs[:, self.objectives.index(self.choice)].argmin())

    def __str__(self) -> str:
        if self.front:
            return f"{self.choice} of the front of {', '.join(self.objectives)}"
        return ", ".join(f"{name}={weight:g}" for name, weight in self.weights.items())


def _weight(word: str) -> tuple[TuningObjective, float]:
    name, equals, text = word.partition("=")
    if name not in OBJECTIVES:
        raise InputError(
            f"unknown objective '{name}'{suggestion(name, OBJECTIVES)}; there are {', '.join(OBJECTIVES)}"
        )
    try:
        if equals:
            weight = float(text)
        else:
            weight = 1.0
    except ValueError:
        weight = math.nan
    if not 1e-3 <= weight <= 1e3:
        raise InputError(
            f"the weight of {name} is '{text}'; allowed: 0.001 to 1000, such as {name}=0.5"
        )
    return cast(TuningObjective, name), weight
