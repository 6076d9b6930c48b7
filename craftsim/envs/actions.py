"""What cars are told to do: checked before a tick, and judged after it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.actions import Action
from craftsim.discrete.errors import InputError

N_ACTIONS = len(Action)


def checked(actions: Any, shape: tuple[int, ...]) -> NDArray[np.int64]:
    """Return actions as integers of this shape, whose last dimension is the cars.

    Raises InputError for another shape, and for anything but whole numbers from 0 to 14.
    """
    try:
        told = np.asarray(actions)
    except ValueError as error:  # rows of different lengths
        raise InputError(f"actions must have shape {shape}, not {actions}") from error
    if told.shape != shape:
        raise InputError(f"actions must have shape {shape}, not {told.shape}")
    if told.dtype.kind not in "iu" or (told < 0).any() or (told >= N_ACTIONS).any():
        raise InputError(f"actions must be whole numbers from 0 to {N_ACTIONS - 1}, not {actions}")
    return told.astype(np.int64)


def illegal(
    told: NDArray[np.int64],
    applied: NDArray[np.bool_],
    offered: NDArray[np.integer],
    queued: NDArray[np.bool_] | None,
) -> NDArray[np.bool_]:
    """Return (..., n): which cars were told what is forbidden, and therefore did nothing.

    Args:
        told: (..., n) the actions.
        applied: (..., n) whether the rules allowed what came of each when the car's turn came.
        offered: (..., n, 15) the masks before the tick.
        queued: (..., n) which cars went on with what the action helper had queued; None without the helper.
    """
    forbidden = ~applied
    if queued is not None:
        # A helper that finds no way makes a STOP of a move, which is legal but not what was asked for.
        unoffered = np.take_along_axis(offered, told[..., None], -1)[..., 0] == 0
        forbidden |= unoffered & ~queued
    wrong: NDArray[np.bool_] = forbidden & (told != Action.STOP)
    return wrong
