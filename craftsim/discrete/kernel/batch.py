"""Entry points for Python: the rules and the helper's search, on batches of worlds with a leading axis."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from craftsim.compiled.jit import compiled, plain
from craftsim.discrete.kernel.codes import FIRST_MOVE, N_ACTIONS
from craftsim.discrete.kernel.rules import (
    REASON_BIT,
    act,
    legal_actions,
    load_below_walls,
    load_fits,
)
from craftsim.discrete.kernel.search import SearchBuffers, due_of, moves_to_plan, plan_move, pop
from craftsim.discrete.kernel.state import (
    AIR,
    DERIVED_MARKS,
    FSLOPE,
    Cars,
    Cells,
    Patterns,
    World,
    apply,
    car_in,
    carried_gear_in,
    derive_marks,
    dir_x,
    dir_y,
    inside,
    kind_at,
    state_of_car,
)

NO_HELPER = -1
"""A search depth: the action helper is off."""

Mask = NDArray[np.bool_]
Queues = NDArray[np.int8]


@compiled
def masks(
    cells: Cells,
    cars: Cars,
    corrections: int,
    patterns: Patterns,
    space: SearchBuffers,
    depth: int,
    out: Mask,
) -> None:
    """Write into out (B, n, 15) what each car could do, all judged on the same state.

    With a search depth moves that the helper finds a plan for are on, too; NO_HELPER leaves them out.
    """
    for i in range(cells.shape[0]):
        w = World(cells[i], cars[i], corrections, patterns)
        for car in range(w.cars.shape[0]):
            legal = legal_actions(w, car, state_of_car(w, car), 0, N_ACTIONS - 1)
            for action in range(N_ACTIONS):
                out[i, car, action] = legal & (1 << action) != 0
            to_plan = moves_to_plan(w, car, space, legal, depth) if depth != NO_HELPER else 0
            for m in range(4):
                if to_plan & (1 << m):
                    out[i, car, FIRST_MOVE + m] = (
                        plan_move(w, car, space, FIRST_MOVE + m, depth) >= 0
                    )


@compiled
def step(
    cells: Cells,
    cars: Cars,
    corrections: int,
    patterns: Patterns,
    order: NDArray[np.int64],
    actions: NDArray[np.int64],
    applied: Mask,
) -> None:
    """Let the cars order[i] of each world act one after the other, each judged on what the earlier ones left.

    ``actions`` (B, k) are in this order, as is ``applied``: whether each action was legal when its turn came.
    """
    for i in range(cells.shape[0]):
        w = World(cells[i], cars[i], corrections, patterns)
        for turn in range(order.shape[1]):
            applied[i, turn] = act(w, order[i, turn], actions[i, turn])
        if corrections & DERIVED_MARKS:
            derive_marks(w)


@compiled
def step_with_helper(
    cells: Cells,
    cars: Cars,
    corrections: int,
    patterns: Patterns,
    order: NDArray[np.int64],
    actions: NDArray[np.int64],
    applied: Mask,
    queues: Queues,
    space: SearchBuffers,
    depth: int,
) -> None:
    """Do the same with the action helper; ``queues`` (B, n, depth + 1) hold what it still has to do.

    A car does what its queue has, else what a new plan for a MOVE has, else the action. If what was queued is not legal
    any more, the queue is thrown away.
    """
    for i in range(cells.shape[0]):
        w = World(cells[i], cars[i], corrections, patterns)
        for turn in range(order.shape[1]):
            car = order[i, turn]
            queue = queues[i, car]
            queued = queue[0] >= 0
            due = due_of(w, car, actions[i, turn], queue, space, depth)
            if queue[0] >= 0:
                pop(queue)
            applied[i, turn] = act(w, car, due)
            if queued and not applied[i, turn]:
                queue[:] = -1
        if corrections & DERIVED_MARKS:
            derive_marks(w)


@compiled
def reason(
    cells: Cells, cars: Cars, corrections: int, patterns: Patterns, car: int, action: int
) -> int:
    """Return why a car of a single world could not do an action now, as :func:`why` does."""
    w = World(cells, cars, corrections, patterns)
    return legal_actions(w, car, state_of_car(w, car), action, action) >> REASON_BIT


@compiled
def apply_actions(
    cells: Cells,
    cars: Cars,
    corrections: int,
    patterns: Patterns,
    order: NDArray[np.int64],
    actions: NDArray[np.int64],
) -> None:
    """Change each world as the actions of the cars order[i] do, one after the other, whether they are legal or not.

    ``actions`` (B, k) are in this order; what is none of the 15 changes nothing, and marks are not derived.
    """
    for i in range(cells.shape[0]):
        w = World(cells[i], cars[i], corrections, patterns)
        for turn in range(order.shape[1]):
            apply(w, order[i, turn], actions[i, turn])


@plain
def load_has_room(w: World, me: int) -> bool:
    """Return whether what a car of a single world carries is clear of all else, as in all that play leads to."""
    car = state_of_car(w, me)
    if car.load == AIR:
        return True
    if not (load_below_walls(w, car, car) and load_fits(w, me, car, car)):
        return False
    if car.load != FSLOPE:
        return True
    x = car.x + dir_x(car.load_yaw)
    y = car.y + dir_y(car.load_yaw)
    if not inside(w, x, y, 0):
        return False
    if car.slope != 0:
        return True
    crowded = car_in(w, me, x, y, car.z, True) >= 0 or carried_gear_in(w, me, x, y, car.z, -1)
    return kind_at(w, x, y, car.z) == AIR and not crowded
