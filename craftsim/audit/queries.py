"""What a learner tries next: situations of play on the grid alone, chosen by what the examples do not say yet.

Some are forbidden by patterns that rest on other situations, some are like a pattern, and some are unfamiliar: two
things near the car that no action which worked had together. A failure mostly depends on few things, so that pairs
find most (combinatorial testing: Kuhn, Kacker and Lei, Introduction to Combinatorial Testing, 2013).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from heapq import heapify, heappop, heappush
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from craftsim.audit.examples import (
    ROTATE_LEFT,
    Example,
    WorldAction,
    mirrored,
    surroundings_of,
)
from craftsim.audit.induction import Pattern, forbidden, similar
from craftsim.discrete.files.blueprint import blueprint_text
from craftsim.discrete.grid import Grid
from craftsim.discrete.kernel import patterns as bits
from craftsim.discrete.kinds import Action, RuleSetName
from craftsim.discrete.rules import Rules
from craftsim.validation.play import choose
from craftsim.validation.worlds import RandomWorlds

_DOUBTS: Final = 4
"""Situations in which a pattern is tried beyond those that asked for it."""
_CONJECTURES: Final = 2
"""Situations in which something like a pattern is tried."""
_MOST_CONJECTURED: Final = 160
_REFUTED: Final = 2
"""Successes after which it is not tried any more."""
_TICKS: Final = 8
"""Of play on the grid in each world."""
_LEVELS: Final = bits.HIGHEST - bits.LOWEST + 1
_NEAR_CELLS: Final = 2
"""Cells ahead or aside of the car of which combinations count."""
_EMPTY: Final = 7
"""Bits of air, outside and ground, which do not count."""
_OWN_PER_HEADING: Final = bits.N_OWN // 4


class Option(NamedTuple):
    """An action that rules allow in play on the grid."""

    grid: Grid
    car: int
    action: Action
    verb: int
    surroundings: NDArray[np.int64]
    """(N_CELLS + 1,), as an example has them."""

    @property
    def situation(self) -> WorldAction:
        """It as it is tried."""
        return WorldAction(blueprint_text(self.grid), self.car, self.action)


def options_of_play(base: RuleSetName, rng: np.random.Generator, n_worlds: int) -> Iterator[Option]:
    """Yield all that a rule set allows, tick by tick, in play in so many random worlds."""
    rules = Rules(base)
    for _ in range(n_worlds):
        grid = RandomWorlds().grid(rng)
        done: Counter[str] = Counter()
        for _ in range(_TICKS):
            for car in rng.permutation(grid.n_cars).tolist():
                for number in np.flatnonzero(rules.mask(grid)[car]).tolist():
                    if number != Action.STOP:
                        verb, surroundings = surroundings_of(grid, car, number)
                        yield Option(grid, car, Action(number), verb, surroundings)
                chosen = choose(grid, rules, rng, car, done)
                if chosen is not None:
                    grid = chosen[1]
                    grid.derive_marks()


def doubtful(
    patterns: Sequence[Pattern],
    examples: Sequence[Example],
    options: Sequence[Option],
    rng: np.random.Generator,
) -> Iterator[WorldAction]:
    """Yield situations that tell more of patterns: some that they forbid, and some that are like these.

    What is like a pattern has another thing there, or the same one cell further; successes rule it out.
    """
    conjectured: list[WorldAction] = []
    for verb in range(len(bits.VERBS)):
        of_verb = [option for option in options if option.verb == verb]
        of_patterns = [pattern for pattern in patterns if pattern.verb == verb]
        if not of_verb or not of_patterns:
            continue
        around = np.array([option.surroundings for option in of_verb])
        matches = forbidden(of_patterns, verb, around)
        for matched in matches:
            for place in rng.permutation(np.flatnonzero(matched))[:_DOUBTS].tolist():
                yield of_verb[place].situation
        worked = _worked(examples, verb)
        conjectures = list(similar(of_patterns))
        refuted = forbidden(conjectures, verb, worked).sum(axis=1) >= _REFUTED
        open_ones = [c for c, wrong in zip(conjectures, refuted, strict=True) if not wrong]
        likely = forbidden(open_ones, verb, around) & ~matches.any(axis=0)
        for matched in likely:
            for place in rng.permutation(np.flatnonzero(matched))[:_CONJECTURES].tolist():
                conjectured.append(of_verb[place].situation)
    order = rng.permutation(len(conjectured))[:_MOST_CONJECTURED]
    for place in order.tolist():
        yield conjectured[place]


def unfamiliar(
    patterns: Sequence[Pattern],
    examples: Sequence[Example],
    options: Sequence[Option],
    max_number: int,
) -> list[WorldAction]:
    """Return situations that no pattern forbids, with most combinations of things that no success had yet.

    Combinations count for each verb, load and stance of the car, those nearby more. They are chosen greedily: what a
    chosen situation has is not counted again.
    """
    groups: list[_Combinations] = []
    heap: list[tuple[float, int, int]] = []
    chosen: list[WorldAction] = []
    for verb in range(len(bits.VERBS)):
        of_verb = [option for option in options if option.verb == verb]
        if not of_verb:
            continue
        around = np.array([option.surroundings for option in of_verb])
        allowed = ~forbidden(patterns, verb, around).any(axis=0)
        worked = _worked(examples, verb)
        if verb != ROTATE_LEFT:
            worked = np.concatenate([worked, mirrored(worked)])
        states = around[:, -1] % _OWN_PER_HEADING
        worked_states = worked[:, -1] % _OWN_PER_HEADING
        for state in np.unique(states[allowed]).tolist():
            places = np.flatnonzero(allowed & (states == state))
            group = _Combinations(
                [of_verb[place] for place in places.tolist()],
                around[places],
                worked[worked_states == state],
            )
            heap += [(-group.gain(place), len(groups), place) for place in range(len(places))]
            groups.append(group)
    heapify(heap)
    # A gain never grows, so that one that is still first after an update is the largest.
    while heap and len(chosen) < max_number:
        _, number, place = heappop(heap)
        group = groups[number]
        gain = group.gain(place)
        if gain <= 0:
            continue
        if heap and -gain > heap[0][0]:
            heappush(heap, (-gain, number, place))
            continue
        group.take(place)
        chosen.append(group.options[place].situation)
    return chosen


def _worked(examples: Iterable[Example], verb: int) -> NDArray[np.int64]:
    """Return the surroundings (n, N_CELLS + 1) of a verb's examples that worked."""
    rows = [example.surroundings for example in examples if example.verb == verb and example.worked]
    return np.array(rows, np.int64).reshape(-1, bits.N_CELLS + 1)


class _Combinations:
    """Which two things near a car were never there together when a verb worked, for one state of the car."""

    def __init__(
        self,
        options: Sequence[Option],
        around: NDArray[np.int64],
        worked: NDArray[np.int64],
    ) -> None:
        self.options = options
        has = _near_bits(around)
        columns = np.flatnonzero(has.any(axis=0))
        self._has = [np.flatnonzero(row) for row in has[:, columns]]
        self._weights = _COLUMN_WEIGHTS[columns]
        before = _near_bits(worked)[:, columns].astype(np.float32)
        self._is_open = before.T @ before == 0

    def gain(self, place: int) -> float:
        """Return the weight of the combinations of an option that are open."""
        columns = self._has[place]
        weights = self._weights[columns]
        return float(weights @ self._is_open[np.ix_(columns, columns)] @ weights)

    def take(self, place: int) -> None:
        """Count the combinations of an option no more."""
        columns = self._has[place]
        self._is_open[np.ix_(columns, columns)] = False


def _near_cells() -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the numbers of the cells that count, and the weight of each."""
    numbers = []
    weights = []
    for cell in range(bits.N_CELLS):
        forward, remaining = divmod(cell, bits.SIDE * _LEVELS)
        aside, up = divmod(remaining, _LEVELS)
        ahead_or_aside = (abs(forward - bits.REACH_CELLS), abs(aside - bits.REACH_CELLS))
        if max(ahead_or_aside) <= _NEAR_CELLS:
            numbers.append(cell)
            weights.append(0.5 ** (sum(ahead_or_aside) + abs(up + bits.LOWEST)))
    return np.array(numbers), np.array(weights)


_CELLS, _CELL_WEIGHTS = _near_cells()
_COLUMN_WEIGHTS: Final = np.repeat(_CELL_WEIGHTS, bits.N_BITS)


def _near_bits(surroundings: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return (n, columns): which bits each near cell has, but for those that say that nothing is there."""
    cells = surroundings[:, _CELLS] & ~_EMPTY
    has = cells[:, :, None] >> np.arange(bits.N_BITS) & 1
    return has.astype(np.bool_).reshape(len(surroundings), len(_COLUMN_WEIGHTS))
