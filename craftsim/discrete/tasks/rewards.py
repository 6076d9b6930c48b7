"""Rewards: what a tick pays, one number shared by all cars. docs/tasks.md shows how to write one's own."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.grid import Grid
from craftsim.discrete.tasks.measures import Custom, Measure

ALPHA: Final = 10.0
"""What a tick that ends with the flag on the goal pays, by the paper."""

BETA: Final = 1.0
"""What every tick of the barrier task costs, by the paper."""

CODE_BONUS: Final = 20.0
"""From this CraftEnv's code subtracts the tick's number when the flag first reaches the goal."""

Worths = NDArray[np.float64]


class Reward:
    """Pays the change of a measure: over an episode this adds up to the end's worth less the start's."""

    def __init__(self, measure: Measure | Callable[[Grid], float]) -> None:
        self.measure = measure if isinstance(measure, Measure) else Custom(measure)

    def pay(
        self, before: Worths, after: Worths, t: NDArray[np.int64], paid: NDArray[np.bool_]
    ) -> tuple[Worths, NDArray[np.bool_]]:
        """Return what tick t (from 0) pays, and whether a one-time bonus counts as paid from now on.

        All arguments and results have one element a world: the measure before and after the tick, the tick's
        number, and whether the bonus was paid in an earlier tick.
        """
        return after - before, paid


class CodeReward(Reward):
    """Pays the change, but in the first tick all that the world is worth (docs/rules.md#first-tick)."""

    def pay(
        self, before: Worths, after: Worths, t: NDArray[np.int64], paid: NDArray[np.bool_]
    ) -> tuple[Worths, NDArray[np.bool_]]:
        """Return what tick t pays; there is no bonus."""
        return np.where(t == 0, after, after - before), paid


class PaperBarrier(Reward):
    """Pays each step of the flag towards the goal, ALPHA while it is there, less BETA every tick."""

    def pay(
        self, before: Worths, after: Worths, t: NDArray[np.int64], paid: NDArray[np.bool_]
    ) -> tuple[Worths, NDArray[np.bool_]]:
        """Return what tick t pays; the bonus comes every tick, so nothing is remembered."""
        return after - before + ALPHA * (after == 0) - BETA, paid


class CodeBarrier(Reward):
    """Pays not in the first tick, then each step of the flag, and one bonus (docs/rules.md#flag-bonus)."""

    def pay(
        self, before: Worths, after: Worths, t: NDArray[np.int64], paid: NDArray[np.bool_]
    ) -> tuple[Worths, NDArray[np.bool_]]:
        """Return what tick t pays, and whether the bonus is spent."""
        arrived = (t >= 1) & (after == 0) & ~paid
        return np.where(t == 0, 0.0, after - before) + np.where(arrived, CODE_BONUS - t, 0.0), paid | arrived
