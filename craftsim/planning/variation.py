"""Neighbours of a plan: the same turns in the same order but for one or two of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from craftsim.discrete.grid import Piece
from craftsim.planning.building import Turn

_CUT: Final = 0.25
"""So often all is decided anew from some turn on."""
_CRITICAL: Final = 0.7
"""So often it is a turn on which the makespan depends that changes."""
_ONE: Final = 0.7
"""So often one change is enough, and so often one more is..."""
_CHANGES: Final = 8
"""...up to so many."""


Turns = list[Turn | None]
"""What is tried turn after turn; None: whatever seems best then."""

Change = Callable[[Turns, int, Sequence[Piece], int, np.random.Generator], None]
"""Changes the turn with a number, in place."""


def vary(
    turns: Sequence[Turn],
    critical: Sequence[int],
    things: Sequence[Piece],
    n_cars: int,
    rng: np.random.Generator,
) -> tuple[int, Turns]:
    """Return how many turns stay as they are, and those that are tried after them.

    Args:
        turns: of a plan, at least one.
        critical: which of them the makespan depends on.
        things: those of the start; one may be used in place of another.
        n_cars: how many cars there are.
        rng: decides what changes.
    """
    chosen = critical if critical and rng.random() < _CRITICAL else range(len(turns))
    i = chosen[int(rng.integers(len(chosen)))]
    if rng.random() < _CUT:
        return i, []
    new: Turns = list(turns)
    for _ in range(_CHANGES):
        change = _WAYS[int(rng.integers(len(_WAYS)))]
        change(new, i, things, n_cars, rng)
        if not new or (new != list(turns) and rng.random() < _ONE):
            break
        i = int(rng.integers(len(new)))
    same = [mine == its for mine, its in zip(turns, new, strict=False)]
    n_kept = same.index(False) if False in same else len(same)
    return n_kept, new[n_kept:]


def _other_car(turns: Turns, i: int, things: Sequence[Piece], n_cars: int, rng: np.random.Generator) -> None:
    if turn := turns[i]:
        turns[i] = turn._replace(car=int(rng.integers(n_cars)))


def _swap_cars(turns: Turns, i: int, things: Sequence[Piece], n_cars: int, rng: np.random.Generator) -> None:
    j = int(rng.integers(len(turns)))
    if (one := turns[i]) and (other := turns[j]):
        turns[i], turns[j] = one._replace(car=other.car), other._replace(car=one.car)


def _move(turns: Turns, i: int, things: Sequence[Piece], n_cars: int, rng: np.random.Generator) -> None:
    turns.insert(int(rng.integers(len(turns))), turns.pop(i))


def _drop(turns: Turns, i: int, things: Sequence[Piece], n_cars: int, rng: np.random.Generator) -> None:
    turns.pop(i)


def _anything(turns: Turns, i: int, things: Sequence[Piece], n_cars: int, rng: np.random.Generator) -> None:
    turns[i] = None


def _other_source(
    turns: Turns, i: int, things: Sequence[Piece], n_cars: int, rng: np.random.Generator
) -> None:
    """Use another thing of the same kind; who would have used that takes this one."""
    changed = turns[i]
    mine = changed and changed.delivery.source
    others = [thing for thing in things if mine and thing.load == mine.load and thing != mine]
    if not changed or not others:
        return
    other = others[int(rng.integers(len(others)))]
    for j, turn in enumerate(turns):
        if turn and turn.delivery.source == other:
            turns[j] = turn._replace(delivery=replace(turn.delivery, source=mine))
    turns[i] = changed._replace(delivery=replace(changed.delivery, source=other))


_WAYS: Final[tuple[Change, ...]] = (_other_car, _swap_cars, _move, _drop, _anything, _other_source)
