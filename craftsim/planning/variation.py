"""Neighbours of a plan: the same turns but for one or two of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from craftsim.planning.building import Turn
from craftsim.planning.things import BuildingPart


def vary(
    turns: Sequence[Turn], things: Sequence[BuildingPart], n_cars: int, rng: np.random.Generator
) -> tuple[int, list[Turn]]:
    """Return how many turns stay as they are, and those that come after them.

    Args:
        turns: of a plan, at least one.
        things: those of the start, of which others may be used.
        n_cars: how many cars there are.
        rng: decides what changes.
    """
    if rng.random() < 0.25:
        return int(rng.integers(len(turns))), []
    new = list(turns)
    for _ in range(1 + int(rng.geometric(0.6) - 1)):
        if new:
            _CHANGES[int(rng.integers(len(_CHANGES)))](new, things, n_cars, rng)
    kept = next((i for i, (a, b) in enumerate(zip(turns, new)) if a != b), min(len(turns), len(new)))
    return kept, new[kept:]


def _other_car(turns, things, n_cars, rng):
    i = int(rng.integers(len(turns)))
    turns[i] = turns[i]._replace(car=int(rng.integers(n_cars)))


def _swap_cars(turns, things, n_cars, rng):
    i, j = rng.integers(len(turns), size=2).tolist()
    turns[i], turns[j] = turns[i]._replace(car=turns[j].car), turns[j]._replace(car=turns[i].car)


def _move(turns, things, n_cars, rng):
    i, j = rng.integers(len(turns), size=2).tolist()
    turns.insert(j, turns.pop(i))


def _drop(turns, things, n_cars, rng):
    turns.pop(int(rng.integers(len(turns))))


def _other_source(turns, things, n_cars, rng):
    i = int(rng.integers(len(turns)))
    mine = turns[i].job.source
    if mine is None:
        return
    others = [t for t in things if t.load == mine.load and t != mine]
    if not others:
        return
    other = others[int(rng.integers(len(others)))]
    for j, turn in enumerate(turns):
        if turn.job.source == other:
            turns[j] = turn._replace(job=replace(turn.job, source=mine))
    turns[i] = turns[i]._replace(job=replace(turns[i].job, source=other))


_CHANGES = (_other_car, _swap_cars, _move, _drop, _other_source)
