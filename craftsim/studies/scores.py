"""Statistics over training runs: rliable's measures (Agarwal et al., NeurIPS 2021)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

REPETITIONS: Final = 2000
"""Of the stratified bootstrap."""
TAUS: Final = np.linspace(0.0, 1.0, 51)
"""Success rates at which performance profiles are drawn."""
Scores = Mapping[str, NDArray[np.float64]]
"""By algorithm: success rates, shape (seeds, tasks)."""


def measures(scores: Scores) -> dict[str, Any]:
    """Return, by algorithm, interquartile mean, mean, median and optimality gap over all runs, with 95 % intervals.

    Runs are drawn anew within each task. Each figure is [estimate, low, high].
    """
    from rliable import metrics

    def all_of(runs: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.array(
            [
                metrics.aggregate_iqm(runs),
                metrics.aggregate_mean(runs),
                metrics.aggregate_median(runs),
                metrics.aggregate_optimality_gap(runs),
            ]
        )

    points, intervals = _estimated(scores, all_of)
    names = ("iqm", "mean", "median", "optimality_gap")
    return {
        algo: {
            name: [float(points[algo][i]), float(intervals[algo][0][i]), float(intervals[algo][1][i])]
            for i, name in enumerate(names)
        }
        for algo in scores
    }


def profiles(scores: Scores) -> dict[str, list[list[float]]]:
    """Return, by algorithm, the share of runs above each success rate of TAUS: estimates, lows and highs."""
    from rliable import library

    points, intervals = library.create_performance_profile(
        dict(scores), TAUS, reps=REPETITIONS, random_state=np.random.RandomState(0)
    )
    return {
        algo: [points[algo].tolist(), intervals[algo][0].tolist(), intervals[algo][1].tolist()] for algo in scores
    }


def improvements(scores: Scores) -> dict[str, list[float]]:
    """Return by 'A over B' how likely a run of A is better than one of B on a task, with its interval."""
    from rliable import metrics

    names = list(scores)
    pairs = {f"{a} over {b}": (scores[a], scores[b]) for i, a in enumerate(names) for b in names[i + 1 :]}
    if not pairs:
        return {}
    points, intervals = _estimated(pairs, metrics.probability_of_improvement)
    return {pair: [float(points[pair]), *map(float, intervals[pair][:, 0])] for pair in pairs}


def iqm_curve(runs: Sequence[Sequence[tuple[int, float]]], at: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return (3, len(at)): interquartile mean over runs, low and high, of success after so many steps.

    A run has the success of its last evaluation until then, 0 before its first, and keeps its last one for good.
    """
    from rliable import metrics

    held = np.array([[_held(run, int(step)) for step in at] for run in runs])

    def at_each(drawn: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.array([metrics.aggregate_iqm(drawn[:, i]) for i in range(drawn.shape[1])])

    points, intervals = _estimated({"runs": held}, at_each)
    return np.stack([points["runs"], *intervals["runs"]])


def _held(run: Sequence[tuple[int, float]], step: int) -> float:
    before = [success for at, success in run if at <= step]
    return before[-1] if before else 0.0


def _estimated(scores: Mapping[str, Any], function: Any) -> tuple[dict[str, Any], dict[str, Any]]:
    from rliable import library

    found: tuple[dict[str, Any], dict[str, Any]] = library.get_interval_estimates(
        dict(scores), function, reps=REPETITIONS, random_state=np.random.RandomState(0)
    )
    return found
