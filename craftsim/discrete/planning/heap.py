"""A binary heap of integers ordered by a rank looked up elsewhere; ties stay where the sifting leaves them.

The sifting is that of Python's heapq, because which of two equally good plans is found depends on it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.kernel.jit import compiled


@compiled
def _rise(heap: NDArray[np.int32], top: int, place: int, rank: NDArray[np.int32]) -> None:
    item = heap[place]
    while place > top:
        parent = (place - 1) >> 1
        if rank[item] >= rank[heap[parent]]:
            break
        heap[place] = heap[parent]
        place = parent
    heap[place] = item


@compiled
def _sink(heap: NDArray[np.int32], size: int, place: int, rank: NDArray[np.int32]) -> None:
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
    _rise(heap, top, place, rank)


@compiled
def push(heap: NDArray[np.int32], size: int, item: int, rank: NDArray[np.int32]) -> int:
    """Add an item to a heap of the given size; return the new size."""
    heap[size] = item
    _rise(heap, 0, size, rank)
    return size + 1


@compiled
def pop(heap: NDArray[np.int32], size: int, rank: NDArray[np.int32]) -> int:
    """Take the item of lowest rank from a heap of the given size, which shrinks by one."""
    last = heap[size - 1]
    if size == 1:
        return int(last)
    item = heap[0]
    heap[0] = last
    _sink(heap, size - 1, 0, rank)
    return int(item)


@compiled
def heapify(heap: NDArray[np.int32], size: int, rank: NDArray[np.int32]) -> None:
    """Restore the order after ranks have changed."""
    for place in range(size // 2 - 1, -1, -1):
        _sink(heap, size, place, rank)
