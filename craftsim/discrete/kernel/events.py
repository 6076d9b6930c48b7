"""Asynchronous worlds, compiled: which actions may begin now, beginnings, and the next event."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from craftsim.compiled.jit import compiled
from craftsim.discrete.kernel.batch import NO_HELPER, Mask, Queues
from craftsim.discrete.kernel.claims import Claims, claims_of, conflict
from craftsim.discrete.kernel.codes import (
    FIRST_MOVE,
    FOLD,
    LAST_MOVE,
    LIFT,
    MOVE_DIRECTIONS,
    N_ACTIONS,
    STOP,
    UNFOLD,
)
from craftsim.discrete.kernel.rules import legal_actions
from craftsim.discrete.kernel.search import (
    SearchBuffers,
    due_of,
    moves_to_plan,
    plan_move,
    pop,
    write_path,
)
from craftsim.discrete.kernel.state import (
    AIR,
    BODY,
    F_Z,
    FOOT,
    FSLOPE,
    CarState,
    World,
    apply,
    dir_x,
    dir_y,
    kind_at,
    state_of_car,
)

DECIDES = -1
"""In place of an action: the car has none and decides."""
RUNS, BEGUN, WAITS, ILLEGAL, BLOCKED = range(5)
"""Outcomes of a decision: there was none to make, as the car's action runs; its action began; it waits by choice; or it
waits because the rules or a claim stand against the action."""


class Running(NamedTuple):
    """The actions that cars of B worlds do now, and their last decisions, by car."""

    action: NDArray[np.int64]
    """(B, n): the primitive or registered action, STOP while it waits, DECIDES while it has none."""
    began_s: NDArray[np.float64]
    """(B, n)."""
    ends_s: NDArray[np.float64]
    """(B, n): end of the action, of a wait the latest one; infinite where it is not known."""
    turn: NDArray[np.int64]
    """(B, n): the order in which a world's actions began."""
    fails: NDArray[np.bool_]
    """(B, n): true if it ends without effect."""
    claims: NDArray[np.int16]
    """(B, n, rows, 4)."""
    n_claims: NDArray[np.int64]
    """(B, n): rows of these; none while a car waits or decides."""
    requested: NDArray[np.int64]
    """(B, n): the action that each car asked for when it decided last."""
    outcome: NDArray[np.int64]
    """(B, n): the outcome of that; see above."""
    earned: NDArray[np.float64]
    """(B, n): the rewards since then."""
    decided: NDArray[np.int64]
    """(B,): number of decisions."""
    time_s: NDArray[np.float64]
    """(B,): now."""


class ActionDurations(NamedTuple):
    """Durations of the actions that begin now."""

    nominal_s: NDArray[np.float64]
    """(actions, 4): by action and situation, infinite where they are not known before an action ends."""
    factor: NDArray[np.float64]
    """(B, n): ratio to these, by car."""
    fails: NDArray[np.bool_]
    """(B, n): true if the action that a car begins now fails."""
    wait_s: float


class Ends(NamedTuple):
    """The actions that an event of B worlds has ended."""

    duration_s: NDArray[np.float64]
    """(B,): the time since the event before."""
    doing: NDArray[np.int64]
    """(B, n): the action of each car until then, as in Running."""
    ended: Mask
    """(B, n): cars whose actions have ended; waits count."""
    failed: Mask
    """(B, n): cars whose actions have ended without effect."""


@compiled
def moment(seconds: float) -> float:
    """Return a time rounded to microseconds: what ends together then ends at the same time, however it was added."""
    return math.floor(seconds * 1e6 + 0.5) / 1e6


@compiled
def _reach_of(w: World, car: CarState, action: int) -> int:
    """Return how many cells beside a car's way a legal action may claim any."""
    if car.load != AIR or (
        action in (LIFT, FOLD, UNFOLD) and kind_at(w, car.x, car.y, car.z) in (FSLOPE, BODY)
    ):
        return 3  # the neighbours of its load included
    if action == LIFT:
        return 1
    return 0


@compiled
def within(claim: NDArray[np.int16], x0: int, x1: int, y0: int, y1: int, z: int) -> bool:
    """Return whether a claim may be one against an action of a car at level z, of which these are the reaches."""
    return x0 <= claim[0] <= x1 and y0 <= claim[1] <= y1 and z - 2 <= claim[2] <= z + 3


@compiled
def _neighbours(w: World, running: Running, i: int, car: CarState) -> int:
    """Return which cars run what could stand against any action of a car, a bit each; the last bit is of many."""
    cars_near = 0
    # Onto a ramp a car claims what is 3 cells ahead.
    reach = max(
        3 if car.slope == 0 else 1, _reach_of(w, car, LIFT), _reach_of(w, car, FIRST_MOVE) + 1
    )
    x0 = car.x - reach
    x1 = car.x + reach
    y0 = car.y - reach
    y1 = car.y + reach
    for other_car in range(running.action.shape[1]):
        for k in range(running.n_claims[i, other_car]):
            if within(running.claims[i, other_car, k], x0, x1, y0, y1, car.z):
                cars_near |= 1 << min(other_car, 62)
                break
    return cars_near


@compiled
def blocked(
    w: World,
    running: Running,
    i: int,
    cars_near: int,
    car: CarState,
    action: int,
    row: Claims,
    count: int,
) -> bool:
    """Return whether a claim of what runs in a world stands against a legal action of a car.

    The cars of :func:`_neighbours` are looked at. The action's claims are the first ``count`` rows of ``row``
    (MOST, 4); with 0 they are written there when needed.
    """
    if cars_near == 0:
        return False
    reach = _reach_of(w, car, action)
    dx = 0
    dy = 0
    if FIRST_MOVE <= action <= LAST_MOVE:
        m = MOVE_DIRECTIONS[action - FIRST_MOVE]
        dx = dir_x(m)
        dy = dir_y(m)
        x = car.x + dx
        y = car.y + dy
        if car.slope == 0 and (
            kind_at(w, x, y, car.z) == FOOT or kind_at(w, x, y, car.z - 1) == BODY
        ):
            dx = 3 * dx
            dy = 3 * dy
    x0 = min(car.x, car.x + dx) - reach
    x1 = max(car.x, car.x + dx) + reach
    y0 = min(car.y, car.y + dy) - reach
    y1 = max(car.y, car.y + dy) + reach
    for other_car in range(running.action.shape[1]):
        if not cars_near & (1 << min(other_car, 62)):
            continue
        for k in range(running.n_claims[i, other_car]):
            claim = running.claims[i, other_car, k]
            if within(claim, x0, x1, y0, y1, car.z):
                if count == 0:
                    count = claims_of(w, car, action, row)
                if conflict(row, count, claim[0], claim[1], claim[2], claim[3]):
                    return True
    return False


@compiled
def offer(
    worlds: World,
    running: Running,
    row: Claims,
    plan: NDArray[np.int8],
    space: SearchBuffers,
    depth: int,
    out: Mask,
) -> None:
    """Turn on in out (B, n, 15) what each car that decides could begin now beside what runs; where that is nothing, and
    for the others, STOP.

    With a search depth moves are on, too, that the helper has a plan for whose first primitive can begin. ``row``
    (MOST, 4) and ``plan`` (depth + 1,) are scratch.
    """
    for i in range(worlds.cells.shape[0]):
        w = World(worlds.cells[i], worlds.cars[i], worlds.corrections, worlds.patterns)
        for car in range(w.cars.shape[0]):
            offers = False
            if running.action[i, car] == DECIDES:
                state = state_of_car(w, car)
                legal = legal_actions(w, car, state, 0, N_ACTIONS - 1)
                cars_near = _neighbours(w, running, i, state)
                for action in range(N_ACTIONS):
                    if legal & (1 << action) and (
                        action == STOP
                        or not blocked(w, running, i, cars_near, state, action, row, 0)
                    ):
                        out[i, car, action] = offers = True
                to_plan = moves_to_plan(w, car, space, legal, depth) if depth != NO_HELPER else 0
                for m in range(4):
                    node = (
                        plan_move(w, car, space, FIRST_MOVE + m, depth)
                        if to_plan & (1 << m)
                        else -1
                    )
                    if node >= 0:
                        write_path(space, node, plan)
                        first = int(np.int64(plan[0]))
                        if not blocked(w, running, i, cars_near, state, first, row, 0):
                            out[i, car, FIRST_MOVE + m] = offers = True
            if not offers:
                out[i, car, STOP] = True


@compiled
def decide(
    worlds: World,
    running: Running,
    queues: Queues,
    space: SearchBuffers,
    depth: int,
    durations: ActionDurations,
    order: NDArray[np.int64],
    actions: NDArray[np.int64],
    first: int,
    end: int,
    out: NDArray[np.int64],
) -> None:
    """Let the cars order[i] of the worlds from ``first`` to ``end`` begin what they have decided on, in their order.

    ``actions`` and ``out`` are by car, (B, n); out tells what became of each decision, and stays for other cars. The
    worlds, committed ones, have the effects of what has begun from here on, but marks are not derived.
    """
    for i in range(first, end):
        w = World(worlds.cells[i], worlds.cars[i], worlds.corrections, worlds.patterns)
        now_s = running.time_s[i]
        turn = 0
        for car in range(w.cars.shape[0]):
            turn = max(turn, running.turn[i, car])
        for place in range(order.shape[1]):
            car = order[i, place]
            if running.action[i, car] != DECIDES:
                continue
            due = actions[i, car]
            queued = queues[i, car, 0] >= 0
            if depth != NO_HELPER:
                due = due_of(w, car, due, queues[i, car], space, depth)
            turn += 1
            result = WAITS
            end_s = now_s + durations.wait_s
            if due == STOP:
                result = WAITS if actions[i, car] == STOP or queued else ILLEGAL
            else:
                state = state_of_car(w, car)
                result = ILLEGAL
                if due < N_ACTIONS and legal_actions(w, car, state, due, due) & (1 << due):
                    claims = running.claims[i, car]
                    count = claims_of(w, state, due, claims)
                    result = BLOCKED
                    if not blocked(w, running, i, -1, state, due, claims, count):
                        result = BEGUN
                        apply(w, car, due)
                        running.n_claims[i, car] = count
                        sloping = state.slope > 0 or state_of_car(w, car).slope > 0
                        column = 0
                        if sloping:
                            column += 2
                        if state.load != AIR:
                            column += 1
                        end_s = now_s + durations.nominal_s[due, column] * durations.factor[i, car]
            if depth != NO_HELPER and due != STOP:
                if result == BEGUN:
                    if queues[i, car, 0] >= 0:
                        pop(queues[i, car])
                elif result == ILLEGAL or not queued:
                    queues[i, car, :] = -1
            running.turn[i, car] = turn
            running.action[i, car] = STOP
            if result == BEGUN:
                running.action[i, car] = due
            note_decision(running, durations, i, car, actions[i, car], result, end_s)
            out[i, car] = result


@compiled
def note_decision(
    running: Running,
    durations: ActionDurations,
    i: int,
    car: int,
    requested: int,
    result: int,
    end_s: float,
) -> None:
    """Write down a decision, whatever became of it."""
    running.began_s[i, car] = running.time_s[i]
    running.ends_s[i, car] = moment(end_s) if end_s < math.inf else end_s
    running.fails[i, car] = result == BEGUN and durations.fails[i, car]
    running.requested[i, car] = requested
    running.outcome[i, car] = result
    running.earned[i, car] = 0.0
    running.decided[i] += 1


@compiled
def following(running: Running, i: int, ended: Mask, turn: int) -> int:
    """Return the car of a world whose action began next after a turn, of those that have ``ended``; -1 for none."""
    first = -1
    for car in range(running.action.shape[1]):
        later = ended[i, car] and running.turn[i, car] > turn
        if later and (first < 0 or running.turn[i, car] < running.turn[i, first]):
            first = car
    return first


@compiled
def advance(worlds: World, running: Running, queues: Queues, ends: Ends) -> None:
    """Advance each world, in which no car decides, to its next event.

    What has ended changes the worlds, confirmed ones, in the order in which it began; a wait ends with any event.
    Registered actions change nothing here, and marks are not derived.
    """
    n_cars = running.action.shape[1]
    for i in range(worlds.cells.shape[0]):
        now_s = running.ends_s[i, 0]
        for car in range(1, n_cars):
            now_s = min(now_s, running.ends_s[i, car])
        ends.duration_s[i] = moment(now_s - running.time_s[i])
        running.time_s[i] = now_s
        for car in range(n_cars):
            ends.doing[i, car] = running.action[i, car]
            ends.ended[i, car] = running.action[i, car] == STOP or running.ends_s[i, car] <= now_s
            ends.failed[i, car] = ends.ended[i, car] and running.fails[i, car]
        w = World(worlds.cells[i], worlds.cars[i], worlds.corrections, worlds.patterns)
        car = following(running, i, ends.ended, 0)
        while car >= 0:
            if ends.failed[i, car]:
                queues[i, car, :] = -1
            elif running.action[i, car] < STOP:
                apply(w, car, running.action[i, car])
            running.action[i, car] = DECIDES
            running.n_claims[i, car] = 0
            car = following(running, i, ends.ended, running.turn[i, car])


@compiled
def close(
    running: Running,
    offered: NDArray[np.int8],
    ended: Mask,
    done: Mask,
    elapsed_s: NDArray[np.float64],
    earned: NDArray[np.float64],
    waited: Mask,
) -> None:
    """Write of each decision that has ended, or whose episode is ``done`` (B,), the time since then and what it has
    earned, 0 for the others (B, n); and in which worlds there may be a deadlock.

    That takes that all cars have waited, or are lost. Where none was offered anything else, (B, n, actions), that is so
    still, and where one has asked in vain it can ask again.
    """
    for i in range(done.shape[0]):
        waited[i] = True
        vain = False
        stuck = True
        for car in range(running.action.shape[1]):
            elapsed_s[i, car] = earned[i, car] = 0.0
            if ended[i, car] or done[i]:
                elapsed_s[i, car] = moment(running.time_s[i] - running.began_s[i, car])
                earned[i, car] = running.earned[i, car]
            outcome = running.outcome[i, car]
            lost = running.action[i, car] == STOP and running.ends_s[i, car] == math.inf
            waited[i] = waited[i] and (outcome in (WAITS, ILLEGAL) or lost)
            vain = vain or outcome == ILLEGAL
        if waited[i] and not vain:
            for car in range(offered.shape[1]):
                for action in range(offered.shape[2]):
                    stuck = stuck and (action == STOP or offered[i, car, action] == 0)
        waited[i] = waited[i] and (vain or stuck)


@compiled
def stands_against(
    w: World, running: Running, i: int, car: int, action: int, other_car: int, row: Claims
) -> bool:
    """Return whether another car of world i is in the way of an action of the 15: a claim of it, or where it is.

    The latter means that the rules forbid the action, and would not if that car were not there. ``row`` (MOST, 4) is
    scratch.
    """
    state = state_of_car(w, car)
    bit = 1 << action
    if legal_actions(w, car, state, action, action) & bit:
        count = claims_of(w, state, action, row)
        for k in range(running.n_claims[i, other_car]):
            claim = running.claims[i, other_car, k]
            if conflict(row, count, claim[0], claim[1], claim[2], claim[3]):
                return True
        return False
    level = w.cars[other_car, F_Z]
    w.cars[other_car, F_Z] = level + 2 * w.cells.shape[2]  # above everything
    legal = legal_actions(w, car, state, action, action) & bit
    w.cars[other_car, F_Z] = level
    return legal != 0


@compiled
def asked_in_vain(
    worlds: World, running: Running, rows: NDArray[np.int64], row: Claims, out: NDArray[np.bool_]
) -> None:
    """Write into out (k,) in which worlds ``rows`` (k,) each car is lost, or has asked for what another one prevents.

    ``row`` (MOST, 4) is scratch.
    """
    for k in range(len(rows)):
        i = rows[k]
        w = World(worlds.cells[i], worlds.cars[i], worlds.corrections, worlds.patterns)
        out[k] = True
        for car in range(w.cars.shape[0]):
            lost = running.action[i, car] == STOP and running.ends_s[i, car] == math.inf
            if lost:
                continue
            action = running.requested[i, car]
            prevented = False
            if running.outcome[i, car] == ILLEGAL and action < N_ACTIONS and action != STOP:
                for other_car in range(w.cars.shape[0]):
                    if other_car != car and not prevented:
                        prevented = stands_against(w, running, i, car, action, other_car, row)
            if not prevented:
                out[k] = False
                break


@compiled
def write_activity(running: Running, doing: NDArray[np.float32], out: NDArray[np.int8]) -> None:
    """Write what each car does, action and seconds (B, n, 2), and 1 for each claimed cell (B, L, W, H + 1)."""
    length, width, layers = out.shape[1:]
    for i in range(out.shape[0]):
        for car in range(doing.shape[1]):
            action = running.action[i, car]
            doing[i, car, 0] = action
            doing[i, car, 1] = (
                0.0 if action == DECIDES else running.time_s[i] - running.began_s[i, car]
            )
            for k in range(running.n_claims[i, car]):
                claim = running.claims[i, car, k]
                x = claim[0]
                y = claim[1]
                z = claim[2]
                if 0 <= x < length and 0 <= y < width and z < layers:
                    out[i, x, y, z] = 1
