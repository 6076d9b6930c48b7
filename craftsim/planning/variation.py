"""Neighbours of a plan: the same turns but for one or two of them."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from craftsim.planning.building import Turn
from craftsim.planning.things import BuildingPart

CUT = float(os.environ.get("CUT", 0.25))
CRIT = float(os.environ.get("CRIT", 0.7))
P1 = float(os.environ.get("P1", 0.7))


def vary(
    turns: Sequence[Turn], critical: Sequence[int], things: Sequence[BuildingPart], n_cars: int, rng: np.random.Generator
) -> tuple[int, list[Turn]]:
    """Return how many turns stay as they are, and those that come after them.

    Args:
        turns: of a plan, at least one.
        things: those of the start, of which others may be used.
        n_cars: how many cars there are.
        rng: decides what changes.
    """
    if rng.random() < CUT:
        if critical and rng.random() < CRIT:
            return critical[int(rng.integers(len(critical)))], []
        return int(rng.integers(len(turns))), []
    new = list(turns)
    for n in range(8):
        if not new:
            break
        i = int(rng.integers(len(new)))
        if new == list(turns) and critical and rng.random() < CRIT:
            i = critical[int(rng.integers(len(critical)))]
        _CHANGES[int(rng.integers(len(_CHANGES)))](new, i, things, n_cars, rng)
        if new != list(turns) and rng.random() < P1:
            break
    kept = next((i for i, (a, b) in enumerate(zip(turns, new)) if a != b), min(len(turns), len(new)))
    return kept, new[kept:]


def _other_car(turns, i, things, n_cars, rng):
    turns[i] = turns[i]._replace(car=int(rng.integers(n_cars)))


def _swap_cars(turns, i, things, n_cars, rng):
    j = int(rng.integers(len(turns)))
    turns[i], turns[j] = turns[i]._replace(car=turns[j].car), turns[j]._replace(car=turns[i].car)


def _move(turns, i, things, n_cars, rng):
    j = int(rng.integers(len(turns)))
    turns.insert(j, turns.pop(i))


def _drop(turns, i, things, n_cars, rng):
    turns.pop(i)


def _other_source(turns, i, things, n_cars, rng):
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
