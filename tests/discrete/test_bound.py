"""Compiled functions bound to their arrays."""

import weakref
from typing import Any, NamedTuple

import numpy as np

from craftsim.discrete.kernel.bound import bound
from craftsim.discrete.kernel.jit import compiled, records

THING = np.dtype([("number", "i8"), ("weights", "f8", (2,))], align=True)


class Table(NamedTuple):
    """Arrays that belong together."""

    rows: Any
    things: Any


@compiled
def _add(table: Table, out: Any, factor: float) -> int:
    for row in range(len(table.rows)):
        for column in range(table.rows.shape[1]):
            out[row] += factor * table.rows[row, column]
    table.things[1].number += 1
    return len(table.things) + len(out)


def test_a_bound_function_works_on_the_arrays_themselves():
    rows, things, out = np.arange(6.0).reshape(2, 3), records(3, THING), np.zeros(2)
    add = bound(_add, Table(rows, things), out)
    assert add(2.0) == 5
    rows[1] = 0.0
    assert add(1.0) == 5
    assert out.tolist() == [9.0, 24.0]
    assert things["number"].tolist() == [0, 2, 0]


def test_the_arrays_live_as_long_as_what_is_bound_to_them():
    rows, out = np.ones((1, 1)), np.zeros(1)
    gone = weakref.ref(rows)
    add = bound(_add, Table(rows, records(2, THING)), out)
    del rows
    add(1.0)
    assert gone() is not None
    assert out[0] == 1.0
    del add
    assert gone() is None
