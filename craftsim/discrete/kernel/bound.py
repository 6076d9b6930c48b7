"""Compiled functions that are bound to their arrays.

Each call from Python unpacks every argument: 0.1 us an array, and over 10 us a named tuple. A function that is called
thousands of times with the same arrays is bound to them once; a call then unpacks one argument.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import lru_cache, partial
from typing import Any, Final

import numpy as np
from llvmlite import ir
from numba.core import config, types
from numba.extending import intrinsic
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
    call: Any = partial(_entry(function, _type(first)), np.array(numbers, np.int64))
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


def _type(argument: Any) -> types.Type:
    """Return numba's type of an array or a tuple."""
    if isinstance(argument, tuple):
        named = None if type(argument) is tuple else type(argument)
        return types.BaseTuple.from_types(list(map(_type, argument)), named)
    return types.Array(_element(argument.dtype), argument.ndim, "C")


_element: Final = lru_cache(maxsize=64)(from_dtype)


@lru_cache(maxsize=64)
def _entry(function: Callable[..., Any], arguments: types.Type) -> Callable[..., Any]:
    """Return a compiled function of where arrays lie and how long they are, and of all other arguments."""

    def arrays_at(context: Any, places: types.Type) -> Any:
        def build(context: Any, builder: ir.IRBuilder, signature: Any, given: Any) -> Any:
            from numba.np.arrayobj import make_array, populate_array  # slow to import

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
