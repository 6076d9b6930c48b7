"""The action helper's A* search, with the ties and limits of CraftEnv's (docs/rules.md#action-helper).

Nodes are (x, y, z, yaw) of one car; all else stands still. A car's slope state and the yaw of its load follow
along.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.kernel.jit import compiled
from craftsim.discrete.kernel.state import BODY, FOOT, FSLOPE, Pose, World, dir_x, dir_y, kind_at, pose_of
from craftsim.discrete.kinds import Action
from craftsim.discrete.planning.heap import heapify, pop, push
from craftsim.discrete.rules.effects import turned
from craftsim.discrete.rules.legality import FIRST_MOVE, ROTATE_LEFT, ROTATE_RIGHT, move_direction
from craftsim.discrete.rules.moves import moved
from craftsim.discrete.rules.table import legal

MOVE_FORWARD = int(Action.MOVE_FORWARD)
MOVE_BACK = int(Action.MOVE_BACK)
MOVE_LEFT = int(Action.MOVE_LEFT)
MOVE_RIGHT = int(Action.MOVE_RIGHT)

SUCCESSORS = (MOVE_FORWARD, MOVE_BACK, MOVE_RIGHT, MOVE_LEFT, ROTATE_RIGHT, ROTATE_LEFT)
"""Order in which a node's successors are tried; it decides between equally good plans."""

UNSEEN, OPEN, CLOSED = 0, 1, 2


class Space(NamedTuple):
    """Scratch arrays of a search, one entry a node, made once for a map size and used again and again."""

    state: NDArray[np.int8]
    cost: NDArray[np.int32]
    rank: NDArray[np.int32]
    """Cost so far plus distance left; the start has 0."""
    depth: NDArray[np.int32]
    slope: NDArray[np.int64]
    parent: NDArray[np.int32]
    action: NDArray[np.int8]
    heap: NDArray[np.int32]
    ways: NDArray[np.int8]
    """Legal successors as bits, known for one car in one world; -1 where not worked out yet."""
    ways_slope: NDArray[np.int8]
    """The slope state for which ``ways`` holds."""


def make_space(size: tuple[int, int, int]) -> Space:
    """Return scratch arrays for maps of size (L, W, H); a car can be at levels 0 to H + 1."""
    nodes = size[0] * size[1] * (size[2] + 2) * 4

    def small() -> NDArray[np.int8]:
        return np.zeros(nodes, np.int8)

    def large() -> NDArray[np.int32]:
        return np.zeros(nodes, np.int32)

    return Space(
        state=small(),
        cost=large(),
        rank=large(),
        depth=large(),
        slope=np.zeros(nodes, np.int64),
        parent=large(),
        action=small(),
        heap=large(),
        ways=small(),
        ways_slope=small(),
    )


@compiled
def node_of(w: World, car: Pose) -> int:
    """Return the index of a car's state among the nodes."""
    layers = w.cells.shape[2] + 1
    return ((car.x * w.cells.shape[1] + car.y) * layers + car.z) * 4 + car.yaw


@compiled
def pose_at(w: World, start: Pose, node: int, slope: int) -> Pose:
    """Return the state of the car at a node; a carried slope has turned along with it from the start."""
    layers = w.cells.shape[2] + 1
    yaw = node & 3
    rest = node >> 2
    z = rest % layers
    rest //= layers
    load_yaw = (start.load_yaw + yaw - start.yaw) & 3 if start.load == FSLOPE else 0
    return Pose(rest // w.cells.shape[1], rest % w.cells.shape[1], z, yaw, start.load, load_yaw, slope)


@compiled
def ways_from(w: World, me: int, space: Space, node: int, car: Pose) -> int:
    """Return the legal successors of a node as bits in the order of SUCCESSORS, worked out at most once."""
    if space.ways[node] < 0 or space.ways_slope[node] != car.slope:
        bits = 0
        for i in range(len(SUCCESSORS)):
            if legal(w, me, car, SUCCESSORS[i]):
                bits |= 1 << i
        space.ways[node] = bits
        space.ways_slope[node] = car.slope
    return int(space.ways[node])


@compiled
def after(w: World, car: Pose, action: int) -> Pose:
    """Return the car's state after one of SUCCESSORS."""
    if action == ROTATE_LEFT:
        return turned(car, 1)
    if action == ROTATE_RIGHT:
        return turned(car, -1)
    return moved(w, car, move_direction(action))


@compiled
def forget_ways(space: Space) -> None:
    """Forget what is legal where; needed whenever the world or the car searched for is another."""
    space.ways[:] = -1


@compiled
def search(w: World, me: int, space: Space, goal_x: int, goal_y: int, goal_z: int, limit: int) -> int:
    """Search a way for car ``me`` to a cell; return the node reached, or -1 if there is none.

    The whole search fails as soon as a node deeper than ``limit`` is taken up, so a way has at most limit + 1
    steps.
    """
    start = pose_of(w, me)
    space.state[:] = UNSEEN
    first = node_of(w, start)
    space.state[first] = OPEN
    space.cost[first] = 0
    space.rank[first] = 0
    space.depth[first] = 0
    space.slope[first] = start.slope
    space.parent[first] = -1
    size = push(space.heap, 0, first, space.rank)
    while size > 0:
        node = pop(space.heap, size, space.rank)
        size -= 1
        car = pose_at(w, start, node, space.slope[node])
        if car.x == goal_x and car.y == goal_y and car.z == goal_z:
            return node
        if space.depth[node] > limit:
            return -1
        space.state[node] = CLOSED
        ways = ways_from(w, me, space, node, car)
        for i in range(len(SUCCESSORS)):
            if not ways & (1 << i):
                continue
            new = after(w, car, SUCCESSORS[i])
            next_node = node_of(w, new)
            cost = space.cost[node] + 1
            if space.state[next_node] == CLOSED:
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
                heapify(space.heap, size, space.rank)
            else:
                space.depth[next_node] = space.depth[node] + 1
                space.state[next_node] = OPEN
                size = push(space.heap, size, next_node, space.rank)
    return -1


@compiled
def write_plan(space: Space, node: int, out: NDArray[np.int8]) -> int:
    """Write the actions that lead to a node into out; return how many there are."""
    length = 0
    walker = node
    while space.parent[walker] >= 0:
        walker = space.parent[walker]
        length += 1
    walker = node
    for i in range(length - 1, -1, -1):
        out[i] = space.action[walker]
        walker = space.parent[walker]
    return length


@compiled
def goal_level(w: World, car: Pose, m: int) -> int:
    """Return the level of the cell that a MOVE in direction m asks for, up or down along a slope."""
    x, y = car.x + dir_x(m), car.y + dir_y(m)
    if car.slope == 1 and kind_at(w, x, y, car.z) == BODY:
        return car.z + 1
    if car.slope == 2 and kind_at(w, x, y, car.z - 1) == FOOT:
        return car.z - 1
    return car.z


@compiled
def plan_move(w: World, me: int, space: Space, action: int, limit: int) -> int:
    """Search a way for a MOVE; return the node reached, or -1."""
    car = pose_of(w, me)
    m = move_direction(action)
    return search(w, me, space, car.x + dir_x(m), car.y + dir_y(m), goal_level(w, car, m), limit)


@compiled
def near_enough(w: World, me: int, space: Space, limit: int) -> int:
    """Return, as bits for the four MOVEs, whose goal cell may lie within limit + 1 steps: a quick sieve.

    Floods outwards step by step. All bits are set if some node is met in two slope states, for then what can
    be reached depends on the order of the search.
    """
    start = pose_of(w, me)
    goals = 0
    space.state[:] = UNSEEN
    space.heap[0] = node_of(w, start)
    space.state[space.heap[0]] = OPEN
    space.slope[space.heap[0]] = start.slope
    space.depth[space.heap[0]] = 0
    head, tail = 0, 1
    while head < tail:
        node = space.heap[head]
        head += 1
        car = pose_at(w, start, node, space.slope[node])
        for i in range(4):
            m = move_direction(FIRST_MOVE + i)
            if (
                car.x == start.x + dir_x(m)
                and car.y == start.y + dir_y(m)
                and car.z == goal_level(w, start, m)
            ):
                goals |= 1 << i
        if goals == 15:
            return 15
        if space.depth[node] > limit:
            continue
        ways = ways_from(w, me, space, node, car)
        for i in range(len(SUCCESSORS)):
            if not ways & (1 << i):
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
                return 15
    return goals


@compiled
def fill_reachable(w: World, space: Space, limit: int, mask: NDArray[np.bool_]) -> None:
    """Turn a mask (n, 15) of legal actions into the helper's: a MOVE with a plan is on, too."""
    for me in range(w.cars.shape[0]):
        missing = 0
        for i in range(4):
            if not mask[me, FIRST_MOVE + i]:
                missing |= 1 << i
        if missing == 0:
            continue
        forget_ways(space)
        wanted = missing & near_enough(w, me, space, limit)
        for i in range(4):
            if wanted & (1 << i):
                mask[me, FIRST_MOVE + i] = plan_move(w, me, space, FIRST_MOVE + i, limit) >= 0
