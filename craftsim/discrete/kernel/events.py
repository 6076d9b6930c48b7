"""Asynchronous worlds, compiled: which actions may begin now, beginnings, and the next event."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.kernel.batch import NO_HELPER, Cars, Cells, Mask, Queues
from craftsim.discrete.kernel.claims import Board, Claims, claims_of, clashes, mark
from craftsim.discrete.kernel.codes import FIRST_MOVE, N_ACTIONS, STOP
from craftsim.discrete.kernel.effects import apply
from craftsim.discrete.kernel.jit import compiled
from craftsim.discrete.kernel.rules import act, legal_actions
from craftsim.discrete.kernel.search import (
    UNKNOWN,
    SearchBuffers,
    due_of,
    near_enough,
    plan_move,
    pop,
    write_plan,
)
from craftsim.discrete.kernel.state import DERIVED_MARKS, World, derive_marks, pose_of

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
def mark_running(running: Running, i: int, board: Board, is_set: bool) -> bool:
    """Mark what runs in a world on a board, or clear it; return whether anything does."""
    any_runs = False
    for car in range(running.action.shape[1]):
        if running.n_claims[i, car] > 0:
            mark(board, running.claims[i, car], running.n_claims[i, car], is_set)
            any_runs = True
    return any_runs


@compiled
def offer(
    cells: Cells,
    cars: Cars,
    corrections: int,
    running: Running,
    board: Board,
    row: Claims,
    plan: NDArray[np.int8],
    space: SearchBuffers,
    depth: int,
    out: Mask,
) -> None:
    """Write into out (B, n, 15) what each car that decides could begin now beside what runs; nothing for the others.

    With a search depth moves are on, too, that the helper has a plan for whose first primitive can begin. ``board`` is
    empty, ``row`` (MOST, 4) and ``plan`` (depth + 1,) are scratch.
    """
    for i in range(cells.shape[0]):
        w = World(cells[i], cars[i], corrections)
        any_runs = mark_running(running, i, board, True)
        for car in range(w.cars.shape[0]):
            out[i, car, :] = False
            if running.action[i, car] != DECIDES:
                continue
            pose = pose_of(w, car)
            legal = legal_actions(w, car, pose, 0, N_ACTIONS - 1)
            for action in range(N_ACTIONS):
                free = legal & (1 << action) != 0
                if free and any_runs and action != STOP:
                    free = not clashes(board, row, claims_of(w, pose, action, row))
                out[i, car, action] = free
            if depth == NO_HELPER:
                continue
            missing = ~(legal >> FIRST_MOVE) & 15
            if missing == 0:
                continue
            space.legal[:] = UNKNOWN
            wanted = missing & near_enough(w, car, space, depth)
            for m in range(4):
                if not wanted & (1 << m):
                    continue
                node = plan_move(w, car, space, FIRST_MOVE + m, depth)
                if node < 0:
                    continue
                write_plan(space, node, plan)
                first = int(np.int64(plan[0]))
                free = not any_runs or not clashes(board, row, claims_of(w, pose, first, row))
                out[i, car, FIRST_MOVE + m] = free
        if any_runs:
            mark_running(running, i, board, False)


@compiled
def decide(
    cells: Cells,
    cars: Cars,
    corrections: int,
    running: Running,
    order: NDArray[np.int64],
    actions: NDArray[np.int64],
    board: Board,
    queues: Queues,
    space: SearchBuffers,
    depth: int,
    out: NDArray[np.int64],
) -> None:
    """Let the cars order[i] of each world begin what they have decided on, one after the other, if they decide.

    ``actions`` and ``out`` are by car, (B, n); out tells what became of each decision. Cells and cars have the effects
    of what has begun from here on. Claims, actions and turns are written into ``running``, times are not.
    """
    for i in range(cells.shape[0]):
        w = World(cells[i], cars[i], corrections)
        mark_running(running, i, board, True)
        turn, begun = 0, False
        for car in range(w.cars.shape[0]):
            turn = max(turn, running.turn[i, car])
        for place in range(order.shape[1]):
            car = order[i, place]
            if running.action[i, car] != DECIDES:
                out[i, car] = RUNS
                continue
            due, queued = actions[i, car], queues[i, car, 0] >= 0
            if depth != NO_HELPER:
                due = due_of(w, car, due, queues[i, car], space, depth)
            turn += 1
            running.turn[i, car], running.action[i, car] = turn, STOP
            if due == STOP:
                out[i, car] = WAITS if actions[i, car] == STOP or queued else ILLEGAL
                continue
            pose = pose_of(w, car)
            out[i, car] = ILLEGAL
            if due < N_ACTIONS and legal_actions(w, car, pose, due, due) & (1 << due):
                claims = running.claims[i, car]
                count = claims_of(w, pose, due, claims)
                out[i, car] = BLOCKED
                if not clashes(board, claims, count):
                    act(w, car, due)
                    mark(board, claims, count, True)
                    running.action[i, car], running.n_claims[i, car] = due, count
                    out[i, car], begun = BEGUN, True
            if depth != NO_HELPER:
                if out[i, car] == BEGUN:
                    if queues[i, car, 0] >= 0:
                        pop(queues[i, car])
                elif out[i, car] == ILLEGAL or not queued:
                    queues[i, car, :] = -1
        mark_running(running, i, board, False)
        if begun and corrections & DERIVED_MARKS:
            derive_marks(w)


@compiled
def following(running: Running, i: int, turn: int) -> int:
    """Return the car of a world whose action began next after a turn; -1 if there is none."""
    found = -1
    for car in range(running.action.shape[1]):
        if running.turn[i, car] > turn and (found < 0 or running.turn[i, car] < running.turn[i, found]):
            found = car
    return found


@compiled
def advance(
    confirmed: World,
    committed: World,
    running: Running,
    queues: Queues,
    time_s: NDArray[np.float64],
    ended: Mask,
) -> None:
    """Advance each world, in which no car decides, to its next event; write its time (B,), and what has ended (B, n).

    What has ended is applied to the confirmed worlds in the order in which it began; a wait ends with any event. Where
    something failed, the committed worlds are made anew. Registered actions change nothing here.
    """
    for i in range(time_s.shape[0]):
        time_s[i] = running.ends_s[i, 0]
        for car in range(1, running.action.shape[1]):
            time_s[i] = min(time_s[i], running.ends_s[i, car])
        w = World(confirmed.cells[i], confirmed.cars[i], confirmed.corrections)
        failed, changed, turn = False, False, 0
        for _ in range(running.action.shape[1]):
            car = following(running, i, turn)
            turn = running.turn[i, car]
            action = running.action[i, car]
            ended[i, car] = action == STOP or running.ends_s[i, car] <= time_s[i]
            if not ended[i, car]:
                continue
            if running.fails[i, car]:
                failed = True
                queues[i, car, :] = -1
            elif action < STOP:
                apply(w, car, action)
                changed = True
            running.action[i, car], running.n_claims[i, car] = DECIDES, 0
        if changed and w.corrections & DERIVED_MARKS:
            derive_marks(w)
        if failed:
            commit(confirmed, committed, running, i)


@compiled
def commit(confirmed: World, committed: World, running: Running, i: int) -> None:
    """Make a committed world anew: the confirmed one with the effects of what runs."""
    for x in range(committed.cells.shape[1]):
        for y in range(committed.cells.shape[2]):
            for z in range(committed.cells.shape[3]):
                for field in range(committed.cells.shape[4]):
                    committed.cells[i, x, y, z, field] = confirmed.cells[i, x, y, z, field]
    for car in range(committed.cars.shape[1]):
        for field in range(committed.cars.shape[2]):
            committed.cars[i, car, field] = confirmed.cars[i, car, field]
    w = World(committed.cells[i], committed.cars[i], committed.corrections)
    turn = 0
    for _ in range(running.action.shape[1]):
        car = following(running, i, turn)
        if car < 0:
            break
        turn = running.turn[i, car]
        if 0 <= running.action[i, car] < STOP:
            apply(w, car, running.action[i, car])
    if w.corrections & DERIVED_MARKS:
        derive_marks(w)


@compiled
def enforce(cells: Cells, cars: Cars, corrections: int, car: int, action: int) -> None:
    """Change a single world as an action of the 15 does, legal or not, and derive its marks where the rules do."""
    w = World(cells, cars, corrections)
    apply(w, car, action)
    if corrections & DERIVED_MARKS:
        derive_marks(w)


@compiled
def claimed(running: Running, out: NDArray[np.int8]) -> None:
    """Write into out (B, L, W, H + 1) 1 for each cell that an action which runs has claimed, else 0."""
    for i in range(out.shape[0]):
        out[i, :, :, :] = 0
        for car in range(running.action.shape[1]):
            for k in range(running.n_claims[i, car]):
                x, y, z = (
                    running.claims[i, car, k, 0],
                    running.claims[i, car, k, 1],
                    running.claims[i, car, k, 2],
                )
                if 0 <= x < out.shape[1] and 0 <= y < out.shape[2] and z < out.shape[3]:
                    out[i, x, y, z] = 1
