"""The action helper's A* search, with the ties and limits of CraftEnv's (docs/rules.md#action-helper).

Nodes are (x, y, z, yaw) of one car; all else stands still. A car's slope state and the yaw of its load follow along.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from craftsim.compiled.jit import compiled
from craftsim.discrete.kernel.codes import (
    FIRST_MOVE,
    LAST_MOVE,
    MOVE_DIRECTIONS,
    ROTATE_LEFT,
    ROTATE_RIGHT,
    STOP,
)
from craftsim.discrete.kernel.rules import REASON_BIT, legal_actions
from craftsim.discrete.kernel.state import (
    FSLOPE,
    CarState,
    World,
    after,
    dir_x,
    dir_y,
    state_of_car,
)

SUCCESSORS = (FIRST_MOVE, FIRST_MOVE + 1, LAST_MOVE, LAST_MOVE - 1, ROTATE_RIGHT, ROTATE_LEFT)
"""Order in which a node's successors are tried, the actions ROTATE_LEFT to LAST_MOVE; it decides between equally good
plans: forward, back, right, left, then turns."""

UNSEEN = 0
OPEN = 1
_CLOSED = 2
UNKNOWN = -1
"""Legal successors that are not worked out yet."""


class SearchBuffers(NamedTuple):
    """Scratch arrays of a search, one entry a node, made once for a map size and used again and again."""

    state: NDArray[np.int64]
    cost: NDArray[np.int64]
    rank: NDArray[np.int64]
    """Cost so far plus distance left; the start has 0."""
    depth: NDArray[np.int64]
    slope: NDArray[np.int64]
    parent: NDArray[np.int64]
    action: NDArray[np.int64]
    heap: NDArray[np.int64]
    legal: NDArray[np.int64]
    """Legal successors, a bit for each action, known for one car in one world; else UNKNOWN."""
    legal_slope: NDArray[np.int64]
    """The slope state for which ``legal`` holds."""


def search_buffers(size: tuple[int, int, int]) -> SearchBuffers:
    """Return scratch arrays for maps of size (L, W, H); a car can be at levels 0 to H + 1."""
    nodes = size[0] * size[1] * (size[2] + 2) * 4
    return SearchBuffers(*(np.zeros(nodes, np.int64) for _ in SearchBuffers._fields))


# A binary heap of nodes ordered by their rank. The sifting is that of Python's heapq, because which of two equally good
# plans is found depends on it.


@compiled
def rise(heap: NDArray[np.int64], top: int, place: int, rank: NDArray[np.int64]) -> None:
    """Let an item rise to its place, not above ``top``."""
    item = heap[place]
    while place > top:
        parent = (place - 1) >> 1
        if rank[item] >= rank[heap[parent]]:
            break
        heap[place] = heap[parent]
        place = parent
    heap[place] = item


@compiled
def sink(heap: NDArray[np.int64], size: int, place: int, rank: NDArray[np.int64]) -> None:
    """Let an item sink to a leaf, and rise from there to its place."""
    top = place
    item = heap[place]
    child = 2 * place + 1
    while child < size:
        right = child + 1
        if right < size and rank[heap[child]] >= rank[heap[right]]:
            child = right
        heap[place] = heap[child]
        place = child
        child = 2 * place + 1
    heap[place] = item
    rise(heap, top, place, rank)


@compiled
def node_of(w: World, car: CarState) -> int:
    """Return the index of a car's state among the nodes."""
    layers = w.cells.shape[2] + 1
    return ((car.x * w.cells.shape[1] + car.y) * layers + car.z) * 4 + car.yaw


@compiled
def state_at(w: World, start: CarState, node: int, slope: int) -> CarState:
    """Return the state of the car at a node; a carried slope has turned along with it from the start."""
    layers = w.cells.shape[2] + 1
    yaw = node & 3
    index = node >> 2
    z = index % layers
    index = index // layers
    load_yaw = (start.load_yaw + yaw - start.yaw) & 3 if start.load == FSLOPE else 0
    return CarState(
        index // w.cells.shape[1], index % w.cells.shape[1], z, yaw, start.load, load_yaw, slope
    )


@compiled
def _legal_from(w: World, me: int, space: SearchBuffers, node: int, car: CarState) -> int:
    """Return the legal successors of a node, a bit for each action, worked out at most once."""
    if space.legal[node] == UNKNOWN or space.legal_slope[node] != car.slope:
        legal = legal_actions(w, me, car, ROTATE_LEFT, LAST_MOVE)
        space.legal[node] = legal & ((1 << REASON_BIT) - 1)
        space.legal_slope[node] = car.slope
    return int(space.legal[node])


@compiled(inline=False)
def search_path(
    w: World, me: int, space: SearchBuffers, goal_x: int, goal_y: int, goal_z: int, limit: int
) -> int:
    """Search a way for car ``me`` to a cell; return the node reached, or -1 if there is none.

    The whole search fails as soon as a node deeper than ``limit`` is taken up, so a way has at most limit + 1 steps.
    """
    start = state_of_car(w, me)
    space.state[:] = UNSEEN
    first = node_of(w, start)
    space.state[first] = OPEN
    space.cost[first] = 0
    space.rank[first] = 0
    space.depth[first] = 0
    space.slope[first] = start.slope
    space.parent[first] = -1
    space.heap[0] = first
    size = 1
    while size > 0:
        node = int(space.heap[0])
        size -= 1
        space.heap[0] = space.heap[size]
        if size > 0:
            sink(space.heap, size, 0, space.rank)
        car = state_at(w, start, node, space.slope[node])
        if car.x == goal_x and car.y == goal_y and car.z == goal_z:
            return node
        if space.depth[node] > limit:
            return -1
        space.state[node] = _CLOSED
        legal = _legal_from(w, me, space, node, car)
        for i in range(len(SUCCESSORS)):
            if not legal & (1 << SUCCESSORS[i]):
                continue
            new = after(w, car, SUCCESSORS[i])
            next_node = node_of(w, new)
            cost = space.cost[node] + 1
            if space.state[next_node] == _CLOSED:
                continue
            was_open = space.state[next_node] == OPEN
            if was_open and cost >= space.cost[next_node]:
                continue
            space.cost[next_node] = cost
            space.rank[next_node] = cost + abs(new.x - goal_x) + abs(new.y - goal_y)
            space.parent[next_node] = node
            space.action[next_node] = SUCCESSORS[i]
            space.slope[next_node] = new.slope
            if was_open:
                # The depth stays that of the first way found (docs/rules.md#action-helper).
                for place in range(size // 2 - 1, -1, -1):
                    sink(space.heap, size, place, space.rank)
            else:
                space.depth[next_node] = space.depth[node] + 1
                space.state[next_node] = OPEN
                space.heap[size] = next_node
                rise(space.heap, 0, size, space.rank)
                size += 1
    return -1


@compiled
def write_path(space: SearchBuffers, node: int, out: NDArray[np.int8]) -> int:
    """Write the actions that lead to a node into out; return how many there are."""
    length = 0
    walker = np.int64(node)
    while space.parent[walker] >= 0:
        walker = np.int64(space.parent[walker])
        length += 1
    walker = np.int64(node)
    for i in range(length - 1, -1, -1):
        out[i] = space.action[walker]
        walker = np.int64(space.parent[walker])
    return length


@compiled
def plan_move(w: World, me: int, space: SearchBuffers, action: int, limit: int) -> int:
    """Search a way for a MOVE, to where that would lead, up or down along a slope; return the node reached, or -1."""
    goal = after(w, state_of_car(w, me), action)
    return search_path(w, me, space, goal.x, goal.y, goal.z, limit)


@compiled
def moves_to_plan(w: World, me: int, space: SearchBuffers, legal: int, limit: int) -> int:
    """Return, as bits for the four MOVEs, which of those that are not legal are worth a search: a quick sieve.

    Floods outwards step by step, as their goal cells must lie within limit + 1 steps. All bits are set if some node is
    met in two slope states, for then what can be reached depends on the order of the search.
    """
    missing = ~(legal >> FIRST_MOVE) & 15
    if missing == 0:
        return 0
    space.legal[:] = UNKNOWN
    start = state_of_car(w, me)
    goals = 0
    space.state[:] = UNSEEN
    space.heap[0] = node_of(w, start)
    space.state[space.heap[0]] = OPEN
    space.slope[space.heap[0]] = start.slope
    space.depth[space.heap[0]] = 0
    head = 0
    tail = 1
    while head < tail:
        node = int(space.heap[head])
        head += 1
        car = state_at(w, start, node, space.slope[node])
        for i in range(4):
            m = MOVE_DIRECTIONS[i]
            arrived = car.x == start.x + dir_x(m) and car.y == start.y + dir_y(m)
            if arrived and car.z == after(w, start, FIRST_MOVE + i).z:
                goals |= 1 << i
        if goals == 15:
            return missing
        if space.depth[node] > limit:
            continue
        legal = _legal_from(w, me, space, node, car)
        for i in range(len(SUCCESSORS)):
            if not legal & (1 << SUCCESSORS[i]):
                continue
            new = after(w, car, SUCCESSORS[i])
            next_node = node_of(w, new)
            if space.state[next_node] == UNSEEN:
                space.state[next_node] = OPEN
                space.slope[next_node] = new.slope
                space.depth[next_node] = space.depth[node] + 1
                space.heap[tail] = next_node
                tail += 1
            elif space.slope[next_node] != new.slope:
                return missing
    return missing & goals


@compiled
def due_of(
    w: World, car: int, action: int, queue: NDArray[np.int8], space: SearchBuffers, limit: int
) -> int:
    """Return the primitive that an action stands for now: of the queue, else of a new plan for a MOVE, which is queued.

    A MOVE without a plan is a STOP.
    """
    if queue[0] < 0 and FIRST_MOVE <= action <= LAST_MOVE:
        space.legal[:] = UNKNOWN
        node = plan_move(w, car, space, action, limit)
        if node < 0:
            return STOP
        write_path(space, node, queue)
    if queue[0] >= 0:
        return int(np.int64(queue[0]))
    return action


@compiled
def pop(queue: NDArray[np.int8]) -> None:
    """Take the first primitive out of a queue."""
    for i in range(len(queue) - 1):
        queue[i] = queue[i + 1]
    queue[-1] = -1
