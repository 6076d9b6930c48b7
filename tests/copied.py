"""Ways to copy, and a comparison of how an object and its copy refer to arrays."""

import copy
import functools
import pickle
import types

import cloudpickle
import mujoco
import numpy as np
from numpy.lib.array_utils import byte_bounds


def by_pickle(original):
    return pickle.loads(pickle.dumps(original))


def by_cloudpickle(original):
    return cloudpickle.loads(cloudpickle.dumps(original))


WAYS = (copy.copy, copy.deepcopy, by_pickle, by_cloudpickle)


def numbers_of(data: mujoco.MjData) -> dict[str, bytes]:
    """Return everything public in MjData, but for what tells one MjData from another.

    MuJoCo leaves the places of a sparse Jacobian's numbers uninitialized where its Jacobians are dense.
    """
    numbers = {}
    for name in dir(data):
        if name.startswith("efc_J_"):
            continue
        value = getattr(data, name)
        if isinstance(value, np.ndarray):
            numbers[name] = value.tobytes()
        elif isinstance(value, int | float) and name not in ("_address", "signature"):
            numbers[name] = repr(value).encode()
    return numbers


def arrays_of(root: object) -> dict[str, np.ndarray]:
    """Return all arrays that an object refers to, by the way that leads there; MuJoCo's objects are not entered.

    Nor are starts at rest, which all worlds of a process share and only read.
    """
    arrays: dict[str, np.ndarray] = {}
    entered: set[int] = set()
    left: list[tuple[str, object]] = [("", root)]
    while left:
        path, value = left.pop()
        if isinstance(value, np.ndarray):
            arrays[path] = value
            if value.dtype != object:
                continue
        if id(value) in entered or isinstance(value, type | types.ModuleType | str | bytes):
            continue
        entered.add(id(value))
        left += [(f"{path}{name}", part) for name, part in _parts(value)]
    return arrays


def _parts(value):
    if isinstance(value, dict):
        yield from ((f"[{key!r}]", part) for key, part in value.items())
    elif isinstance(value, list | tuple | set | frozenset):
        yield from ((f"[{number}]", part) for number, part in enumerate(value))
    elif isinstance(value, functools.partial):
        yield from ((".func", value.func), (".args", value.args), (".keywords", value.keywords))
    elif isinstance(value, types.MethodType):
        yield ".__self__", value.__self__
    elif isinstance(value, types.FunctionType):
        yield from (
            (f".cell{n}", cell.cell_contents) for n, cell in enumerate(value.__closure__ or ())
        )
    elif type(value).__module__.startswith("craftsim.compiled.jit"):
        return
    members = getattr(value, "__dict__", {})
    yield from ((f".{name}", part) for name, part in members.items() if name != "_rested")


def shared_memory(arrays: dict[str, np.ndarray]) -> set[frozenset[str]]:
    """Return which arrays lie in the same memory, by their ways."""
    places = sorted((*byte_bounds(array), path) for path, array in arrays.items() if array.size)
    groups: list[list[str]] = []
    furthest = -1
    for start, end, path in places:
        if start >= furthest:
            groups.append([])
        groups[-1].append(path)
        furthest = max(furthest, end)
    return {frozenset(group) for group in groups}


def in_common(arrays: dict[str, np.ndarray], others: dict[str, np.ndarray]) -> set[str]:
    """Return the ways to arrays that can be written to, and lie in memory of other ones that can."""
    places = [
        byte_bounds(array) for array in others.values() if array.size and array.flags.writeable
    ]
    found = set()
    for path, array in arrays.items():
        if array.size and array.flags.writeable:
            start, end = byte_bounds(array)
            if any(start < other_end and other_start < end for other_start, other_end in places):
                found.add(path)
    return found
