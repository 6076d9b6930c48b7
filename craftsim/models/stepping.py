"""MuJoCo's step in compiled code, many without Python between them; an error of MuJoCo's in one is an exception.

MuJoCo ends the process where one of its C functions finds an error, unless its caller takes that. Its Python bindings
do, and so does ``mjb_apply`` of its C interface: of a batch, here one of an empty world, it runs a function that it is
given, and says whether there was an error. No layout of MuJoCo's structures is assumed. Releases before 3.17 have no
batches; there each step is a call of the bindings, as in plain Python.
"""

from __future__ import annotations

import ctypes
import weakref
from collections.abc import Callable
from functools import partial
from typing import Final

import mujoco
import numpy as np
from numba.core import config, types
from numpy.typing import NDArray

from craftsim.compiled.arrays import Ints
from craftsim.compiled.jit import address_of, compiled
from craftsim.models.distant import Distant, WatchedArrays, leave_out, look_again, put_back
from craftsim.models.library import LIBRARY, words_at
from craftsim.workers.copying import NotCopyable

_EMPTY_BYTES: Final = 1024
_ONE_THREAD: Final = (1, 0)
"""``mjBatchConfig``: an integer and a truth value, of how many threads, and whether these stay."""
_POINTER: Final = ctypes.c_void_p
_HAS_BATCHES: Final = hasattr(LIBRARY, "mjb_apply")
if _HAS_BATCHES:
    LIBRARY.mjb_makeBatch.restype = _POINTER
    LIBRARY.mjb_makeBatch.argtypes = _POINTER, ctypes.c_int, _POINTER, _POINTER, ctypes.c_int
    LIBRARY.mjb_deleteBatch.argtypes = (_POINTER,)
    LIBRARY.mjb_error.restype = ctypes.c_char_p
    LIBRARY.mjb_error.argtypes = (_POINTER, ctypes.c_int)
    LIBRARY.mjb_apply.argtypes = _POINTER, _POINTER, ctypes.c_int, _POINTER, _POINTER, ctypes.c_int
_word: Final = types.int64
_int: Final = types.int32
_mj_step: Final = types.ExternalFunction("mj_step", types.void(_word, _word))
_apply: Final = types.ExternalFunction("mjb_apply", _int(_word, _word, _int, _word, _word, _int))


@compiled(inline=False)
def _step(model: int, data: int, number: int, world: int) -> int:
    """Step the world whose model and data are at an address, for a batch whose own model and data are empty."""
    addresses = words_at(world)
    _mj_step(addresses[0], addresses[1])
    return 0


class Stepping(NotCopyable):
    """The steps of one world."""

    _instead = "copy its PhysicsWorld"

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, most_iterations: int) -> None:
        """Step a world; count steps in which a solver needs so many iterations."""
        self._world = model, data
        self.distant = Distant(model, data)
        watched = self.distant.watched
        self._run: Callable[[bool, int], int] = partial(
            _run_in_python, model, data, watched, most_iterations
        )
        if config.DISABLE_JIT or not _HAS_BATCHES:
            return
        spec = mujoco.MjSpec()
        spec.memory = _EMPTY_BYTES
        empty = spec.compile()
        self._batch = LIBRARY.mjb_makeBatch(
            empty._address, 1, (ctypes.c_int * 2)(*_ONE_THREAD), None, 0
        )
        weakref.finalize(self, LIBRARY.mjb_deleteBatch, self._batch)
        self._addresses = np.array([model._address, data._address], np.int64)
        step = address_of(_step, (_word,) * 4)
        self._call = np.array([self._batch, step, self._addresses.ctypes.data], np.int64)
        """Arguments of mjb_apply: the batch, the function, and what that takes."""
        limit = np.array([most_iterations], np.int64)
        self._run = partial(_run_steps, self._call, data.solver_niter, limit, watched)

    def run(self, n_steps: int) -> int:
        """Run physics steps; return in how many a solver gave up. Raises FatalError as MuJoCo does."""
        n_capped = self._run(self.distant.is_on, n_steps)
        if n_capped < 0:
            raise mujoco.FatalError(LIBRARY.mjb_error(self._batch, 0).decode())
        return n_capped


def _run_in_python(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    watched: WatchedArrays,
    most_iterations: int,
    is_watched: bool,
    n_steps: int,
) -> int:
    n_capped = 0
    try:
        if is_watched:
            leave_out(watched)
        for _ in range(n_steps):
            if is_watched:
                look_again(watched)
            mujoco.mj_step(model, data)
            n_capped += int(data.solver_niter.max() >= most_iterations)
    finally:
        put_back(watched)
    return n_capped


@compiled
def _run_steps(
    call: NDArray[np.int64],
    iterations: Ints,
    limit: NDArray[np.int64],
    watched: WatchedArrays,
    is_watched: bool,
    n_steps: int,
) -> int:
    """Step so often; return in how many steps a solver gave up, -1 for an error in one."""
    n_capped = 0
    if is_watched:
        leave_out(watched)
    for _ in range(n_steps):
        if is_watched:
            look_again(watched)
        if _apply(call[0], 0, 0, call[1], call[2], 0):
            n_capped = -1
            break
        largest = iterations[0]
        for island in range(len(iterations)):
            largest = max(largest, iterations[island])
        n_capped += largest >= limit[0]
    put_back(watched)
    return n_capped
