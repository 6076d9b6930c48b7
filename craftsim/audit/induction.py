"""Patterns that separate actions that fail from those that work: the fewest that cover all failures and no success.

A pattern is grown from one failure: from no condition at all, one is added at a time that keeps as many failures and as
few successes as it can (as FOIL does, Quinlan 1990), until no success is left. It is then made minimal: each condition
is dropped, and each widened to what alternative failures show, while it still covers no success. Patterns are chosen
greedily by the number of failures that no earlier one covers, as sets that cover.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from craftsim.audit.examples import ROTATE_LEFT, Example, mirrored
from craftsim.discrete.kernel import patterns as bits
from craftsim.discrete.learned import CAR_PROPERTIES, CAR_STATES

_BITS: Final = bits.N_BITS
_N_CELL_COLUMNS: Final = bits.N_CELLS * _BITS
_CELLS_SHAPE: Final = (bits.SIDE, bits.SIDE, bits.HIGHEST - bits.LOWEST + 1)
"""Numbers of cells ahead, to the left and up."""
_GROUPS: Final = (
    range(bits.N_THINGS),
    range(bits.CAR_BIT, bits.GEAR_BIT),
    range(bits.GEAR_BIT, bits.LEAN_BIT),
    range(bits.LEAN_BIT, _BITS),
)
"""Bits of a cell that a condition may list together."""
_EMPTY_BITS: Final = (0, 1, 2)
"""Air, outside and ground, which conditions name last."""
_OCCASIONAL: Final = 0.02
"""Share of successes that a pattern may cover: those of a physics that does not always fail."""
_MOST_CONDITIONS: Final = 8
_NEAR_MISS_WEIGHT: Final = 20.0
_COVERED_WEIGHT: Final = 0.05
"""Of a failure that another pattern covers already."""
_SEEDS: Final = 6
"""Failures from each of which a pattern is grown, of which the one that covers most is taken."""
_EMPTY_WEIGHT: Final = 0.7
_DISTANCE_WEIGHT: Final = 0.03


def _car_columns() -> tuple[list[range], NDArray[np.bool_]]:
    """Return the columns of each property of a car, and which of them each of its states has."""
    groups = []
    start = 0
    values: list[tuple[str, str]] = []
    for name, allowed in CAR_PROPERTIES.items():
        groups.append(range(start, start + len(allowed)))
        values += [(name, value) for value in allowed]
        start += len(allowed)
    table = np.zeros((bits.N_OWN, len(values)), np.bool_)
    for state, properties in enumerate(CAR_STATES):
        for column, (name, value) in enumerate(values):
            table[state, column] = properties[name] == value
    return groups, table


_CAR_GROUPS, _CAR_TABLE = _car_columns()
_N_COLUMNS: Final = _N_CELL_COLUMNS + _CAR_TABLE.shape[1]


@dataclass(frozen=True)
class Pattern:
    """A pattern of one verb: conditions, each a set of columns of which an example has at least one."""

    verb: int
    conditions: tuple[frozenset[int], ...]

    @property
    def cells(self) -> list[tuple[int, int]]:
        """The number of a cell, and the bits that it has at least one of, of each condition on a cell."""
        cells = []
        for condition in self.conditions:
            column = min(condition)
            if column < _N_CELL_COLUMNS:
                allowed = 0
                for alternative in condition:
                    allowed |= 1 << (alternative % _BITS)
                cells.append((column // _BITS, allowed))
        return sorted(cells)

    @property
    def car(self) -> dict[str, tuple[str, ...]]:
        """The values that properties of the car may have."""
        values: dict[str, tuple[str, ...]] = {}
        for condition in self.conditions:
            columns = {column - _N_CELL_COLUMNS for column in condition}
            for (name, allowed), group in zip(CAR_PROPERTIES.items(), _CAR_GROUPS, strict=True):
                if columns <= set(group):
                    listed = {allowed[column - group.start] for column in columns}
                    remaining = values.get(name, allowed)
                    values[name] = tuple(value for value in remaining if value in listed)
        return values


def _group_of(column: int) -> int:
    bit = column % _BITS
    for number, group in enumerate(_GROUPS):
        if bit in group:
            return number
    raise ValueError(f"no column {column}")


def _group_columns(column: int) -> NDArray[np.int64]:
    """Return the columns that a condition may list together with one."""
    if column >= _N_CELL_COLUMNS:
        for group in _CAR_GROUPS:
            if column - _N_CELL_COLUMNS in group:
                return np.array(group) + _N_CELL_COLUMNS
    group = _GROUPS[_group_of(column)]
    return np.array(group) + column // _BITS * _BITS


def _weights() -> NDArray[np.float64]:
    """Return how much is thought of each column: things nearby most."""
    weights = np.ones(_N_COLUMNS)
    side = bits.SIDE
    levels = bits.HIGHEST - bits.LOWEST + 1
    for cell in range(bits.N_CELLS):
        forward, remaining = divmod(cell, side * levels)
        aside, up = divmod(remaining, levels)
        distance = (
            abs(forward - bits.REACH_CELLS) + abs(aside - bits.REACH_CELLS) + abs(up + bits.LOWEST)
        )
        first = cell * _BITS
        weights[first : first + _BITS] = 1 - _DISTANCE_WEIGHT * distance
        for bit in _EMPTY_BITS:
            weights[first + bit] *= _EMPTY_WEIGHT
    return weights


_WEIGHTS: Final = _weights()


def matrix_of(surroundings: NDArray[np.int64]) -> csr_array:
    """Return which columns each of some surroundings (n, N_CELLS + 1) has, (n, columns)."""
    rows = []
    columns = []
    cells = surroundings[:, :-1]
    for bit in range(_BITS):
        row, cell = np.nonzero(cells >> bit & 1)
        rows.append(row)
        columns.append(cell * _BITS + bit)
    row, column = np.nonzero(_CAR_TABLE[surroundings[:, -1]])
    rows.append(row)
    columns.append(column + _N_CELL_COLUMNS)
    places = (np.concatenate(rows), np.concatenate(columns))
    entries = np.ones(len(places[0]), np.float32)
    return csr_array((entries, places), shape=(len(surroundings), _N_COLUMNS))


@dataclass
class ExampleSet:
    """All examples of one verb, those with equal surroundings as one."""

    verb: int
    surroundings: NDArray[np.int64]
    """(n, N_CELLS + 1), mirror images included."""
    failures: NDArray[np.int64]
    """(n,): how many failed."""
    successes: NDArray[np.int64]
    """(n,): how many worked."""
    importance: NDArray[np.float64]
    """(n,): how much these count where conditions are chosen: more where they are near misses."""
    images: NDArray[np.int64] | None = None
    """(n,): the place of each one's mirror image; None where there are none."""

    @classmethod
    def of(cls, verb: int, examples: Iterable[Example], both_sides: bool = True) -> ExampleSet:
        """Return the examples of a verb; with ``both_sides`` each as its mirror image, too.

        Turns to the right are mirror images of turns to the left anyway.
        """
        chosen = [example for example in examples if example.verb == verb]
        surroundings = np.array([example.surroundings for example in chosen], np.int64)
        surroundings = surroundings.reshape(-1, bits.N_CELLS + 1)
        worked = np.array([example.worked for example in chosen], np.bool_)
        is_near = np.array([example.is_near_miss for example in chosen], np.bool_)
        if both_sides and verb != ROTATE_LEFT:
            surroundings = np.concatenate([surroundings, mirrored(surroundings)])
            worked = np.concatenate([worked, worked])
            is_near = np.concatenate([is_near, is_near])
        distinct, numbers = np.unique(surroundings, axis=0, return_inverse=True)
        numbers = numbers.ravel()
        failures = np.bincount(numbers[~worked], minlength=len(distinct))
        successes = np.bincount(numbers[worked], minlength=len(distinct))
        weights = np.where(is_near, _NEAR_MISS_WEIGHT, 1.0)
        importance = np.bincount(numbers[worked], weights[worked], len(distinct)).astype(float)
        images = None
        if both_sides and verb != ROTATE_LEFT:
            half = len(numbers) // 2
            images = np.empty(len(distinct), np.int64)
            images[numbers[:half]] = numbers[half:]
            images[numbers[half:]] = numbers[:half]
        return cls(verb, distinct, failures, successes, importance, images)

    def __post_init__(self) -> None:
        self.matrix = matrix_of(self.surroundings)
        self._by_column = self.matrix.tocsc()

    def has(self, columns: Iterable[int]) -> NDArray[np.bool_]:
        """Return (n,): which examples have at least one of some columns."""
        result = np.zeros(len(self.surroundings), np.bool_)
        starts = self._by_column.indptr
        for column in columns:
            result[self._by_column.indices[starts[column] : starts[column + 1]]] = True
        return result

    def matches(self, conditions: Iterable[Iterable[int]]) -> NDArray[np.bool_]:
        """Return (n,): which examples have all conditions."""
        result = np.ones(len(self.surroundings), np.bool_)
        for condition in conditions:
            result &= self.has(condition)
        return result

    def covers(self, conditions: Iterable[Iterable[int]]) -> NDArray[np.bool_]:
        """Return (n,): which examples a pattern or its mirror image matches."""
        matched = self.matches(conditions)
        if self.images is None:
            return matched
        return matched | matched[self.images]

    def allows(self, covered: NDArray[np.bool_]) -> bool:
        """Return whether a pattern that covers these examples costs few enough successes."""
        n_failures = int(self.failures[covered].sum())
        return int(self.successes[covered].sum()) <= _OCCASIONAL * n_failures


def fit(
    examples: ExampleSet,
    rng: np.random.Generator,
    on_pattern: Callable[[int], None] = lambda n: None,
) -> tuple[list[Pattern], NDArray[np.bool_]]:
    """Return patterns that cover the failures, and (n,) which examples with failures none covers.

    ``on_pattern`` is called with the number of failures that are not covered yet.
    """
    chosen: list[tuple[frozenset[int], ...]] = []
    # What mostly works is no failure to explain, but chance.
    failing = examples.failures > examples.successes
    uncovered = failing.copy()
    hopeless = np.zeros_like(uncovered)
    while (uncovered & ~hopeless).any():
        candidates = np.flatnonzero(uncovered & ~hopeless)
        best: tuple[frozenset[int], ...] | None = None
        largest = 0
        for seed in rng.choice(candidates, min(_SEEDS, len(candidates)), replace=False).tolist():
            conditions = _grown(examples, seed, uncovered)
            if conditions is None:
                hopeless[seed] = True
                continue
            conditions = _minimal(examples, conditions)
            gain = int(examples.failures[uncovered & examples.covers(conditions)].sum())
            if gain > largest:
                largest = gain
                best = conditions
        if best is None:
            continue
        chosen.append(best)
        uncovered &= ~examples.covers(best)
        on_pattern(int(examples.failures[uncovered].sum()))
    chosen = _without_spare(examples, chosen, failing)
    patterns = [Pattern(examples.verb, conditions) for conditions in chosen]
    return patterns, uncovered


def _grown(
    examples: ExampleSet, seed: int, uncovered: NDArray[np.bool_]
) -> tuple[frozenset[int], ...] | None:
    """Return conditions that a failure has and successes have not; None if there are none."""
    starts = examples.matrix.indptr
    seed_columns = examples.matrix.indices[starts[seed] : starts[seed + 1]]
    conditions: list[frozenset[int]] = []
    current = np.ones(len(uncovered), np.bool_)
    while not examples.allows(current):
        if len(conditions) == _MOST_CONDITIONS:
            return None
        rows = np.flatnonzero(current)
        matched = examples.matrix[rows]
        of_failures = examples.failures[rows] * np.where(uncovered[rows], 1.0, _COVERED_WEIGHT)
        n_failures = matched.T @ of_failures.astype(np.float32)
        n_successes = matched.T @ examples.importance[rows].astype(np.float32)
        condition = _best_condition(
            seed_columns,
            n_failures,
            n_successes,
            float(of_failures.sum()),
            float(examples.importance[rows].sum()),
        )
        if condition is None:
            return None
        conditions.append(condition)
        current &= examples.has(condition)
    return tuple(conditions)


def _best_condition(
    seed_columns: NDArray[np.int64],
    failures: NDArray[np.float32],
    successes: NDArray[np.float32],
    all_failures: float,
    all_successes: float,
) -> frozenset[int] | None:
    """Return the condition with the largest gain of information that a failure with these columns meets."""
    best = None
    largest = 0.0
    before = np.log2(all_failures / (all_failures + all_successes))
    own_failures = failures[seed_columns]
    own_successes = successes[seed_columns]
    # A condition of one column that rules nothing out gains nothing, whatever is listed with it.
    useful = own_successes < all_successes
    after = np.log2(own_failures / (own_failures + own_successes))
    scores = own_failures * (after - before) * _WEIGHTS[seed_columns]
    order = np.argsort(-scores)
    for place in order[:12].tolist():
        if not useful[place]:
            continue
        column = int(seed_columns[place])
        group = _group_columns(column)
        # What fails here more often than this column does belongs to it.
        ratio = successes[column] / failures[column]
        listed = group[(failures[group] > 0) & (successes[group] <= ratio * failures[group])]
        condition = {column, *listed.tolist()}
        kept_failures = min(float(failures[list(condition)].sum()), all_failures)
        kept_successes = float(successes[list(condition)].sum())
        after_both = np.log2(kept_failures / (kept_failures + kept_successes))
        gain = kept_failures * (after_both - before) * _WEIGHTS[column]
        if kept_successes < all_successes and gain > largest:
            largest = gain
            best = frozenset(condition)
    return best


def _minimal(
    examples: ExampleSet, conditions: tuple[frozenset[int], ...]
) -> tuple[frozenset[int], ...]:
    """Return conditions of which none can be dropped, or widened to what failures show, without covering successes."""
    remaining = list(conditions)
    changed = True
    while changed:
        changed = False
        for condition in sorted(remaining, key=_need):
            alternatives = [
                alternative for alternative in remaining if alternative is not condition
            ]
            if alternatives and examples.allows(examples.matches(alternatives)):
                remaining = alternatives
                changed = True
                break
    for number, condition in enumerate(remaining):
        alternatives = remaining[:number] + remaining[number + 1 :]
        context = examples.matches(alternatives)
        widened = set(condition)
        for column in _group_columns(next(iter(condition))).tolist():
            covered = context & examples.has((column,))
            is_car = column >= _N_CELL_COLUMNS
            shows_failure = bool(examples.failures[covered].any())
            if column not in widened and (shows_failure or is_car) and examples.allows(covered):
                widened.add(column)
        remaining[number] = frozenset(widened)
    return tuple(remaining)


def _need(condition: frozenset[int]) -> float:
    """Return how much is thought of a condition; that of which least is thought is dropped first."""
    return float(max(_WEIGHTS[column] for column in condition))


def _without_spare(
    examples: ExampleSet,
    patterns: Sequence[tuple[frozenset[int], ...]],
    failing: NDArray[np.bool_],
) -> list[tuple[frozenset[int], ...]]:
    """Return patterns without those whose failures the others cover, too."""
    covered = [examples.covers(conditions) & failing for conditions in patterns]
    counts = np.sum(covered, axis=0) if covered else np.zeros(len(failing))
    remaining = []
    for conditions, matched in sorted(
        zip(patterns, covered, strict=True), key=lambda pair: int(examples.failures[pair[1]].sum())
    ):
        if (counts[matched] > 1).all():
            counts = counts - matched
        else:
            remaining.append(conditions)
    return remaining[::-1]


def forbidden(
    patterns: Sequence[Pattern], verb: int, surroundings: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """Return (patterns, n): whether each pattern of a verb, or its mirror image, matches some surroundings."""
    result = np.zeros((len(patterns), len(surroundings)), np.bool_)
    if not len(surroundings):
        return result
    sides = [surroundings]
    if verb != ROTATE_LEFT:
        sides.append(mirrored(surroundings))
    nothing = np.zeros(len(surroundings), np.int64)
    for side in sides:
        examples = ExampleSet(verb, side, nothing, nothing, nothing.astype(float))
        for number, pattern in enumerate(patterns):
            if pattern.verb == verb:
                result[number] |= examples.matches(pattern.conditions)
    return result


def cautious(examples: ExampleSet, pattern: Pattern) -> Pattern:
    """Return a pattern that also forbids what is like it and never worked: other things in each of its cells.

    What no trial shows to work is not allowed, as in safe action models (Stern and Juba 2017).
    """
    conditions = list(pattern.conditions)
    for number, condition in enumerate(conditions):
        columns = _group_columns(min(condition))
        if columns[0] >= _N_CELL_COLUMNS:
            continue
        context = examples.matches(conditions[:number] + conditions[number + 1 :])
        widened = set(condition)
        for column in columns.tolist():
            is_thing = column % _BITS not in _EMPTY_BITS
            if is_thing and not examples.successes[context & examples.has((column,))].any():
                widened.add(column)
        conditions[number] = frozenset(widened)
    return Pattern(pattern.verb, tuple(conditions))


def similar(patterns: Iterable[Pattern]) -> Iterator[Pattern]:
    """Yield patterns like some: with another thing in one of their cells, or the same in a cell beside it."""
    yielded = set[Pattern]()
    for pattern in patterns:
        for number, condition in enumerate(pattern.conditions):
            column = min(condition)
            if column >= _N_CELL_COLUMNS:
                continue
            alternatives = []
            for alternative in _group_columns(column).tolist():
                if alternative not in condition:
                    alternatives.append({alternative})
            for cell in _cells_beside(column // _BITS):
                moved = {cell * _BITS + alternative % _BITS for alternative in condition}
                alternatives.append(moved)
            for alternative in alternatives:
                conditions = list(pattern.conditions)
                conditions[number] = frozenset(alternative)
                conjecture = Pattern(pattern.verb, tuple(conditions))
                if conjecture not in yielded:
                    yielded.add(conjecture)
                    yield conjecture


def _cells_beside(cell: int) -> Iterator[int]:
    """Yield the numbers of the cells that have a side in common with one."""
    at = np.unravel_index(cell, _CELLS_SHAPE)
    for axis, size in enumerate(_CELLS_SHAPE):
        for step in (1, -1):
            neighbour = [int(coordinate) for coordinate in at]
            neighbour[axis] += step
            if 0 <= neighbour[axis] < size:
                yield int(np.ravel_multi_index(neighbour, _CELLS_SHAPE))
