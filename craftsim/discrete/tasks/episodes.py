"""Episodes of a task: reset, step, reward, done. Many at once, or a single one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.grid import Grid
from craftsim.discrete.rules import DEFAULT_DEPTH, Rules, RuleSet
from craftsim.discrete.tasks.batches import Starts
from craftsim.discrete.tasks.measures import Measure
from craftsim.discrete.tasks.observation import car_vectors
from craftsim.discrete.tasks.task import Task
from craftsim.discrete.tasks.worlds import Worlds


@dataclass(frozen=True)
class Steps:
    """What a tick brought, one element an episode."""

    reward: NDArray[np.float64]
    """(B,): one number shared by all cars."""
    done: NDArray[np.bool_]
    """(B,): the episode is over, by its length or, where the task says so, by success."""
    success: NDArray[np.bool_]
    """(B,): the work is done now."""
    applied: NDArray[np.bool_]
    """(B, n): by car, whether what it did was legal when its turn came."""
    order: NDArray[np.int64]
    """(B, n): the cars in the order in which they acted."""


class Episodes:
    """B episodes of one task, side by side. Nothing is hidden: all state is in public attributes.

    With ``helper_depth`` the action helper is on: a MOVE asks for the neighbour cell, and ``worlds.queue``
    holds what is left to do. ``rng`` draws start worlds and, where the caller gives none, the order in which
    cars act.
    """

    def __init__(
        self,
        task: Task,
        rng: np.random.Generator,
        n: int = 1,
        rule_set: RuleSet = "physical",
        helper_depth: int | None = None,
    ) -> None:
        self.task = task
        self.rng = rng
        self.layout = task.layout
        starts = task.draw_starts(rng, n)
        self.worlds = Worlds(Rules(rule_set), [starts.grid(i) for i in range(n)], helper_depth)
        self.designs = starts.designs
        """(B, T, 5): what is to be built in each world, see :data:`craftsim.discrete.tasks.batches.Targets`."""
        self.t = np.zeros(n, np.int64)
        self.bonus_given = np.zeros(n, np.bool_)
        self.done = np.zeros(n, np.bool_)
        self.potential = self._measured(task.reward.measure)

    def reset(self, which: Sequence[int] | NDArray[np.integer] | None = None) -> None:
        """Start some episodes anew, or all."""
        rows = np.arange(len(self.worlds)) if which is None else np.asarray(which, np.int64)
        if len(rows):
            self.begin(rows, self.task.draw_starts(self.rng, len(rows)))

    def begin(self, rows: NDArray[np.integer], starts: Starts) -> None:
        """Start the episodes ``rows`` anew, each as the start of the same place says."""
        self.worlds.put(rows, starts.grids)
        self.designs[rows] = starts.designs
        self.t[rows] = 0
        self.bonus_given[rows] = False
        self.done[rows] = False
        self.potential[rows] = self.task.reward.measure.of_episodes(starts.grids.world(), starts.designs)

    def _measured(self, measure: Measure) -> NDArray[np.float64]:
        return measure.of_episodes(self.worlds.arrays, self.designs)

    def draw_order(self) -> NDArray[np.int64]:
        """Return (B, n): for each episode a fresh, uniform order of its cars."""
        return np.argsort(self.rng.random((len(self.worlds), self.worlds.n_cars)), axis=1)

    def step(self, actions: NDArray[np.integer], order: NDArray[np.integer] | None = None) -> Steps:
        """Let all cars act once; ``actions`` (B, n) by car, ``order`` (B, n) of the cars' turns."""
        turns = self.draw_order() if order is None else np.asarray(order, np.int64)
        applied = self.worlds.tick(actions, turns)
        after = self._measured(self.task.reward.measure)
        reward, self.bonus_given = self.task.reward.of_tick(self.potential, after, self.t, self.bonus_given)
        success = self._measured(self.task.success_measure) != 0
        self.potential = after
        self.done = self.task.over(self.t, success)
        self.t = self.t + 1
        return Steps(reward, self.done, success, applied, turns)

    def legal(self) -> NDArray[np.bool_]:
        """Return (B, n, 15): what each car could do at once."""
        return self.worlds.legal()

    def reachable(self) -> NDArray[np.bool_]:
        """Return (B, n, 15): the same, and the moves that the helper finds a plan for."""
        depth = self.worlds.depth
        return self.worlds.reachable(DEFAULT_DEPTH if depth is None else depth)

    def offered(self) -> NDArray[np.bool_]:
        """Return (B, n, 15): what each car is offered to do, STOP where the rules leave it nothing; never all false."""
        return self.worlds.offered()

    def entity_rows(self) -> NDArray[np.int32]:
        """Return (B, n_observed, 13): what is where, as :mod:`craftsim.discrete.tasks.observation` lays it out."""
        return self.worlds.entity_rows(self.layout, self.designs)

    def vectors(self) -> NDArray[np.int32]:
        """Return (B, n, vector_length): each car's observation."""
        return car_vectors(self.entity_rows(), self.worlds.n_cars)


@dataclass(frozen=True)
class EpisodeStep:
    """What a tick of a single episode brought; see :class:`Steps`."""

    reward: float
    done: bool
    success: bool
    applied: NDArray[np.bool_]
    order: NDArray[np.int64]


class GridEpisode:
    """A single episode: a batch of one, without the leading dimension."""

    def __init__(
        self,
        task: Task,
        rng: np.random.Generator,
        rule_set: RuleSet = "physical",
        helper_depth: int | None = None,
    ) -> None:
        self.batch = Episodes(task, rng, 1, rule_set, helper_depth)

    @property
    def grid(self) -> Grid:
        """A copy of the world as it is."""
        return self.batch.worlds.grid(0)

    @property
    def queue(self) -> NDArray[np.int8]:
        """(n, depth + 1): what the helper has still to do, -1 where nothing."""
        return self.batch.worlds.queue[0].copy()

    @property
    def t(self) -> int:
        """Number of ticks since the reset."""
        return int(self.batch.t[0])

    def reset(self) -> None:
        """Start anew."""
        self.batch.reset()

    def step(
        self, actions: Sequence[int] | NDArray[np.integer], order: Sequence[int] | None = None
    ) -> EpisodeStep:
        """Let all cars act once; ``actions`` by car, ``order`` of their turns."""
        turns = None if order is None else np.asarray(order)[None]
        steps = self.batch.step(np.asarray(actions, np.int64)[None], turns)
        return EpisodeStep(
            float(steps.reward[0]),
            bool(steps.done[0]),
            bool(steps.success[0]),
            steps.applied[0],
            steps.order[0],
        )

    def legal(self) -> NDArray[np.bool_]:
        """Return (n, 15): what each car could do at once."""
        return self.batch.legal()[0]

    def reachable(self) -> NDArray[np.bool_]:
        """Return (n, 15): the same, and the moves that the helper finds a plan for."""
        return self.batch.reachable()[0]

    def vectors(self) -> NDArray[np.int32]:
        """Return (n, vector_length): each car's observation."""
        return self.batch.vectors()[0]
