"""Statistics over training runs, as Agarwal et al. advise ("Deep reinforcement learning at the edge of the statistical
precipice", NeurIPS 2021).

The measures are those of their library rliable, which does not import beside pandas 3 (its dependency arch does not).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.stats import trim_mean

REPETITIONS: Final = 2000
"""Of the stratified bootstrap."""
TAUS: Final = np.linspace(0.0, 1.0, 51)
"""Success rates at which performance profiles are drawn."""
Runs = NDArray[np.float64]
"""Success rates, shape (..., seeds, tasks)."""
Scores = Mapping[str, Runs]
"""By algorithm."""


def iqm(runs: Runs) -> NDArray[np.float64]:
    """Return the interquartile mean over seeds and tasks: of the middle half of all runs, shape (...)."""
    found: NDArray[np.float64] = trim_mean(runs.reshape(*runs.shape[:-2], -1), 0.25, axis=-1)
    return found


MEASURES: Final[Mapping[str, Callable[[Runs], NDArray[np.float64]]]] = {
    "iqm": iqm,
    "mean": lambda runs: runs.mean((-2, -1)),
    "median": lambda runs: np.median(runs.mean(-2), -1),
    "optimality_gap": lambda runs: 1 - np.minimum(runs, 1.0).mean((-2, -1)),
}
"""By name: what is said of all runs of an algorithm; the median is that of the tasks' means."""


def measures(runs: Runs) -> dict[str, list[float]]:
    """Return every measure of an algorithm's runs (seeds, tasks), each as estimate, low and high at 95 %."""
    drawn = _drawn(runs)
    return {
        name: [float(measure(runs)), *np.quantile(measure(drawn), (0.025, 0.975)).tolist()]
        for name, measure in MEASURES.items()
    }


def profile(runs: Runs) -> NDArray[np.float64]:
    """Return (3, len(TAUS)): the share of runs above each success rate, its low and its high at 95 %."""

    def above(some: Runs) -> NDArray[np.float64]:
        shares: NDArray[np.float64] = (some[..., None] > TAUS).mean((-3, -2))
        return shares

    return np.stack([above(runs), *np.quantile(above(_drawn(runs)), (0.025, 0.975), axis=0)])


def improvement(ours: Runs, theirs: Runs) -> list[float]:
    """Return how likely a run of ours is better than one of theirs on a task, ties by half, its low and its high."""

    def better(a: Runs, b: Runs) -> NDArray[np.float64]:
        gap = a[..., :, None, :] - b[..., None, :, :]
        likely: NDArray[np.float64] = ((gap > 0) + 0.5 * (gap == 0)).mean((-3, -2, -1))
        return likely

    bounds = np.quantile(better(_drawn(ours), _drawn(theirs, 1)), (0.025, 0.975))
    return [float(better(ours, theirs)), *bounds.tolist()]


def iqm_curve(runs: Sequence[Sequence[tuple[int, float]]], at: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return (3, len(at)): the interquartile mean over runs of success after so many steps, its low and its high.

    A run, a list of (steps, success), has the success of its last evaluation until then, and 0 before its first one.
    """
    held = np.array([[_held(run, int(step)) for step in at] for run in runs])
    columns = np.moveaxis(_drawn(held), -1, 0)[..., None]
    bounds = np.quantile(iqm(columns), (0.025, 0.975), axis=-1)
    return np.stack([iqm(held.T[..., None]), *bounds])


def _held(run: Sequence[tuple[int, float]], step: int) -> float:
    before = [success for at, success in run if at <= step]
    return before[-1] if before else 0.0


def _drawn(runs: Runs, seed: int = 0) -> Runs:
    """Return (REPETITIONS, seeds, tasks): runs drawn with replacement, those of each task by themselves."""
    rng = np.random.default_rng(seed)
    rows = rng.integers(len(runs), size=(REPETITIONS, *runs.shape))
    return np.take_along_axis(np.broadcast_to(runs, rows.shape), rows, axis=1)
