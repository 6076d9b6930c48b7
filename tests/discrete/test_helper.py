"""The action helper: its heap, its plans and its queue."""

import heapq

import numpy as np
import pytest

from craftsim.discrete.grid import CarField, Kind
from craftsim.discrete.kernel import batch
from craftsim.discrete.kernel.search import (
    UNKNOWN,
    rise,
    search_buffers,
    search_path,
    sink,
    write_path,
)
from craftsim.discrete.kinds import Action
from craftsim.discrete.rules import Rules, empty_queue

BLOCK = Kind.BLOCK
RIGHT = Action.MOVE_RIGHT


def plan_to(grid, car, cell):
    """Return the primitives that bring a car to a cell, or None if the helper finds no way."""
    steps, space = np.empty(11, np.int8), search_buffers(grid.size)
    space.legal[:] = UNKNOWN
    node = search_path(grid.world(Rules("physical").corrections), car, space, *cell, 10)
    return None if node < 0 else tuple(steps[: write_path(space, node, steps)].tolist())


def tick(grid, queue, joint):
    """Let cars act in the order given, helper on; return world, queues and which primitives applied."""
    after, queues = grid.copy(), queue[None].copy()
    turns, acts = np.array(joint, np.int64).T.copy()
    applied, space = np.empty((1, len(joint)), np.bool_), search_buffers(grid.size)
    arrays = (*after[None].world(Rules("physical").corrections),)
    batch.step_with_helper(
        *arrays, turns[None], acts[None], applied, queues, space, queue.shape[1] - 1
    )
    return after, queues[0], applied[0]


class Ranked:
    """An item that heapq compares by rank alone."""

    def __init__(self, item, ranks):
        self.item, self.ranks = item, ranks

    def __lt__(self, other):
        return self.ranks[self.item] < self.ranks[other.item]


def pop(heap, size, ranks):
    """Take the item of lowest rank, as the search does."""
    item, heap[0] = int(heap[0]), heap[size - 1]
    if size > 1:
        sink(heap, size - 1, 0, ranks)
    return item


def test_the_heap_keeps_ties_in_the_order_of_pythons_heapq():
    rng = np.random.default_rng(3)
    ranks = rng.integers(0, 4, 300).astype(np.int32)
    heap, size, model = np.zeros(300, np.int32), 0, []
    for item in range(300):
        heap[size] = item
        rise(heap, 0, size, ranks)
        size += 1
        heapq.heappush(model, Ranked(item, ranks))
        if rng.random() < 0.4:
            assert pop(heap, size, ranks) == heapq.heappop(model).item
            size -= 1
        if rng.random() < 0.2 and size:
            ranks[heap[rng.integers(size)]] -= 1
            for place in range(size // 2 - 1, -1, -1):
                sink(heap, size, place, ranks)
            heapq.heapify(model)
        assert heap[:size].tolist() == [entry.item for entry in model]
    while size:
        assert pop(heap, size, ranks) == heapq.heappop(model).item
        size -= 1


def test_a_plan_of_moves_and_turns_has_at_most_one_step_more_than_the_search_depth(scene, car):
    grid, planner = scene([(BLOCK, (3, 3, 1))], [car(3, 3, yaw=1)]), Rules("physical")
    assert not planner.legal(grid, 0, RIGHT)
    for depth, plan in ((0, None), (1, (Action.ROTATE_RIGHT, RIGHT))):
        assert planner.plan_move(grid, 0, RIGHT, depth) == plan
        assert planner.reachable(grid, depth)[0, RIGHT] == (plan is not None)


def test_a_way_to_a_cell_leads_up_a_ramp(scene, car):
    grid = scene([(Kind.BODY, (3, 3, 1), 2), (BLOCK, (4, 3, 1))], [car(1, 3)])
    assert plan_to(grid, 0, (4, 3, 2)) == (RIGHT, RIGHT, RIGHT)
    assert plan_to(grid, 0, (4, 3, 3)) is None
    assert plan_to(grid, 0, (1, 3, 1)) == ()


def test_the_queue_goes_on_whatever_the_car_is_told(scene, car):
    grid = scene([(BLOCK, (3, 3, 1))], [car(3, 3, yaw=1)])
    queue = empty_queue(1, 10)
    grid, queue, applied = tick(grid, queue, [(0, RIGHT)])
    assert applied.tolist() == [True]
    assert queue[0, :2].tolist() == [RIGHT, -1]
    grid, queue, applied = tick(grid, queue, [(0, Action.LIFT)])
    assert applied.tolist() == [True]
    assert grid.cars[0, : CarField.YAW + 1].tolist() == [4, 3, 1, 0]
    assert (queue == -1).all()


def test_a_queue_whose_next_step_became_illegal_is_thrown_away(scene, car):
    grid = scene([(BLOCK, (3, 3, 1))], [car(3, 3, yaw=1), car(4, 4)])
    queue = empty_queue(2, 10)
    grid, queue, _ = tick(grid, queue, [(0, RIGHT), (1, Action.MOVE_BACK)])
    assert queue[0, 0] == RIGHT
    grid, queue, applied = tick(grid, queue, [(0, RIGHT), (1, Action.STOP)])
    assert applied.tolist() == [False, True]
    assert (queue[0] == -1).all()
    assert grid.cars[0, : CarField.YAW].tolist() == [3, 3, 1]


def test_a_move_without_a_plan_is_a_stop_and_nothing_else_is_planned(scene, car):
    grid = scene([], [car(0, 0)])
    after, queue, applied = tick(grid, empty_queue(1, 10), [(0, Action.MOVE_LEFT)])
    assert applied.tolist() == [True]
    assert after.same_visible(grid)
    assert (queue == -1).all()
    with pytest.raises(ValueError, match="LIFT"):
        Rules("physical").plan_move(grid, 0, Action.LIFT)
    with pytest.raises(ValueError, match="search depth is -1"):
        empty_queue(1, -1)
