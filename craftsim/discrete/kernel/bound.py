"""Compiled functions that are bound to their arrays.

A call from Python takes each of its arguments apart anew, 0.1 us an array, and twice as long where other code has run
in between. What is called with the same arrays thousands of times is bound to them once; a call then takes one argument
apart.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import lru_cache, partial
from typing import Any

import numpy as np
from llvmlite import ir
from numba.core import config, types
from numba.extending import intrinsic
from numba.np.arrayobj import make_array, populate_array
from numba.np.numpy_support import from_dtype

from craftsim.discrete.kernel.jit import compiled


def bound(function: Callable[..., Any], *first: Any) -> Callable[..., Any]:
    """Return a compiled function with its first arguments, arrays and tuples of them, as ``functools.partial`` does.

    The arrays are in C order and stay where they are; they are kept alive. A call releases the interpreter's lock.
    """
    if config.DISABLE_JIT:
        return partial(function, *first)
    arrays = list(_arrays(first))
    numbers = [number for array in arrays for number in (array.ctypes.data, *array.shape)]
    call: Any = partial(_entry(function, _kind(first)), np.array(numbers, np.int64))
    call.kept = first
    result: Callable[..., Any] = call
    return result


def _arrays(arguments: Any) -> Iterator[Any]:
    """Yield all arrays of nested tuples."""
    for one in arguments:
        if isinstance(one, tuple):
            yield from _arrays(one)
        else:
            assert one.flags.c_contiguous
            yield one


def _kind(argument: Any) -> Any:
    """Return what says of which types an argument is: as :func:`_type` takes it, and hashable."""
    if isinstance(argument, tuple):
        return type(argument), tuple(map(_kind, argument))
    return argument.dtype, argument.ndim


def _type(kind: Any) -> types.Type:
    """Return numba's type of an array or a tuple."""
    first, second = kind
    if isinstance(first, np.dtype):
        return types.Array(from_dtype(first), second, "C")
    return types.BaseTuple.from_types(list(map(_type, second)), None if first is tuple else first)


@lru_cache(maxsize=64)
def _entry(function: Callable[..., Any], kind: Any) -> Callable[..., Any]:
    """Return a compiled function of where arrays lie and how long they are, and of all other arguments."""
    arguments = _type(kind)

    def arrays_at(context: Any, places: types.Type) -> Any:
        def build(context: Any, builder: ir.IRBuilder, signature: Any, given: Any) -> Any:
            numbers = make_array(places)(context, builder, given[0]).data
            n_read = 0

            def read() -> Any:
                nonlocal n_read
                n_read += 1
                return builder.load(builder.gep(numbers, [ir.IntType(64)(n_read - 1)]))

            def make(kind: types.Type) -> Any:
                if isinstance(kind, types.BaseTuple):
                    return context.make_tuple(builder, kind, [make(one) for one in kind])
                array = make_array(kind)(context, builder)
                data, shape = builder.inttoptr(read(), array.data.type), [read() for _ in range(kind.ndim)]
                size = ir.IntType(64)(context.get_abi_sizeof(context.get_data_type(kind.dtype)))
                strides = [size]
                for length in reversed(shape[1:]):
                    strides.insert(0, builder.mul(strides[0], length))
                populate_array(array, data=data, shape=shape, strides=strides, itemsize=size, meminfo=None)
                return array._getvalue()

            return make(arguments)

        return arguments(places), build

    # What is compiled is kept by the names of what it refers to.
    arrays_at.__qualname__ = f"arrays_at {arguments}"
    arrays = intrinsic(arrays_at)

    @compiled(nogil=True)
    def entry(places: Any, *others: Any) -> Any:
        return function(*(arrays(places) + others))

    return entry
