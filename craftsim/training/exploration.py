"""Exploration before learning: return to a world that was reached, go on from there at random, remember what is new.

After Ecoffet et al., "First return, then explore", Nature 590, 2021. Training then has starts among the worlds that
were reached: on the way to the best of them, and of every potential; what was done on that way is imitated first. No
plan and no other knowledge of the task goes in but its reward's potential.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.grid import Grid
from craftsim.discrete.kernel.codes import N_ACTIONS
from craftsim.discrete.kinds import Action
from craftsim.discrete.rules import Rules, RuleSet
from craftsim.discrete.tasks import Task
from craftsim.discrete.tasks.episodes import Episodes
from craftsim.planning.joint_plan import Ticks

WORLDS: Final = 500
"""How many are stepped side by side."""
SEGMENT: Final = 10
"""Ticks that are played from a world before another is returned to."""
EARLY: Final = 2.0
"""Of the worlds of one potential those are returned to that took so many ticks more than the earliest, on average."""
EPISODES: Final = 2
"""Lengths of an episode, after which a world is not gone on from: a way may be longer than one, for learning shortens
it."""
STARTS: Final = 1000
"""How many worlds are returned: half of them lie on the way to the best one, the others anywhere."""
_ARRAYS: Final = ("cells", "cars")
_HASH_SEED: Final = 1


def explore(
    task: Task, rules: RuleSet, ticks: int, rng: np.random.Generator
) -> tuple[list[Grid], list[Grid]]:
    """Explore for so many ticks, without an action helper, each of whose primitives is an action, too.

    Where there are no slopes no car turns, for it would make no difference. Returns STARTS of the worlds that were
    reached, one maybe more than once; and those from the start to the one of the highest potential, of these the one
    that was reached the earliest.
    """
    episodes = Episodes(task, rng, WORLDS, rules)
    reached = _Reached(episodes)
    plays = np.ones(N_ACTIONS, np.bool_)
    plays[[Action.ROTATE_LEFT, Action.ROTATE_RIGHT]] = task.layout.n_slopes > 0
    played = 0
    while played < ticks:
        at = reached.draw(rng, WORLDS)
        reached.put(episodes, at)
        running = np.ones(WORLDS, np.bool_)
        for _ in range(SEGMENT):
            offered = episodes.offered() & plays
            steps = episodes.step((rng.random(offered.shape) * offered).argmax(-1))
            played += int(running.sum())
            # What one car kept another from would not happen again where they act in another order.
            running &= steps.applied.all(-1)
            at = reached.add(episodes, at, running, steps.success)
            running &= ~steps.success
    way = reached.way_to_best()
    starts = [*rng.choice(way[:-1] or way, STARTS // 2), *reached.draw(rng, STARTS // 2)]
    return reached.grids(starts), reached.grids(way)


def done_on(way: Sequence[Grid], rules: Rules) -> Ticks:
    """Return what cars did in each tick from one world to the next, in the order in which they acted.

    All that they did was offered to them when the tick began. Raises ValueError where nothing leads from one to the
    next.
    """
    done = []
    for before, after in pairwise(way):
        offered = {car: np.flatnonzero(row).tolist() for car, row in enumerate(rules.mask(before))}
        found = _done_between(before, after, offered, rules)
        if found is None:
            raise ValueError("no actions lead from one world to the next")
        done.append(found)
    return tuple(done)


def _done_between(
    before: Grid, after: Grid, offered: Mapping[int, Sequence[int]], rules: Rules
) -> tuple[tuple[int, Action], ...] | None:
    """Return what each car may have done of what it was offered, STOP where nothing; None where it cannot have been."""
    if before.same_visible(after) and before.same_marks(after):
        return tuple((car, Action.STOP) for car in offered)
    for car, actions in offered.items():
        others = {other: theirs for other, theirs in offered.items() if other != car}
        for action in actions:
            if not rules.legal(before, car, action):
                continue
            then = rules.apply(before, car, action)
            # No car moves another.
            if np.array_equal(then.cars[car], after.cars[car]):
                rest = _done_between(then, after, others, rules)
                if rest is not None:
                    return ((car, Action(action)), *rest)
    return None


class _Reached:
    """Every world that was reached, with the fewest ticks that it took, and from where."""

    def __init__(self, episodes: Episodes) -> None:
        self._limit = EPISODES * (episodes.task.max_steps + 2)
        live = self._live(episodes)
        self._arrays = {
            name: np.empty((1 << 12, *array.shape[1:]), array.dtype) for name, array in live.items()
        }
        length = sum(array[0].size for array in live.values())
        self._factors = np.random.default_rng(_HASH_SEED).integers(-(2**62), 2**62, length)
        self._index: dict[int, int] = {}
        self._ticks: list[int] = []
        self._potential: list[float] = []
        self._before: list[int] = []
        self._returns: list[int] = []
        self._open: dict[float, dict[int, list[int]]] = {}
        """By potential and ticks: where one may go on."""
        first = np.zeros(len(episodes), np.bool_)
        first[0] = True
        self.add(episodes, np.zeros(len(first), np.int64), first, np.zeros_like(first))

    @staticmethod
    def _live(episodes: Episodes) -> dict[str, NDArray[np.generic]]:
        return {name: getattr(episodes.grids, name) for name in _ARRAYS}

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
            cells = by_tick[ticks[min(int(rng.exponential(EARLY)), len(ticks) - 1)]]
            first, second = (cells[int(k)] for k in rng.integers(len(cells), size=2))
            chosen[i] = first if self._returns[first] <= self._returns[second] else second
            self._returns[chosen[i]] += 1
        return chosen

    def put(self, episodes: Episodes, which: NDArray[np.int64]) -> None:
        """Return to worlds, one an episode."""
        for name, array in self._live(episodes).items():
            array[:] = self._arrays[name][which]
        episodes.t[:] = [self._ticks[i] for i in which]
        episodes.bonus_given[:] = False
        episodes.potential = episodes.task.potential(episodes.grids, episodes.designs)

    def add(
        self,
        episodes: Episodes,
        before: NDArray[np.int64],
        running: NDArray[np.bool_],
        success: NDArray[np.bool_],
    ) -> NDArray[np.int64]:
        """Remember the worlds of running episodes, reached from ``before``; one goes on from those without success.

        Returns which worlds they are, ``before`` where an episode runs no more.
        """
        live = self._live(episodes)
        flat = [array.reshape(len(running), -1).astype(np.int64) for array in live.values()]
        keys = (np.concatenate(flat, axis=1) * self._factors).sum(axis=1).tolist()
        ticks, potential = episodes.t.tolist(), episodes.potential.tolist()
        at, new = before.copy(), []
        for i in np.flatnonzero(running).tolist():
            known = self._index.setdefault(keys[i], len(self._ticks))
            at[i] = known
            if known == len(self._ticks):
                new.append(i)
                self._ticks.append(ticks[i])
                self._potential.append(potential[i])
                self._before.append(int(before[i]))
                self._returns.append(0)
            elif ticks[i] < self._ticks[known]:
                self._ticks[known], self._before[known] = ticks[i], int(before[i])
            else:
                continue
            if not success[i] and ticks[i] < self._limit:
                self._open.setdefault(potential[i], {}).setdefault(ticks[i], []).append(known)
        self._store(live, new)
        return at

    def _store(self, live: dict[str, NDArray[np.generic]], new: list[int]) -> None:
        n = len(self._ticks)
        for name, array in live.items():
            kept = self._arrays[name]
            if n > len(kept):
                kept = self._arrays[name] = np.concatenate([kept, np.empty_like(kept)])
            kept[n - len(new) : n] = array[new]

    def way_to_best(self) -> list[int]:
        """Return the worlds from the start to the best one."""
        way = [min(range(len(self._ticks)), key=lambda i: (-self._potential[i], self._ticks[i]))]
        while way[-1]:
            way.append(self._before[way[-1]])
        return way[::-1]

    def grids(self, which: Sequence[int]) -> list[Grid]:
        """Return copies of worlds."""
        return [Grid(*(self._arrays[name][i].copy() for name in _ARRAYS)) for i in which]
