"""Asynchronous worlds, compiled: which actions may begin now beside what runs, and beginnings."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

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
from craftsim.discrete.kernel.jit import compiled
from craftsim.discrete.kernel.rules import legal_actions
from craftsim.discrete.kernel.search import SearchBuffers, due_of, moves_to_plan, plan_move, pop, write_plan
from craftsim.discrete.kernel.state import (
    AIR,
    BODY,
    FOOT,
    FSLOPE,
    Pose,
    World,
    apply,
    dir_x,
    dir_y,
    kind_at,
    pose_of,
)

DECIDES = -1
"""In place of an action: the car has none and decides."""
RUNS, BEGUN, WAITS, ILLEGAL, BLOCKED = range(5)
"""What became of a decision: there was none to make, as the car's action runs; its action began; it waits by choice; or
it waits because the rules or a claim stand against the action."""


class Running(NamedTuple):
    """What the cars of B worlds are doing, by car."""

    action: NDArray[np.int64]
    """(B, n): the primitive or registered action, STOP while it waits, DECIDES while it has none."""
    began_s: NDArray[np.float64]
    """(B, n)."""
    ends_s: NDArray[np.float64]
    """(B, n): at the latest, of a wait; infinite where it is not known."""
    turn: NDArray[np.int64]
    """(B, n): the order in which a world's actions began."""
    fails: NDArray[np.bool_]
    """(B, n): whether it ends without effect."""
    claims: NDArray[np.int16]
    """(B, n, rows, 4)."""
    n_claims: NDArray[np.int64]
    """(B, n): rows of these; none while a car waits or decides."""


@compiled
def reach_of(w: World, car: Pose, action: int) -> int:
    """Return how many cells beside a car's way a legal action may claim any."""
    if car.load != AIR or (
        action in (LIFT, FOLD, UNFOLD) and kind_at(w, car.x, car.y, car.z) in (FSLOPE, BODY)
    ):
        return 3  # the neighbours of its load included
    return 1 if action == LIFT else 0


@compiled
def within(claim: NDArray[np.int16], x0: int, x1: int, y0: int, y1: int, z: int) -> bool:
    """Return whether a claim may be one against an action of a car at level z, of which these are the reaches."""
    return x0 <= claim[0] <= x1 and y0 <= claim[1] <= y1 and z - 2 <= claim[2] <= z + 3


@compiled
def neighbours(w: World, running: Running, i: int, car: Pose) -> int:
    """Return which cars run what could stand against any action of a car, a bit each; the last bit is of many."""
    found = 0
    # Onto a ramp a car claims what is 3 cells ahead.
    reach = max(3 if car.slope == 0 else 1, reach_of(w, car, LIFT), reach_of(w, car, FIRST_MOVE) + 1)
    x0, x1, y0, y1 = car.x - reach, car.x + reach, car.y - reach, car.y + reach
    for other in range(running.action.shape[1]):
        for k in range(running.n_claims[i, other]):
            if within(running.claims[i, other, k], x0, x1, y0, y1, car.z):
                found |= 1 << min(other, 62)
                break
    return found


@compiled
def blocked(
    w: World, running: Running, i: int, others: int, car: Pose, action: int, row: Claims, count: int
) -> bool:
    """Return whether a claim of what runs in a world stands against a legal action of a car.

    Looked at are the cars of :func:`neighbours`. The action's claims are the first ``count`` rows of ``row`` (MOST, 4);
    with 0 they are written there when needed.
    """
    if others == 0:
        return False
    reach, dx, dy = reach_of(w, car, action), 0, 0
    if FIRST_MOVE <= action <= LAST_MOVE:
        m = MOVE_DIRECTIONS[action - FIRST_MOVE]
        dx, dy = dir_x(m), dir_y(m)
        x, y = car.x + dx, car.y + dy
        if car.slope == 0 and (kind_at(w, x, y, car.z) == FOOT or kind_at(w, x, y, car.z - 1) == BODY):
            dx, dy = 3 * dx, 3 * dy
    x0, x1 = min(car.x, car.x + dx) - reach, max(car.x, car.x + dx) + reach
    y0, y1 = min(car.y, car.y + dy) - reach, max(car.y, car.y + dy) + reach
    for other in range(running.action.shape[1]):
        if not others & (1 << min(other, 62)):
            continue
        for k in range(running.n_claims[i, other]):
            claim = running.claims[i, other, k]
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
        w = World(worlds.cells[i], worlds.cars[i], worlds.corrections)
        for car in range(w.cars.shape[0]):
            some = False
            if running.action[i, car] == DECIDES:
                pose = pose_of(w, car)
                legal = legal_actions(w, car, pose, 0, N_ACTIONS - 1)
                others = neighbours(w, running, i, pose)
                for action in range(N_ACTIONS):
                    if legal & (1 << action) and (
                        action == STOP or not blocked(w, running, i, others, pose, action, row, 0)
                    ):
                        out[i, car, action] = some = True
                wanted = moves_to_plan(w, car, space, legal, depth) if depth != NO_HELPER else 0
                for m in range(4):
                    node = plan_move(w, car, space, FIRST_MOVE + m, depth) if wanted & (1 << m) else -1
                    if node >= 0:
                        write_plan(space, node, plan)
                        first = int(np.int64(plan[0]))
                        if not blocked(w, running, i, others, pose, first, row, 0):
                            out[i, car, FIRST_MOVE + m] = some = True
            if not some:
                out[i, car, STOP] = True


@compiled
def decide(
    worlds: World,
    running: Running,
    queues: Queues,
    space: SearchBuffers,
    depth: int,
    order: NDArray[np.int64],
    actions: NDArray[np.int64],
    first: int,
    end: int,
    out: NDArray[np.int64],
) -> None:
    """Let the cars order[i] of the worlds from ``first`` to ``end`` begin what they have decided on, in their order.

    ``actions`` and ``out`` are by car, (B, n); out tells what became of each decision, and stays for other cars. The
    worlds have the effects of what has begun from here on, but marks are not derived.
    """
    for i in range(first, end):
        w, turn = World(worlds.cells[i], worlds.cars[i], worlds.corrections), 0
        for car in range(w.cars.shape[0]):
            turn = max(turn, running.turn[i, car])
        for place in range(order.shape[1]):
            car = order[i, place]
            if running.action[i, car] != DECIDES:
                continue
            due, queued = actions[i, car], queues[i, car, 0] >= 0
            if depth != NO_HELPER:
                due = due_of(w, car, due, queues[i, car], space, depth)
            turn += 1
            result = WAITS
            if due == STOP:
                result = WAITS if actions[i, car] == STOP or queued else ILLEGAL
            else:
                pose = pose_of(w, car)
                result = ILLEGAL
                if due < N_ACTIONS and legal_actions(w, car, pose, due, due) & (1 << due):
                    claims = running.claims[i, car]
                    count = claims_of(w, pose, due, claims)
                    result = BLOCKED if blocked(w, running, i, -1, pose, due, claims, count) else BEGUN
                    if result == BEGUN:
                        apply(w, car, due)
                        running.n_claims[i, car] = count
            if depth != NO_HELPER and due != STOP:
                if result == BEGUN:
                    if queues[i, car, 0] >= 0:
                        pop(queues[i, car])
                elif result == ILLEGAL or not queued:
                    queues[i, car, :] = -1
            running.turn[i, car], running.action[i, car] = turn, due if result == BEGUN else STOP
            out[i, car] = result
