"""Rewards: one number a tick, shared by all cars. docs/tasks.md shows how to write one's own."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from typing import Final

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.files.design import Design
from craftsim.discrete.grid import Grid
from craftsim.discrete.tasks.measures import Custom, Measure

ALPHA: Final = 10.0
"""Reward of a tick that ends with the flag on the goal, by the paper."""

BETA: Final = 1.0
"""What every tick of the barrier task costs, by the paper."""

CODE_BONUS: Final = 20.0
"""From this CraftEnv's code subtracts the tick's number when the flag first reaches the goal."""

Potentials = NDArray[np.float64]


class Reward:
    """The change of a potential: over an episode this adds up to that of the end less that of the start."""

    def __init__(self, measure: Measure | Callable[[Grid], float]) -> None:
        self.measure = measure if isinstance(measure, Measure) else Custom(measure)

    def for_design(self, design: Design | None) -> Reward:
        """Return the same reward for another design, or, for None, for one in each world."""
        other = copy(self)
        other.measure = self.measure.for_design(design)
        return other

    def of_tick(
        self, before: Potentials, after: Potentials, t: NDArray[np.int64], given: NDArray[np.bool_]
    ) -> tuple[Potentials, NDArray[np.bool_]]:
        """Return the reward of tick t (from 0), and whether a one-time bonus counts as given from now on.

        All arguments and results have one element a world: the potential before and after the tick, the tick's
        number, and whether the bonus was given in an earlier tick.
        """
        return after - before, given


class CodeReward(Reward):
    """The change of the potential, but in the first tick the whole potential (docs/rules.md#first-tick)."""

    def of_tick(
        self, before: Potentials, after: Potentials, t: NDArray[np.int64], given: NDArray[np.bool_]
    ) -> tuple[Potentials, NDArray[np.bool_]]:
        """Return the reward of tick t; there is no bonus."""
        return np.where(t == 0, after, after - before), given


class PaperBarrier(Reward):
    """Each step of the flag towards the goal, ALPHA while it is there, less BETA every tick."""

    def of_tick(
        self, before: Potentials, after: Potentials, t: NDArray[np.int64], given: NDArray[np.bool_]
    ) -> tuple[Potentials, NDArray[np.bool_]]:
        """Return the reward of tick t; the bonus comes every tick, so nothing is remembered."""
        return after - before + ALPHA * (after == 0) - BETA, given


class CodeBarrier(Reward):
    """Nothing in the first tick, then each step of the flag, and one bonus (docs/rules.md#flag-bonus)."""

    def of_tick(
        self, before: Potentials, after: Potentials, t: NDArray[np.int64], given: NDArray[np.bool_]
    ) -> tuple[Potentials, NDArray[np.bool_]]:
        """Return the reward of tick t, and whether the bonus is spent."""
        arrived = (t >= 1) & (after == 0) & ~given
        return np.where(t == 0, 0.0, after - before) + np.where(arrived, CODE_BONUS - t, 0.0), given | arrived
