"""Exploration before learning: return to a world that was reached, go on from there at random, remember what is new.

After Ecoffet et al., "First return, then explore", Nature 590, 2021. Training then starts in worlds that were reached,
and what led to the best of them is imitated first. The only knowledge of the task that goes in is its potential.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.grid import Grid
from craftsim.discrete.kernel.codes import N_ACTIONS
from craftsim.discrete.kinds import Action, PlanTick
from craftsim.discrete.rules import RuleSet
from craftsim.tasks import Task
from craftsim.tasks.episodes import Episodes

_WORLDS: Final = 500
"""How many are stepped side by side."""
_SEGMENT: Final = 10
"""Ticks that are played from a world before another is returned to."""
_EARLY: Final = 2.0
"""Of the worlds of one potential those are returned to that took so many ticks more than the earliest, on average."""
_EPISODES: Final = 2
"""Lengths of an episode after which a world is not gone on from; more than one, for learning shortens a way."""
EXPLORED_STARTS: Final = 1000
"""How many worlds are returned: half of them lie on the way to the best one, the others anywhere."""


def hashes(rows: NDArray[np.integer]) -> NDArray[np.int64]:
    """Return (k,): numbers of 64 bits that tell rows (k, ...) apart."""
    flat = rows.reshape(len(rows), -1).astype(np.int64)
    factors = np.random.default_rng(1).integers(-(2**62), 2**62, flat.shape[1])
    with np.errstate(over="ignore"):
        sums: NDArray[np.int64] = (flat * factors).sum(axis=1)
    return sums


def explore(
    task: Task, rules: RuleSet, ticks: int, rng: np.random.Generator
) -> tuple[list[Grid], list[Grid], tuple[PlanTick, ...]]:
    """Explore for so many ticks, without an action helper, each of whose primitives is an action, too.

    Where there are no slopes no car turns, for it would make no difference. Returns STARTS of the worlds that were
    reached, one maybe more than once; those from the start to the one of the highest potential, of these the one that
    was reached the earliest; and what the cars did between these, in the order in which they acted.
    """
    episodes = Episodes(task, rng, _WORLDS, rules)
    reached = _Reached(episodes)
    plays = np.ones(N_ACTIONS, np.bool_)
    plays[[Action.ROTATE_LEFT, Action.ROTATE_RIGHT]] = task.layout.n_slopes > 0
    played = 0
    while played < ticks:
        at = reached.draw(rng, _WORLDS)
        reached.put(episodes, at)
        running = np.ones(_WORLDS, np.bool_)
        for _ in range(_SEGMENT):
            offered = episodes.offered() & plays
            actions = (rng.random(offered.shape) * offered).argmax(-1)
            steps = episodes.step(actions)
            played += int(running.sum())
            # What one car kept another from would not happen again where they act in another order.
            running &= steps.applied.all(-1)
            acted = np.stack([steps.order, np.take_along_axis(actions, steps.order, -1)], -1)
            at = reached.add(episodes, at, running, acted, steps.success)
            running &= ~steps.success
    path = reached.way_to_best()
    starts = [
        *rng.choice(path[:-1] or path, EXPLORED_STARTS // 2),
        *reached.draw(rng, EXPLORED_STARTS // 2),
    ]
    ticks_to_best: list[PlanTick] = []
    for number in path[1:]:
        tick = []
        for car, action in reached.worlds[number].actions.tolist():
            tick.append((car, Action(action)))
        ticks_to_best.append(tuple(tick))
    return reached.grids(starts), reached.grids(path), tuple(ticks_to_best)


@dataclass(slots=True)
class _World:
    grid: Grid
    potential: float
    ticks: int  # the fewest that it took to come here
    before: int  # number of the world from which one came so soon
    actions: NDArray[np.int64]  # (n, 2): what led here from there, car and action in acting order
    returns: int = 0


class _Reached:
    """Every world that was reached, the start first."""

    def __init__(self, episodes: Episodes) -> None:
        n = len(episodes)
        self._limit = _EPISODES * (episodes.task.max_steps + 2)
        self.worlds: list[_World] = []
        self._numbers: dict[int, int] = {}  # by hash
        self._open: dict[
            float, dict[int, list[int]]
        ] = {}  # by potential and ticks: where one may go on
        nothing = np.zeros((n, 0, 2), np.int64)
        none = np.zeros(n, np.bool_)
        self.add(episodes, np.zeros(n, np.int64), np.arange(n) == 0, nothing, none)

    def draw(self, rng: np.random.Generator, n: int) -> NDArray[np.int64]:
        """Return n worlds to go on from: those of higher potentials more often, of these rather the earliest.

        Of two candidates the one that was returned to less often.
        """
        levels = sorted(self._open)
        weights = np.arange(1.0, len(levels) + 1)
        chosen = np.empty(n, np.int64)
        for i, level in enumerate(rng.choice(len(levels), n, p=weights / weights.sum())):
            by_tick = self._open[levels[level]]
            ticks = sorted(by_tick)
            candidates = by_tick[ticks[min(int(rng.exponential(_EARLY)), len(ticks) - 1)]]
            pair = (candidates[int(k)] for k in rng.integers(len(candidates), size=2))
            chosen[i] = min(pair, key=lambda number: self.worlds[number].returns)
            self.worlds[chosen[i]].returns += 1
        return chosen

    def put(self, episodes: Episodes, which: NDArray[np.int64]) -> None:
        """Return to worlds, one an episode."""
        worlds = [self.worlds[i] for i in which]
        episodes.put(slice(None), Grid.stack([world.grid for world in worlds]))
        episodes.t[:] = [world.ticks for world in worlds]
        episodes.bonus_given[:] = False
        episodes.potentials = episodes.task.reward.potentials(
            episodes.grids, episodes.designs, episodes.layout
        )

    def add(
        self,
        episodes: Episodes,
        before: NDArray[np.int64],
        running: NDArray[np.bool_],
        actions: NDArray[np.int64],
        success: NDArray[np.bool_],
    ) -> NDArray[np.int64]:
        """Remember the worlds of running episodes, reached from ``before``; one goes on from those without success.

        Returns which worlds they are, ``before`` where an episode runs no more.
        """
        cells = episodes.grids.cells.reshape(len(running), -1)
        cars = episodes.grids.cars.reshape(len(running), -1)
        keys = hashes(np.concatenate([cells, cars], axis=1)).tolist()
        ticks = episodes.t.tolist()
        potential = episodes.potential.tolist()
        at = before.copy()
        for i in np.flatnonzero(running).tolist():
            at[i] = number = self._numbers.setdefault(keys[i], len(self.worlds))
            arrival = ticks[i], int(before[i]), actions[i].copy()
            if number == len(self.worlds):
                self.worlds.append(_World(episodes.grid(i), potential[i], *arrival))
            else:
                world = self.worlds[number]
                if ticks[i] < world.ticks:
                    world.ticks, world.before, world.actions = arrival
                else:
                    continue
            if not success[i] and ticks[i] < self._limit:
                self._open.setdefault(potential[i], {}).setdefault(ticks[i], []).append(number)
        return at

    def grids(self, numbers: Iterable[int]) -> list[Grid]:
        """Return copies of some worlds."""
        return [self.worlds[number].grid.copy() for number in numbers]

    def way_to_best(self) -> list[int]:
        """Return the numbers of the worlds from the start to the best one."""
        best = 0
        for number, world in enumerate(self.worlds):
            place = (-world.potential, world.ticks)
            if place < (-self.worlds[best].potential, self.worlds[best].ticks):
                best = number
        path = [best]
        while path[-1]:
            path.append(self.worlds[path[-1]].before)
        return path[::-1]
