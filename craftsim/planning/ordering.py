"""The search for an order of assembly, backwards from the finished building."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from craftsim.discrete.grid import Kind, Piece
from craftsim.planning.assembly import Assembly, Order, Placing, State, ramp_places

_TRIES = 200
"""Steps backwards that a search may take beyond six for each thing..."""
_SEARCHES = 12
"""...before it begins anew, in another order, so many times."""


def find_order(
    assembly: Assembly, goal: State, fixed: State, n_slopes: int, rng: np.random.Generator
) -> Order | None:
    """Return an order in which the things of a goal can be put to their places, or None if none is found.

    Args:
        assembly: the rules of the building site.
        goal: the finished building.
        fixed: those of its things that stand already.
        n_slopes: how many slopes there are; those that the goal does not have may serve for building.
        rng: decides between steps that are equally good.
    """
    for i in range(_SEARCHES):
        path = _search(assembly, goal, fixed, n_slopes, rng, from_below=i % 4 == 3)
        if path is not None:
            return Order(tuple(reversed(path)))
    return None


def _search(
    assembly: Assembly, goal: State, fixed: State, n_slopes: int, rng: np.random.Generator, from_below: bool
) -> list[Placing] | None:
    """Return the steps from the last to the first; ``from_below``: the lowest level may go while others stand."""

    def options(state: State) -> Iterator[Placing]:
        return _options(assembly, state, fixed, n_slopes, rng, from_below)

    seen: set[State] = {goal}
    path: list[Placing] = []
    states, branches = [goal], [options(goal)]
    for _ in range(_TRIES + 6 * len(goal)):
        if states[-1] == fixed:
            return path
        step = next(branches[-1], None)
        if step is None:
            branches.pop()
            states.pop()
            if not branches:
                return None
            path.pop()
            continue
        before = _before(states[-1], step)
        if before not in seen:
            seen.add(before)
            path.append(step)
            states.append(before)
            branches.append(options(before))
    return None


def _before(state: State, step: Placing) -> State:
    """Return what stood before a step."""
    return state | {step.thing} if step.taken else state - {step.thing}


def _options(
    assembly: Assembly, state: State, fixed: State, n_slopes: int, rng: np.random.Generator, from_below: bool
) -> Iterator[Placing]:
    """Yield the steps that may have come last, the likeliest first."""
    rest = sorted(state - fixed)
    rest = [rest[i] for i in rng.permutation(len(rest))]
    n_ramps = sum(thing.load == Kind.FSLOPE for thing in state)
    highest = max((thing.cell[2] for thing in rest if thing.kind != Kind.BODY), default=0)
    # A ramp goes as soon as it leads nowhere that is still to be built.
    useless = [thing for thing in rest if thing.kind == Kind.BODY and thing.cell[2] >= highest]
    things = [thing for thing in rest if thing.kind != Kind.BODY]
    upper = [thing for thing in things if thing.cell[2] > 1]
    for thing in useless:
        step = Placing(thing)
        if assembly.possible(state - {thing}, step):
            yield step
    barren: dict[Placing, None] = {}
    for level in range(highest, 1, -1):
        here = [thing for thing in upper if thing.cell[2] == level]
        for thing in here:
            step = Placing(thing)
            if assembly.possible(state - {thing}, step):
                yield step
        if n_ramps < n_slopes and here:
            for step, serves in _ramps(assembly, state, here, rng):
                if serves:
                    yield step
                else:
                    barren[step] = None
    # A ramp elsewhere may do; the floor level comes last, for what stands on it is driven on.
    ramps = [thing for thing in rest if thing.kind == Kind.BODY and thing not in useless]
    for thing in ramps:
        step = Placing(thing)
        if assembly.possible(state - {thing}, step):
            yield step
    yield from barren
    if from_below or not upper:
        for thing in things:
            step = Placing(thing)
            if thing not in upper and assembly.possible(state - {thing}, step):
                yield step


def _ramps(
    assembly: Assembly, state: State, upper: list[Piece], rng: np.random.Generator
) -> Iterator[tuple[Placing, bool]]:
    """Yield ramps that may have been taken away last, and whether something is in reach with each."""
    places = list(ramp_places(assembly.grid(state), assembly.rules))
    for i in rng.permutation(len(places)):
        before = state | {places[i]}
        step = Placing(places[i], taken=True)
        if assembly.possible(before, step):
            yield step, any(assembly.possible(before - {thing}, Placing(thing)) for thing in upper)
